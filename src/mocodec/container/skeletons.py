"""A skeleton on disk: its tree by number, its offsets in steps of 10 µm as residuals of a prediction.

    offset of a joint ──► predicted from the mirrored offset of its partner on the other side, if that comes earlier;
                          else from the reference body of a known tree; else zero
                      ──► residual of the largest predicted coordinate; the prediction of the two others is scaled by
                          it ──► two more residuals ──► exponential Golomb bits

People are nearly symmetric and bones keep their direction, so most residuals of the second side and of the limbs take
one bit. All arithmetic is on integers. The lossless codec stores exact offsets instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from ..errors import CannotEncode
from ..motion import Skeleton
from ..typing import Floats, Integers
from . import arrays, limits, names
from .tables import REFERENCE_OFFSETS, TREES
from .wire import BitReader, BitWriter, Cursor, blob, unzigzag, zigzag

STEP_M = 1e-5
"""Offsets are rounded to this step: finer than any measurement of a body."""
MAX_STEPS = 1 << 31
EXACT, OWN_NAMES, MIRROR, TREE, CHAINED = 1, 2, 2, 4, 128
"""Flags: bit 0 exact offsets, bit 1 joint names differ from the point names, bit 7 each prediction is scaled by the
length ratio of the bone before. Shifts: MIRROR of the mirror axis (0 none, x, y, z), TREE of the tree's number."""

EXTENDED = 7 << TREE
"""In place of the flags: a tree that no table has. Facts, limits and the skeleton follow."""
ROTATIONS, LIMITED = 1, 2
"""Facts: the rotations of the joints are coded; joint limits follow."""

Vector = tuple[int, int, int]
SIDES = (("left", "right"), ("Left", "Right"), ("l", "r"), ("L", "R"))


def rounded(offsets: Floats) -> Floats:
    """Offsets in metres as a file stores them: rounded to steps of 10 µm."""
    return np.rint(np.asarray(offsets, np.float64) / STEP_M) / round(1 / STEP_M)


def pack_with_rotations(skeleton: Skeleton, point_names: Sequence[str], exact: bool = False) -> bytes:
    """The skeleton of a motion whose rotations are coded too: with its joint limits. Raises CannotEncode."""
    limited = skeleton.limits is not None
    packed = blob(limits.pack(skeleton.limits)) if skeleton.limits is not None else b""
    return bytes([EXTENDED, ROTATIONS | LIMITED * limited]) + packed + pack(skeleton, point_names, exact)


def unpack_any(cursor: Cursor, point_names: Sequence[str]) -> tuple[Skeleton, bool]:
    """A skeleton, and whether the rotations of its joints are coded too. Raises Corrupt, Truncated."""
    if not cursor.left or cursor.data[cursor.at] != EXTENDED:
        return unpack(cursor, point_names), False
    cursor.byte()
    facts = cursor.byte()
    if facts & ~(ROTATIONS | LIMITED):
        raise cursor.corrupt("a skeleton with parts that this version does not know")
    known = limits.unpack(cursor.blob(), len(point_names)) if facts & LIMITED else None
    skeleton = unpack(cursor, point_names)
    return replace(skeleton, limits=known), bool(facts & ROTATIONS)


def pack(skeleton: Skeleton, point_names: Sequence[str], exact: bool = False) -> bytes:
    """Flags, names if they differ, then the bits of tree and offsets. Raises CannotEncode for offsets not finite."""
    if not np.isfinite(skeleton.offsets).all():
        raise CannotEncode("the skeleton has offsets that are not finite")
    exact = exact or bool((np.abs(skeleton.offsets) >= MAX_STEPS * STEP_M).any())
    tree = TREES.index(skeleton.parents) if skeleton.parents in TREES else 0
    own_names = skeleton.names != tuple(point_names)
    head = names.pack(skeleton.names) if own_names else b""
    flags = exact | own_names * OWN_NAMES | tree << TREE
    if exact:
        bits = BitWriter()
        if not tree:
            _put_parents(bits, skeleton.parents)
        return bytes([flags]) + head + bits.bytes() + arrays.pack(skeleton.offsets)
    steps = np.rint(skeleton.offsets / STEP_M).astype(np.int64)
    how, body = _tree_and_offsets(skeleton.names, skeleton.parents, tree, steps.tobytes())
    return bytes([flags | how]) + head + body


@lru_cache(maxsize=16)
def _tree_and_offsets(
    joint_names: tuple[str, ...], parents: tuple[int, ...], tree: int, steps: bytes
) -> tuple[int, bytes]:
    """Flags and bits of a tree and its offsets (joints, 3), int64. They are kept: the files of a person share them."""
    bits = BitWriter()
    if not tree:
        _put_parents(bits, parents)
    found = _cheapest_prediction(np.frombuffer(steps, np.int64).reshape(-1, 3), joint_names, tree)
    _put_offsets(bits, found)
    return found.chained | found.axis << MIRROR, bits.bytes()


def unpack(cursor: Cursor, point_names: Sequence[str]) -> Skeleton:
    """The inverse of `pack`. Raises Corrupt, Truncated.

    The files of a person have the same bytes here, so what was read last is kept.
    """
    start, key = cursor.at, (tuple(point_names), cursor.data[cursor.at : cursor.at + KEY_BYTES])
    stored, skeleton = _last_read.get(key, (b"", None))
    if skeleton is None or cursor.data[start : min(start + len(stored), cursor.end)] != stored:
        skeleton = _unpack(cursor, point_names)
        if len(_last_read) >= MOST_KEPT:
            _last_read.clear()
        _last_read[key] = cursor.data[start : cursor.at], skeleton
    else:
        cursor.at += len(stored)
    found = copy(skeleton)  # `replace` would test the tree again
    object.__setattr__(found, "offsets", skeleton.offsets.copy())
    return found


KEY_BYTES, MOST_KEPT = 8, 64
_last_read: dict[tuple[tuple[str, ...], bytes], tuple[bytes, Skeleton]] = {}
"""By names of the points and first bytes: all bytes of a skeleton, and the skeleton."""


def _unpack(cursor: Cursor, point_names: Sequence[str]) -> Skeleton:
    flags = cursor.byte()
    axis, tree = flags >> MIRROR & 3, flags >> TREE & 7
    joint_names = names.unpack(cursor) if flags & OWN_NAMES else tuple(point_names)
    if len(joint_names) != len(point_names) or tree >= len(TREES) or (tree and len(TREES[tree]) != len(joint_names)):
        raise cursor.corrupt("the skeleton does not match the points, or its tree is unknown")
    bits = BitReader(cursor)
    parents = TREES[tree] if tree else _get_parents(bits, len(joint_names))
    if flags & EXACT:
        bits.done()
        offsets = arrays.unpack(cursor)
        if offsets.shape != (len(joint_names), 3) or offsets.dtype != np.float64 or not np.isfinite(offsets).all():
            raise cursor.corrupt("the skeleton's offsets do not match its joints")
        return Skeleton(joint_names, parents, offsets)
    steps = _get_offsets(bits, _predictors(joint_names, tree, axis), bool(flags & CHAINED))
    bits.done()
    return Skeleton(joint_names, parents, np.array(steps, np.float64).reshape(-1, 3) / round(1 / STEP_M))


def _put_parents(bits: BitWriter, parents: Sequence[int]) -> None:
    """The distance joint − 1 − parent of each joint; the parent of a root is −1."""
    for joint, parent in enumerate(parents):
        bits.golomb(joint - 1 - parent, 0)


def _get_parents(bits: BitReader, joints: int) -> tuple[int, ...]:
    parents = tuple(joint - 1 - bits.golomb(0) for joint in range(joints))
    if parents and min(parents) < -1:
        raise bits.cursor.corrupt("a joint's parent is out of range")
    return parents


Predictor = tuple[int, int] | Vector
"""(index of the partner joint, axis to mirror), or a fixed offset."""


@lru_cache(maxsize=64)
def _predictors(joint_names: tuple[str, ...], tree: int, axis: int) -> list[Predictor]:
    """How each joint's offset is predicted; axis: 0 without mirroring, else 1 + the mirror axis."""
    index_of: dict[str, int] = {}
    predictors: list[Predictor] = []
    for joint, name in enumerate(joint_names):
        partner = next((index_of[other] for other in _other_sides(name) if other in index_of), None) if axis else None
        if partner is not None:
            predictors.append((partner, axis - 1))
        else:
            predictors.append(REFERENCE_OFFSETS[tree][joint] if tree in REFERENCE_OFFSETS else (0, 0, 0))
        index_of.setdefault(name, joint)
    return predictors


def _other_sides(name: str) -> list[str]:
    """Candidate names of the same joint on the other side: each occurrence of a side exchanged."""
    candidates = []
    for left, right in SIDES:
        for this, other in ((left, right), (right, left)):
            at = name.find(this)
            if at >= 0 and (len(this) > 1 or at == 0 or not name[at - 1].isalpha()):
                candidates.append(name[:at] + other + name[at + len(this) :])
    return candidates


def _predict(predictor: Predictor, known: Sequence[Vector]) -> Vector:
    """The predicted offset; known: the offsets of the joints before."""
    if len(predictor) == 3:
        return predictor
    partner, axis = predictor
    x, y, z = known[partner]
    return (-x if axis == 0 else x, -y if axis == 1 else y, -z if axis == 2 else z)


def _scaled(vector: Vector, main: int, value: int) -> list[int]:
    """The vector scaled so that its coordinate `main` becomes `value`; rounded half up."""
    divisor = vector[main]
    return [(2 * v * value + divisor) // (2 * divisor) if divisor else v for v in vector]


def _times(vector: Vector, ratio: tuple[int, int]) -> Vector:
    """The vector times a ratio (numerator, denominator), rounded half up."""
    x, y, z = ((2 * v * ratio[0] + ratio[1]) // (2 * ratio[1]) for v in vector)
    return x, y, z


def _main(vector: Vector) -> int:
    """The axis of the largest coordinate."""
    x, y, z = map(abs, vector)
    return 0 if x >= y and x >= z else 1 if y >= z else 2


def _ratio(offset: Sequence[int], vector: Vector) -> tuple[int, int]:
    """Actual over predicted length along the main axis, as (numerator, denominator); 1 if the signs differ."""
    main = _main(vector)
    return (offset[main], vector[main]) if offset[main] * vector[main] > 0 else (1, 1)


class Predicted(NamedTuple):
    """axis: 0 without mirroring, else 1 + the mirror axis. chained: CHAINED or 0.

    mains (joints,), others (joints · 2,): residuals of each joint's main coordinate, and of its two other coordinates.
    orders: of their exponential Golomb codes.
    """

    axis: int
    chained: int
    mains: Integers
    others: Integers
    orders: tuple[int, int]


def _cheapest_prediction(steps: Integers, joint_names: tuple[str, ...], tree: int) -> Predicted:
    """The prediction of offsets (joints, 3) whose residuals take the fewest bytes."""
    # Products of large offsets exceed 64 bits: Python's integers do not.
    offsets = steps if np.abs(steps).max(initial=0) < LARGEST_FAST else steps.astype(object)
    choices = list(product(range(4), (0, CHAINED)))
    of_axis = [_predicted(offsets, _predictors(joint_names, tree, axis)) for axis in range(4)]
    unscaled = np.stack([of_axis[axis] for axis, _ in choices])
    predicted = np.take_along_axis(unscaled, (main := _main_axis(unscaled)), 2)
    actual = np.take_along_axis(np.broadcast_to(offsets, unscaled.shape), main, 2)
    scales = (actual * predicted > 0) & (np.array([c for _, c in choices]) > 0)[:, None, None]
    # the ratio of each joint scales the prediction of the next one
    over, under = (np.where(scales, each, 1)[:, :-1] for each in (actual, predicted))
    vector = unscaled.copy()
    vector[:, 1:] = (2 * unscaled[:, 1:] * over + under) // (2 * under)
    main = _main_axis(vector)
    divisor, value = (np.take_along_axis(np.broadcast_to(each, vector.shape), main, 2) for each in (vector, offsets))
    scaled = np.where(divisor != 0, (2 * vector * value + divisor) // np.where(divisor != 0, 2 * divisor, 1), vector)
    residual = offsets - scaled
    mains = (value - divisor)[..., 0]
    others = residual[np.arange(3) != main].reshape(len(choices), -1)
    bits = np.stack([_golomb_bits(mains), _golomb_bits(others)])
    best = int(np.argmin(-(-(bits.min(axis=2).sum(axis=0) + 8) // 8)))
    main_order, other_order = bits[:, best].argmin(axis=1).tolist()
    return Predicted(*choices[best], mains[best], others[best], (main_order, other_order))


LARGEST_FAST = 1 << 20
"""Offsets below this many steps, 10 m, have products below 2⁶³."""


def _predicted(offsets: Integers, predictors: Sequence[Predictor]) -> Integers:
    """`_predict` of all joints, (joints, 3)."""
    out = np.empty_like(offsets)
    for joint, predictor in enumerate(predictors):
        if len(predictor) == 3:
            out[joint] = predictor
        else:
            out[joint] = offsets[predictor[0]]
            out[joint, predictor[1]] *= -1
    return out


def _main_axis(vectors: Integers) -> Integers:
    """`_main` of vectors (…, 3), (…, 1)."""
    return np.abs(vectors).argmax(axis=-1)[..., None]


def _golomb_bits(residuals: Integers) -> Integers:
    """Bits of residuals (choices, n) in exponential Golomb codes of the orders 0 to 15, (choices, 16)."""
    folded = np.abs(2 * residuals.astype(np.float64)) - (residuals < 0)
    below = (folded - 1)[..., None] + 2.0 ** np.arange(16)
    cost = np.where(folded[..., None] == 0, 1, 2 * np.frexp(below)[1] - np.arange(16))
    return cost.sum(axis=1)


def _put_offsets(bits: BitWriter, found: Predicted) -> None:
    """Two Golomb orders of 4 bits, then three residuals a joint: a bit "not zero", then exponential Golomb."""
    for order in found.orders:
        bits.put(order, 4)
    mains, others = map(zigzag, found.mains.tolist()), map(zigzag, found.others.tolist())
    for value in mains:
        _put_residual(bits, value, found.orders[0])
        for other in (next(others), next(others)):
            _put_residual(bits, other, found.orders[1])


def _get_offsets(bits: BitReader, predictors: Sequence[Predictor], chained: bool) -> list[Vector]:
    orders = bits.get(4), bits.get(4)
    known: list[Vector] = []
    ratio = (1, 1)
    for predictor in predictors:
        unscaled = _predict(predictor, known)
        vector = _times(unscaled, ratio)
        main = _main(vector)
        value = vector[main] + _get_residual(bits, orders[0])
        offset = _scaled(vector, main, value)
        for axis in range(3):
            offset[axis] = value if axis == main else offset[axis] + _get_residual(bits, orders[1])
        if max(map(abs, offset)) > MAX_STEPS:
            raise bits.cursor.corrupt("an offset is out of range")
        ratio = _ratio(offset, unscaled) if chained else ratio
        known.append((offset[0], offset[1], offset[2]))
    return known


def _put_residual(bits: BitWriter, value: int, order: int) -> None:
    bits.put(value > 0, 1)
    if value:
        bits.golomb(value - 1, order)


def _get_residual(bits: BitReader, order: int) -> int:
    return unzigzag(bits.golomb(order) + 1) if bits.get(1) else 0
