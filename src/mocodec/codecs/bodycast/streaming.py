"""Live use: a packet a frame with at most one frame of latency, over a channel that may lose packets.

    points ──Sender.push──► packets ──any channel──► Receiver.push ──► points of the body's surface, or all points

The first packet carries the model. It must arrive; `Sender.model` repeats it for receivers that join late. Poses are
coded as differences from an earlier pose. Within a group of KEY_INTERVAL frames, counted from its key pose, frame n
refers to n without its lowest one bit: 7 to 6, 6 to 4, 4 to the key pose. So no frame refers to the odd half of the
packets. After a loss the receiver extrapolates the motion until the next pose that it can decode. Pictures of the
changing surface refer to the model's key picture only.

Within a bound, a packet carries all points of its frame and the pose that they are coded from. It needs the model and
no other packet.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...entropy import coder, varint
from ...errors import CannotEncode, Corrupt
from ...geometry import articulation
from ...geometry.articulation import Pose
from ...pointcloud import PointClouds
from ...typing import Bytes, Floats, Integers
from ..clouds.raw_frames import Cloud, is_usable, no_points
from . import video
from .body_model import unpack_model
from .codec import Bodycast
from .decoder import BodyDecoder
from .encoder import BodyEncoder
from .point_packets import PointBody, decode_points, pack_points, split_parts
from .pose_stream import dequantise_pose, quantise_pose
from .texture_atlas import CellSums, atlas_planes
from .tracking import MIN_BODY_POINTS, PersonTracker

MODEL, KEY_POSE, POSE, NO_BODY, PICTURE, POINTS = range(6)  # kinds of packets
KEY_INTERVAL = 16  # frames
FIRST_WAIT = 16  # frames until a body is looked for again, twice as many each time
MAX_KNOWN_POSES = 4 * KEY_INTERVAL
KEEP = 0.6  # factor on the old sums of a cell of the surface when new points fall into it
FIRST_WEIGHT = 3.0  # points that the key picture counts for in each cell
CHECKSUM_BYTES, MIN_PACKET_BYTES = 2, 3


def with_checksum(content: bytes) -> bytes:
    """The packet with this content: two bytes of its CRC-32 follow it."""
    return content + (zlib.crc32(content) & 0xFFFF).to_bytes(CHECKSUM_BYTES, "little")


@dataclass
class Sender:
    """Packets of frames of one person.

    skeleton, pose_step, points, cells, surface_quality, tracked_points: as in `Bodycast`. up: the vertical axis.
    picture_every: frames from one picture of the changing surface to the next; 0 sends none. max_error: no point is
    farther from the nearest decoded point than this, and no decoded point from the nearest point, metres; None: packets
    carry the pose of the body's surface, and no points. Raises BadInput for settings that cannot be used.
    """

    skeleton: Any = None
    up: str = "y"
    pose_step: float = 0.003
    points: int | None = None
    cells: int = 10_000
    surface_quality: int = 30
    tracked_points: int = 2500
    picture_every: int = 0
    max_error: float | None = None
    model: bytes = b""
    """The packet with the model; empty until a frame has shown a body."""
    _body: BodyEncoder | None = None
    _sums: CellSums | None = None
    _next_frame: int = 0
    _key_frame: int = 0
    _sent: dict[int, Integers] = field(default_factory=dict)  # poses since the key pose, by frame
    _next_search: int = 0  # frame from which a body is looked for
    _wait: int = FIRST_WAIT

    def __post_init__(self) -> None:
        self._codec.require_settings()

    def push(self, points: Floats, colours: Bytes | None = None) -> list[bytes]:
        """The packets of one frame: points (n, 3) metres, colours (n, 3). Points that are not finite are left out.

        One packet for the frame; before the first pose the model's too, and every `picture_every` frames a picture.
        Raises CannotEncode if the first frame with points shows no body, no skeleton is given and there is no bound;
        BadInput for arrays of other shapes.
        """
        PointClouds([points], 1.0, None if colours is None else [colours])  # checks both
        usable = is_usable(points)
        cloud = points[usable], None if colours is None else colours[usable]
        frame, self._next_frame = self._next_frame, self._next_frame + 1
        had_body = self._body is not None
        body = self._follow(cloud, frame) if len(cloud[0]) >= MIN_BODY_POINTS else None
        packets = [self.model] if body is not None and not had_body else []
        pose = None if body is None else self._pose(body, frame)
        if body is not None and pose is not None and self.picture_every:
            packets += self._picture(body, cloud, frame, dequantise_pose(body.person.body, pose, body.model.pose_steps))
        return [*packets, self._frame_packet(frame, cloud, body, pose)]

    @property
    def _codec(self) -> Bodycast:
        """The codec of recordings with these settings."""
        return Bodycast(
            max_error=self.max_error, pose_step=self.pose_step, points=self.points, cells=self.cells,
            surface_quality=self.surface_quality, tracked_points=self.tracked_points,
        )  # fmt: skip

    def _follow(self, cloud: Cloud, frame: int) -> BodyEncoder | None:
        """The body, moved to this frame, or found in it; None where a stream within a bound has none."""
        if self._body is not None:
            self._body.person.fit(cloud, frame)
        elif frame >= self._next_search:
            try:
                self._body = self._start(cloud)
            except CannotEncode:
                if self.max_error is None or self.skeleton is not None:
                    raise
                self._next_search, self._wait = frame + self._wait, 2 * self._wait
        return self._body

    def _pose(self, body: BodyEncoder, frame: int) -> Integers:
        """The pose of the body in steps; its angles continue from those of the pose sent before."""
        person = body.person
        latest = self._sent.get(frame - 1, next(reversed(self._sent.values()), None))
        previous = np.zeros(3 + 3 * len(person.body), np.int64) if latest is None else latest
        return quantise_pose(person.body, person.tracker.pose, body.model.pose_steps, previous)

    def _frame_packet(self, frame: int, cloud: Cloud, body: BodyEncoder | None, pose: Integers | None) -> bytes:
        """The packet that shows a frame. pose: of the body in it."""
        if self.max_error is not None:
            coded_from = None if body is None else PointBody(body.model, body.texture)
            content = pack_points(cloud, self.max_error, coded_from, pose)
            return with_checksum(varint.write([POINTS, frame]) + content)
        return with_checksum(varint.write([NO_BODY, frame])) if pose is None else self._pose_packet(frame, pose)

    def _pose_packet(self, frame: int, pose: Integers) -> bytes:
        if not self._sent or frame - self._key_frame >= KEY_INTERVAL:
            self._key_frame, self._sent = frame, {frame: pose}
            return with_checksum(varint.write([KEY_POSE, frame]) + coder.pack(_rows(pose)))
        back = _reference_distance(frame - self._key_frame)
        while frame - back not in self._sent:  # that frame showed no body
            back += _reference_distance(frame - back - self._key_frame)
        difference = pose - self._sent[frame - back]
        self._sent[frame] = pose
        return with_checksum(varint.write([POSE, frame, back]) + coder.pack(_rows(difference)))

    def _start(self, cloud: Cloud) -> BodyEncoder:
        """The encoder of the first body, and its model."""
        points, colours = cloud
        body = BodyEncoder(PersonTracker(cloud, self.skeleton, self.up, self.tracked_points))
        body.add_frame(0, cloud, is_tracked=False)
        body.build_model(self._codec.parameters, len(points), colours is not None, is_only_body=True)
        body.clouds.clear()
        self._sums = CellSums.from_planes(body.model.atlas, body.planes, FIRST_WEIGHT)
        self.model = with_checksum(varint.write([MODEL]) + body.packed_model)
        return body

    def _picture(self, body: BodyEncoder, cloud: Cloud, frame: int, pose: Pose) -> list[bytes]:
        """Adds the frame to the changing surface; the packet of its picture if one is due."""
        assert self._sums is not None
        atlas, person = body.model.atlas, body.person
        seen = person.to_canonical(person.dense_data(cloud, frame), pose)
        self._sums.add(atlas, seen.points, seen.links, seen.colours, KEEP)
        if frame % self.picture_every:
            return []
        pictures = [body.planes, atlas_planes(atlas, self._sums)]
        packet = video.encode(pictures, self.surface_quality, self.surface_quality)[1]
        return [with_checksum(varint.write([PICTURE, frame]) + packet)]


def _reference_distance(offset: int) -> int:
    """Frames from a pose back to its reference, for a pose `offset` frames after the key pose: the lowest one bit."""
    return offset & -offset


def _rows(pose: Integers) -> Integers:
    """(1 + links, 3): the integers of a pose as they are coded."""
    return pose.reshape(-1, 3)


@dataclass
class Receiver:
    """Points of packets. pose, frame: of the last pose decoded; `conceal` extrapolates the pose."""

    pose: Pose | None = None
    frame: int = -1
    _body: BodyDecoder | None = None
    _coded_from: PointBody | None = None
    _surface: tuple[Floats, Bytes] | None = None
    _picture_frame: int = -1
    _known: dict[int, Integers] = field(default_factory=dict)  # poses since the key pose, by frame
    _previous: Pose | None = None
    _model: bytes = b""
    _shown: int = -1  # the latest frame of which a pose packet has yielded points

    def push(self, packet: bytes) -> Cloud | None:
        """The frame of one packet; None for a model or a picture, and for any packet before the model.

        A packet that comes a second time, or after one of a later frame, shows nothing new: None. A late pose is still
        kept as the reference of later ones. A pose whose reference was lost yields the extrapolated frame. Raises
        Corrupt for a damaged packet; the next packet can still be decoded.
        """
        content = packet[:-CHECKSUM_BYTES]
        if len(packet) < MIN_PACKET_BYTES or with_checksum(content) != packet:
            raise Corrupt("bodycast: a packet is damaged: its checksum does not match")
        (kind,), at = varint.read(content, 1)
        if kind == MODEL:
            self._take_model(content[at:])
            return None
        if kind not in (KEY_POSE, POSE, NO_BODY, PICTURE, POINTS):
            raise Corrupt(f"bodycast: a packet of unknown kind {kind}")
        (frame,), at = varint.read(content, 1, at)
        if kind == POINTS:
            return self._take_points(frame, content[at:])
        if self._body is None:
            return None
        if kind == PICTURE:
            self._take_picture(self._body, frame, content[at:])
            return None
        is_new = frame > self._shown
        self._shown = max(self._shown, frame)
        if kind == NO_BODY:
            self.frame = max(self.frame, frame)
            return no_points(self._body.model.coloured) if is_new else None
        (back,), at = varint.read(content, 1, at) if kind == POSE else ([0], at)
        reference = self._known.get(frame - back) if kind == POSE else None
        if frame not in self._known and (kind == KEY_POSE or reference is not None):
            integers = self._take_pose(self._body, frame, content[at:], kind == KEY_POSE, reference)
            if is_new:
                self._show(self._body, frame, integers)
                return self._posed(self._body, self.pose)
        return self.conceal() if is_new else None

    def conceal(self) -> Cloud | None:
        """The extrapolated frame for a packet that is missing, as the body's surface: each time the motion is half as
        fast. None where no body has been seen.
        """
        if self._body is None or self.pose is None:
            return None
        if self._previous is not None:
            step = articulation.log(self._previous.rotations.transpose(0, 2, 1) @ self.pose.rotations) / 2
            root = self.pose.root + (self.pose.root - self._previous.root) / 2
            self._previous, self.pose = self.pose, Pose(self.pose.rotations @ articulation.exp(step), root)
        return self._posed(self._body, self.pose)

    def _take_model(self, data: bytes) -> None:
        """The body of a new stream; a repeated model changes nothing."""
        if data == self._model:
            return
        self._body, self._model = BodyDecoder(unpack_model(data)), data
        self._coded_from = None
        self._known.clear()
        self.pose = self._previous = self._surface = None
        self.frame = self._shown = self._picture_frame = -1

    def _take_picture(self, body: BodyDecoder, frame: int, packet: bytes) -> None:
        """A newer picture of the surface."""
        if frame <= self._picture_frame:
            return
        *_, planes = video.decode([body.model.key_picture, packet], body.model.atlas.image_shape)
        self._surface, self._picture_frame = body.samples.surface(planes), frame

    def _take_points(self, frame: int, data: bytes) -> Cloud | None:
        """The points of a frame, unless a later one has been shown or the model of their body is missing."""
        part = split_parts(data)
        if frame <= self._shown or (part.has_body and self._body is None):
            return None
        pose = None
        if part.has_body and self._body is not None:
            self._coded_from = self._coded_from or PointBody.of(self._body.model)
            pose = self._coded_from.unpack_pose(part.pose)
        cloud = decode_points(part, self._coded_from, pose)
        self._shown = frame
        if self._body is not None and pose is not None:
            self._show(self._body, frame, pose)
        return cloud

    def _take_pose(
        self, body: BodyDecoder, frame: int, data: bytes, is_key: bool, reference: Integers | None
    ) -> Integers:
        """Keep a pose as a reference of later ones, and return it as integers. A key pose later than all others
        replaces them.
        """
        integers = coder.unpack(data, (1 + len(body.body), 3)).reshape(-1)
        if reference is not None:
            integers = integers + reference
        if is_key and frame > max(self._known, default=-1):
            self._known.clear()
        self._known[frame] = integers
        if len(self._known) > MAX_KNOWN_POSES:
            raise Corrupt(f"bodycast: more than {MAX_KNOWN_POSES} poses without a key pose")
        return integers

    def _show(self, body: BodyDecoder, frame: int, integers: Integers) -> None:
        """Make a pose the latest; it has a velocity if the frame before was decoded too."""
        pose = dequantise_pose(body.body, integers, body.model.pose_steps)
        self._previous = self.pose if frame == self.frame + 1 else None
        self.pose, self.frame = pose, frame

    def _posed(self, body: BodyDecoder, pose: Pose | None) -> Cloud:
        assert pose is not None
        colours = body.colours if self._surface is None else self._surface[1]
        skin_matrix = body.skin_matrix if self._surface is None else body.skin_matrix.with_points(self._surface[0])
        points = skin_matrix.posed(*articulation.transforms(body.body, pose))
        return points, colours if body.model.coloured else None
