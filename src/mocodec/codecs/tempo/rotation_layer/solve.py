"""Rotations from positions: each joint is aimed at its targets, parents first.

    targets (what the inner stream decodes to), side values ─solve─► local rotations, positions

A joint aims from where its parent was placed, so errors do not accumulate along a limb. The positions that come out are
those of forward kinematics, with all bones at their own length.
"""

from __future__ import annotations

import numpy as np

from .... import native
from ....geometry import rigid
from ....typing import Floats
from . import shell
from .rules import (
    FIXED,
    FREE,
    HINGE,
    HINGE_CODED,
    HUB,
    SWING,
    UNIVERSAL_CODED,
    UNIVERSAL_REFINED,
    Carried,
    JointRule,
    Rules,
)

REFINE_WEIGHT_M = 0.03
"""How far a point must be off its bone for its error by a coded twist to weigh as much as a hinge's target."""
REFINEMENTS = 4
"""Gauss–Newton steps for a twist or a second angle."""
HUB_STEPS = 3
"""Gauss–Newton steps for the rotation of a hub."""
TINY = 1e-12


def solve(rules: Rules, targets: Floats, side: Floats) -> tuple[Floats, Floats]:
    """Local rotations (frames, joints, 4) and positions (frames, joints, 3).

    targets (frames, joints, 3): metres. side (frames, side_values).
    """
    if (kernel := native.kernel("aim_joints")) is not None:
        from .compiled import tables

        return kernel(np.ascontiguousarray(targets), np.ascontiguousarray(side), *tables(rules))
    frames, joints = targets.shape[:2]
    local = np.empty((frames, joints, 4))
    positions = np.empty((frames, joints, 3))
    world = np.empty((joints, frames, 4))
    for joint, (rule, parent) in enumerate(zip(rules.joints, rules.skeleton.parents, strict=True)):
        held = parent < 0 or rule.placed
        if held:
            positions[:, joint] = targets[:, joint]
        elif not rules.own_frame:
            positions[:, joint] = positions[:, parent] + rigid.rotate(world[parent], rules.skeleton.offsets[joint])
        carried = rules.carried[joint]
        values = side[:, rules.starts[joint] : rules.starts[joint + 1]]
        above = world[parent] if parent >= 0 else np.broadcast_to([1.0, 0, 0, 0], (frames, 4))

        def seen(points: tuple[int, ...], start: Floats, above: Floats = above) -> Floats:
            """From a start to the targets, in the parent's frame: (n, frames, 3)."""
            back = rigid.inverse(above)
            return np.array([rigid.rotate(back, targets[:, p] - start) for p in points]).reshape(-1, frames, 3)

        aims = seen(carried.targets, positions[:, carried.anchor])
        if rule.rule == SWING:
            local[:, joint] = _swing(rule, carried, aims, values[:, 0])
            for hinge in _hinge_aims(rules, joint, positions, above, local[:, joint], targets):
                local[:, joint] = hinge
        else:
            local[:, joint] = rotation_of(rule, carried, aims, values)
        world[joint] = rigid.multiply(above, local[:, joint])
        if rules.own_frame and not held:
            positions[:, joint] = positions[:, parent] + rigid.rotate(world[joint], rules.skeleton.offsets[joint])
    return local, positions


def forward(rules: Rules, local: Floats, held: Floats) -> Floats:
    """Positions (frames, joints, 3) by forward kinematics; roots and placed joints are where `held` has them."""
    world = shell.world_rotations(rules.skeleton, local)
    positions = np.array(held)
    for joint, (rule, parent) in enumerate(zip(rules.joints, rules.skeleton.parents, strict=True)):
        if parent >= 0 and not rule.placed:
            carrier = world[:, joint if rules.own_frame else parent]
            positions[:, joint] = positions[:, parent] + rigid.rotate(carrier, rules.skeleton.offsets[joint])
    return positions


def rotation_of(rule: JointRule, carried: Carried, aims: Floats, values: Floats) -> Floats:
    """Local rotations (frames, 4) by any rule but SWING. aims (n, frames, 3): carried vectors as their targets show
    them, in the parent's frame. values (frames, n): side values.
    """
    frames = len(values)
    if rule.rule == FIXED:
        return np.broadcast_to(rule.usual, (frames, 4))
    if rule.rule == HUB:
        return _hub(rule, carried, aims)
    if rule.rule == FREE:
        return rigid.multiply(rule.usual, unit(values))
    assert rule.form is not None
    if rule.rule in (HINGE_CODED, UNIVERSAL_CODED):
        return rule.form.rotation(values)
    if rule.rule == HINGE:
        return rule.form.rotation(_hinge_angle(rule, carried, aims)[:, None])
    second = values[:, 0] if rule.rule == UNIVERSAL_REFINED else None
    return rule.form.rotation(_two_angles(rule, carried, aims, second))


def unit(vectors: Floats) -> Floats:
    """Vectors divided by their lengths; the first axis for vectors without length."""
    length = np.sqrt((vectors * vectors).sum(axis=-1, keepdims=True))
    first = np.zeros(vectors.shape[-1])
    first[0] = 1.0
    return np.where(length > TINY, vectors / np.maximum(length, TINY), first)


def aimed(carried: Carried, aims: Floats) -> Floats:
    """`Carried.aimed` as the aims (n, frames, 3) show it, (frames, 3)."""
    total = carried.weights[0] * aims[0]
    for weight, aim in zip(carried.weights[1:], aims[1:], strict=True):
        total = total + weight * aim
    return total


def shortest(start: Floats, end: Floats) -> Floats:
    """The shortest rotations (frames, 4) of one unit vector (3,) onto others (frames, 3)."""
    q = np.empty((len(end), 4))
    q[:, 0] = 1.0 + end @ start
    q[:, 1:] = np.cross(np.broadcast_to(start, end.shape), end)
    return unit(q)


def _swing(rule: JointRule, carried: Carried, aims: Floats, twist: Floats) -> Floats:
    """The shortest rotation that takes the usual direction to the aim, after the usual rotation and a twist."""
    start = rigid.rotate(rule.usual, carried.direction)
    end = aimed(carried, aims)
    length = np.sqrt((end * end).sum(axis=1, keepdims=True))
    end = np.where(length > TINY, end / np.maximum(length, TINY), start)
    return rigid.multiply(rigid.multiply(shortest(start, end), rule.usual), twisted(carried.direction, twist))


def twisted(axis: Floats, angle: Floats) -> Floats:
    """Rotations (frames, 4) about a unit vector (3,)."""
    return np.concatenate([np.cos(angle / 2)[:, None], np.sin(angle / 2)[:, None] * axis], axis=1)


def _hinge_aims(
    rules: Rules, joint: int, positions: Floats, above: Floats, local: Floats, targets: Floats
) -> list[Floats]:
    """The joint's rotation with the twist that its hinges show, in a list; nothing where it has no hinges.

    Minimises r² (twist − coded)² + Σ (A cos + B sin − E)², where A cos + B sin − E is how far a hinge's target is off
    the circle that its carried vector describes, metres.
    """
    hinges = rules.hinges[joint]
    if not hinges:
        return []
    carried = rules.carried[joint]
    world = rigid.multiply(above, local)
    back = rigid.inverse(world)
    v = carried.direction
    terms: list[tuple[Floats, Floats, Floats]] = []
    for hinge in hinges:
        of = rules.carried[hinge.child]
        if rules.own_frame and not rules.joints[joint].placed and rules.skeleton.parents[joint] >= 0:
            start = positions[:, rules.skeleton.parents[joint]] + rigid.rotate(world, rules.skeleton.offsets[joint])
        elif rules.own_frame:
            start = positions[:, joint]
        elif rules.joints[hinge.child].placed:
            start = targets[:, hinge.child]
        else:
            start = positions[:, joint] + rigid.rotate(world, rules.skeleton.offsets[hinge.child])
        seen = np.array([rigid.rotate(back, targets[:, p] - start) for p in of.targets])
        aim = aimed(of, seen)
        scale = of.lever / of.size
        lengthwise = v * (v @ hinge.axis)
        terms.append(
            (
                scale * (aim @ (hinge.axis - lengthwise)),
                scale * (aim @ np.cross(v, hinge.axis)),
                scale * (hinge.along - aim @ lengthwise),
            )
        )
    return [rigid.multiply(local, twisted(v, _refined(np.zeros(len(targets)), terms)))]


def _refined(coded: Floats, terms: list[tuple[Floats, Floats, Floats]]) -> Floats:
    """The angle x (frames,) with the least r² (x − coded)² + Σ (A cos x + B sin x − E)²: Gauss–Newton from `coded`."""
    x = coded
    weight = REFINE_WEIGHT_M**2
    for _ in range(REFINEMENTS):
        cos, sin = np.cos(x), np.sin(x)
        top, bottom = weight * (x - coded), np.full(len(x), weight)
        for a, b, e in terms:
            value, slope = a * cos + b * sin - e, b * cos - a * sin
            top = top + slope * value
            bottom = bottom + slope * slope
        x = x - top / bottom
    return x


def _hub(rule: JointRule, carried: Carried, aims: Floats) -> Floats:
    """The rotation that takes the carried vectors nearest to the aims, weighted by their lengths."""
    first, second = rule.pair
    frame = _pair_frame(carried.vectors[first][None], carried.vectors[second][None])[0]
    matrices = _pair_frame(aims[first], aims[second]) @ frame.T
    for _ in range(HUB_STEPS):
        turn, inertia = np.zeros((len(matrices), 3)), np.zeros((len(matrices), 3, 3))
        for v, aim in zip(carried.vectors, aims, strict=True):
            r = matrices @ v
            turn += np.cross(r, aim)
            inertia += (r * r).sum(axis=1)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None, :]
        by = _solve3(inertia, turn)
        matrices = rigid.to_matrix(unit(np.concatenate([np.ones((len(by), 1)), by / 2], axis=1))) @ matrices
    return quaternions(matrices)


def _pair_frame(first: Floats, second: Floats) -> Floats:
    """Orthonormal columns (frames, 3, 3): along the first vector, in the plane of both, and their normal."""
    x = unit(first)
    z = unit(np.cross(x, second))
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _solve3(matrices: Floats, vectors: Floats) -> Floats:
    """Solutions (frames, 3) of symmetric positive systems, by Cramer's rule; zero for singular ones."""
    columns = np.moveaxis(matrices, -1, 0)
    crossed = np.cross(columns[1], columns[2])
    determinant = (columns[0] * crossed).sum(axis=1)
    tops = [
        (vectors * crossed).sum(axis=1),
        (columns[0] * np.cross(vectors, columns[2])).sum(axis=1),
        (columns[0] * np.cross(columns[1], vectors)).sum(axis=1),
    ]
    safe = np.abs(determinant) > 1e-30
    return np.stack([np.where(safe, t / np.where(safe, determinant, 1.0), 0.0) for t in tops], axis=1)


def quaternions(m: Floats) -> Floats:
    """Quaternions (…, 4) of rotation matrices (…, 3, 3), from the largest of their components."""
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    squares = [1 + trace, *(1 - trace + 2 * m[..., i, i] for i in range(3))]
    w = [squares[0], m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]]
    x = [w[1], squares[1], m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0]]
    y = [w[2], x[2], squares[2], m[..., 1, 2] + m[..., 2, 1]]
    z = [w[3], x[3], y[3], squares[3]]
    best = np.argmax(np.stack(squares, axis=-1), axis=-1)
    multiples = np.stack([np.stack(part, axis=-1) for part in (w, x, y, z)], axis=-2)
    return unit(np.take_along_axis(multiples, best[..., None, None], axis=-2)[..., 0, :])


def _hinge_angle(rule: JointRule, carried: Carried, aims: Floats) -> Floats:
    """The angle about the hinge's axis that takes the carried vectors nearest to the aims (Paden–Kahan 1)."""
    assert rule.form is not None
    (before, after), (axis,) = rule.form.factors
    sine, cosine = np.zeros(aims.shape[1]), np.zeros(aims.shape[1])
    for v, aim in zip(carried.vectors, aims, strict=True):
        u, e = rigid.rotate(after, v), rigid.rotate(rigid.inverse(before), aim)
        sine += np.cross(axis, u) @ e.T
        cosine += e @ (u - axis * (axis @ u))
    return np.arctan2(sine, cosine)


def _two_angles(rule: JointRule, carried: Carried, aims: Floats, coded: Floats | None) -> Floats:
    """Two angles (frames, 2) that take the carried direction to the aim (Paden–Kahan 2).

    coded: the second angle where it is coded; it is refined by what the aim shows of it.
    """
    assert rule.form is not None
    (before, between, after), (first, second) = rule.form.factors
    w = rigid.rotate(after, carried.direction)
    length = carried.lever
    e = rigid.rotate(rigid.inverse(before), unit(aimed(carried, aims)))
    n = rigid.rotate(rigid.inverse(between), first)
    lengthwise = second * (second @ w)
    a, b = float(n @ (w - lengthwise)), float(n @ np.cross(second, w))
    height = e @ first - float(n @ lengthwise)
    if coded is None:
        size = max(float(np.hypot(a, b)), TINY)
        y = np.arctan2(b, a) + rule.branch * np.arccos(np.clip(height / size, -1, 1))
    else:
        full = np.ones(len(e))
        y = _refined(coded, [(length * a * full, length * b * full, length * height)])
    cos, sin = np.cos(y)[:, None], np.sin(y)[:, None]
    u = lengthwise + cos * (w - lengthwise) + sin * np.cross(second, w)
    u = rigid.rotate(between, u)
    x = np.arctan2(np.cross(u, e) @ first, (u * e).sum(axis=1) - (u @ first) * (e @ first))
    return np.stack([x, y], axis=1)
