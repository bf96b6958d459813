"""What the codecs of point clouds of people share: bodies, poses and stray frames as bytes.

Body ──pack_body──► bytes         links in millimetres
Pose ──quantise──► integers ──pack_poses──► bytes         rotation vectors of the joints and the root's translation
points that are no body ──pack_raw──► bytes               frames of a few points, as they are
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..encoded import Encoded
from ..entropy import coder, varint
from ..errors import BadInput, Corrupt, MissingExtra
from ..geometry import articulation
from ..geometry.articulation import Body, Floats, Pose
from ..motion import Motion, Skeleton
from ..pointcloud import PointClouds

Integers = NDArray[np.int64]
MILLIMETRE = 1e-3
FARTHEST = 1e4  # metres from the origin: what is beyond is nobody's
MAX_LINKS, MAX_POINTS, MAX_RAW = 255, 1 << 19, 1 << 24


class Steps(NamedTuple):
    """How finely poses are stored, in metres: the root's place, and how far a turn of one step moves what hangs on
    it.
    """

    reach: float
    place: float

    def turns(self, body: Body) -> Floats:
        """(links,): radians of one step of each joint: the farther the body reaches beyond it, the finer."""
        ends = np.concatenate([body.origins, body.tips])
        away = np.linalg.norm(ends[None] - body.origins[:, None], axis=2)
        lever = np.where(np.tile(body.ancestors, (1, 2)), away, 0.0).max(axis=1)
        return self.reach / np.maximum(lever, 0.05)


def rounded(body: Body) -> Body:
    """The body as its bytes will give it back."""
    body = replace(body, joints=())
    grid = [np.round(values / MILLIMETRE) * MILLIMETRE for values in (body.origins, body.tips, body.radii)]
    return replace(body, origins=grid[0], tips=grid[1], radii=grid[2])


def pack_body(body: Body) -> bytes:
    """Names, parents and links in millimetres."""
    names = zlib.compress("\n".join(body.names).encode(), 9)
    values = np.column_stack([body.origins, body.tips - body.origins, body.radii]) / MILLIMETRE
    rows = np.column_stack([np.array(body.parents) + 1, np.round(values)]).astype(np.int64)
    links = coder.pack(rows)
    return varint.write([len(body), len(names), len(links)]) + names + links


def unpack_body(data: bytes) -> tuple[Body, int]:
    """The body at the start of the bytes and where it ends. Raises Corrupt."""
    (links, name_bytes, link_bytes), at = varint.read(data, 3)
    if not 0 < links <= MAX_LINKS or at + name_bytes + link_bytes > len(data):
        raise Corrupt("the stored body is damaged")
    names = inflate(data[at : at + name_bytes], 1 << 16).decode("utf-8", "replace").split("\n")
    at += name_bytes
    rows = coder.unpack(data[at : at + link_bytes], (links, 8))
    parents = rows[:, 0] - 1
    values = np.asarray(np.clip(rows[:, 1:], -(10**7), 10**7) * MILLIMETRE, np.float64)
    if len(names) != links or (parents >= np.arange(links)).any() or (parents < -1).any() or (parents[1:] < 0).any():
        raise Corrupt("the stored body is damaged")
    origins = values[:, :3]
    body = Body(
        tuple(names), tuple(parents.tolist()), origins, origins + values[:, 3:6], np.maximum(values[:, 6], 1e-3)
    )
    return body, at + link_bytes


def quantise(body: Body, pose: Pose, steps: Steps, previous: Integers) -> Integers:
    """(3 + 3 links,): the root's place and the joints' rotation vectors in steps.

    Each link is turned to where the pose has it in the world, so that a joint makes up for the rounding of those
    above it. Of the vectors of a rotation, the one nearest to the last frame's is taken.
    """
    turns = steps.turns(body)
    wanted, _ = articulation.transforms(body, pose)
    stored = np.empty_like(wanted)
    integers = np.empty((len(body), 3), np.int64)
    for link, parent in enumerate(body.parents):
        above = stored[parent] if parent >= 0 else np.eye(3)
        vector = articulation.log(above.T @ wanted[link])
        last = previous[3 + 3 * link : 6 + 3 * link] * turns[link]
        angle = float(np.linalg.norm(vector))
        if angle > 1e-9:
            unit = vector / angle
            vector = unit * (angle + 2 * np.pi * round((float(last @ unit) - angle) / (2 * np.pi)))
        integers[link] = np.round(vector / turns[link])
        stored[link] = above @ articulation.exp(integers[link] * turns[link])
    return np.concatenate([np.round(pose.root / steps.place).astype(np.int64), integers.ravel()])


def dequantise(body: Body, integers: Integers, steps: Steps) -> Pose:
    """The pose of integers (3 + 3 links,)."""
    values = np.clip(integers, -(10**8), 10**8).astype(np.float64)
    vectors = values[3:].reshape(-1, 3) * steps.turns(body)[:, None]
    return Pose(articulation.exp(vectors), values[:3] * steps.place)


def is_here(points: Floats, within: float = FARTHEST) -> NDArray[np.bool_]:
    """(n,): which points are no NaN and within so many metres of the origin."""
    return np.asarray((np.abs(points) < within).all(axis=1))


def clean(clouds: PointClouds, frame: int, within: float = FARTHEST) -> tuple[Floats, NDArray[np.uint8] | None]:
    """Points and colours of a frame that `is_here` keeps."""
    points = np.asarray(clouds.positions[frame], np.float64)
    colours = None if clouds.colours is None else clouds.colours[frame]
    if points.size and -within < points.min() and points.max() < within:  # false where any is NaN
        return points, colours
    good = is_here(points, within)
    return points[good], None if colours is None else colours[good]


def pack_raw(frames: Sequence[tuple[Floats, NDArray[np.uint8] | None]]) -> bytes:
    """Frames of few points, exactly as 32-bit floats; nothing for no frames."""
    if not frames:
        return b""
    body = b"".join(
        points.astype("<f4").tobytes() + (b"" if colours is None else colours.tobytes()) for points, colours in frames
    )
    counts = varint.write(len(points) for points, _ in frames)
    return counts + zlib.compress(body, 9)


def unpack_raw(data: bytes, frames: int, coloured: bool) -> list[tuple[Floats, NDArray[np.uint8] | None]]:
    """The frames of `pack_raw`. Raises Corrupt."""
    if not frames:
        return []
    counts, at = varint.read(data, frames)
    width = 15 if coloured else 12
    if sum(counts) > MAX_RAW:
        raise Corrupt("a frame of stray points is too large")
    body = inflate(data[at:], sum(counts) * width)
    if len(body) != sum(counts) * width:
        raise Corrupt("a frame of stray points is damaged")
    result, at = [], 0
    for count in counts:
        points = np.frombuffer(body, "<f4", count * 3, at).reshape(count, 3).astype(np.float64)
        at += count * 12
        colours = np.frombuffer(body, np.uint8, count * 3, at).reshape(count, 3) if coloured else None
        at += count * 3 * coloured
        result.append((points, colours))
    return result


def inflate(data: bytes, most: int) -> bytes:
    """Deflated bytes, of which there must not be more than `most`. Raises Corrupt."""
    try:
        inflater = zlib.decompressobj()
        out = inflater.decompress(data, most + 1)
    except zlib.error as error:
        raise Corrupt(f"damaged data ({error})") from None
    if len(out) > most or not inflater.eof:
        raise Corrupt("damaged data: it does not unpack to its size")
    return out


def track(encoded: Encoded[PointClouds], body: Body, poses: Sequence[Pose]) -> Motion:
    """The tracked body as a motion with skeleton and rotations: what can be written as BVH."""
    ends, order, parents = _tree(body)
    place, rest = joints_of_track(body)
    offsets = np.array([rest[i] - rest[p] if p >= 0 else np.zeros(3) for i, p in enumerate(parents)])
    names = (*body.names, *(f"{body.names[link]}_end" for link in ends))
    names = tuple(names[joint] for joint in order)
    positions = np.empty((len(poses), len(order), 3))
    rotations = np.tile([1.0, 0, 0, 0], (len(poses), len(order), 1))
    if poses:
        turns = np.stack([pose.rotations for pose in poses])
        a, b = articulation.transforms(body, Pose(turns, np.stack([pose.root for pose in poses])))
        tips = np.einsum("tlij,lj->tli", a[:, ends], body.tips[ends]) + b[:, ends]
        origins = np.einsum("tlij,lj->tli", a, body.origins) + b
        positions[:] = np.concatenate([origins, tips], axis=1)[:, order]
        rotations[:, place] = articulation.quaternions(turns)
    about = encoded.about
    skeleton = Skeleton(names, parents, offsets)
    return Motion(positions, about.rate, names, up=about.up, skeleton=skeleton, rotations=rotations)


def joints_of_track(body: Body) -> tuple[NDArray[Any], Floats]:
    """(links,): which joint of `track` each link's origin is; (joints, 3): where those stand in the canonical pose."""
    ends, order, _ = _tree(body)
    place = np.array([order.index(link) for link in range(len(body))])
    return place, np.concatenate([body.origins, body.tips[ends]])[order]


def _tree(body: Body) -> tuple[list[int], list[int], tuple[int, ...]]:
    """Links that are last, with a joint at the tip of each, so that the link's turn shows; all joints in the order that
    BVH files need; and their parents.
    """
    ends = [link for link in range(len(body)) if link not in body.parents]
    above = [*body.parents, *ends]
    order = articulation.depth_first_order(above)
    return ends, order, tuple(order.index(above[joint]) if above[joint] >= 0 else -1 for joint in order)


def skeleton_motion(skeleton: Any) -> Motion:
    """The skeleton that a user gives: a Motion, or the path of a file of one. Raises BadInput."""
    from .. import formats

    motion = skeleton if isinstance(skeleton, Motion) else formats.read(str(skeleton))
    if not isinstance(motion, Motion) or motion.skeleton is None or not len(motion):
        raise BadInput(f"{skeleton}: has no skeleton; give a .bvh or .amc whose first frame is the first frame's pose")
    return motion


def imaging() -> Any:
    """Pillow's Image module. Raises MissingExtra."""
    try:
        return import_module("PIL.Image")
    except ImportError:
        raise MissingExtra("coding residual maps as stills", "cloud") from None
