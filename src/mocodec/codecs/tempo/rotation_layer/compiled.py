"""The rules as arrays, for the compiled solver (`src/native/joint_rotations.cpp`)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ....typing import Floats, Integers
from . import rules as r
from .rules import Rules


@lru_cache(maxsize=8)
def tables(rules: Rules) -> tuple[Integers, Floats, Integers, Floats, Integers, Floats]:
    """Integers and floats of joints, of carried vectors and of hinges.

    joints, 13 integers: rule, parent (−1: none), whether it is held at its target, branch, first side value, anchor,
    first and number of carried vectors, pair, first and number of hinges, whether in its own frame.
    joints, 29 floats: offset 3, usual 4, A 4, B 4, C 4, first axis 3, second axis 3, direction 3, lever 1.
    carried: target; vector 3, weight 1. hinges: child, whether its start is its own target; axis 3, along 1, scale 1.
    """
    joint_integers = np.zeros((len(rules.joints), 13), np.int64)
    joint_floats = np.zeros((len(rules.joints), 29))
    targets, vectors, hinges, axes = list[int](), list[Floats](), list[list[int]](), list[Floats]()
    for joint, (rule, parent) in enumerate(zip(rules.joints, rules.skeleton.parents, strict=True)):
        carried, turned = rules.carried[joint], rules.hinges[joint]
        held = parent < 0 or rule.placed
        joint_integers[joint] = [
            rule.rule, parent, held, rule.branch, rules.starts[joint], carried.anchor, len(targets),
            len(carried.targets), *rule.pair, len(hinges), len(turned), rules.own_frame,
        ]  # fmt: skip
        row = joint_floats[joint]
        row[:3], row[3:7] = rules.skeleton.offsets[joint], rule.usual
        row[7:19] = np.tile(r.IDENTITY, 3)
        if rule.form is not None:
            constants, free = rule.form.factors
            row[7:11], row[15:19], row[19:22], row[22:25] = constants[0], constants[-1], free[0], free[-1]
            row[11:15] = constants[1] if len(free) == 2 else r.IDENTITY
        if len(carried.targets):
            row[25:28], row[28] = carried.direction, carried.lever
            targets += carried.targets
            vectors += [np.append(v, w) for v, w in zip(carried.vectors, carried.weights, strict=True)]
        for hinge in turned:
            of = rules.carried[hinge.child]
            hinges.append([hinge.child, rules.joints[hinge.child].placed])
            axes.append(np.array([*hinge.axis, hinge.along, of.lever / of.size]))
    return (
        joint_integers,
        joint_floats,
        np.array(targets, np.int64),
        np.array(vectors).reshape(-1, 4),
        np.array(hinges, np.int64).reshape(-1, 2),
        np.array(axes).reshape(-1, 5),
    )
