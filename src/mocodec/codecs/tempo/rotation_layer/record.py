"""The stored form of the rules, and of the statistics of side values: the second part of a stream's shared bytes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....errors import Corrupt
from ....fields import Record, array, count, fixed, flag, positive_float, raw, sized, unsigned
from ....motion import Skeleton
from ....typing import Booleans, Floats, Integers
from ..models import prior
from ..models.prior import Prior
from ..models.stored_basis import StoredBasis
from . import reference
from . import rules as r
from .choose import USUAL_MOST, rounded_usual, stored_usual
from .rules import Form, JointRule, Rules, angle_steps, angles_of_steps, limits_form

RULE, FLAGS, FORM, LOCKED, PAIR, COLUMNS = 0, 1, 2, 3, 4, 5
"""The stored fields of a joint, in this order."""
PLACED, SECOND_BRANCH = 1, 2
LIMITS_FORM = 1 + len(r.ORDERS)
"""0: no form, or no rotation of a FIXED joint. 1 to 6: an order of Euler angles. 7: the form that joint limits say."""
EXPLICIT = 1
"""Form of a FIXED joint whose rotation is the next four constants."""
REACH_UNITS = 10_000
"""The distance of shell points is stored in 1/10,000 m where it is a multiple of that."""
LARGEST = 1 << 20
STEP_M, LARGEST_ROUNDED_M = 1e-5, 21474.83648
"""Offsets are rounded to this step, up to this length: the container's (`container.skeletons`)."""
FREE_ANGLE, ZERO, CONSTANT = 0, 1, 2
"""States of an angle; those of three angles are digits in base 3, the first highest."""

LAYER = Record(
    "tempo: rotations",
    flag("own_frame", "AMC's convention"),
    unsigned("reach_units", most=LARGEST, meaning="distance of shell points, 0.1 mm; 0: the next field has it"),
    positive_float("reach", "distance of shell points, metres", when=lambda known: not known["reach_units"]),
    unsigned("reference", most=len(reference.REFERENCES), meaning="the rules that these depart from, 0 none"),
    unsigned("digits", most=r.ANGLE_DIGITS, meaning="decimals of a degree of constant angles"),
    count("numbers", of="constants"),
    count("fixed_angles", of="angles"),
    *sized(
        array("joints", ("joint_count", COLUMNS), most=LARGEST, meaning="rule · flags · form · locked · pair"),
        array("usual", ("joint_count", 3), most=2 * USUAL_MOST, meaning="usual rotation, rotation vector in 1/16 rad"),
        array("angles", ("fixed_angles",), most=1 << 40, meaning="constant angles of joints whose form the limits say"),
        fixed("constants", ("numbers",), "<f8", meaning="other constant angles and rotations"),
    ),
    raw("statistics", meaning="prior, and stored basis if there are side values"),
)


class _Constants:
    """Constants of joints, joint after joint: floats, and angles in steps of `rules.ANGLE_STEP` degrees."""

    def __init__(self, floats: list[float], steps: list[int]) -> None:
        self.floats, self.steps = floats, steps

    def next_float(self) -> float:
        """Raises Corrupt."""
        if not self.floats or not np.isfinite(self.floats[0]):
            raise Corrupt("tempo: a constant of a rotation is missing")
        return self.floats.pop(0)

    def next_steps(self, count: int) -> list[int]:
        """Raises Corrupt."""
        if len(self.steps) < count:
            raise Corrupt("tempo: a constant angle of a rotation is missing")
        taken, self.steps = self.steps[:count], self.steps[count:]
        return taken


def pack(rules: Rules, reach_m: float, statistics: bytes) -> bytes:
    """The layer's shared bytes."""
    joints = len(rules.joints)
    table, usual = np.zeros((joints, COLUMNS), np.int64), np.zeros((joints, 3), np.int64)
    constants = _Constants([], [])
    for joint, (row, mean, rule) in enumerate(zip(table, usual, rules.joints, strict=True)):
        row[RULE] = rule.rule
        row[FLAGS] = PLACED * rule.placed + SECOND_BRANCH * (rule.branch < 0)
        if rule.rule == r.FIXED:
            row[FORM] = _pack_fixed(rule, limits_form(rules.skeleton, joint), constants)
            continue
        mean[:] = stored_usual(rule.usual)
        row[PAIR] = rule.pair[0] * joints + rule.pair[1] if rule.rule == r.HUB else 0
        if rule.form is not None:
            row[FORM] = 1 + r.ORDERS.index(rule.form.order)
            if _is_of_limits(rule.form, rules.skeleton, joint):
                row[FORM] = LIMITS_FORM
                continue
            for angle in rule.form.locked.tolist():
                kind = FREE_ANGLE if np.isnan(angle) else ZERO if angle == 0 else CONSTANT
                row[LOCKED] = 3 * row[LOCKED] + kind
                constants.floats += [angle] if kind == CONSTANT else []
    digits = next(
        d for d in range(r.ANGLE_DIGITS + 1) if not any(s % 10 ** (r.ANGLE_DIGITS - d) for s in constants.steps)
    )
    units = round(min(reach_m, 1e9) * REACH_UNITS)
    units = units if units <= LARGEST and units / REACH_UNITS == reach_m else 0
    values = {
        "own_frame": rules.own_frame,
        "reach_units": units,
        "reach": None if units else reach_m,
        "digits": digits,
        "angles": np.array(constants.steps, np.int64) // 10 ** (r.ANGLE_DIGITS - digits),
        "constants": np.array(constants.floats, np.float64),
        "statistics": statistics,
    }
    packed = list[bytes]()
    for number in reference.numbers(joints):
        known = reference.by_number(number, joints)
        departures = {"joints": table - known.joints, "usual": np.where(_turns(table), usual - known.usual, 0)}
        packed.append(LAYER.pack({**values, "reference": number, **departures}))
    return min(packed, key=len)


def _turns(table: Integers) -> Booleans:
    """Whether joints (joints, 1) have a usual rotation."""
    return table[:, RULE, None] != r.FIXED


def _pack_fixed(rule: JointRule, form: Form | None, constants: _Constants) -> int:
    """The form of a FIXED joint, after its constants; form: that the joint limits say."""
    if np.array_equal(rule.usual, r.IDENTITY):
        return 0
    if form is not None:
        steps = angle_steps(form, rule.usual)
        if np.array_equal(form.rotation(angles_of_steps(steps)), rule.usual):
            constants.steps += steps.tolist()
            return LIMITS_FORM
    constants.floats += rule.usual.tolist()
    return EXPLICIT


def unpack(data: bytes, skeleton: Skeleton | None) -> tuple[Rules, float, bytes]:
    """Rules, distance of shell points, and the bytes of the statistics. Raises Corrupt."""
    if skeleton is None:
        raise Corrupt("tempo: rotations without a skeleton")
    skeleton = rounded(skeleton)
    values = LAYER.unpack(data, joint_count=len(skeleton))
    if values["reference"] not in reference.numbers(len(skeleton)):
        raise Corrupt("tempo: rules that depart from those of another skeleton")
    known = reference.by_number(values["reference"], len(skeleton))
    table = values["joints"] + known.joints
    usual = np.where(_turns(table), values["usual"] + known.usual, 0)
    if table.min(initial=0) < 0 or np.abs(usual).max(initial=0) > USUAL_MOST:
        raise Corrupt("tempo: rules for rotations that are out of range")
    finer = 10 ** (r.ANGLE_DIGITS - values["digits"])
    constants = _Constants(
        np.asarray(values["constants"], np.float64).tolist(), [finer * s for s in values["angles"].tolist()]
    )
    joints = [
        _joint_rule(row, mean, constants, skeleton, joint)
        for joint, (row, mean) in enumerate(zip(table, usual, strict=True))
    ]
    if constants.floats or constants.steps:
        raise Corrupt("tempo: more constants than the joints' rotations have")
    found = Rules(skeleton, values["own_frame"], joints)
    _require_shown(found)
    units = values["reach_units"]
    return found, units / REACH_UNITS if units else values["reach"], values["statistics"]


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


def _joint_rule(row: Integers, mean: Integers, constants: _Constants, skeleton: Skeleton, joint: int) -> JointRule:
    """One joint's rule; takes its numbers from the front of `constants`. Raises Corrupt."""
    rule, flags, form, locked, pair = row.tolist()
    if rule >= len(r.ANGLES) or flags > PLACED + SECOND_BRANCH or form > LIMITS_FORM:
        raise Corrupt(f"tempo: an unknown rule for the rotation of {skeleton.names[joint]}")
    placed = bool(flags & PLACED)
    if rule == r.FIXED:
        return JointRule(rule, placed, _fixed_rotation(form, constants, skeleton, joint))
    usual = rounded_usual(mean)
    branch = -1 if flags & SECOND_BRANCH else 1
    found = _form(form, locked, constants, skeleton, joint) if form else None
    if r.ANGLES[rule] != (3 if found is None else len(found.free)):
        raise Corrupt("tempo: axes that do not suit their rule")
    return JointRule(rule, placed, usual, found, branch, divmod(pair, len(skeleton)))


def _fixed_rotation(form: int, constants: _Constants, skeleton: Skeleton, joint: int) -> Floats:
    """The constant rotation (4,) of a FIXED joint. Raises Corrupt."""
    if form == LIMITS_FORM:
        found = _form(form, 0, constants, skeleton, joint)
        return found.rotation(angles_of_steps(np.array(constants.next_steps(len(found.free)))))
    q = np.array([constants.next_float() for _ in range(4)]) if form else r.IDENTITY
    if form > EXPLICIT or abs(float(q @ q) - 1) > 1e-6:
        raise Corrupt("tempo: a constant rotation that is not a unit quaternion")
    return q


def _form(form: int, locked: int, constants: _Constants, skeleton: Skeleton, joint: int) -> Form:
    """Raises Corrupt."""
    if form == LIMITS_FORM:
        found = limits_form(skeleton, joint)
        if found is None:
            raise Corrupt("tempo: rotations that need the joint limits of the skeleton, which are missing")
        return found
    kinds = [locked // 9, locked // 3 % 3, locked % 3]
    if max(kinds) > CONSTANT:
        raise Corrupt("tempo: an unknown kind of angle")
    angles = np.array([np.nan if k == FREE_ANGLE else 0.0 if k == ZERO else constants.next_float() for k in kinds])
    return Form(r.ORDERS[form - 1], r.IDENTITY, angles)


def _is_of_limits(form: Form, skeleton: Skeleton, joint: int) -> bool:
    """Whether the joint limits say all of a form."""
    of = limits_form(skeleton, joint)
    same = of is not None and of.order == form.order and np.array_equal(of.frame, form.frame)
    return same and of is not None and np.array_equal(of.locked, form.locked, equal_nan=True)


def _require_shown(rules: Rules) -> None:
    """Raises Corrupt where a rule aims with vectors that the joint does not carry."""
    for joint, carried in zip(rules.joints, rules.carried, strict=True):
        count = len(carried.vectors)
        if joint.rule == r.HUB and (max(joint.pair) >= count or joint.pair[0] == joint.pair[1]):
            raise Corrupt("tempo: a hub without two vectors")
        if joint.rule in (r.SWING, r.HINGE, r.UNIVERSAL, r.UNIVERSAL_REFINED) and not count:
            raise Corrupt("tempo: a rotation that nothing shows")
