"""The usual kinds of fields: numbers, byte strings, text and arrays of integers.

A limit, a count or a side of a shape is an `Amount`: a number, the name of a known value, or a function of all known
values. A field that takes all bytes that are left (`raw`, `array`) is the last of its record or stands in `sized`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..entropy import coder
from ..entropy.varint import signed as zigzag
from ..entropy.varint import write as write_varints
from ..errors import Corrupt
from ..typing import AnyInteger
from . import cursor as values
from .cursor import Cursor
from .record import Field, Known, Record

Amount = int | str | Callable[[Known], int]
Condition = Callable[[Known], bool] | None

LARGEST_VARINT = (1 << 63) - 1
LARGEST_SIGNED = (1 << 62) - 1
"""The largest magnitude of a signed varint and of an array's integers."""


def amount(of: Amount, known: Known) -> int:
    """The number that an `Amount` stands for."""
    if isinstance(of, int):
        return of
    return known[of] if isinstance(of, str) else of(known)


def unsigned(
    name: str, least: Amount = 0, most: Amount = LARGEST_VARINT, meaning: str = "", when: Condition = None
) -> Field:
    """A varint in [least, most]."""

    def read(cursor: Cursor, known: Known) -> int:
        return _limited(cursor, cursor.varint(), amount(least, known), amount(most, known))

    return Field(name, lambda value, _: values.varint(value), read, meaning, when)


def signed(name: str, most: Amount = LARGEST_SIGNED, meaning: str = "", when: Condition = None) -> Field:
    """A varint of a number of either sign, in [−most, most]: 0, −1, 1, −2 are stored as 0, 1, 2, 3."""

    def read(cursor: Cursor, known: Known) -> int:
        limit = amount(most, known)
        return _limited(cursor, cursor.signed(), -limit, limit)

    return Field(name, lambda value, _: values.varint(zigzag(int(value))), read, meaning, when)


def flag(name: str, meaning: str = "", when: Condition = None) -> Field:
    """True or false in one byte, 1 or 0."""

    def read(cursor: Cursor, _: Known) -> bool:
        return bool(_limited(cursor, cursor.byte(), 0, 1))

    return Field(name, lambda value, _: bytes([bool(value)]), read, meaning, when)


def count(
    name: str, of: str, least: Amount = 0, most: Amount = LARGEST_VARINT, meaning: str = "", when: Condition = None
) -> Field:
    """The length of a later field, as a varint. It is hidden: `pack` counts, and shapes of later fields may use it."""
    field = unsigned(name, least, most, meaning, when)
    return replace(field, write=lambda _, known: values.varint(len(known[of])), hidden=True)


def numbers(name: str, count: Amount, meaning: str = "", when: Condition = None) -> Field:
    """A list of `count` varints."""

    def read(cursor: Cursor, known: Known) -> list[int]:
        return cursor.varints(amount(count, known))

    return Field(name, lambda value, _: write_varints(value), read, meaning, when)


def positive_float(name: str, meaning: str = "", when: Condition = None) -> Field:
    """A finite float64 > 0, such as a length in metres."""

    def read(cursor: Cursor, _: Known) -> float:
        value = cursor.float64()
        if not 0 < value < math.inf:
            raise cursor.corrupt(f"{value} is not a positive number")
        return value

    return Field(name, lambda value, _: struct.pack("<d", value), read, meaning, when)


def text(name: str, meaning: str = "", when: Condition = None) -> Field:
    """UTF-8 with its length in front."""
    return Field(name, lambda value, _: values.text(value), lambda cursor, _: cursor.text(), meaning, when)


def raw(name: str, meaning: str = "", when: Condition = None) -> Field:
    """All bytes that are left, as they are."""
    return Field(name, lambda value, _: bytes(value), lambda cursor, _: cursor.rest(), meaning, when)


def array(
    name: str,
    shape: Sequence[Amount],
    least: Amount | None = None,
    most: Amount = LARGEST_SIGNED,
    meaning: str = "",
    when: Condition = None,
) -> Field:
    """Integers of this shape in [least, most], least being −most by default, coded by `entropy.coder` in all bytes that
    are left. The sides after the first are coded as one."""

    def write(value: AnyInteger, _: Known) -> bytes:
        rows = np.asarray(value)
        return coder.pack(rows.reshape(len(rows), math.prod(rows.shape[1:])))

    def read(cursor: Cursor, known: Known) -> AnyInteger:
        first, *others = (amount(side, known) for side in shape)
        try:
            found = coder.unpack(cursor.rest(), (first, math.prod(others))).reshape(first, *others)
        except Corrupt as problem:
            raise cursor.corrupt(str(problem)) from None
        high = amount(most, known)
        _limited(cursor, int(found.max(initial=0)), None, high)
        low = -high if least is None else amount(least, known)
        _limited(cursor, int(found.min(initial=high)), low, None)
        return found

    return Field(name, write, read, meaning, when)


def fixed(
    name: str, shape: Sequence[Amount], dtype: Any = np.uint8, meaning: str = "", when: Condition = None
) -> Field:
    """An array of this shape in the bytes of its numbers, without any coding. dtype: little-endian where it matters,
    for instance "<u2"."""
    kind = np.dtype(dtype)

    def read(cursor: Cursor, known: Known) -> AnyInteger:
        sides = [amount(side, known) for side in shape]
        return np.frombuffer(cursor.take(math.prod(sides) * kind.itemsize), kind).reshape(sides)

    return Field(name, lambda value, _: np.asarray(value).astype(kind).tobytes(), read, meaning, when)


def nested(name: str, record: Record, meaning: str = "", when: Condition = None) -> Field:
    """Another record, whose values come as one dict. It knows what this one knows."""
    return Field(name, lambda value, known: record.pack({**known, **value}), record.read, meaning, when)


def sized(*fields: Field) -> tuple[Field, ...]:
    """Fields whose lengths in bytes are stored: the lengths of all of them as varints, then their contents.

    `sized(a)` has its length right in front; `*sized(a, b), c` stores the lengths of a and b, then a, b and c.
    """
    lengths: list[Field] = []
    contents: list[Field] = []
    for field in fields:
        length = unsigned(f"length of {field.name}", when=field.when)
        lengths.append(replace(length, hidden=True, length_of=field.name))
        contents.append(replace(field, length=length.name))
    return (*lengths, *contents)


def _limited(cursor: Cursor, value: int, least: int | None, most: int | None) -> int:
    if least is not None and value < least:
        raise cursor.corrupt(f"{value} is less than {least}, the least that is possible")
    if most is not None and value > most:
        raise cursor.corrupt(f"{value} is more than {most}, the most that is possible")
    return value
