"""Bodycast as it happens: a packet a frame, one frame of latency at most, and a lost packet costs its own frame alone.

    points ──Sender.push──► packet ──any channel──► Receiver.push ──► points

The first packets carry the model: they must arrive (`Sender.model` gives it again at any time, to whoever joins
late). Every later packet is a pose against the key pose that its number names, so that only key poses are waited for;
where one is lost, or a packet, the body goes on as it was moving until the next key pose.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry import articulation, body_tracking
from ...geometry.articulation import Floats, Pose
from .. import body_stream
from . import (
    FEWEST,
    STEPS,
    Atlas,
    Cloud,
    Integers,
    Model,
    Stage,
    Sums,
    begin,
    pack_model,
    picture,
    sight,
    unpack_model,
    valid_cells,
    video,
)

MODEL, KEY, POSE, NOBODY = range(4)
KEY_EVERY = 15  # frames from one key pose to the next


def sealed(packet: bytes) -> bytes:
    """The packet with a checksum of two bytes behind it."""
    return packet + (zlib.crc32(packet) & 0xFFFF).to_bytes(2, "little")


@dataclass
class Sender:
    """Packets of frames. skeleton, cells, surface_quality: as in `Bodycast`. up: the vertical axis."""

    skeleton: Any = None
    up: str = "y"
    cells: int | None = None
    surface_quality: int = 26
    tracked_points: int = 1000
    model: bytes = b""
    """The packet with the model; empty until a frame has shown a body."""
    _tracker: body_tracking.Tracker | None = None
    _number: int = 0
    _key: tuple[int, Integers] | None = None
    _last: Integers = field(default_factory=lambda: np.zeros(0, np.int64))

    def push(self, points: Floats, colours: NDArray[np.uint8] | None = None) -> list[bytes]:
        """The packets of one frame of points (n, 3), metres: one, and before the first body the model's too.

        Raises CannotEncode where the first frame with points shows no body and no skeleton is given.
        """
        good = np.isfinite(points).all(axis=1)
        points, colours = points[good], None if colours is None else colours[good]
        number, self._number = self._number, self._number + 1
        if len(points) < FEWEST:
            return [sealed(varint.write([NOBODY, number]))]
        packets = list[bytes]()
        if self._tracker is None:
            body, self._tracker = begin(points, colours, self.skeleton, self.up, self.tracked_points)
            pose = self._tracker.pose
            seen = sight(self._tracker, self._tracker.see(points, colours, number, len(points)), pose)
            atlas = Atlas.plan(body, seen.points, seen.links, self.cells or len(points))
            sums = Sums.empty(atlas)
            sums.gather(atlas, seen.points, seen.links, seen.colours)
            key = video.encode([picture(atlas, sums)], self.surface_quality, self.surface_quality)[0]
            model = Model(atlas, valid_cells(atlas, sums), key, colours is not None)
            self.model = sealed(varint.write([MODEL]) + pack_model(model))
            self._last = np.zeros(3 + 3 * len(body), np.int64)
            packets.append(self.model)
        else:
            pose = self._tracker.fit(points, colours, number).pose
        self._last = body_stream.quantise(self._tracker.body, pose, STEPS, self._last)
        if self._key is None or number - self._key[0] >= KEY_EVERY:
            self._key = number, self._last
            return [*packets, sealed(varint.write([KEY, number]) + coder.pack(self._last[None]))]
        back = number - self._key[0]
        return [sealed(varint.write([POSE, number, back]) + coder.pack((self._last - self._key[1])[None]))]


@dataclass
class Receiver:
    """Points of packets. `pose` and `number` are those of the last packet understood."""

    pose: Pose | None = None
    number: int = -1
    _stage: Stage | None = None
    _keys: dict[int, Integers] = field(default_factory=dict)
    _before: Pose | None = None
    _model: bytes = b""

    def push(self, packet: bytes) -> Cloud | None:
        """The frame of one packet; None for a model, and for a pose whose model has not come.

        A packet that comes late, twice, or whose key pose was lost is answered by the frame that was to be expected.
        Raises Corrupt for a packet that is damaged; the next one still works.
        """
        if len(packet) < 3 or sealed(packet[:-2]) != packet:
            raise Corrupt("bodycast: a damaged packet")
        packet = packet[:-2]
        (kind,), at = varint.read(packet, 1)
        if kind == MODEL:
            if packet[at:] != self._model:
                self._stage, self._model = Stage(unpack_model((packet[at:],))), packet[at:]
                self._keys.clear()
            return None
        if kind not in (KEY, POSE, NOBODY):
            raise Corrupt("bodycast: a packet of an unknown kind")
        (number,), at = varint.read(packet, 1, at)
        if self._stage is None:
            return None
        if kind == NOBODY:
            self.number = max(self.number, number)
            return np.zeros((0, 3)), np.zeros((0, 3), np.uint8) if self._stage.model.coloured else None
        (back,), at = varint.read(packet, 1, at) if kind == POSE else ([0], at)
        shape = 1, 3 + 3 * len(self._stage.body)
        key = self._keys.get(number - back)
        if number <= self.number or (kind == POSE and key is None):
            return self.conceal()
        values = coder.unpack(packet[at:], shape)[0]
        if kind == KEY:
            self._keys = {number: values}
        pose = body_stream.dequantise(self._stage.body, values if key is None else values + key, STEPS)
        self._before = self.pose if number == self.number + 1 else None
        self.pose, self.number = pose, number
        return self._stage.posed(pose)

    def conceal(self) -> Cloud | None:
        """The frame that is to be expected where a packet is missing: the body half as fast as it was moving."""
        if self._stage is None or self.pose is None:
            return None
        if self._before is not None:
            step = articulation.log(self._before.rotations.transpose(0, 2, 1) @ self.pose.rotations) / 2
            root = self.pose.root + (self.pose.root - self._before.root) / 2
            self._before, self.pose = self.pose, Pose(self.pose.rotations @ articulation.exp(step), root)
        return self._stage.posed(self.pose)
