"""Poses of a run of frames as bytes: each joint's turns as a spectrum, rounded by what they move.

    rotations ─► against the joint's turn in the middle frame: swing of the link, turn about itself
              ─► × lever / step ─► cosine transform along time ─► rounded ─► entropy coder

A turn of a joint moves its link, and the joints that hang on that with all beyond them; those make up for the turn
itself. A joint's lever is the root mean square distance by which all of the surface then moves, a radian about that
axis, so that an error of one step is worth the same wherever it is made. Noise of the tracker lies mostly in turns that
move little (a hand, a sleeve about itself) and in high frequencies, where rounding takes it away.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry import articulation, cylinder_map
from ...geometry.articulation import Body, Floats, Pose
from ...geometry.skinning import Skin

Integers = NDArray[np.int64]
UNIT = 1e-5  # metres, of steps as they are stored
FINEST, OCTAVE = 0.015, 4  # metres: the shortest lever; how many sizes of lever there are to a doubling
MIDDLE = 0.05  # radians a step of the turns in the middle frame
ALONE, AMONG = 0.74, 0.62  # what a coefficient must be to be rounded up to 1: among zeros, and among others
INWARD = 0.05  # how far inside of its cell's middle a coefficient probably is
LARGEST = 1 << 24


class Scale(NamedTuple):
    """How finely a body's poses are stored: step, metres that the surface moves; levers (links, 3) in sizes."""

    step: float
    levers: Integers

    def sizes(self) -> Floats:
        """(3 + 3 links,): one step of the root's place and of each joint's turn, in metres and radians."""
        lever = FINEST * 2.0 ** (self.levers / OCTAVE)
        return np.concatenate([np.full(3, self.step), (self.step / lever).ravel()])

    @staticmethod
    def of(body: Body, skin: Skin, step: float) -> Scale:
        """Levers of the points that follow each link, and of the joints that hang on it with all beyond them."""
        shares = skin.shares(len(body)) / len(skin.points)
        beyond = body.ancestors.astype(float) @ shares.sum(axis=0)  # (links,): the part of the surface below each joint
        square = np.empty((len(body), 3))
        for link, axes in enumerate(_axes(body)):
            below = [child for child, parent in enumerate(body.parents) if parent == link]
            arms = np.concatenate([skin.points, body.origins[below]]) - body.origins[link]
            squares = (arms @ axes.T) ** 2
            square[link] = np.concatenate([shares[:, link], beyond[below]]) @ (
                squares.sum(axis=1, keepdims=True) - squares
            )
        sizes = np.round(OCTAVE * np.log2(np.maximum(np.sqrt(square), FINEST) / FINEST))
        return Scale(max(round(step / UNIT), 1) * UNIT, sizes.astype(np.int64))

    def pack(self) -> bytes:
        levers = coder.pack(self.levers)
        return varint.write([round(self.step / UNIT), len(levers)]) + levers

    @staticmethod
    def unpack(body: Body, data: bytes, at: int) -> tuple[Scale, int]:
        """The scale and where its bytes end. Raises Corrupt."""
        (step, size), at = varint.read(data, 2, at)
        if not 0 < step <= 1 << 17 or at + size > len(data):
            raise Corrupt("bodycast: the scale of its poses is damaged")
        levers = coder.unpack(data[at : at + size], (len(body), 3))
        if (levers < 0).any() or (levers > 20 * OCTAVE).any():
            raise Corrupt("bodycast: the scale of its poses is damaged")
        return Scale(step * UNIT, levers), at + size


class Track(NamedTuple):
    """Poses of frames: rotations (frames, links, 3, 3) from the parents' frames, roots (frames, 3)."""

    rotations: Floats
    roots: Floats

    @staticmethod
    def of(poses: Sequence[Pose]) -> Track:
        return Track(np.stack([p.rotations for p in poses]), np.stack([p.root for p in poses]))

    def __getitem__(self, frame: Any) -> Any:
        return Pose(self.rotations[frame], self.roots[frame])

    def transforms(self, body: Body) -> tuple[Floats, Floats]:
        """(frames, links, 3, 3) and (frames, links, 3), as `articulation.transforms`."""
        return articulation.transforms(body, Pose(self.rotations, self.roots))


def pack(body: Body, track: Track, scale: Scale) -> bytes:
    """A run of frames. Each joint is turned to where the pose has its link in the world, and so makes up for the
    rounding of those above it.
    """
    from scipy.fft import dct, idct

    frames, links = track.rotations.shape[:2]
    middle = np.round(articulation.log(track.rotations[frames // 2]) / MIDDLE).astype(np.int64)
    fixed, axes, sizes = articulation.exp(np.asarray(middle * MIDDLE, np.float64)), _axes(body), scale.sizes()
    spectrum = np.empty((frames, 3 + 3 * links), np.int64)
    spectrum[:, :3] = rounded(np.asarray(dct(track.roots / sizes[:3], axis=0, norm="ortho")))
    wanted, stored = np.empty_like(track.rotations), np.empty_like(track.rotations)
    for link, parent in enumerate(body.parents):
        own, here = track.rotations[:, link], slice(3 + 3 * link, 6 + 3 * link)
        wanted[:, link] = own if parent < 0 else wanted[:, parent] @ own
        above = np.eye(3) if parent < 0 else stored[:, parent]
        values = _parted(_transposed(above @ fixed[link]) @ wanted[:, link], axes[link]) / sizes[here]
        spectrum[:, here] = rounded(np.asarray(dct(values, axis=0, norm="ortho")))
        values = np.asarray(idct(_inward(spectrum[:, here]), axis=0, norm="ortho")) * sizes[here]
        stored[:, link] = above @ fixed[link] @ _joined(values, axes[link])
    head = coder.pack(middle)
    return varint.write([len(head)]) + head + coder.pack(spectrum[:, _order(links)])


def unpack(body: Body, data: bytes, frames: int, scale: Scale) -> Track:
    """The inverse of `pack`, but for rounding. Raises Corrupt."""
    from scipy.fft import idct

    links = len(body)
    (size,), at = varint.read(data, 1)
    if at + size > len(data):
        raise Corrupt("bodycast: poses are damaged")
    middle = np.clip(coder.unpack(data[at : at + size], (links, 3)), -200, 200)
    spectrum = np.zeros((frames, 3 + 3 * links), np.int64)
    spectrum[:, _order(links)] = coder.unpack(data[at + size :], spectrum.shape)
    spectrum = np.clip(spectrum, -LARGEST, LARGEST)
    values = np.asarray(idct(_inward(spectrum), axis=0, norm="ortho")) * scale.sizes()
    turns = _joined(values[:, 3:].reshape(frames, links, 3), _axes(body))
    return Track(articulation.exp(np.asarray(middle * MIDDLE, np.float64)) @ turns, values[:, :3])


def quantise(body: Body, pose: Pose, scale: Scale, previous: Integers) -> Integers:
    """(3 + 3 links,): one pose in steps, alone; the vector of a turn is the one nearest to the last frame's."""
    axes, sizes = _axes(body), scale.sizes()
    wanted, _ = articulation.transforms(body, pose)
    stored, steps = np.empty_like(wanted), np.empty((len(body), 3), np.int64)
    for link, parent in enumerate(body.parents):
        above = stored[parent] if parent >= 0 else np.eye(3)
        here = sizes[3 + 3 * link : 6 + 3 * link]
        last = _joined(previous[3 + 3 * link : 6 + 3 * link] * here, axes[link])
        both = _parted(np.stack([last, above.T @ wanted[link]]), axes[link])
        both[1] += previous[3 + 3 * link : 6 + 3 * link] * here - both[0]
        steps[link] = np.round(both[1] / here)
        stored[link] = above @ _joined(steps[link] * here, axes[link])
    return np.concatenate([np.round(pose.root / sizes[:3]).astype(np.int64), steps.ravel()])


def dequantise(body: Body, steps: Integers, scale: Scale) -> Pose:
    """The pose of steps (3 + 3 links,)."""
    values = np.clip(steps, -LARGEST, LARGEST) * scale.sizes()
    return Pose(_joined(values[3:].reshape(-1, 3), _axes(body)), values[:3])


def rounded(spectrum: Floats) -> Integers:
    """Whole numbers for coefficients (frequencies, channels): a one among zeros costs more bits than it is worth."""
    size = np.abs(spectrum)
    near = np.minimum(np.floor(size + 0.5), 2.0)
    around = np.zeros_like(size)
    for shift in (1, 2):
        around[shift:] += near[:-shift]
        around[:-shift] += near[shift:]
    need = np.where(around >= 2, AMONG, ALONE)
    return (np.sign(spectrum) * np.floor(size + 1 - need)).astype(np.int64)


def _inward(numbers: Integers) -> Floats:
    """What whole numbers stand for."""
    return numbers - INWARD * np.sign(numbers)


def _order(links: int) -> Integers:
    """Channels as they are coded: root's place, then the first axes of all links, the second, the third."""
    return np.concatenate([np.arange(3), 3 + np.arange(3 * links).reshape(links, 3).T.ravel()])


def _axes(body: Body) -> Floats:
    """(links, 3, 3): two directions across each link and the one along it, as rows."""
    return np.stack(cylinder_map.directions(body.origins, body.tips), axis=1)


def _transposed(rotations: Floats) -> Floats:
    return np.swapaxes(rotations, -1, -2)


def _parted(rotations: Floats, axes: Floats) -> Floats:
    """(frames, 3): how far a link is swung, about the two directions across it, and how far it was turned about itself
    before that, without leaps from frame to frame. The swing moves its far end, the turn only what is around its axis:
    an error of one is none of the other, however far it is turned.
    """
    w, x, y, z = articulation.quaternions(axes @ rotations @ axes.T).T
    half = np.arctan2(z, w)
    c, s = np.cos(half), np.sin(half)
    across = np.stack([x * c - y * s, x * s + y * c], axis=1)
    sine = np.linalg.norm(across, axis=1)
    angle = 2 * np.arctan2(sine, np.hypot(w, z))
    swing = across * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)[:, None]
    return np.concatenate([_unwound(swing), np.unwrap(2 * half)[:, None]], axis=1)


def _joined(values: Floats, axes: Floats) -> Floats:
    """(…, 3, 3): the rotations of swings and turns (…, 3)."""
    swing, turn = np.zeros_like(values), np.zeros_like(values)
    swing[..., :2], turn[..., 2] = values[..., :2], values[..., 2]
    return _transposed(axes) @ articulation.exp(swing) @ articulation.exp(turn) @ axes


def _unwound(vectors: Floats) -> Floats:
    """Rotation vectors (frames, 2): of those of each rotation, the one nearest to the last frame's."""
    result = vectors.copy()
    angle = np.linalg.norm(vectors, axis=1)
    unit = vectors / np.maximum(angle, 1e-9)[:, None]

    def turns(frames: slice) -> Floats:
        last = result[frames.start - 1 : frames.stop - 1]
        return np.round((np.sum(last * unit[frames], axis=1) - angle[frames]) / (2 * np.pi))

    away = np.flatnonzero(turns(slice(1, len(vectors))))  # until the first of these, vectors stay as they are
    for frame in range(1 + away[0] if len(away) else len(vectors), len(vectors)):
        result[frame] += unit[frame] * (2 * np.pi * turns(slice(frame, frame + 1)))
    return result
