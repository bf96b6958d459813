"""Which bone of the prior each point sits on, and where, found from a pose and from how the points move.

    a pose ─the prior's body, rotated, scaled, shifted and posed into it─► nearest bones ─► offsets      first guesses
    movement ─► movement of all bones ─► bone and offset that explain each point best ─► repeat ─► the likeliest

Names are not used: every laboratory has its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .... import native
from ....typing import Floats, Integers
from ..coding import contexts
from ..coding.rows import POSE, step_size
from ..pose import heading
from . import markers_on_bones, predicted_motion
from .markers_on_bones import ARM_M, NO_BONE, OFFSET_UNIT_M, SCALE_UNIT, MarkerPlacement, MarkersOnBones
from .model import Model
from .prior import BoneMotion, Prior
from .stored_basis import MOST_DIMENSIONS

SAMPLE_FRAMES = 120
POSE_FRAMES = 2000
SEARCH_MODES, POSTURE_MODES = 96, 24
"""Components used to explain movement, and those of them used to pose the body."""
SEARCH_FREQUENCY = 2
"""Index into `BANDS_MHZ`: the spread at this frequency is the strength of a component in the search."""
HEADINGS = 12
SCALES, EXTENTS = (0.25, 4.0), (0.05, 5.0)
"""Range of the body's size, and of the points' extent, relative to the prior's body. Outside they are no body."""
POSING_ROUNDS = 6
KEPT_GUESSES, KEPT_ROUNDS, LAST_ROUNDS = 4, 3, 5
"""The best first guesses are refined for some rounds, and the best of these for more."""
ALIKE_M = 0.02
"""Poses whose points are nearer to each other than this lead to the same guesses."""
NEAR_BONE_M = 0.12
"""Usual distance of a point from its bone."""
UNEXPLAINED, LEAST_UNEXPLAINED = 0.05, 1e-3
"""Share of the movement's energy that bones do not explain: at first, and at least."""
FREE_SHARE = 0.8
"""A point of whose movement no bone explains more than 1 − this share has no bone."""
FARTHEST_M = 0.75
FEWEST_POINTS = 4
MOST_POINTS = MOST_DIMENSIONS // 3
POSE_STEP_BITS = -2
"""The mean pose is stored in steps of about 2^−(this) Δ/√frames, rounded to a power of two metres."""
FIRST_LEVELS = (0, 0, -24, 0, -140)
LEVEL_FLOOR_STEPS = 0.3
"""A coefficient below this many steps costs as little as zero."""


@dataclass(frozen=True, eq=False)
class Guess:
    """scale: of the body; bone (points,): of each point; offsets (points, 3): from the bone's joint, metres."""

    scale: float
    bone: Integers
    offsets: Floats


def fit(
    positions: Sequence[Floats], prior: Prior, names: tuple[str, ...], rate: float, step: int
) -> MarkersOnBones | None:
    """How the points of chunks (frames, points, 3), y up, sit on bones, or None if they do not look like a body."""
    bones, frames = prior.bones, sum(map(len, positions))
    if bones is None or not FEWEST_POINTS <= len(names) <= MOST_POINTS or not frames:
        return None
    centred = np.concatenate([p[:: max(1, frames // POSE_FRAMES)] for p in positions])
    centred = centred - centred.mean(axis=1, keepdims=True)
    pose = heading.mean_pose(centred)
    aligned = heading.align(centred[:: max(1, len(centred) // SAMPLE_FRAMES)], pose)
    tallest = aligned[np.ptp(aligned[..., 1], axis=1).argmax()]
    poses = [pose] if np.abs(tallest - pose).max() < ALIKE_M else [pose, tallest]
    guesses = [g for p in poses for g in _guesses(p, bones)]
    if not guesses:
        return None
    moved = aligned - pose
    best = min(
        (_refined(moved, angle, guess, bones) for angle, guess in _likeliest(moved, guesses, bones)),
        key=lambda result: result[0],
    )
    _, angle, found = _refined(moved, best[1], best[2], bones, LAST_ROUNDS)
    digits = int(np.clip(POSE_STEP_BITS - np.floor(np.log2(step_size(step) / np.sqrt(frames))), -60, 60))
    has_bone = (found.bone >= 0)[:, None]
    offsets = np.where(has_bone, np.rint(found.offsets / OFFSET_UNIT_M), 0).astype(np.int64)
    towards_prior = heading.rotate(pose[None], np.array([angle]))[0]
    scale, levels = round(found.scale / SCALE_UNIT), np.array(FIRST_LEVELS)
    alone = MarkerPlacement(digits, _rounded(towards_prior, digits), False, scale, found.bone, offsets, levels)
    difference = towards_prior - markers_on_bones.body_pose(alone, bones)
    on_body = replace(alone, pose=_rounded(difference, digits), on_body=True)
    placement = min(alone, on_body, key=lambda p: len(p.pack()))
    predicted = markers_on_bones.predict(placement, bones)
    model = MarkersOnBones(prior, placement, predicted).model(names, rate)
    levels = cheapest_levels(
        positions, model, lambda at: predicted_motion.spreads(predicted, bones.median_spread, at), FIRST_LEVELS, step
    )
    return MarkersOnBones(prior, replace(placement, levels=levels), predicted)


def _rounded(pose: Floats, digits: int) -> Integers:
    return np.rint(np.ldexp(pose, digits)).astype(np.int64)


def _guesses(pose: Floats, bones: BoneMotion) -> list[tuple[float, Guess]]:
    """First guesses: headings, and the body posed into the pose so rotated, at its height's scale or the prior's."""
    height = np.ptp(bones.joints[:, 1])
    if not EXTENTS[0] < float(np.sqrt((pose**2).mean() / (bones.joints**2).mean())) < EXTENTS[1]:
        return []
    angles, poses, scales = list[float](), list[Floats](), list[float]()
    for angle in np.arange(HEADINGS) * 2 * np.pi / HEADINGS:
        here = heading.rotate(pose[None], np.array([angle]))[0]
        for scale in (float(np.ptp(here[:, 1]) / height), 1.0):
            if SCALES[0] < scale < SCALES[1]:
                angles.append(float(angle))
                poses.append(here)
                scales.append(scale)
    return list(zip(angles, _posed_into(np.array(poses), np.array(scales), bones), strict=True)) if poses else []


def _posed_into(poses: Floats, scales: Floats, bones: BoneMotion) -> list[Guess]:
    """The body shifted, scaled and posed until the points lie near its bones, by iterated weighted least squares: into
    each of poses (guesses, points, 3) side by side, from scales (guesses,)."""
    guesses, count = poses.shape[:2]
    parents, scale = bones.parents, scales[:, None]
    flat_modes = bones.statistics.bases[0][:POSTURE_MODES]
    modes = flat_modes.reshape(POSTURE_MODES, -1, 4, 3)
    usual = step_size(bones.statistics.means[POSE : POSE + POSTURE_MODES])
    arms = bones.pose.reshape(-1, 4, 3)
    shift = poses.mean(axis=1) - scale * bones.joints.mean(axis=0)
    middle = (bones.joints[:, 1].max() + bones.joints[:, 1].min()) / 2
    shift[:, 1] = (poses[..., 1].max(axis=1) + poses[..., 1].min(axis=1)) / 2 - scales * middle
    posed, bone = np.repeat(arms[None], guesses, axis=0), np.zeros((guesses, count), np.int64)
    shifts = np.tile(np.eye(3), count)
    for round_ in range(POSING_ROUNDS):
        joints = posed[:, :, 0] * scale[:, None] + shift[:, None]
        bone, share, distance = _nearest_bones(poses, joints, parents)
        weight = 1 / (0.05 + distance)
        free = 0 if round_ < POSING_ROUNDS // 3 else POSTURE_MODES
        ends, starts = modes[:free, :, 0][:, bone], modes[:free, :, 0][:, parents[bone]]
        still = arms[parents[bone], 0] * (1 - share) + arms[bone, 0] * share
        moves = (starts * (1 - share) + ends * share).swapaxes(0, 1).reshape(guesses, free, 3 * count)
        wide = np.concatenate([usual[:free] * scale, 0.1 * scale, np.full((guesses, 3), 10.0)], axis=1)
        flat = still.reshape(guesses, 1, -1)
        a = np.concatenate([moves, flat, np.repeat(shifts[None], guesses, axis=0)], axis=1) * wide[..., None]
        weighted = a * np.repeat(weight / weight.sum(axis=1, keepdims=True), 3, axis=1)[:, None]
        stiff = ((NEAR_BONE_M * scale) ** 2 / count)[..., None] * np.eye(a.shape[1])
        off = poses.reshape(guesses, -1, 1) - flat.swapaxes(1, 2) * scale[..., None]
        best = np.linalg.solve(weighted @ a.swapaxes(1, 2) + stiff, weighted @ off)[..., 0] * wide
        scale = np.clip(scale + best[:, free : free + 1], *SCALES)
        shift = best[:, free + 1 :]
        posed = arms + ((best[:, None, :free] / scale[..., None]) @ flat_modes[:free]).reshape(posed.shape)
    each = np.arange(guesses)[:, None]
    axes = ((posed[:, :, 1:] - posed[:, :, :1]) / ARM_M).swapaxes(2, 3)[each, bone]
    away = poses - posed[each, bone, 0] * scale[..., None] - shift[:, None]
    offsets = (np.linalg.pinv(axes, 0.3) @ away[..., None])[..., 0]
    farthest = FARTHEST_M * scale[..., None]
    offsets = offsets.clip(-farthest, farthest)
    return [Guess(float(s[0]), b, o) for s, b, o in zip(scale, bone, offsets, strict=True)]


def _nearest_bones(poses: Floats, joints: Floats, parents: Integers) -> tuple[Integers, Floats, Floats]:
    """The nearest bone of each point of poses (guesses, points, 3): its number, (guesses, points); where along it the
    point is, 0 at its start to 1 at its joint, (guesses, points, 1); and the distance, (guesses, points).

    joints (guesses, bones, 3).
    """
    if (kernel := native.kernel("nearest_bones")) is not None:
        return kernel(poses, joints, parents)
    start = joints[:, parents]
    along = joints - start
    offset = poses[:, :, None] - start[:, None]
    part = (offset * along[:, None]).sum(axis=3) / ((along**2).sum(axis=2) + 1e-9)[:, None]
    np.clip(part, 0.0, 1.0, out=part)
    offset -= part[..., None] * along[:, None]
    offset *= offset
    distance = np.sqrt(offset.sum(axis=3))
    bone = distance.argmin(axis=2)[..., None]
    share, nearest = (np.take_along_axis(each, bone, axis=2) for each in (part, distance))
    return bone[..., 0], share, nearest[..., 0]


def _components(bones: BoneMotion) -> Floats:
    """The prior's components times their usual strength: (modes, 12 bones)."""
    strength = step_size(bones.statistics.spreads[POSE : POSE + SEARCH_MODES, SEARCH_FREQUENCY])
    return bones.statistics.bases[0][: len(strength)] * strength[:, None]


def _likeliest(moved: Floats, guesses: Sequence[tuple[float, Guess]], bones: BoneMotion) -> list[tuple[float, Guess]]:
    """The guesses that explain movement (frames, points, 3) best."""

    def cost(guess: tuple[float, Guess]) -> float:
        a, flat, noise, _ = _explanation(moved, *guess, bones)
        return _negative_log_likelihood(a, flat, noise)

    return sorted(guesses, key=cost)[:KEPT_GUESSES]


def _explanation(moved: Floats, angle: float, guess: Guess, bones: BoneMotion) -> tuple[Floats, Floats, float, float]:
    """Movement of the points for a unit of each component, (3 points, modes), scaled to the energy of the movement;
    the movement rotated by the angle, (3 points, frames); noise variance; and the scaling."""
    flat = heading.rotate(moved, np.full(len(moved), angle)).reshape(len(moved), -1).T
    energy = float((flat**2).mean()) + 1e-12
    weights = markers_on_bones.weights(guess.bone, guess.offsets, guess.scale)
    a = markers_on_bones.moved_points(_components(bones), weights, guess.bone).T
    gain = float(np.sqrt(energy / max(float((a**2).sum() / len(a)), 1e-12)))
    return a * gain, flat, UNEXPLAINED * energy, gain


def _negative_log_likelihood(a: Floats, flat: Floats, noise: float) -> float:
    """Per frame, up to a constant, of movement (3 points, frames) under the Gaussian of covariance a aᵀ + noise."""
    inner = np.eye(a.shape[1]) + a.T @ a / noise
    factor = np.linalg.cholesky(inner)
    along = np.linalg.solve(factor, a.T @ flat) / noise
    fits = (float((flat**2).sum()) / noise - float((along**2).sum())) / flat.shape[1]
    return 2 * float(np.log(np.diag(factor)).sum()) + fits + len(flat) * float(np.log(noise))


def _refined(
    moved: Floats, angle: float, guess: Guess, bones: BoneMotion, rounds: int = KEPT_ROUNDS
) -> tuple[float, float, Guess]:
    """Alternates between the movement of all bones, given placements, and the placement of each point, given that.

    Returns the negative log-likelihood, the angle, and the refined guess.
    """
    a, flat, noise, gain = _explanation(moved, angle, guess, bones)
    energy, frames, count = noise / UNEXPLAINED, flat.shape[1], len(guess.bone)
    components = _components(bones)
    own = flat.reshape(count, 3, frames)
    points = np.arange(count)
    for _ in range(rounds):
        parts = np.linalg.solve(np.eye(a.shape[1]) + a.T @ a / noise, a.T @ flat / noise)
        noise = max(float(((flat - a @ parts) ** 2).mean()), LEAST_UNEXPLAINED * energy)
        bone_motion = (components.T @ parts * gain).reshape(-1, 4, 3, frames)
        weights = markers_on_bones.weights(guess.bone, guess.offsets, guess.scale)
        target = own + np.einsum("pw,pwct->pct", weights, bone_motion[guess.bone]).mean(axis=0)
        rotating = ((bone_motion[:, 1:] - bone_motion[:, :1]) / ARM_M).reshape(len(bone_motion), 3, -1)
        rest = (target[None] - guess.scale * bone_motion[:, None, 0]).reshape(len(bone_motion), count, -1)
        along = rest @ rotating.swapaxes(1, 2)
        stiff = noise / (NEAR_BONE_M * guess.scale) ** 2 * np.eye(3)
        inner = rotating @ rotating.swapaxes(1, 2) + stiff
        offsets = np.linalg.solve(inner[:, None], along[..., None])[..., 0]
        cost = np.einsum("bpi,bpi->bp", rest, rest) - np.einsum("bpi,bpi->bp", offsets, along)
        pick = cost.argmin(axis=0)
        free = cost[pick, points] > FREE_SHARE * (own**2).sum(axis=(1, 2)) + 1e-9 * energy
        found = np.round(offsets[pick, points] / OFFSET_UNIT_M) * OFFSET_UNIT_M
        farthest = FARTHEST_M * guess.scale
        guess = Guess(guess.scale, np.where(free, NO_BONE, pick), found.clip(-farthest, farthest))
        a, _, _, gain = _explanation(moved, angle, guess, bones)
    return _negative_log_likelihood(a, flat, noise), angle, guess


def cheapest_levels(
    positions: Sequence[Floats],
    start: Model,
    spreads: Callable[[Integers], Integers],
    first: tuple[int, ...],
    step: int,
) -> Integers:
    """The levels whose spreads (rows, frequencies) make the coefficients of the recording cheapest: coordinate
    descent on an estimate of the bits."""
    size = float(step_size(step)) * LEVEL_FLOOR_STEPS
    nodes = np.array(contexts.BANDS_MHZ[1:])
    total, count = np.zeros((len(nodes), start.rows - POSE)), np.zeros(len(nodes))
    for p in positions:
        spectrum = np.abs(start.analyse(p)[1:, POSE:]) * np.sqrt(120 / start.rate)
        millihertz = np.arange(1, len(p)) * start.rate * 500 / len(p)
        near = np.abs(np.log(millihertz[:, None] / nodes)).argmin(axis=1)
        np.add.at(total, near, spectrum)
        np.add.at(count, near, 1.0)
    mean = total / np.maximum(count, 1)[:, None] + size

    def bits(levels: tuple[int, ...]) -> float:
        expected = step_size(spreads(np.array(levels))[:, 1:].T) + size
        return float((count[:, None] * (np.log2(expected) + mean / expected / np.log(2))).sum())

    best, levels = bits(first), first
    for width in (16, 8, 4, 2, 1) * 2:
        for i in range(len(first)):
            for change in (-width, width):
                other = (*levels[:i], int(np.clip(levels[i] + change, -400, 400)), *levels[i + 1 :])
                cost = bits(other)
                if cost < best:
                    best, levels = cost, other
    return np.array(levels)
