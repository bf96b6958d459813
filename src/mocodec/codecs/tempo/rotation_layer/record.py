"""The stored form of the rules, and of the statistics of side values: the second part of a stream's shared bytes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....errors import Corrupt
from ....fields import Record, array, count, fixed, flag, positive_float, raw, sized
from ....motion import Skeleton
from ....typing import Integers
from ..models import prior
from ..models.prior import Prior
from ..models.stored_basis import StoredBasis
from . import rules as r
from .choose import rounded_usual, stored_usual
from .rules import Form, JointRule, Rules, limits_form

RULE, FLAGS, FORM, LOCKED, PAIR, COLUMNS = 0, 1, 2, 3, 4, 5
"""What is stored of a joint, in this order."""
PLACED, SECOND_BRANCH = 1, 2
LIMITS_FORM = 1 + len(r.ORDERS)
"""0: no form, or no rotation of a FIXED joint. 1 to 6: an order of Euler angles. 7: the form that joint limits say."""
EXPLICIT = 1
STEP_M, LARGEST_ROUNDED_M = 1e-5, 21474.83648
"""Offsets are rounded to this step, up to this length: the container's (`container.skeletons`)."""
FREE_ANGLE, ZERO, CONSTANT = 0, 1, 2
"""Of each of three angles, in base 3, the first highest."""

LAYER = Record(
    "tempo: rotations",
    flag("own_frame", "AMC's convention"),
    positive_float("reach", "distance of shell points, metres"),
    count("numbers", of="constants"),
    *sized(
        array("joints", ("joint_count", COLUMNS), least=0, most=1 << 20, meaning="rule · flags · form · locked · pair"),
        array("usual", ("joint_count", 3), most=64, meaning="usual rotation, rotation vector in 1/16 rad"),
        fixed("constants", ("numbers",), "<f8", meaning="constant angles and rotations"),
    ),
    raw("statistics", meaning="prior, and stored basis if there are side values"),
)


def pack(rules: Rules, reach_m: float, statistics: bytes) -> bytes:
    """The layer's shared bytes."""
    table = np.zeros((len(rules.joints), COLUMNS), np.int64)
    usual = np.zeros((len(rules.joints), 3), np.int64)
    constants: list[float] = []
    for joint, (row, mean, rule) in enumerate(zip(table, usual, rules.joints, strict=True)):
        row[RULE] = rule.rule
        row[FLAGS] = PLACED * rule.placed + SECOND_BRANCH * (rule.branch < 0)
        if rule.rule == r.FIXED:
            if not np.array_equal(rule.usual, r.IDENTITY):
                row[FORM] = EXPLICIT
                constants += rule.usual.tolist()
            continue
        mean[:] = stored_usual(rule.usual)
        row[PAIR] = rule.pair[0] * len(rules.joints) + rule.pair[1] if rule.rule == r.HUB else 0
        if rule.form is not None:
            row[FORM] = 1 + r.ORDERS.index(rule.form.order)
            if _is_of_limits(rule.form, rules.skeleton, joint):
                row[FORM] = LIMITS_FORM
                continue
            for angle in rule.form.locked.tolist():
                kind = FREE_ANGLE if np.isnan(angle) else ZERO if angle == 0 else CONSTANT
                row[LOCKED] = 3 * row[LOCKED] + kind
                constants += [angle] if kind == CONSTANT else []
    values = {
        "own_frame": rules.own_frame,
        "reach": reach_m,
        "joints": table,
        "usual": usual,
        "constants": np.array(constants, np.float64),
        "statistics": statistics,
    }
    return LAYER.pack(values)


def unpack(data: bytes, skeleton: Skeleton | None) -> tuple[Rules, float, bytes]:
    """Rules, distance of shell points, and the bytes of the statistics. Raises Corrupt."""
    if skeleton is None:
        raise Corrupt("tempo: rotations without a skeleton")
    skeleton = rounded(skeleton)
    values = LAYER.unpack(data, joint_count=len(skeleton))
    constants = np.asarray(values["constants"], np.float64).tolist()
    joints = [
        _joint_rule(row, mean, constants, skeleton, joint)
        for joint, (row, mean) in enumerate(zip(values["joints"], values["usual"], strict=True))
    ]
    if constants:
        raise Corrupt("tempo: more constants than the joints' rotations have")
    found = Rules(skeleton, values["own_frame"], joints)
    _require_shown(found)
    return found, values["reach"], values["statistics"]


def pack_statistics(stored: StoredBasis | None, known: Prior) -> bytes:
    return known.id + (b"" if stored is None else stored.pack())


def unpack_statistics(data: bytes, dimensions: int) -> tuple[StoredBasis | None, Prior]:
    """Raises Corrupt, UnknownCodec."""
    id_, rest = data[: prior.ID_BYTES], data[prior.ID_BYTES :]
    if len(id_) < prior.ID_BYTES or (rest and not dimensions):
        raise Corrupt("tempo: rotations whose statistics do not end where they should")
    return StoredBasis.unpack(rest, dimensions) if dimensions else None, prior.by_id(id_)


def rounded(skeleton: Skeleton) -> Skeleton:
    """The skeleton with offsets as a file has them, rounded to 10 µm; larger ones than 10 km are exact in both."""
    offsets = np.asarray(skeleton.offsets, np.float64)
    if (np.abs(offsets) >= LARGEST_ROUNDED_M).any():
        return skeleton
    return replace(skeleton, offsets=np.rint(offsets / STEP_M) / round(1 / STEP_M))


def _joint_rule(row: Integers, mean: Integers, constants: list[float], skeleton: Skeleton, joint: int) -> JointRule:
    """One joint's rule; takes its numbers from the front of `constants`. Raises Corrupt."""
    rule, flags, form, locked, pair = row.tolist()
    if rule >= len(r.ANGLES) or flags > PLACED + SECOND_BRANCH or form > LIMITS_FORM:
        raise Corrupt(f"tempo: an unknown rule for the rotation of {skeleton.names[joint]}")
    placed = bool(flags & PLACED)
    if rule == r.FIXED:
        q = np.array([_next(constants) for _ in range(4)]) if form else r.IDENTITY
        if abs(float(q @ q) - 1) > 1e-6:
            raise Corrupt("tempo: a constant rotation that is not a unit quaternion")
        return JointRule(rule, placed, q)
    usual = rounded_usual(mean)
    branch = -1 if flags & SECOND_BRANCH else 1
    found = _form(form, locked, constants, skeleton, joint) if form else None
    if r.ANGLES[rule] != (3 if found is None else len(found.free)):
        raise Corrupt("tempo: axes that do not suit their rule")
    return JointRule(rule, placed, usual, found, branch, divmod(pair, len(skeleton)))


def _form(form: int, locked: int, constants: list[float], skeleton: Skeleton, joint: int) -> Form:
    """Raises Corrupt."""
    if form == LIMITS_FORM:
        found = limits_form(skeleton, joint)
        if found is None:
            raise Corrupt("tempo: rotations that need the joint limits of the skeleton, which are missing")
        return found
    kinds = [locked // 9, locked // 3 % 3, locked % 3]
    if max(kinds) > CONSTANT:
        raise Corrupt("tempo: an unknown kind of angle")
    angles = np.array([np.nan if k == FREE_ANGLE else 0.0 if k == ZERO else _next(constants) for k in kinds])
    return Form(r.ORDERS[form - 1], r.IDENTITY, angles)


def _is_of_limits(form: Form, skeleton: Skeleton, joint: int) -> bool:
    """Whether the joint limits say all of a form."""
    of = limits_form(skeleton, joint)
    same = of is not None and of.order == form.order and np.array_equal(of.frame, form.frame)
    return same and of is not None and np.array_equal(of.locked, form.locked, equal_nan=True)


def _next(constants: list[float]) -> float:
    if not constants or not np.isfinite(constants[0]):
        raise Corrupt("tempo: a constant of a rotation is missing")
    return constants.pop(0)


def _require_shown(rules: Rules) -> None:
    """Raises Corrupt where a rule aims with vectors that the joint does not carry."""
    for joint, carried in zip(rules.joints, rules.carried, strict=True):
        count = len(carried.vectors)
        if joint.rule == r.HUB and (max(joint.pair) >= count or joint.pair[0] == joint.pair[1]):
            raise Corrupt("tempo: a hub without two vectors")
        if joint.rule in (r.SWING, r.HINGE, r.UNIVERSAL, r.UNIVERSAL_REFINED) and not count:
            raise Corrupt("tempo: a rotation that nothing shows")
