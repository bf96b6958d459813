"""A channel as integers, and back bit for bit.

    constant     every sample has the same bits                             nothing to code
    copy         every sample has the bits of an earlier channel            nothing to code
    integers     value = k · step, an integer type
    counts       value = offset + k · step, rounded to the channel's type   converter counts behind floats
    corrected    as counts, then some last bits up or down                  counts that were filtered or shifted since
    palette      k = place in the channel's distinct values, sorted         few values, without a step
    grid         k = value / 2^exponent, truncated                          other floats; lower bits are stored raw

Samples that their form does not give back (NaN, infinities, −0, tiny values beside a coarse grid) are special: their
bits are stored as they are.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..entropy import bits
from ..entropy.compressors import deflate, inflate
from ..entropy.varint import signed as zigzag
from ..fields.cursor import Cursor, blob, varint
from ..typing import Booleans, Integers

Array = NDArray[Any]

CONSTANT, INTEGERS, COUNTS, GRID, CORRECTED, PALETTE, COPY = range(7)
MAX_INTEGER = 1 << 29
"""Integers of a channel are below it in size."""
MANTISSA_BITS = {2: 10, 4: 23, 8: 52}
LEAST_EXPONENT = {2: -24, 4: -149, 8: -1074}
"""The exponent of the last bit of the smallest numbers, by the bytes of the type."""
MAX_PALETTE = 1 << 14
MAX_CORRECTION = 1 << 20


@dataclass(frozen=True)
class Form:
    """How a channel becomes integers. item: the bytes of a constant. palette: distinct values as `sortable` integers,
    ascending. channel: the number of the earlier channel that a copy equals."""

    kind: int
    step: float = 1.0
    offset: float = 0.0
    exponent: int = 0
    item: bytes = b""
    palette: tuple[int, ...] = ()
    channel: int = 0


def pack(form: Form) -> bytes:
    """The kind, then its numbers."""
    head = bytes([form.kind])
    if form.kind == CONSTANT:
        return head + form.item
    if form.kind == COPY:
        return head + varint(form.channel)
    if form.kind == INTEGERS:
        return head + varint(int(form.step))
    if form.kind in (COUNTS, CORRECTED):
        return head + struct.pack("<dd", form.step, form.offset)
    if form.kind == PALETTE:
        return head + _pack_palette(form.palette)
    return head + varint(zigzag(form.exponent))


def _pack_palette(palette: tuple[int, ...]) -> bytes:
    """Their number, then of the differences the bits of each (deflated bytes) and all bits below the highest."""
    steps = np.diff(np.array(palette, np.uint64), prepend=np.uint64(0))
    upper, lower_half = (np.frexp((steps >> shift & 0xFFFFFFFF).astype(np.float64))[1] for shift in (np.uint64(32), 0))
    lengths = np.where(upper > 0, 32 + upper, lower_half).astype(np.uint8)
    below = np.maximum(lengths.astype(np.int64) - 1, 0)
    lower = steps.astype(np.int64) & ((1 << below) - 1)
    return varint(len(palette)) + blob(deflate(lengths.tobytes())) + np.packbits(bits.pack(lower, below)).tobytes()


def _unpack_palette(cursor: Cursor, dtype: np.dtype[Any]) -> tuple[int, ...]:
    """The inverse of `_pack_palette`. Raises Corrupt."""
    count = cursor.varint()
    if not 1 < count <= MAX_PALETTE:
        raise cursor.corrupt("a palette is out of range")
    lengths = np.frombuffer(inflate(cursor.blob(), count, cursor.what), np.uint8).astype(np.int64)
    if lengths.max() > 8 * dtype.itemsize or lengths[1:].min() == 0:
        raise cursor.corrupt("a palette is out of range")
    below = np.maximum(lengths - 1, 0)
    stream = np.frombuffer(cursor.take((int(below.sum()) + 7) // 8), np.uint8)
    steps = bits.unpack(np.unpackbits(stream), below) | np.where(lengths > 0, 1 << below, 0)
    return tuple(np.cumsum(steps.astype(np.uint64)).tolist())


def unpack(cursor: Cursor, dtype: np.dtype[Any]) -> Form:
    """The inverse of `pack`. Raises Corrupt."""
    kind = cursor.byte()
    if kind == CONSTANT:
        return Form(kind, item=cursor.take(dtype.itemsize))
    if kind == COPY:
        return Form(kind, channel=cursor.varint())
    if kind == INTEGERS and dtype.kind in "biu":
        step = cursor.varint()
        if 0 < step <= 1 << 40:
            return Form(kind, step=step)
    if kind in (COUNTS, CORRECTED) and dtype.kind == "f":
        step, offset = cursor.float64(), cursor.float64()
        if np.isfinite([step, offset]).all():
            return Form(kind, step=step, offset=offset)
    if kind == PALETTE and dtype.kind == "f":
        return Form(kind, palette=_unpack_palette(cursor, dtype))
    if kind == GRID and dtype.kind == "f":
        exponent = cursor.signed()
        if abs(exponent) <= 1200:
            return Form(kind, exponent=exponent)
    raise cursor.corrupt("a channel's form is out of range")


def as_arrays(channel_forms: Sequence[Form], dtype: np.dtype[Any]) -> tuple[Array, ...]:
    """Forms as the compiled module takes them.

    Of each channel: its kind; step and offset (channels, 2); exponent, or the channel that it copies; the item of a
    constant (channels, bytes); then all palettes one after the other, and where that of each channel starts.
    """
    palettes = [form.palette for form in channel_forms]
    return (
        np.array([form.kind for form in channel_forms], np.uint8),
        np.array([(form.step, form.offset) for form in channel_forms]).reshape(-1, 2),
        np.array([form.channel if form.kind == COPY else form.exponent for form in channel_forms], np.int64),
        np.frombuffer(b"".join(form.item or bytes(dtype.itemsize) for form in channel_forms), np.uint8).reshape(
            -1, dtype.itemsize
        ),
        np.array([entry for palette in palettes for entry in palette], np.uint64),
        np.cumsum([0, *map(len, palettes)]),
    )


def suits(dtype: np.dtype[Any]) -> bool:
    """Whether channels of this type have a form."""
    return dtype.kind in "biu" or (dtype.kind == "f" and dtype.itemsize in MANTISSA_BITS)


def words(values: Array) -> NDArray[np.unsignedinteger[Any]]:
    """The bits of each value, as an integer of the same size."""
    native = values.astype(values.dtype.newbyteorder("="), copy=False)
    return np.ascontiguousarray(native).view(f"u{values.dtype.itemsize}")


def forward(form: Form, values: Array) -> tuple[Integers, Booleans, Integers]:
    """Integers of a channel (samples,), which samples are special (their integers are 0), and what forms of more than
    integers store beside them: the lower bits on a grid, the corrections of counts."""
    if form.kind == GRID:
        return _truncated(form, values)
    if form.kind in (COUNTS, CORRECTED):
        integers, special, extra = nearest_all([form], values)
        return integers[0], special[0], extra[0]
    if form.kind == PALETTE:
        places = np.searchsorted(np.array(form.palette, np.uint64), sortable(values))
        return places, np.zeros(len(values), bool), places
    counts = values.astype(np.int64) // int(form.step)
    return counts, np.zeros(len(values), bool), counts


def inverse(form: Form, integers: Integers, extra: Integers, dtype: np.dtype[Any]) -> Array:
    """The values of integers (samples,); extra: the lower bits of a grid, or corrections. Special samples are put in by
    the caller."""
    with np.errstate(all="ignore"):
        if form.kind == INTEGERS:
            return (integers * int(form.step)).astype(dtype)
        if form.kind == COUNTS:
            return (integers * form.step + form.offset).astype(dtype)
        if form.kind == PALETTE:
            palette = np.array(form.palette, np.uint64)
            return _from_sortable(palette[np.clip(integers, 0, len(palette) - 1)], dtype)
        if form.kind == CORRECTED:
            return _from_rank(_rank((integers * form.step + form.offset).astype(dtype)) + extra, dtype)
        size = np.abs(integers)
        last, width = _last_bit(form, size, dtype)
        mantissa = np.where(width > 0, size << width | extra, size >> np.maximum(0, last - form.exponent))
        return np.ldexp(np.copysign(mantissa.astype(np.float64), integers), last.astype(np.int32)).astype(dtype)


def rounded(form: Form, values: Array) -> Array:
    """The nearest values of counts to values (samples,), of the same type."""
    with np.errstate(all="ignore"):
        return (np.rint((values.astype(np.float64) - form.offset) / form.step) * form.step + form.offset + 0.0).astype(
            values.dtype
        )


def extra_widths(form: Form, integers: Integers, dtype: np.dtype[Any]) -> Integers:
    """The number of lower bits that are stored for each integer (samples,) of a grid."""
    return np.where(integers == 0, 0, _last_bit(form, np.abs(integers), dtype)[1])


def lower_bits(form: Form, integers: Integers, extra: Integers, dtype: np.dtype[Any]) -> bytes:
    """The lower bits of integers (samples,) on a grid as a bit field."""
    if (kernel := _kernel("signals_lower_bits", dtype)) is not None:
        return kernel(integers, extra, form.exponent).tobytes()
    return np.packbits(bits.pack(extra, extra_widths(form, integers, dtype))).tobytes()


def sortable(values: Array) -> NDArray[np.uint64]:
    """Bits of floats as integers in the same order."""
    size = 8 * values.dtype.itemsize
    plain = words(values).astype(np.uint64)
    sign = np.uint64(1 << (size - 1))
    return np.where(plain & sign, plain ^ np.uint64((1 << size) - 1), plain | sign)


def _from_sortable(sortable: NDArray[np.uint64], dtype: np.dtype[Any]) -> Array:
    """The inverse of `sortable`."""
    size = 8 * dtype.itemsize
    sign = np.uint64(1 << (size - 1))
    plain = np.where(sortable & sign, sortable ^ sign, sortable ^ np.uint64((1 << size) - 1))
    return plain.astype(f"u{dtype.itemsize}").view(dtype.newbyteorder("=")).astype(dtype)


def _rank(values: Array) -> Integers:
    """The place of each float among all of its type: neighbours differ by 1, and −0 is 0."""
    size = 8 * values.dtype.itemsize - 1
    plain = words(values).astype(np.int64)
    magnitude = plain & ((1 << size) - 1)
    return np.where(np.signbit(values), -magnitude, magnitude)


def _from_rank(rank: Integers, dtype: np.dtype[Any]) -> Array:
    """The inverse of `_rank`; 0 is +0."""
    size = 8 * dtype.itemsize - 1
    magnitude = (np.abs(rank) & ((1 << size) - 1)).astype(np.uint64)
    plain = magnitude | (rank < 0).astype(np.uint64) << np.uint64(size)
    return plain.astype(f"u{dtype.itemsize}").view(dtype.newbyteorder("=")).astype(dtype)


def _columns(forms: Sequence[Form]) -> NDArray[np.float64]:
    """Steps and offsets (2, forms, 1)."""
    return np.array([[form.step for form in forms], [form.offset for form in forms]])[..., None]


def _last_bit(form: Form, size: Integers, dtype: np.dtype[Any]) -> tuple[Integers, Integers]:
    """The exponent of the last bit of values with integers of this size, and how far it is below the grid."""
    leading = np.frexp(np.maximum(size, 1).astype(np.float64))[1] - 1 + form.exponent
    last = np.maximum(leading - MANTISSA_BITS[dtype.itemsize], LEAST_EXPONENT[dtype.itemsize]).astype(np.int64)
    return last, np.maximum(0, form.exponent - last)


def _truncated(form: Form, values: Array) -> tuple[Integers, Booleans, Integers]:
    """Integers, special samples and lower bits of values on a grid."""
    if (kernel := _kernel("signals_truncated", values.dtype)) is not None:
        return kernel(values, form.exponent)
    mantissa_bits, least = MANTISSA_BITS[values.dtype.itemsize], LEAST_EXPONENT[values.dtype.itemsize]
    plain = words(values).astype(np.int64)
    exponent = plain >> mantissa_bits & ((1 << (8 * values.dtype.itemsize - 1 - mantissa_bits)) - 1)
    mantissa = (plain & ((1 << mantissa_bits) - 1)) | np.where(exponent > 0, 1 << mantissa_bits, 0)
    below = form.exponent - (np.maximum(exponent, 1) - 1 + least)
    size = np.where(below > 0, mantissa >> np.clip(below, 0, 63), mantissa << np.clip(-below, 0, 63 - mantissa_bits))
    is_positive_zero = plain == 0
    special = ((size == 0) & ~is_positive_zero) | ~np.isfinite(values) | (size >= MAX_INTEGER) | (size < 0)
    size[special] = 0
    extra = np.where(special, 0, mantissa & ((1 << np.clip(below, 0, 62)) - 1))
    return np.where(np.signbit(values), -size, size), special, extra


def _kernel(name: str, dtype: np.dtype[Any]) -> Callable[..., Any] | None:
    """The compiled function for a type of floats."""
    return native.kernel(f"{name}_{dtype.itemsize}") if dtype.isnative and dtype.itemsize > 2 else None


def nearest_all(forms: Sequence[Form], values: Array) -> tuple[Integers, Booleans, Integers]:
    """Counts of values (samples,) in several forms, all COUNTS or all CORRECTED: (forms, samples).

    Then which samples they do not give back, and by how many floats the others are above their counts.
    """
    step, offset = _columns(forms)
    is_corrected = forms[0].kind == CORRECTED
    if (kernel := _kernel("signals_nearest", values.dtype)) is not None:
        return kernel(values, step[:, 0], offset[:, 0], is_corrected)
    with np.errstate(all="ignore"):
        counts = np.rint((values.astype(np.float64) - offset) / step)
        usable = np.abs(counts) < MAX_INTEGER
        integers = np.where(usable, counts, 0).astype(np.int64)
        back = (integers * step + offset).astype(values.dtype)
    extra = _rank(values) - _rank(back)
    if is_corrected:
        usable &= np.abs(extra) < MAX_CORRECTION
        back = _from_rank(_rank(back) + extra, values.dtype)
    special = ~usable | (words(back) != words(values))
    integers[special] = 0
    return integers, special, extra
