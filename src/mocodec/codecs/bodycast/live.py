"""Bodycast as it happens: a packet a frame, one frame of latency at most, and a lost packet costs little but its frame.

    points ──Sender.push──► packets ──any channel──► Receiver.push ──► points

The first packet carries the model: it must arrive (`Sender.model` gives it again at any time, to whoever joins
late). A pose is sent against an earlier one: of the frames since the key pose, each against the one whose number has
its last binary one taken away (7 against 6, 6 against 4, 4 against the key). So half of all packets are needed by
none, and where one is lost that others need, the body goes on as it was moving until the next that can be read; key
poses come twice a second. Pictures of the moving surface are each sent against the model's own, so that none needs
another.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry import articulation
from ...geometry.articulation import Floats, Pose
from .. import body_stream
from . import Bodycast, Role, poses, video
from . import model as models
from .atlas import Sums, picture
from .follow import FEWEST, Cloud, Follower
from .poses import Integers
from .stage import Actor

MODEL, KEY, POSE, NOBODY, PICTURE = range(5)
KEY_EVERY = 16  # frames from one key pose to the next
REMEMBERED = 0.6  # of what a cell of the moving surface held counts on from frame to frame
AS_FIRST = 3.0  # points that the first picture counts for in each cell


def sealed(packet: bytes) -> bytes:
    """The packet with a checksum of two bytes behind it."""
    return packet + (zlib.crc32(packet) & 0xFFFF).to_bytes(2, "little")


@dataclass
class Sender:
    """Packets of frames of one person. skeleton, pose_step, points, cells, surface_quality, tracked_points: as in
    `Bodycast`. up: the vertical axis. picture_every: frames from one picture of the moving surface to the next; 0 sends
    none.
    """

    skeleton: Any = None
    up: str = "y"
    pose_step: float = 0.003
    points: int | None = None
    cells: int = 10_000
    surface_quality: int = 30
    tracked_points: int = 2500
    picture_every: int = 0
    model: bytes = b""
    """The packet with the model; empty until a frame has shown a body."""
    _role: Role | None = None
    _sums: Sums | None = None
    _number: int = 0
    _key: int = 0
    _sent: dict[int, Integers] = field(default_factory=dict)

    def push(self, points: Floats, colours: NDArray[np.uint8] | None = None) -> list[bytes]:
        """The packets of one frame of points (n, 3), metres: one, before the first body the model's too, and now and
        then one with a picture.

        Raises CannotEncode where the first frame with points shows no body and no skeleton is given.
        """
        good = body_stream.is_here(points)
        points, colours = points[good], None if colours is None else colours[good]
        number, self._number = self._number, self._number + 1
        if len(points) < FEWEST:
            return [sealed(varint.write([NOBODY, number]))]
        packets = list[bytes]()
        if self._role is None:
            packets.append(self._begin(points, colours, number))
        else:
            self._role.follower.fit(points, colours, number)
        assert self._role is not None
        follower, scale = self._role.follower, self._role.model.scale
        last = self._sent.get(number - 1, next(reversed(self._sent.values()), None))
        before = np.zeros(3 + 3 * len(follower.body), np.int64) if last is None else last
        now = poses.quantise(follower.body, follower.tracker.pose, scale, before)
        if self.picture_every:
            packets += self._picture(points, colours, number, poses.dequantise(follower.body, now, scale))
        if not self._sent or number - self._key >= KEY_EVERY:
            self._key, self._sent = number, {number: now}
            return [*packets, sealed(varint.write([KEY, number]) + coder.pack(_column(now)))]
        back = _reference(number - self._key)
        while number - back not in self._sent:  # nobody was there then
            back += _reference(number - back - self._key)
        difference = now - self._sent[number - back]
        self._sent[number] = now
        return [*packets, sealed(varint.write([POSE, number, back]) + coder.pack(_column(difference)))]

    def _begin(self, points: Floats, colours: NDArray[np.uint8] | None, number: int) -> bytes:
        """The first body's model."""
        follower = Follower(points, colours, self.skeleton, self.up, self.tracked_points)
        role = Role(follower)
        role.watch(0, (points, colours), started=False)
        codec = Bodycast(
            pose_step=self.pose_step, points=self.points, cells=self.cells, surface_quality=self.surface_quality
        )  # fmt: skip
        role.prepare(codec, len(points), colours is not None, 1)
        role.clouds.clear()
        self._role = role
        self._sums = Sums.showing(role.model.atlas, role.planes, AS_FIRST)
        self.model = sealed(varint.write([MODEL]) + models.pack(role.model))
        return self.model

    def _picture(self, points: Floats, colours: NDArray[np.uint8] | None, number: int, pose: Pose) -> list[bytes]:
        """What was seen joins the moving surface; its picture where one is due."""
        assert self._role is not None
        assert self._sums is not None
        atlas = self._role.model.atlas
        follower = self._role.follower
        seen = follower.sight(follower.look_closely(points, colours, number), pose)
        self._sums.gather(atlas, seen.points, seen.links, seen.colours, REMEMBERED)
        if number % self.picture_every:
            return []
        both = [self._role.planes, picture(atlas, self._sums)]
        return [
            sealed(varint.write([PICTURE, number]) + video.encode(both, self.surface_quality, self.surface_quality)[1])
        ]


def _reference(offset: int) -> int:
    """How far back the frame is that a frame so far behind its key pose is sent against."""
    return offset & -offset


def _column(steps: Integers) -> Integers:
    """Steps (3 + 3 links,) as they are coded: the axes of all joints beside one another."""
    return steps.reshape(-1, 3)


@dataclass
class Receiver:
    """Points of packets. `pose` and `number` are those of the last packet understood."""

    pose: Pose | None = None
    number: int = -1
    _actor: Actor | None = None
    _shown: tuple[Floats, NDArray[np.uint8]] | None = None
    _pictured: int = -1
    _known: dict[int, Integers] = field(default_factory=dict)
    _before: Pose | None = None
    _model: bytes = b""

    def push(self, packet: bytes) -> Cloud | None:
        """The frame of one packet; None for a model or a picture, and for a pose whose model has not come.

        A packet that comes late, twice, or that needs one that was lost is answered by the frame that was to be
        expected. Raises Corrupt for a packet that is damaged; the next one still works.
        """
        if len(packet) < 3 or sealed(packet[:-2]) != packet:
            raise Corrupt("bodycast: a damaged packet")
        packet = packet[:-2]
        (kind,), at = varint.read(packet, 1)
        if kind == MODEL:
            if packet[at:] != self._model:
                self._actor, self._model = Actor(models.unpack(packet[at:])), packet[at:]
                self._known.clear()
                self._shown = None
            return None
        if kind not in (KEY, POSE, NOBODY, PICTURE):
            raise Corrupt("bodycast: a packet of an unknown kind")
        (number,), at = varint.read(packet, 1, at)
        if self._actor is None:
            return None
        if kind == PICTURE:
            self._show(number, packet[at:])
            return None
        if kind == NOBODY:
            self.number = max(self.number, number)
            return np.zeros((0, 3)), np.zeros((0, 3), np.uint8) if self._actor.model.coloured else None
        (back,), at = varint.read(packet, 1, at) if kind == POSE else ([0], at)
        against = self._known.get(number - back)
        if number <= self.number or (kind == POSE and against is None):
            return self.conceal()
        values = coder.unpack(packet[at:], (1 + len(self._actor.body), 3)).reshape(-1)
        steps = values if against is None else values + against
        self._known = {number: steps} if kind == KEY else {**self._known, number: steps}
        if len(self._known) > 4 * KEY_EVERY:
            raise Corrupt("bodycast: too many poses without a key")
        pose = poses.dequantise(self._actor.body, steps, self._actor.model.scale)
        self._before = self.pose if number == self.number + 1 else None
        self.pose, self.number = pose, number
        return self._posed()

    def conceal(self) -> Cloud | None:
        """The frame that is to be expected where a packet is missing: the body half as fast as it was moving."""
        if self._actor is None or self.pose is None:
            return None
        if self._before is not None:
            step = articulation.log(self._before.rotations.transpose(0, 2, 1) @ self.pose.rotations) / 2
            root = self.pose.root + (self.pose.root - self._before.root) / 2
            self._before, self.pose = self.pose, Pose(self.pose.rotations @ articulation.exp(step), root)
        return self._posed()

    def _show(self, number: int, packet: bytes) -> None:
        """A newer picture of the surface."""
        if self._actor is None or number <= self._pictured:
            return
        *_, planes = video.decode([self._actor.model.key, packet], self._actor.model.atlas.picture_shape)
        self._shown, self._pictured = self._actor.weave.surface(planes), number

    def _posed(self) -> Cloud:
        assert self._actor is not None
        assert self.pose is not None
        colours = self._actor.colours if self._shown is None else self._shown[1]
        rig = self._actor.rig if self._shown is None else self._actor.rig.with_points(self._shown[0])
        points = rig.posed(*articulation.transforms(self._actor.body, self.pose))
        return points, colours if self._actor.model.coloured else None
