"""How a decoder finds each joint's rotation: a rule per joint, from the skeleton and what the stream stores.

A joint frame *carries* vectors that are rigid in it: the offsets of its children (in AMC's convention its own offset),
and those of children whose rotation is constant. Where they point says how the frame is rotated, up to what they leave
open. What they leave open is coded as *side values*, radians or components of a quaternion.

    rule                rotation                                              side values
    FIXED               constant                                              0
    HUB                 onto carried vectors of two directions                0
    SWING               shortest rotation onto one direction, then a twist    1   the twist
    FREE                not shown by any carried vector                       4   a quaternion
    HINGE               one angle, from carried vectors                       0
    HINGE_CODED         one angle, not shown                                  1   the angle
    UNIVERSAL           two angles, from one carried vector                   0
    UNIVERSAL_REFINED   two angles, badly conditioned                         1   the second angle
    UNIVERSAL_CODED     two angles, not shown                                 2   the angles

One or two angles are those of joints with restricted freedom: A · Rot(first axis) · B · Rot(second axis) · C with
constant rotations A, B and C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import permutations

import numpy as np

from ....geometry import rigid
from ....motion import Skeleton
from ....typing import Floats, Integers

FIXED, HUB, SWING, FREE, HINGE, HINGE_CODED, UNIVERSAL, UNIVERSAL_REFINED, UNIVERSAL_CODED = range(9)
"""Rules, as stored. Never change them."""
SIDE_VALUES = (0, 0, 1, 4, 0, 1, 0, 1, 2)
"""How many side values each rule has."""
ANGLES = (0, 3, 3, 3, 1, 1, 2, 2, 2)
"""How many free angles each rule has."""
ORDERS = tuple("".join(order) for order in permutations("xyz"))
"""Orders of Euler angles by number, as stored. Never change them."""
SHORTEST_M = 1e-4
"""Shorter vectors show no direction: they are not carried."""
ANGLE_DIGITS = 6
"""Constant angles of forms that the joint limits say are multiples of 10⁻⁶ degrees."""
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, eq=False)
class Form:
    """A rotation as Euler angles of which some are constant: frame · E(order, angles) · frame⁻¹.

    locked (3,): the constant angles, radians, NaN for free ones.
    """

    order: str
    frame: Floats
    locked: Floats

    @property
    def free(self) -> list[int]:
        return [i for i in range(3) if np.isnan(self.locked[i])]

    def rotation(self, angles: Floats) -> Floats:
        """Quaternions (…, 4) of the free angles (…, free)."""
        every = np.empty((*angles.shape[:-1], 3))
        every[:] = self.locked
        every[..., self.free] = angles
        return rigid.multiply(
            rigid.multiply(self.frame, rigid.from_euler(self.order, every)), rigid.inverse(self.frame)
        )

    @cached_property
    def factors(self) -> tuple[list[Floats], list[Floats]]:
        """Constant quaternions before, between and after the free axes, and those axes: A, (B,) C and a (, b)."""
        constants, axes = [self.frame], list[Floats]()
        for letter, angle in zip(self.order, self.locked, strict=True):
            if np.isnan(angle):
                axes.append(np.eye(3)["xyz".index(letter)])
                constants.append(IDENTITY)
            else:
                constants[-1] = rigid.multiply(constants[-1], rigid.about_axis(letter, np.asarray(angle, np.float64)))
        constants[-1] = rigid.multiply(constants[-1], rigid.inverse(self.frame))
        return constants, axes


@dataclass(frozen=True, eq=False)
class JointRule:
    """The stored rule of a joint.

    placed: it is put at its coded position instead of its offset's end. usual (4,): a usual local rotation; of FIXED,
    the rotation. form: of joints with restricted freedom. branch: which of two solutions, ±1, of UNIVERSAL. pair: the
    two carried vectors that a HUB begins with.
    """

    rule: int
    placed: bool = False
    usual: Floats = field(default_factory=lambda: IDENTITY)
    form: Form | None = None
    branch: int = 1
    pair: tuple[int, int] = (0, 1)

    @property
    def side_values(self) -> int:
        return SIDE_VALUES[self.rule]


@dataclass(frozen=True, eq=False)
class Carried:
    """Vectors (n, 3) in a joint's frame, from the point `anchor`, whose ends are the points `targets` (n,)."""

    anchor: int
    targets: tuple[int, ...]
    vectors: Floats

    @cached_property
    def weights(self) -> Floats:
        """Weight of each vector in the one that is aimed, (n,): its component along the longest."""
        longest = self.vectors[int(np.argmax((self.vectors**2).sum(axis=1)))]
        return self.vectors @ (longest / np.sqrt(longest @ longest))

    @cached_property
    def aimed(self) -> Floats:
        """The weighted sum of the vectors, (3,)."""
        return self.weights @ self.vectors

    @cached_property
    def size(self) -> float:
        """Length of `aimed`."""
        return float(np.sqrt(self.aimed @ self.aimed))

    @cached_property
    def direction(self) -> Floats:
        """Unit vector along `aimed`, (3,)."""
        return self.aimed / self.size

    @cached_property
    def lever(self) -> float:
        """How far off, metres, a point shows rotations as exactly as `aimed` does."""
        return self.size / float(np.sqrt(self.weights @ self.weights))


@dataclass(frozen=True, eq=False)
class Hinge:
    """A hinge that a joint's twist turns, so that its target shows the twist.

    child: the joint; axis (3,): in the twisting joint's frame; along: the component of
    `Carried.aimed` along the axis.
    """

    child: int
    axis: Floats
    along: float


@dataclass(frozen=True, eq=False)
class Rules:
    """The rules of all joints of a skeleton. own_frame: AMC's convention, see `Skeleton`."""

    skeleton: Skeleton
    own_frame: bool
    joints: Sequence[JointRule]

    @cached_property
    def starts(self) -> list[int]:
        """The first side value of each joint, and their number."""
        return np.cumsum([0, *(rule.side_values for rule in self.joints)]).tolist()

    @property
    def side_values(self) -> int:
        return self.starts[-1]

    @cached_property
    def carried(self) -> list[Carried]:
        """What each joint's frame carries."""
        return carried_vectors(self.skeleton, self.own_frame, self.joints)

    @cached_property
    def hinges(self) -> list[list[Hinge]]:
        """For each SWING joint the hinges among its children that its twist turns."""
        found: list[list[Hinge]] = [[] for _ in self.joints]
        for joint, (rule, parent) in enumerate(zip(self.joints, self.skeleton.parents, strict=True)):
            if rule.rule != HINGE or parent < 0 or self.joints[parent].rule != SWING or rule.form is None:
                continue
            (before, after), (axis,) = rule.form.factors
            along = float(axis @ rigid.rotate(after, self.carried[joint].aimed))
            found[parent].append(Hinge(joint, rigid.rotate(before, axis), along))
        return found

    @cached_property
    def nominal(self) -> Floats:
        """The side values (side_values,) of usual local rotations."""
        values = np.zeros(self.side_values)
        for rule, start in zip(self.joints, self.starts, strict=False):
            if rule.rule == FREE:
                values[start] = 1.0
            elif rule.rule in (HINGE_CODED, UNIVERSAL_CODED):
                values[start : start + rule.side_values] = self.usual_angles(rule)
            elif rule.rule == UNIVERSAL_REFINED:
                values[start] = self.usual_angles(rule)[1]
        return values

    @staticmethod
    def usual_angles(rule: JointRule) -> Floats:
        """The free angles of a restricted joint's usual rotation."""
        assert rule.form is not None
        return form_angles(rule.form, rule.usual)


def limits_form(skeleton: Skeleton, joint: int) -> Form | None:
    """The form that a joint's limits say: axes about which it does not rotate are locked. None without any."""
    if skeleton.limits is None:
        return None
    locked = np.where((skeleton.limits.ranges[joint] == 0).all(axis=1), 0.0, np.nan)
    some = 0 < int(np.isnan(locked).sum()) < 3
    return Form(skeleton.limits.orders[joint], skeleton.limits.axes[joint], locked) if some else None


def angle_steps(form: Form, rotation: Floats) -> Integers:
    """The free angles of a rotation (4,) that has this form, in steps of 10⁻⁶ degrees."""
    return np.rint(np.degrees(form_angles(form, rotation)) * 10.0**ANGLE_DIGITS).astype(np.int64)


def angles_of_steps(steps: Integers) -> Floats:
    """Angles, radians, of steps of 10⁻⁶ degrees."""
    return np.radians(steps / 10.0**ANGLE_DIGITS)


def form_angles(form: Form, rotations: Floats) -> Floats:
    """The free angles (…, free) of rotations (…, 4) that have, or nearly have, this form."""
    inner = rigid.multiply(rigid.multiply(rigid.inverse(form.frame), rotations), form.frame)
    if len(form.free) == 1 and not form.locked[[i for i in range(3) if i not in form.free]].any():
        half = np.arctan2(inner[..., 1 + "xyz".index(form.order[form.free[0]])], inner[..., 0])
        return ((2 * half + np.pi) % (2 * np.pi) - np.pi)[..., None]
    if len(form.free) == 2 and not form.locked[[i for i in range(3) if i not in form.free]].any():
        kept = "".join(form.order[i] for i in form.free)
        between = next(axis for axis in "xyz" if axis not in kept)
        return rigid.to_euler(kept[0] + between + kept[1], inner)[..., ::2]
    return rigid.to_euler(form.order, inner)[..., form.free]


def carried_vectors(skeleton: Skeleton, own_frame: bool, joints: Sequence[JointRule]) -> list[Carried]:
    """What each joint's frame carries, given which joints are placed and which rotations are constant."""
    children: list[list[int]] = [[] for _ in joints]
    for joint, parent in enumerate(skeleton.parents):
        if parent >= 0:
            children[parent].append(joint)
    result: list[Carried | None] = [None] * len(joints)
    for joint in reversed(range(len(joints))):
        targets, vectors = list[int](), list[Floats]()
        anchor, own = joint, np.zeros(3)
        if own_frame and skeleton.parents[joint] >= 0 and not joints[joint].placed:
            anchor, own = skeleton.parents[joint], skeleton.offsets[joint]
            targets.append(joint)
            vectors.append(own)
        for child in children[joint]:
            inside = result[child]
            assert inside is not None
            start = own
            if not own_frame:
                if joints[child].placed:
                    continue
                start = skeleton.offsets[child]
                targets.append(child)
                vectors.append(start)
            if joints[child].rule == FIXED and not (own_frame and joints[child].placed):
                targets += inside.targets
                vectors += [start + rigid.rotate(joints[child].usual, v) for v in inside.vectors]
        long = [i for i, v in enumerate(vectors) if np.sqrt(v @ v) > SHORTEST_M]
        kept = np.array([vectors[i] for i in long]).reshape(-1, 3)
        result[joint] = Carried(anchor, tuple(targets[i] for i in long), kept)
    return [one for one in result if one is not None]
