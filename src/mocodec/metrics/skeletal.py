"""Errors of skeletal motions: joints, shell points and angles.

    rotations ─► world matrices R ─┬─► shell points p + s · R e_k ─► distances
                                   └─► angles between R and R̃, of the world and of each joint against its parent

A shell point is at the distance s off its joint along an axis k = x, y, z of the joint's frame, as the virtual vertices
of animation compressors (ACL): it moves where the skin would, so that a twist about a bone counts. The forward
kinematics is written here with matrices and uses nothing of `geometry`, so that it checks what the codecs compute.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..motion import Motion
from ..typing import Booleans, Floats, Integers

SHELL_M = 0.03
"""Distance of shell points from their joints, metres: about where the skin of an arm is."""
BLOCK_VALUES = 1 << 19
"""Joints × frames that are measured at once: matrices of more frames need more memory than the motion."""
RIGID_M = 1e-5
"""A joint farther than this from where the rotations place it moves against its parent, and is no rigid bone."""


@dataclass(frozen=True)
class Spread:
    """Mean, 99th percentile and largest of errors; at: frame and joint of the largest, None if nothing is measured."""

    mean: float
    p99: float
    largest: float
    at: tuple[int, str] | None


@dataclass(frozen=True)
class SkeletalErrors:
    """How far the pose of a decoded motion is from the original; metres and degrees.

    shell_m: distance of the shell points from their joints. shell: errors of the shell points. joints_and_shell: of
    both together, four points a joint: what `max_error` and `mean_error` promise for files that keep rotations.
    world_degrees, local_degrees: angles between the joints' frames in the world, and against their parents'.
    kinematic_gap_m: largest distance between a decoded joint and where the decoded rotations place it, over joints that
    are rigid in the original. per_joint: mean and largest error of each joint.
    """

    shell_m: float
    shell: Spread
    joints_and_shell: Spread
    world_degrees: Spread
    local_degrees: Spread
    kinematic_gap_m: float
    per_joint: dict[str, dict[str, float]] = field(default_factory=dict[str, dict[str, float]])


class Poses(NamedTuple):
    """Errors of frames: of joints (frames, joints) and shell points (frames, joints, 3), metres; angles of the
    world and local rotations (frames, joints), degrees. NaN where a joint is missing.
    """

    joints: Floats
    shell: Floats
    world: Floats
    local: Floats


def matrices(quaternions: Floats) -> Floats:
    """Rotation matrices (…, 3, 3) of quaternions (…, 4), w first, of any length but zero; NaN for zero."""
    with np.errstate(invalid="ignore", divide="ignore"):
        w, x, y, z = np.moveaxis(quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True), -1, 0)
    result = np.empty((*quaternions.shape[:-1], 3, 3))
    result[..., 0, 0], result[..., 1, 1], result[..., 2, 2] = (
        w * w + x * x - y * y - z * z,
        w * w - x * x + y * y - z * z,
        w * w - x * x - y * y + z * z,
    )
    for row, column, product, axis, sign in ((0, 1, x * y, z, -1), (0, 2, x * z, y, 1), (1, 2, y * z, x, -1)):
        result[..., row, column] = 2 * (product + sign * w * axis)
        result[..., column, row] = 2 * (product - sign * w * axis)
    return result


def world_matrices(parents: tuple[int, ...], local: Floats) -> Floats:
    """Matrices against the world (frames, joints, 3, 3), from those against the parents."""
    world = local.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            world[:, joint] = world[:, parent] @ local[:, joint]
    return world


def forward(motion: Motion) -> Floats:
    """Where the rotations place the joints (frames, joints, 3): roots from the positions, others by their offsets.

    An offset is in the frame of the parent; in a motion from an AMC, in the frame of the joint (see `Skeleton`). The
    motion must have rotations.
    """
    assert motion.skeleton is not None
    parents = motion.skeleton.parents
    _, world = _frames(motion)
    placed = motion.positions.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            carrier = world[:, joint if has_own_frames(motion) else parent]
            placed[:, joint] = placed[:, parent] + carrier @ motion.skeleton.offsets[joint]
    return placed


def has_own_frames(motion: Motion) -> bool:
    """Whether offsets are in the joints' own frames, as in AMC, and not in their parents'."""
    return motion.source.get("format") == "amc"


def shell_points(motion: Motion, shell_m: float = SHELL_M) -> Floats:
    """p + s · R e_k of all joints (frames, joints, 3 axes k, 3), metres. The motion must have rotations."""
    _, world = _frames(motion)
    return motion.positions[:, :, None] + shell_m * world.swapaxes(-1, -2)


def angles(a: Floats, b: Floats) -> Floats:
    """Degrees (…) between the rotations of matrices (…, 3, 3): exact for small angles too.

    |A − B|² = 8 sin²(angle / 2) in the Frobenius norm, for small angles; the trace of Aᵀ B for large ones.
    """
    half_sine = np.sqrt(np.square(a - b).sum(axis=(-1, -2)) / 8)
    half_cosine = np.sqrt(np.maximum(1 + np.einsum("...ij,...ij->...", a, b), 0)) / 2
    return np.degrees(2 * np.arctan2(half_sine, half_cosine))


def measurable(original: Motion, decoded: Motion) -> bool:
    """Whether both have rotations of the same joints, in frames of the same convention."""
    return (
        original.rotations is not None
        and decoded.rotations is not None
        and original.skeleton is not None
        and decoded.skeleton is not None
        and original.positions.shape == decoded.positions.shape
        and has_own_frames(original) == has_own_frames(decoded)
    )


def order_of(original: Motion, decoded: Motion) -> list[int] | None:
    """The decoded joint of each original one, by name; None if they are in the same order, or names do not say."""
    columns = {name: column for column, name in enumerate(decoded.names)}
    if original.names == decoded.names or len(columns) < decoded.points or set(columns) != set(original.names):
        return None
    return [columns[name] for name in original.names]


def errors(original: Motion, decoded: Motion, shell_m: float = SHELL_M) -> Poses:
    """Errors of all joints in all frames. Both motions must be `measurable`."""
    blocks = [_errors(original[part], decoded[part], shell_m) for part in _blocks(original)]
    return Poses(*(np.concatenate(each) for each in zip(*blocks, strict=True)))


def _blocks(motion: Motion) -> list[slice]:
    size = max(1, BLOCK_VALUES // max(1, motion.points))
    return [slice(start, min(start + size, len(motion))) for start in range(0, max(1, len(motion)), size)]


def _errors(original: Motion, decoded: Motion, shell_m: float) -> Poses:
    """As `errors`, of all frames at once."""
    local, world = _frames(original)
    local_q, world_q = _frames(decoded)
    p, q = original.positions, decoded.positions
    if (order := order_of(original, decoded)) is not None:
        q, local_q, world_q = q[:, order], local_q[:, order], world_q[:, order]
    moved = q - p
    missing = np.isnan(moved[..., 0])
    shell = np.linalg.norm(moved[:, :, None] + shell_m * (world_q - world).swapaxes(-1, -2), axis=-1)
    of_world, of_parent = angles(world, world_q), angles(local, local_q)
    of_world[missing], of_parent[missing] = np.nan, np.nan
    return Poses(np.linalg.norm(moved, axis=-1), shell, of_world, of_parent)


def _frames(motion: Motion) -> tuple[Floats, Floats]:
    """The matrices of all joints against their parents and against the world, (frames, joints, 3, 3) each."""
    assert motion.skeleton is not None
    assert motion.rotations is not None
    local = matrices(motion.rotations)
    return local, world_matrices(motion.skeleton.parents, local)


def compare(original: Motion, decoded: Motion, shell_m: float = SHELL_M) -> SkeletalErrors | None:
    """The errors of a pose; None if the motions are not `measurable`: without rotations, say."""
    if not measurable(original, decoded):
        return None
    poses = errors(original, decoded, shell_m)
    every_point = np.concatenate([poses.joints[..., None], poses.shell], axis=-1)
    return SkeletalErrors(
        shell_m=shell_m,
        shell=_spread(poses.shell, original.names),
        joints_and_shell=_spread(every_point, original.names),
        world_degrees=_spread(poses.world, original.names),
        local_degrees=_spread(poses.local, original.names),
        kinematic_gap_m=_kinematic_gap(original, decoded),
        per_joint=dict(zip(original.names, _per_joint(poses), strict=True)),
    )


def _spread(values: Floats, names: tuple[str, ...]) -> Spread:
    """The spread of errors (frames, joints) or (frames, joints, points of a joint)."""
    present = values[~np.isnan(values)]
    if not present.size:
        return Spread(0.0, 0.0, 0.0, None)
    place = np.unravel_index(int(np.nanargmax(values)), values.shape)
    at = (int(place[0]), names[int(place[1])])
    return Spread(float(present.mean()), float(np.percentile(present, 99)), float(present.max()), at)


def _per_joint(poses: Poses) -> list[dict[str, float]]:
    """Mean and largest error of each joint; zeros for joints that are always missing."""
    result: list[dict[str, float]] = [{} for _ in range(poses.joints.shape[1])]
    columns: Mapping[str, Floats] = {
        "shell": poses.shell,
        "world_degrees": poses.world,
        "local_degrees": poses.local,
    }
    for name, values in columns.items():
        for joint, entry in enumerate(result):
            present = values[:, joint][~np.isnan(values[:, joint])]
            entry[f"{name}_mean"] = float(present.mean()) if present.size else 0.0
            entry[f"{name}_max"] = float(present.max()) if present.size else 0.0
    return result


def _kinematic_gap(original: Motion, decoded: Motion) -> float:
    """Largest distance of a decoded joint from where its rotations place it, over rigid joints of the original."""
    largest = np.zeros(original.points)
    rigid: Booleans = np.ones(original.points, bool)
    order = order_of(original, decoded)
    columns: Integers | slice = slice(None) if order is None else np.array(order)
    for part in _blocks(original):
        rigid &= _largest_gap(original[part]) < RIGID_M
        largest = np.maximum(largest, _largest_gap(decoded[part])[columns])
    return float(largest[rigid].max(initial=0.0))


def _largest_gap(motion: Motion) -> Floats:
    """Largest distance of each joint (joints,) from where the bone of the parent places it."""
    assert motion.skeleton is not None
    parents = np.array(motion.skeleton.parents)
    _, world = _frames(motion)
    result = np.zeros(motion.points)
    for joint in np.flatnonzero(parents >= 0):
        carrier = world[:, joint if has_own_frames(motion) else parents[joint]]
        bone = motion.positions[:, joint] - motion.positions[:, parents[joint]]
        gap = np.linalg.norm(bone - carrier @ motion.skeleton.offsets[joint], axis=-1)
        result[joint] = np.nan_to_num(gap).max(initial=0.0)
    return result
