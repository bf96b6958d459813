"""Where the points of a recording sit on the prior's bones, found from a pose and from how they move.

    a pose ─turned, the prior's body scaled, shifted and posed into it─► nearest bones ─► offsets ─┐  first guesses
    movement ─► what all bones probably did ─► the bone and offset that explain each point best ───┤  again and again
                                                              the likeliest of all tries ◄─────────┘─► mapped.Stored

Names say nothing here: there are as many as there are laboratories.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...motion import Floats
from . import body, contexts, mapped
from .model import POSE, Model, step_size
from .prior import Bones, Prior

Integers = NDArray[np.int64]

SAMPLE_FRAMES = 120
SEARCH_MODES, POSTURE = 96, 24
"""So many components tell movement in the search, and so many of them posture."""
SEARCH_NODE = 2
"""Movement at this one of `BANDS_MHZ` says how strong the components are."""
TURNS = 12
SCALES, EXTENTS = (0.25, 4.0), (0.05, 5.0)
"""A body smaller or larger than this is none; nor are points that reach so much less far than it, or farther."""
LAY_ROUNDS = 6
BEST, BEST_ROUNDS, LAST_ROUNDS = 4, 3, 5
"""So many of the first guesses are followed for so many rounds, and the best of these for more."""
NEAR_M = 0.12
"""How far from its bone a point usually is."""
UNEXPLAINED, LEAST_UNEXPLAINED = 0.05, 1e-3
"""Shares of the movement that bones do not explain: to begin with, and at least."""
FREE_FROM = 0.8
"""A point of whose movement more than this is not explained by any bone is on none."""
FURTHEST_M = 0.75


@dataclass(frozen=True, eq=False)
class Try:
    """One way in which points may sit on bones: scale of the body; bones (points,); offsets (points, 3), metres."""

    scale: float
    where: Integers
    offsets: Floats


def fit(
    positions: Sequence[Floats], prior: Prior, names: tuple[str, ...], rate: float, step: int
) -> tuple[mapped.Stored, mapped.Movements] | None:
    """How the points of chunks (frames, points, 3), y up, sit on bones; none where they look like no body."""
    bones, frames = prior.bones, sum(map(len, positions))
    if bones is None or len(names) < FEWEST or not frames:
        return None
    centred = np.concatenate([p[:: max(1, frames // 2000)] for p in positions])
    centred = centred - centred.mean(axis=1, keepdims=True)
    pose = body.mean_pose(centred)
    centred = centred[:: max(1, len(centred) // SAMPLE_FRAMES)]
    turned = body.turn(centred, -body.heading(centred, pose))
    tallest = turned[np.ptp(turned[..., 1], axis=1).argmax()]
    guesses = [g for p in (pose, tallest) for g in _laid(p, bones)]
    if not guesses:
        return None
    # A body faces its own way; the pose is turned to the prior's.
    best = min((_followed(turned - pose, turn, t, bones) for turn, t in _likely(turned - pose, guesses, bones)),
               key=lambda found: found[0])  # fmt: skip
    _, turn, found = _followed(turned - pose, best[1], best[2], bones, LAST_ROUNDS)
    digits = int(np.clip(COARSER - np.floor(np.log2(step_size(step) / np.sqrt(frames))), -60, 60))
    offsets = np.where((found.where >= 0)[:, None], np.rint(found.offsets / mapped.OFFSET_UNIT), 0).astype(np.int64)
    here, levels = body.turn(pose[None], np.array([turn]))[0], np.array(FIRST_LEVELS)
    scale = round(found.scale / mapped.SCALE_UNIT)
    plain = mapped.Stored(digits, _in_digits(here, digits), False, scale, found.where, offsets, levels)
    on_body = replace(plain, pose=_in_digits(here - mapped.on_body(plain, bones), digits), on_body=True)
    stored = min(plain, on_body, key=lambda s: len(s.pack()))
    moves = mapped.movements(stored, bones)
    start = mapped.model(stored, moves, bones, prior, names, rate)
    return replace(stored, levels=_levels(positions, start, moves, bones, step)), moves


FEWEST = 4
"""Fewer points than this are no body."""
COARSER = -2
"""The mean pose is stored in steps of 2^−(this) of Δ/√frames, a power of two metres."""
FIRST_LEVELS = (0, 0, -24, 0, -140)


def _in_digits(pose: Floats, digits: int) -> Integers:
    return np.rint(np.ldexp(pose, digits)).astype(np.int64)


def _laid(pose: Floats, bones: Bones) -> list[tuple[float, Try]]:
    """First guesses: turns, and the body laid into the pose so turned, at the scale of its height or at the prior's."""
    height, found = np.ptp(bones.joints[:, 1]), []
    if not EXTENTS[0] < float(np.sqrt((pose**2).mean() / (bones.joints**2).mean())) < EXTENTS[1]:
        return []
    for turn in np.arange(TURNS) * 2 * np.pi / TURNS:
        here = body.turn(pose[None], np.array([turn]))[0]
        for scale in (float(np.ptp(here[:, 1]) / height), 1.0):
            if SCALES[0] < scale < SCALES[1]:
                found.append((float(turn), _settled(here, scale, bones)))
    return found


def _settled(pose: Floats, scale: float, bones: Bones) -> Try:
    """The body moved, scaled and posed until the points lie near its bones; the offsets that they then have."""
    count, parents = len(pose), bones.parents
    modes = bones.set.bases[0][:POSTURE].reshape(POSTURE, -1, 4, 3)
    usual = step_size(bones.set.means[POSE : POSE + POSTURE])
    arms = bones.set.pose.reshape(-1, 4, 3)
    shift = pose.mean(axis=0) - scale * bones.joints.mean(axis=0)
    middle = (bones.joints[:, 1].max() + bones.joints[:, 1].min()) / 2
    shift[1] = (pose[:, 1].max() + pose[:, 1].min()) / 2 - scale * middle
    posed, at, points = arms, np.zeros(count, np.int64), np.arange(count)
    for done in range(LAY_ROUNDS):
        joints = posed[:, 0] * scale + shift
        start, along = joints[parents], joints - joints[parents]
        offset = pose[:, None] - start
        part = np.clip((offset * along).sum(axis=2) / ((along**2).sum(axis=1) + 1e-9), 0.0, 1.0)
        distance = np.sqrt(((offset - part[..., None] * along) ** 2).sum(axis=2))
        at = distance.argmin(axis=1)
        share = part[points, at][:, None]
        weight = 1 / (0.05 + distance[points, at])
        free = 0 if done < LAY_ROUNDS // 3 else POSTURE
        ends, starts = modes[:free, :, 0][:, at], modes[:free, :, 0][:, parents[at]]
        still = arms[parents[at], 0] * (1 - share) + arms[at, 0] * share
        moves = (starts * (1 - share) + ends * share).reshape(free, 3 * count)
        wide = np.concatenate([usual[:free] * scale, [0.1 * scale], np.full(3, 10.0)])
        a = np.concatenate([moves, still.reshape(1, -1), np.tile(np.eye(3), count)]).T * wide
        w = np.repeat(weight / weight.sum(), 3)[:, None]
        inner = (a * w).T @ a + (NEAR_M * scale) ** 2 / count * np.eye(a.shape[1])
        best = np.linalg.solve(inner, (a * w).T @ (pose.ravel() - still.ravel() * scale)) * wide
        scale = float(np.clip(scale + best[free], *SCALES))
        shift = best[free + 1 :]
        posed = arms + np.tensordot(best[:free] / scale, modes[:free], 1)
    turns = ((posed[:, 1:] - posed[:, :1]) / mapped.REACH_M).swapaxes(1, 2)[at]
    offsets = (np.linalg.pinv(turns, 0.3) @ (pose - posed[at, 0] * scale - shift)[..., None])[..., 0]
    return Try(scale, at, offsets.clip(-FURTHEST_M * scale, FURTHEST_M * scale))


def _components(bones: Bones) -> Floats:
    """The prior's components, as large as they usually are: (modes, 12 bones)."""
    strength = step_size(bones.set.spreads[POSE : POSE + SEARCH_MODES, SEARCH_NODE])
    return bones.set.bases[0][: len(strength)] * strength[:, None]


def _likely(moved: Floats, guesses: Sequence[tuple[float, Try]], bones: Bones) -> list[tuple[float, Try]]:
    """The guesses that explain movement (frames, points, 3) best."""

    def cost(guess: tuple[float, Try]) -> float:
        turn, t = guess
        a, flat, noise, _ = _explained(moved, turn, t, bones)
        return _unlikely(a, flat, noise)

    return sorted(guesses, key=cost)[:BEST]


def _explained(moved: Floats, turn: float, t: Try, bones: Bones) -> tuple[Floats, Floats, float, float]:
    """What a unit of each component moves the points by, (3 points, modes), scaled to the energy that there is; the
    movement so turned, (3 points, frames); noise, squared; and the scaling."""
    flat = body.turn(moved, np.full(len(moved), turn)).reshape(len(moved), -1).T
    energy = float((flat**2).mean()) + 1e-12
    a = mapped.spread_over(_components(bones), mapped.shares(t.where, t.offsets, t.scale), t.where).T
    gain = float(np.sqrt(energy / max(float((a**2).sum() / len(a)), 1e-12)))
    return a * gain, flat, UNEXPLAINED * energy, gain


def _unlikely(a: Floats, flat: Floats, noise: float) -> float:
    """How unlikely movement (3 points, frames) is, as the logarithm of a Gaussian's density a frame."""
    inner = np.eye(a.shape[1]) + a.T @ a / noise
    factor = np.linalg.cholesky(inner)
    along = np.linalg.solve(factor, a.T @ flat) / noise
    fits = (float((flat**2).sum()) / noise - float((along**2).sum())) / flat.shape[1]
    return 2 * float(np.log(np.diag(factor)).sum()) + fits + len(flat) * float(np.log(noise))


def _followed(moved: Floats, turn: float, t: Try, bones: Bones, rounds: int = BEST_ROUNDS) -> tuple[float, float, Try]:
    """Movement tells what all bones did, and that on which bone, and where, each point sits: how unlikely that is in
    the end, the turn, and the try."""
    a, flat, noise, gain = _explained(moved, turn, t, bones)
    energy, frames, count = noise / UNEXPLAINED, flat.shape[1], len(t.where)
    components = _components(bones)
    own = flat.reshape(count, 3, frames)
    for _ in range(rounds):
        parts = np.linalg.solve(np.eye(a.shape[1]) + a.T @ a / noise, a.T @ flat / noise)
        left = float(((flat - a @ parts) ** 2).mean())
        noise = max(left, LEAST_UNEXPLAINED * energy)
        did = (components.T @ parts * gain).reshape(-1, 4, 3, frames)
        weights = mapped.shares(t.where, t.offsets, t.scale)
        target = own + np.einsum("pw,pwct->pct", weights, did[t.where]).mean(axis=0)
        turning = ((did[:, 1:] - did[:, :1]) / mapped.REACH_M).reshape(len(did), 3, -1)
        rest = (target[None] - t.scale * did[:, None, 0]).reshape(len(did), count, -1)
        along = rest @ turning.swapaxes(1, 2)
        stiff = noise / (NEAR_M * t.scale) ** 2 * np.eye(3)
        inner = turning @ turning.swapaxes(1, 2) + stiff
        offsets = np.linalg.solve(inner[:, None], along[..., None])[..., 0]
        cost = np.einsum("bpi,bpi->bp", rest, rest) - np.einsum("bpi,bpi->bp", offsets, along)
        pick = cost.argmin(axis=0)
        points = np.arange(count)
        free = cost[pick, points] > FREE_FROM * (own**2).sum(axis=(1, 2)) + 1e-9 * energy
        found = np.round(offsets[pick, points] / mapped.OFFSET_UNIT) * mapped.OFFSET_UNIT
        furthest = FURTHEST_M * t.scale
        t = Try(t.scale, np.where(free, -1, pick), found.clip(-furthest, furthest))
        a, _, _, gain = _explained(moved, turn, t, bones)
    return _unlikely(a, flat, noise), turn, t


def _levels(positions: Sequence[Floats], start: Model, found: mapped.Movements, bones: Bones, step: int) -> Integers:
    return cheapest(positions, start, lambda at: mapped.spreads_of(found, bones.usual, at), FIRST_LEVELS, step)


def cheapest(
    positions: Sequence[Floats],
    start: Model,
    spreads: Callable[[Integers], Integers],
    first: tuple[int, ...],
    step: int,
) -> Integers:
    """The levels whose spreads (rows, frequencies) make the coefficients of the recording cheapest."""
    size = float(step_size(step)) * FLOOR
    nodes = np.array(contexts.BANDS_MHZ[1:])
    total, count = np.zeros((len(nodes), start.rows - POSE)), np.zeros(len(nodes))
    for p in positions:
        spectrum = np.abs(start.analyse(p)[1:, POSE:]) * np.sqrt(120 / start.rate)
        hertz = np.arange(1, len(p)) * start.rate * 500 / len(p)
        near = np.abs(np.log(hertz[:, None] / nodes)).argmin(axis=1)
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


FLOOR = 0.3
"""A coefficient below this many steps costs as little as none."""
