"""Which rule each joint follows, chosen once per recording, and the side values of the recording.

skeleton, positions, rotations ─choose─► rules        constant · restricted freedom · what the positions show
the same and rules ─side_values─► (frames, side values)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ....geometry import articulation, rigid
from ....motion import Skeleton
from ....typing import Floats, Integers
from . import rules as r
from . import shell, solve
from .rules import (
    Carried,
    Form,
    JointRule,
    Rules,
    angle_steps,
    angles_of_steps,
    carried_vectors,
    form_angles,
    limits_form,
)

SAMPLED_FRAMES = 128
"""At most this many frames decide a rule; constant and locked angles are checked in all frames."""
RIGID_M = 5e-5
"""A joint that is farther than this from the end of its offset is placed: it has translation channels."""
SAME = 1e-8
"""Components of quaternions that differ by no more are equal: 10⁻⁶ degrees."""
LEVER_M = 0.01
"""A rotation follows from positions where a point at least this far off its axis shows it,"""
HUB_LEVER_M = 0.02
"""for a hub also across the first direction, and for two angles by their second."""
RARELY = 0.02
"""Two angles may be shown worse in this share of the frames, which corrections mend."""
REPRODUCED = 0.02
"""A rule must reproduce the rotations from the original positions within this angle, radians."""
FARTHEST_SWING = 0.03
"""Swings whose 1 + cosine is smaller are coded whole: the shortest rotation is not defined for opposite directions."""
USUAL_UNIT = 16
"""Usual rotations are stored as rotation vectors in 1/16 rad."""
USUAL_MOST = 64
"""The largest component of one that a stream may have."""


def choose(skeleton: Skeleton, own_frame: bool, positions: Floats, rotations: Floats) -> Rules:
    """The rules for a recording: positions (frames, joints, 3), local rotations (frames, joints, 4), unit."""
    world = shell.world_rotations(skeleton, rotations)
    placed = _placed(skeleton, own_frame, positions, world)
    forms = _forms(skeleton, rotations)
    joints = [
        JointRule(r.FREE, p, usual_rotation(rotations[:, j]), form)
        for j, (p, form) in enumerate(zip(placed, forms, strict=True))
    ]
    for joint, rule in enumerate(joints):
        q = rotations[:, joint]
        if _is_constant(q):
            joints[joint] = replace(rule, rule=r.FIXED, usual=_constant(q[0], limits_form(skeleton, joint)), form=None)
    carried = carried_vectors(skeleton, own_frame, joints)
    some = slice(None, None, max(1, len(positions) // SAMPLED_FRAMES))
    for joint, rule in enumerate(joints):
        if rule.rule != r.FIXED:
            aims = aims_of(skeleton, carried[joint], joint, positions[some], world[some])
            joints[joint] = _rule(rule, carried[joint], aims, rotations[some, joint])
    return Rules(skeleton, own_frame, joints)


def side_values(rules: Rules, positions: Floats, rotations: Floats) -> Floats:
    """The side values (frames, side_values) of a recording, continuous in time."""
    world = shell.world_rotations(rules.skeleton, rotations)
    values = np.empty((len(positions), rules.side_values))
    for joint, (rule, start) in enumerate(zip(rules.joints, rules.starts, strict=False)):
        if not rule.side_values:
            continue
        own = slice(start, start + rule.side_values)
        q = rotations[:, joint]
        if rule.rule == r.FREE:
            values[:, own] = continuous(rigid.multiply(rigid.inverse(rule.usual), q))
        elif rule.rule == r.SWING:
            aims = aims_of(rules.skeleton, rules.carried[joint], joint, positions, world)
            values[:, own] = np.unwrap(_twist(rule, rules.carried[joint], aims, q))[:, None]
        else:
            assert rule.form is not None
            angles = np.unwrap(form_angles(rule.form, q), axis=0)
            values[:, own] = angles[:, -rule.side_values :]
    return values


def chunk_values(rules: Rules, values: Floats) -> Floats:
    """Side values of a chunk, less the nominal ones; whole turns and signs of quaternions near them."""
    out = values - rules.nominal
    for rule, start in zip(rules.joints, rules.starts, strict=False):
        own = slice(start, start + rule.side_values)
        if rule.rule == r.FREE:
            if values[:, start].mean() < 0:
                out[:, own] = -values[:, own] - rules.nominal[own]
        elif rule.side_values:
            out[:, own] -= 2 * np.pi * np.rint(out[:, own].mean(axis=0) / (2 * np.pi))
    return out


def aims_of(skeleton: Skeleton, carried: Carried, joint: int, positions: Floats, world: Floats) -> Floats:
    """Where positions show the carried vectors, in the parent's frame: (n, frames, 3)."""
    parent = skeleton.parents[joint]
    aims = np.array([positions[:, t] - positions[:, carried.anchor] for t in carried.targets])
    aims = aims.reshape(-1, len(positions), 3)
    return aims if parent < 0 else rigid.rotate(rigid.inverse(world[:, parent]), aims)


def usual_rotation(q: Floats) -> Floats:
    """The mean (4,) of rotations (frames, 4), rounded as it is stored."""
    _, vectors = np.linalg.eigh(q.T @ q)
    return rounded_usual(stored_usual(vectors[:, -1]))


def stored_usual(q: Floats) -> Floats:
    """A rotation (4,) as a rotation vector in stored units, (3,), integers."""
    return np.rint(articulation.log(rigid.to_matrix(q)) * USUAL_UNIT)


def rounded_usual(stored: Floats | Integers) -> Floats:
    """The rotation (4,) of stored units."""
    vector = np.asarray(stored, np.float64) / USUAL_UNIT
    angle = float(np.sqrt(vector @ vector))
    axis = vector / angle if angle else vector
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])


def continuous(q: Floats) -> Floats:
    """Quaternions (frames, 4) with signs that follow each other; of the two choices the one nearer to no rotation."""
    flips = np.where((q[1:] * q[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    signs = np.concatenate([[1.0], np.cumprod(flips)])
    signs *= -1.0 if float((signs * q[:, 0]).sum()) < 0 else 1.0
    return q * signs[:, None]


def _is_constant(q: Floats) -> bool:
    """Whether rotations (frames, 4) are one. A single frame shows it of no rotation only: others would be stored in
    float64, whatever the target."""
    if len(q) == 1 and not np.array_equal(_tidy(q[0]), r.IDENTITY):
        return False
    return bool(np.abs(_aligned(q, q[:1]) - q[0]).max() < SAME)


def _placed(skeleton: Skeleton, own_frame: bool, positions: Floats, world: Floats) -> list[bool]:
    """Which joints are not at the end of their offset in some frame."""
    result = []
    for joint, parent in enumerate(skeleton.parents):
        if parent < 0:
            result.append(False)
            continue
        carrier = world[:, joint if own_frame else parent]
        end = positions[:, parent] + rigid.rotate(carrier, skeleton.offsets[joint])
        result.append(bool(np.abs(end - positions[:, joint]).max() > RIGID_M))
    return result


def _aligned(q: Floats, like: Floats) -> Floats:
    """Quaternions with the sign that brings them near others."""
    return q * np.where((q * like).sum(axis=-1, keepdims=True) < 0, -1.0, 1.0)


def _constant(q: Floats, form: Form | None) -> Floats:
    """A constant rotation (4,), in decimal degrees where that is within the tolerance; form: of the joint limits."""
    q = _tidy(q)
    if form is None or np.array_equal(q, r.IDENTITY):
        return q
    made = form.rotation(angles_of_steps(angle_steps(form, q)))
    return made if np.abs(_aligned(made, q) - q).max() < 2 * SAME else q


def _tidy(q: Floats) -> Floats:
    """The quaternion, w ≥ 0; no rotation where it is nearly none."""
    q = q if q[0] >= 0 else -q
    return r.IDENTITY if np.abs(q - r.IDENTITY).max() < SAME else np.array(q)


def _forms(skeleton: Skeleton, rotations: Floats) -> list[Form | None]:
    """The form of each joint with the fewest free angles that all frames have, or None where all three are free."""
    some = rotations[:: max(1, len(rotations) // SAMPLED_FRAMES)]
    angles = {order: rigid.to_euler(order, some) for order in r.ORDERS}
    result: list[Form | None] = []
    for joint in range(len(skeleton)):
        q = rotations[:, joint]
        candidates = _candidates(skeleton, joint, {order: a[:, joint] for order, a in angles.items()})
        result.append(next((form for form in candidates if _has_form(q, form)), None))
    return result


def _has_form(q: Floats, form: Form) -> bool:
    made = form.rotation(form_angles(form, q))
    return bool(np.abs(_aligned(made, q) - q).max() < 100 * SAME)


def _candidates(skeleton: Skeleton, joint: int, sampled: dict[str, Floats]) -> Iterator[Form]:
    """The form that the limits say, then those of Euler angles (frames, 3) that are constant in some frames."""
    if (of_limits := limits_form(skeleton, joint)) is not None:
        yield of_limits
    found: list[Form] = []
    for order, angles in sampled.items():
        constant = np.abs(np.sin((angles - angles[0]) / 2)).max(axis=0) < SAME
        if 0 < constant.sum() < 3:
            value = np.where(np.abs(angles[0]) < SAME, 0.0, angles[0])
            found.append(Form(order, r.IDENTITY, np.where(constant, value, np.nan)))
    yield from sorted(found, key=lambda form: (len(form.free), np.count_nonzero(np.nan_to_num(form.locked))))


def _rule(rule: JointRule, carried: Carried, aims: Floats, q: Floats) -> JointRule:
    """The rule of a joint that moves: the one with the fewest side values that reproduces its rotations."""
    if rule.form is not None:
        return _restricted(rule, carried, aims, q)
    if not len(carried.vectors):
        return rule
    if _second_lever(carried.vectors) >= HUB_LEVER_M:
        hub = replace(rule, rule=r.HUB, pair=_pair(carried.vectors))
        if _reproduces(hub, carried, aims, q):
            return hub
    end = solve.unit(solve.aimed(carried, aims))
    cosine = end @ rigid.rotate(rule.usual, carried.direction)
    if carried.lever < LEVER_M or 1 + cosine.min(initial=1.0) < FARTHEST_SWING:
        return rule
    shown = rigid.rotate(q, carried.direction)
    if (1 - (shown * end).sum(axis=1)).max(initial=0.0) > REPRODUCED**2 / 2:
        return rule
    return replace(rule, rule=r.SWING)


def _restricted(rule: JointRule, carried: Carried, aims: Floats, q: Floats) -> JointRule:
    """The rule of a joint with one or two free angles."""
    assert rule.form is not None
    constants, axes = rule.form.factors
    coded = replace(rule, rule=r.HINGE_CODED if len(axes) == 1 else r.UNIVERSAL_CODED)
    if not len(carried.vectors):
        return coded
    ends = rigid.rotate(constants[-1], carried.vectors)
    if len(axes) == 1:
        across = ends - np.outer(ends @ axes[0], axes[0])
        hinge = replace(rule, rule=r.HINGE)
        shown = np.sqrt((across**2).sum()) >= LEVER_M and _reproduces(hinge, carried, aims, q)
        return hinge if shown else coded
    w = rigid.rotate(constants[-1], carried.direction)
    n = rigid.rotate(rigid.inverse(constants[1]), axes[0])
    second = form_angles(rule.form, q)[:, 1]
    a, b = n @ (w - axes[1] * (axes[1] @ w)), n @ np.cross(axes[1], w)
    lever = carried.lever * np.abs(b * np.cos(second) - a * np.sin(second))
    height = n @ (axes[1] * (axes[1] @ w)) + a * np.cos(second) + b * np.sin(second)
    across = carried.lever * np.sqrt(np.maximum(1 - height**2, 0))
    if np.quantile(across, RARELY) < LEVER_M:
        return coded
    if np.quantile(lever, RARELY) >= HUB_LEVER_M:
        for branch in (1, -1):
            universal = replace(rule, rule=r.UNIVERSAL, branch=branch)
            if _reproduces(universal, carried, aims, q):
                return universal
    return replace(rule, rule=r.UNIVERSAL_REFINED)


def _reproduces(rule: JointRule, carried: Carried, aims: Floats, q: Floats) -> bool:
    """Whether a rule without side values gives these rotations, nearly."""
    made = solve.rotation_of(rule, carried, aims, np.zeros((len(q), 0)))
    return bool((np.abs((made * q).sum(axis=1)) > np.cos(REPRODUCED / 2)).all())


def _second_lever(vectors: Floats) -> float:
    """How far vectors reach across their main direction: the root of the second eigenvalue of Σ v vᵀ, metres."""
    return float(np.sqrt(max(np.linalg.eigvalsh(vectors.T @ vectors)[1], 0.0)))


def _pair(vectors: Floats) -> tuple[int, int]:
    """The longest vector, and the one that reaches farthest across it."""
    first = int(np.argmax((vectors**2).sum(axis=1)))
    across = (np.cross(vectors[first], vectors) ** 2).sum(axis=1)
    return first, int(np.argmax(across))


def _twist(rule: JointRule, carried: Carried, aims: Floats, q: Floats) -> Floats:
    """The twist (frames,) of rotations about their carried direction, after the shortest rotation onto the aims."""
    start = rigid.rotate(rule.usual, carried.direction)
    swung = rigid.multiply(solve.shortest(start, solve.unit(solve.aimed(carried, aims))), rule.usual)
    left = rigid.multiply(rigid.inverse(swung), q)
    return 2 * np.arctan2(left[:, 1:] @ carried.direction, left[:, 0])
