"""Poses as the directions of their bones: fewer numbers, and straighter curves.

    pose (frames, points, 3) ─forward─► coordinates (frames, dimensions) ─inverse─► pose

An arm that swings is a straight line in these coordinates and a curve in those of its joints; and 31 joints have 58
coordinates instead of 93.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from .... import native
from ....typing import Floats
from . import rotations
from .bone_tree import BoneSchedule, BoneTree
from .rotations import SinCos

BLOCK = 512
"""Frames worked on at a time: many enough to be fast, few enough to stay in a processor's cache."""


def forward(tree: BoneTree, pose: Floats) -> Floats:
    """Coordinates (frames, dimensions), radians, of poses (frames, points, 3): tilts of bones, then hub rotations."""
    if (kernel := native.kernel("tempo_bone_coordinates")) is not None:
        points, schedule = np.ascontiguousarray(pose.T), tree.schedule
        parents = np.array(tree.parents, np.int64)
        return kernel(points, parents, *schedule.program[:3], schedule.order, schedule.points, *schedule.hub_pairs).T
    out = np.empty((tree.dimensions, len(pose)))
    tilts, hubs = tree.schedule.split(out)
    for block in _blocks(len(pose)):
        frames_and_coordinates(tree, pose[block], tilts[..., block], hubs[..., block])
    tilts[:], hubs[:] = rotations.unwrapped(tilts), rotations.unwrapped(hubs)
    return out.T


def inverse(tree: BoneTree, coordinates: Floats) -> Floats:
    """Poses (frames, points, 3), metres, their mean in the origin, of coordinates (frames, dimensions)."""
    rows = np.ascontiguousarray(coordinates.T)
    out = np.empty((3, len(tree.parents), len(coordinates)))
    for block in _blocks(len(coordinates)):
        np.matmul(tree.position_sums, _directions(tree.schedule, rows[:, block]), out=out[..., block])
    return out.T


def frames_and_coordinates(tree: BoneTree, pose: Floats, tilts: Floats, hubs: Floats) -> Floats:
    """Frames (3, 3, slots, frames), in the body's frame, of all references in poses (frames, points, 3).

    Tilts (2, bones, frames) and hub rotations (3, hubs, frames) are written in place.
    """
    schedule, offsets = tree.schedule, offsets_from_parents(pose, tree.parents)
    frames = np.empty((3, 3, schedule.slots, len(pose)))
    for level in schedule.levels:
        for hub in level.hubs:
            pair = offsets[:, hub.pair]
            if hub.reference is not None:
                pair = rotations.into(hub.home, rotations.into(frames[:, :, hub.reference], pair))
            hubs[:, hub.number] = rotations.vector_of(
                rotations.relative_to(rotations.frame_of_pair(pair), hub.pair_frame)
            )
            frames[:, :, hub.slot] = rotations.frames_of(hubs[:, hub.number])
            hub.to_body(frames)
        if level.points:
            here = offsets[:, level.points]
            if level.references is not None:
                here = rotations.into(frames[:, :, level.references], here)
            tilt = rotations.tilt_to(rotations.into(level.rest, here))
            tilts[:, level.numbers] = tilt
            own = frames[:, :, level.slots]
            k = own.shape[2]
            trig = SinCos.of(rotations.squared_length(tilt[:, :k]))
            rotations.tilted_frames(level.rest[:, :, :k], tilt[:, :k], trig, own)
            level.to_body(frames)
    return frames


def _directions(schedule: BoneSchedule, coordinates: Floats) -> Floats:
    """Unit directions (3, bones, frames), body's frame, schedule order, of coordinates (dimensions, frames)."""
    tilts, hubs = schedule.split(coordinates)
    tilts, hubs = tilts[:, schedule.order], np.ascontiguousarray(hubs)
    trig = SinCos.of(np.concatenate([rotations.squared_length(tilts), rotations.squared_length(hubs)]))
    if (kernel := native.kernel("tempo_bone_directions")) is not None:
        return kernel(tilts, hubs, *trig, *schedule.program)
    k, n, free = schedule.framed, len(schedule.bones), schedule.free
    frames = np.empty((3, 3, schedule.slots, coordinates.shape[1]))
    rotations.tilted_frames(schedule.rest[:, :, :k], tilts[:, :k], trig.at(slice(k)), frames[:, :, :k])
    frames[:, :, k:] = rotations.frames_with(hubs, trig.at(slice(n, None)))
    for level in schedule.levels:
        for hub in level.hubs:
            hub.to_body(frames)
        level.to_body(frames)
    out = np.empty((3, len(schedule.points), coordinates.shape[1]))
    out[:, :k] = frames[2, :, :k]
    rotations.tilted_directions(schedule.rest[:, :, k:], tilts[:, k:], trig.at(slice(k, n)), out[:, k:n])
    out[:, n:] = schedule.hub_directions
    if k + free < len(schedule.points):
        rest = schedule.references[k + free :]
        out[:, k + free :] = rotations.out_of(frames[:, :, rest], out[:, k + free :])
    return out


def metric(tree: BoneTree, coordinates: Floats) -> Floats:
    """Mean of JᵀJ over coordinates (frames, dimensions), J the derivative of all positions by all coordinates.

    (dimensions, dimensions), m²/rad²: how far the points move in all when the coordinates change.
    """
    n = tree.dimensions
    moved = np.repeat(coordinates, 2 * n, axis=0).reshape(len(coordinates), 2, n, n)
    moved[:, 0] += DIFFERENCE_RAD * np.eye(n)
    moved[:, 1] -= DIFFERENCE_RAD * np.eye(n)
    poses = inverse(tree, moved.reshape(-1, n)).reshape(len(coordinates), 2, n, -1)
    jacobian = (poses[:, 0] - poses[:, 1]) / (2 * DIFFERENCE_RAD)
    return np.einsum("fac,fbc->ab", jacobian, jacobian) / len(coordinates)


DIFFERENCE_RAD = 1e-4
"""Half the step of the central differences."""


def offsets_from_parents(pose: Floats, parents: Sequence[int]) -> Floats:
    """From parent to point, (3, points, frames), of poses (frames, points, 3)."""
    points = np.ascontiguousarray(pose.T)
    return points - points[:, [max(p, 0) for p in parents]]


def _blocks(frames: int) -> Iterator[slice]:
    return (slice(first, min(first + BLOCK, frames)) for first in range(0, frames, BLOCK))
