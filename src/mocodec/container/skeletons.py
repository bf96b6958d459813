"""A skeleton on disk: its tree by number, its offsets in steps of 10 µm as departures from what is expected.

    offset of a joint ──► expected: the mirrored offset of its partner on the other side, if that stood before;
                                    else the typical body of a known tree; else zero
                      ──► the largest coordinate of what is expected first; the others scaled in proportion ──► bits

People are nearly symmetric and bones keep their direction, so most of a second side and most of a limb cost a bit each.
All arithmetic is on integers. With the lossless codec offsets are kept to the last bit instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from ..errors import CannotEncode
from ..motion import Skeleton
from . import arrays, names
from .tables import REFERENCE_OFFSETS, TREES
from .wire import BitReader, BitWriter, Cursor, unzigzag, zigzag

STEP_M = 1e-5
"""Offsets are rounded to this: a hundredth of a millimetre, below what a body can be measured to."""
MAX_STEPS = 1 << 31
EXACT, OWN_NAMES, MIRROR, TREE, CHAINED = 1, 2, 2, 4, 128
"""Flags: bit 0 exact offsets, bit 1 joints have names of their own, bit 7 each bone is expected longer or shorter as
the one before was. Shifts: mirror axis (0 none, x, y, z), tree."""

Vector = tuple[int, int, int]
SIDES = (("left", "right"), ("Left", "Right"), ("l", "r"), ("L", "R"))


def rounded(offsets: np.ndarray) -> np.ndarray:
    """Offsets as a file gives them back, metres: the nearest step of 10 µm."""
    return np.rint(np.asarray(offsets, np.float64) / STEP_M) / round(1 / STEP_M)


def pack(skeleton: Skeleton, point_names: Sequence[str], exact: bool = False) -> bytes:
    """One byte of flags, then as the flags say: names, bits of the tree and of the offsets. Raises CannotEncode."""
    if not np.isfinite(skeleton.offsets).all():
        raise CannotEncode("the skeleton has offsets that are not finite")
    exact = exact or bool((np.abs(skeleton.offsets) >= MAX_STEPS * STEP_M).any())
    tree = TREES.index(skeleton.parents) if skeleton.parents in TREES else 0
    own_names = skeleton.names != tuple(point_names)
    head = names.pack(skeleton.names) if own_names else b""
    flags = exact | own_names * OWN_NAMES | tree << TREE
    bits = BitWriter()
    if not tree:
        _put_parents(bits, skeleton.parents)
    if exact:
        return bytes([flags]) + head + bits.bytes() + arrays.pack(skeleton.offsets)
    steps = np.rint(skeleton.offsets / STEP_M).astype(np.int64)
    offsets: list[Vector] = [(int(x), int(y), int(z)) for x, y, z in steps]
    candidates = []
    for axis, chained in product(range(4), (0, CHAINED)):
        both = BitWriter()
        both.bits = bits.bits.copy()
        _put_offsets(both, offsets, _expectations(skeleton.names, tree, axis), bool(chained))
        candidates.append(bytes([flags | chained | axis << MIRROR]) + head + both.bytes())
    return min(candidates, key=len)


def unpack(cursor: Cursor, point_names: Sequence[str]) -> Skeleton:
    """The inverse of `pack`. Raises Corrupt, Truncated."""
    flags = cursor.byte()
    axis, tree = flags >> MIRROR & 3, flags >> TREE & 7
    joint_names = names.unpack(cursor) if flags & OWN_NAMES else tuple(point_names)
    if len(joint_names) != len(point_names) or tree >= len(TREES) or (tree and len(TREES[tree]) != len(joint_names)):
        raise cursor.corrupt("the skeleton does not fit the points, or its tree is unknown")
    bits = BitReader(cursor)
    parents = TREES[tree] if tree else _get_parents(bits, len(joint_names))
    if flags & EXACT:
        bits.done()
        offsets = arrays.unpack(cursor)
        if offsets.shape != (len(joint_names), 3) or offsets.dtype != np.float64 or not np.isfinite(offsets).all():
            raise cursor.corrupt("the skeleton's offsets do not fit its joints")
        return Skeleton(joint_names, parents, offsets)
    steps = _get_offsets(bits, _expectations(joint_names, tree, axis), bool(flags & CHAINED))
    bits.done()
    return Skeleton(joint_names, parents, np.array(steps, np.float64).reshape(-1, 3) / round(1 / STEP_M))


def _put_parents(bits: BitWriter, parents: Sequence[int]) -> None:
    """How far back each joint's parent stands; a root counts as standing before the first joint."""
    for joint, parent in enumerate(parents):
        bits.golomb(joint - 1 - parent, 0)


def _get_parents(bits: BitReader, joints: int) -> tuple[int, ...]:
    parents = tuple(joint - 1 - bits.golomb(0) for joint in range(joints))
    if parents and min(parents) < -1:
        raise bits.cursor.corrupt("a joint's parent stands before the first joint")
    return parents


Expectation = tuple[int, int] | Vector
"""(partner's index, axis in which to mirror it), or an offset."""


def _expectations(joint_names: Sequence[str], tree: int, axis: int) -> list[Expectation]:
    where: dict[str, int] = {}
    expected: list[Expectation] = []
    for joint, name in enumerate(joint_names):
        partner = next((where[other] for other in _other_sides(name) if other in where), None) if axis else None
        if partner is not None:
            expected.append((partner, axis - 1))
        else:
            expected.append(REFERENCE_OFFSETS[tree][joint] if tree in REFERENCE_OFFSETS else (0, 0, 0))
        where.setdefault(name, joint)
    return expected


def _other_sides(name: str) -> list[str]:
    """What the same joint could be called on the other side: each place where a side may stand, exchanged."""
    found = []
    for left, right in SIDES:
        for this, other in ((left, right), (right, left)):
            at = name.find(this)
            if at >= 0 and (len(this) > 1 or at == 0 or not name[at - 1].isalpha()):
                found.append(name[:at] + other + name[at + len(this) :])
    return found


def _vector(expectation: Expectation, known: Sequence[Vector]) -> Vector:
    if len(expectation) == 3:
        return expectation
    partner, axis = expectation
    x, y, z = known[partner]
    return (-x if axis == 0 else x, -y if axis == 1 else y, -z if axis == 2 else z)


def _scaled(vector: Vector, main: int, value: int) -> list[int]:
    """The vector in proportion, once its coordinate `main` is known to be `value`; rounded half up."""
    whole = vector[main]
    return [(2 * v * value + whole) // (2 * whole) if whole else v for v in vector]


def _longer(vector: Vector, ratio: tuple[int, int]) -> Vector:
    """The vector times a ratio, rounded half up."""
    x, y, z = ((2 * v * ratio[0] + ratio[1]) // (2 * ratio[1]) for v in vector)
    return x, y, z


def _main(vector: Vector) -> int:
    return max(range(3), key=lambda axis: abs(vector[axis]))


def _ratio(offset: Sequence[int], vector: Vector) -> tuple[int, int]:
    """How much longer a bone is than was expected of it before; 1 where the two do not point the same way."""
    main = _main(vector)
    return (offset[main], vector[main]) if offset[main] * vector[main] > 0 else (1, 1)


def _residuals(
    offsets: Sequence[Vector], expected: Sequence[Expectation], chained: bool
) -> tuple[list[int], list[int]]:
    """Departures of each joint's main coordinate, and of its two others."""
    mains: list[int] = []
    others: list[int] = []
    ratio = (1, 1)
    for offset, expectation in zip(offsets, expected, strict=True):
        plain = _vector(expectation, offsets)
        vector = _longer(plain, ratio)
        ratio = _ratio(offset, plain) if chained else ratio
        main = _main(vector)
        mains.append(zigzag(offset[main] - vector[main]))
        scaled = _scaled(vector, main, offset[main])
        others.extend(zigzag(offset[axis] - scaled[axis]) for axis in range(3) if axis != main)
    return mains, others


def _put_offsets(bits: BitWriter, offsets: Sequence[Vector], expected: Sequence[Expectation], chained: bool) -> None:
    """Two orders, 4 bits each, then per joint its three departures: a bit "not zero", then exponential Golomb."""
    mains, others = _residuals(offsets, expected, chained)
    orders = [min(range(16), key=lambda k, v=values: _cost(v, k)) for values in (mains, others)]
    for order in orders:
        bits.put(order, 4)
    for joint, value in enumerate(mains):
        _put_departure(bits, value, orders[0])
        for other in others[2 * joint : 2 * joint + 2]:
            _put_departure(bits, other, orders[1])


def _get_offsets(bits: BitReader, expected: Sequence[Expectation], chained: bool) -> list[Vector]:
    orders = bits.get(4), bits.get(4)
    known: list[Vector] = []
    ratio = (1, 1)
    for expectation in expected:
        plain = _vector(expectation, known)
        vector = _longer(plain, ratio)
        main = _main(vector)
        value = vector[main] + _get_departure(bits, orders[0])
        offset = _scaled(vector, main, value)
        for axis in range(3):
            offset[axis] = value if axis == main else offset[axis] + _get_departure(bits, orders[1])
        if max(map(abs, offset)) > MAX_STEPS:
            raise bits.cursor.corrupt("an offset is out of range")
        ratio = _ratio(offset, plain) if chained else ratio
        known.append((offset[0], offset[1], offset[2]))
    return known


def _put_departure(bits: BitWriter, value: int, order: int) -> None:
    bits.put(value > 0, 1)
    if value:
        bits.golomb(value - 1, order)


def _get_departure(bits: BitReader, order: int) -> int:
    return unzigzag(bits.golomb(order) + 1) if bits.get(1) else 0


def _cost(values: Sequence[int], k: int) -> int:
    return sum(1 if v == 0 else 2 * (v - 1 + (1 << k)).bit_length() - k for v in values)
