"""Poses of a run of frames as bytes: each joint's rotation as a quantised spectrum.

    rotations ─► relative to the joint's rotation in the middle frame ─► swing and twist
              ─► ÷ step ─► DCT along time ─► quantised with a dead zone ─► entropy coder

A joint moves its link, and the joints below with everything on them, which then compensate for the rotation. The lever
of a joint axis is the root mean square distance that all of the surface moves by then, for a rotation of one radian
about it. A joint's step is inversely proportional to its lever, so that an error of one step moves the surface alike at
every joint. Tracking noise lies mostly in rotations that move little (a hand, a twisted sleeve) and in high
frequencies, where quantisation removes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry import articulation
from ...geometry.articulation import Body, Pose
from ...geometry.skinning import Skin
from ...stages import dct
from ...typing import Floats, Integers
from .swing_twist import from_swing_twist, link_frames, to_swing_twist, transposed

STEP_UNIT_M = 1e-5  # of the stored step
MAX_STORED_STEP = 1 << 17
MIN_LEVER_M, LEVELS_PER_OCTAVE = 0.015, 4
MAX_LEVER_LEVEL = 20 * LEVELS_PER_OCTAVE
MIDDLE_STEP_RAD = 0.05  # of the rotations in the middle frame
MAX_MIDDLE_STEPS = 200
UP_AMONG_ZEROS, UP_AMONG_OTHERS = 0.74, 0.62  # fraction above which a coefficient is rounded up: dead zone
TOWARDS_ZERO = 0.05  # of a step: reconstruction points lie this much closer to zero than the integer
MAX_COEFFICIENT = 1 << 24


class PoseSteps(NamedTuple):
    """Quantisation steps of a body's poses.

    step_m: how far the surface moves for one step of a joint; also the step of the root's translation.
    levers (links, 3): levels of the lever of each joint axis, LEVELS_PER_OCTAVE above MIN_LEVER_M.
    """

    step_m: float
    levers: Integers

    def step_sizes(self) -> Floats:
        """(3 + 3 links,): one step of the root's translation, metres, and of each joint's swing and twist, radians."""
        lever = MIN_LEVER_M * 2.0 ** (self.levers / LEVELS_PER_OCTAVE)
        return np.concatenate([np.full(3, self.step_m), (self.step_m / lever).ravel()])

    @staticmethod
    def for_skin(body: Body, skin: Skin, step_m: float) -> PoseSteps:
        """Levers from the points that follow each link, and from the joints on it with everything below them."""
        shares = skin.shares(len(body)) / len(skin.points)
        below = body.ancestors.astype(float) @ shares.sum(axis=0)  # (links,): the part of the surface below each joint
        square = np.empty((len(body), 3))
        for link, axes in enumerate(link_frames(body)):
            children = [child for child, parent in enumerate(body.parents) if parent == link]
            arms = np.concatenate([skin.points, body.origins[children]]) - body.origins[link]
            squares = (arms @ axes.T) ** 2
            square[link] = np.concatenate([shares[:, link], below[children]]) @ (
                squares.sum(axis=1, keepdims=True) - squares
            )
        levers = np.round(LEVELS_PER_OCTAVE * np.log2(np.maximum(np.sqrt(square), MIN_LEVER_M) / MIN_LEVER_M))
        return PoseSteps(max(round(step_m / STEP_UNIT_M), 1) * STEP_UNIT_M, levers.astype(np.int64))

    def pack(self) -> bytes:
        levers = coder.pack(self.levers)
        return varint.write([round(self.step_m / STEP_UNIT_M), len(levers)]) + levers

    @staticmethod
    def unpack(body: Body, data: bytes, at: int) -> tuple[PoseSteps, int]:
        """The steps at position `at` and the position after them. Raises Corrupt."""
        (step, size), at = varint.read(data, 2, at)
        if not 0 < step <= MAX_STORED_STEP or at + size > len(data):
            raise Corrupt("bodycast: the quantisation steps of the poses are damaged")
        levers = coder.unpack(data[at : at + size], (len(body), 3))
        if (levers < 0).any() or (levers > MAX_LEVER_LEVEL).any():
            raise Corrupt("bodycast: the levers of the joints are out of range")
        return PoseSteps(step * STEP_UNIT_M, levers), at + size


class PoseSequence(NamedTuple):
    """Poses of frames: rotations (frames, links, 3, 3) from the parents' frames, roots (frames, 3)."""

    rotations: Floats
    roots: Floats

    @staticmethod
    def from_poses(poses: Sequence[Pose]) -> PoseSequence:
        return PoseSequence(np.stack([p.rotations for p in poses]), np.stack([p.root for p in poses]))

    def __getitem__(self, frame: Any) -> Any:
        """The pose of a frame; with a slice, one Pose whose leading axis is the frames."""
        return Pose(self.rotations[frame], self.roots[frame])

    def transforms(self, body: Body) -> tuple[Floats, Floats]:
        """(frames, links, 3, 3) and (frames, links, 3), as `articulation.transforms`."""
        return articulation.transforms(body, Pose(self.rotations, self.roots))


# --- a run of frames ------------------------------------------------------------------------------------------------


def pack_poses(body: Body, sequence: PoseSequence, steps: PoseSteps) -> bytes:
    """A run of frames. Each joint corrects the rounding of the joints above it: it rotates its link to the link's world
    orientation.
    """
    frames, links = sequence.rotations.shape[:2]
    middle = np.round(articulation.log(sequence.rotations[frames // 2]) / MIDDLE_STEP_RAD).astype(np.int64)
    middle_rotations = articulation.exp(np.asarray(middle * MIDDLE_STEP_RAD, np.float64))
    axes, sizes = link_frames(body), steps.step_sizes()
    spectrum = np.empty((frames, 3 + 3 * links), np.int64)
    spectrum[:, :3] = quantise_spectrum(dct.forward(sequence.roots / sizes[:3]))
    target, decoded = np.empty_like(sequence.rotations), np.empty_like(sequence.rotations)
    for link, parent in enumerate(body.parents):
        own, columns = sequence.rotations[:, link], slice(3 + 3 * link, 6 + 3 * link)
        target[:, link] = own if parent < 0 else target[:, parent] @ own
        above = np.eye(3) if parent < 0 else decoded[:, parent]
        relative = transposed(above @ middle_rotations[link]) @ target[:, link]
        values = to_swing_twist(relative, axes[link]) / sizes[columns]
        spectrum[:, columns] = quantise_spectrum(dct.forward(values))
        values = dct.inverse(dequantise_spectrum(spectrum[:, columns]), frames) * sizes[columns]
        decoded[:, link] = above @ middle_rotations[link] @ from_swing_twist(values, axes[link])
    head = coder.pack(middle)
    return varint.write([len(head)]) + head + coder.pack(spectrum[:, _channel_order(links)])


def unpack_poses(body: Body, data: bytes, frames: int, steps: PoseSteps) -> PoseSequence:
    """The inverse of `pack_poses`, but for rounding. Raises Corrupt."""
    links = len(body)
    (size,), at = varint.read(data, 1)
    if at + size > len(data):
        raise Corrupt("bodycast: poses are cut off")
    middle = np.clip(coder.unpack(data[at : at + size], (links, 3)), -MAX_MIDDLE_STEPS, MAX_MIDDLE_STEPS)
    middle_rotations = articulation.exp(np.asarray(middle * MIDDLE_STEP_RAD, np.float64))
    spectrum = np.zeros((frames, 3 + 3 * links), np.int64)
    spectrum[:, _channel_order(links)] = coder.unpack(data[at + size :], spectrum.shape)
    spectrum = np.clip(spectrum, -MAX_COEFFICIENT, MAX_COEFFICIENT)
    values = dct.inverse(dequantise_spectrum(spectrum), frames) * steps.step_sizes()
    turns = from_swing_twist(values[:, 3:].reshape(frames, links, 3), link_frames(body))
    return PoseSequence(middle_rotations @ turns, values[:, :3])


def quantise_spectrum(spectrum: Floats) -> Integers:
    """Integers of coefficients (frequencies, channels). An isolated ±1 costs more bits than it is worth, so the dead
    zone is wider among zeros.
    """
    size = np.abs(spectrum)
    rounded = np.minimum(np.floor(size + 0.5), 2.0)
    around = np.zeros_like(size)
    for shift in (1, 2):
        around[shift:] += rounded[:-shift]
        around[:-shift] += rounded[shift:]
    threshold = np.where(around >= 2, UP_AMONG_OTHERS, UP_AMONG_ZEROS)
    return (np.sign(spectrum) * np.floor(size + 1 - threshold)).astype(np.int64)


def dequantise_spectrum(integers: Integers) -> Floats:
    """Coefficients of integers: a little closer to zero, where coefficients are denser."""
    return integers - TOWARDS_ZERO * np.sign(integers)


def _channel_order(links: int) -> Integers:
    """Channels as they are coded: the root, then the first axis of all links, the second, the third."""
    return np.concatenate([np.arange(3), 3 + np.arange(3 * links).reshape(links, 3).T.ravel()])


# --- single poses ---------------------------------------------------------------------------------------------------


def quantise_pose(body: Body, pose: Pose, steps: PoseSteps, previous: Integers) -> Integers:
    """(3 + 3 links,): one pose in steps. previous: the integers of the frame before; angles continue from them."""
    axes, sizes = link_frames(body), steps.step_sizes()
    target, _ = articulation.transforms(body, pose)
    decoded, integers = np.empty_like(target), np.empty((len(body), 3), np.int64)
    for link, parent in enumerate(body.parents):
        above = decoded[parent] if parent >= 0 else np.eye(3)
        columns = slice(3 + 3 * link, 6 + 3 * link)
        last = from_swing_twist(previous[columns] * sizes[columns], axes[link])
        both = to_swing_twist(np.stack([last, above.T @ target[link]]), axes[link])
        both[1] += previous[columns] * sizes[columns] - both[0]
        integers[link] = np.round(both[1] / sizes[columns])
        decoded[link] = above @ from_swing_twist(integers[link] * sizes[columns], axes[link])
    return np.concatenate([np.round(pose.root / sizes[:3]).astype(np.int64), integers.ravel()])


def dequantise_pose(body: Body, integers: Integers, steps: PoseSteps) -> Pose:
    """The pose of integers (3 + 3 links,)."""
    values = np.clip(integers, -MAX_COEFFICIENT, MAX_COEFFICIENT) * steps.step_sizes()
    return Pose(from_swing_twist(values[3:].reshape(-1, 3), link_frames(body)), values[:3])
