"""Arrays on disk, lossless to the bit: the shortest of several forms, chosen by coding the first 128 KiB in each.

array ──► constant: one item
      ──► plain | bytes of equal weight together | the same of differences along time | multiples of one step
      ──► raw | deflate | LZMA
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..entropy.compressors import lzma2, unlzma2
from ..errors import CannotEncode, Corrupt
from .wire import Cursor, blob, deflate, inflate, text, varint

Array = NDArray[Any]

RAW, DEFLATE, LZMA, CONSTANT = 0, 1, 2, 3
PLAIN, SHUFFLED, DELTA, STEPS = 0, 1, 2, 3
KINDS = "biufcSUmM"
MAX_DIMENSIONS = 16
SAMPLE_BYTES = 1 << 17


class Budget:
    """How many bytes may still be unpacked; `take` raises Corrupt before anything larger is allocated."""

    def __init__(self, limit: int) -> None:
        self.left = limit

    def take(self, size: int, what: str) -> None:
        self.left -= size
        if self.left < 0:
            raise Corrupt(f"{what}: unpacks to more bytes than the header declares")


def pack(array: Array) -> bytes:
    """dtype, dimensions, transform and coder, then a blob (one item if all items are equal).

    Raises CannotEncode for objects and for dtypes that differ between machines.
    """
    require_storable(array)
    shape = array.shape
    array = np.ascontiguousarray(array).reshape(shape)
    head = text(array.dtype.str) + varint(array.ndim) + b"".join(map(varint, shape))
    data = array.tobytes()
    item = data[: array.dtype.itemsize]
    if data == item * array.size:
        return head + bytes([CONSTANT]) + item
    step = _step(array)
    _, transform, coder = min((len(form), form[0] >> 2, form[0] & 3) for form in _forms(_sample(array), step))
    data = _forward(array, transform, step)
    return head + min(_form(data, transform, step, RAW), _form(data, transform, step, coder), key=len)


def _sample(array: Array) -> Array:
    """The first rows: the form of the whole array is chosen on them."""
    return array[: max(1, SAMPLE_BYTES * len(array) // array.nbytes)] if array.ndim else array


def _forms(array: Array, step: float) -> list[bytes]:
    """The array in every form that applies: byte strings stay plain, STEPS needs a step."""
    transforms = [PLAIN] if array.dtype.kind == "S" else [PLAIN, SHUFFLED, DELTA, *([STEPS] if step else [])]
    forms = []
    for transform in transforms:
        data = _forward(array, transform, step)
        forms += [_form(data, transform, step, coder) for coder in (RAW, DEFLATE, LZMA)]
    return forms


def _form(data: bytes, transform: int, step: float, coder: int) -> bytes:
    """The byte of coder and transform, the step if there is one, and the blob."""
    packed = deflate(data) if coder == DEFLATE else lzma2(data) if coder == LZMA else data
    return bytes([coder | transform << 2]) + (struct.pack("<d", step) if transform == STEPS else b"") + blob(packed)


def require_storable(array: Array) -> None:
    """Raises CannotEncode for arrays that `pack` cannot store."""
    if array.dtype.kind not in KINDS or array.dtype.itemsize == 0 or array.dtype.itemsize > 1 << 20:
        raise CannotEncode(f"an array of dtype {array.dtype} cannot be stored; numbers, strings and times can")
    if array.dtype.kind in "fc" and array.dtype.itemsize > (8 if array.dtype.kind == "f" else 16):
        raise CannotEncode(f"an array of dtype {array.dtype} differs between machines; convert it to float64 first")
    if array.ndim > MAX_DIMENSIONS:
        raise CannotEncode(f"an array of {array.ndim} dimensions cannot be stored; {MAX_DIMENSIONS} at most can")


def unpack(cursor: Cursor, budget: Budget | None = None) -> Array:
    """The inverse of `pack`. Raises Corrupt if it would unpack to more than the budget (by default 16 MiB)."""
    budget = budget or Budget(1 << 24)
    dtype = dtype_of(cursor.text(), cursor)
    shape = read_shape(cursor)
    size = math.prod(shape) * dtype.itemsize
    budget.take(size, cursor.what)
    form = cursor.byte()
    coder, transform = form & 3, form >> 2
    if transform > STEPS or (coder == CONSTANT and transform):
        raise cursor.corrupt("an array has a reserved form")
    if coder == CONSTANT:
        item = cursor.take(dtype.itemsize if size else 0)
        return np.frombuffer(item * (size // dtype.itemsize), dtype).reshape(shape).copy()
    step = cursor.float64() if transform == STEPS else 0.0
    if transform == STEPS:
        if dtype.kind != "f":
            raise cursor.corrupt("an array of multiples of a step is not of floats")
        size = size // dtype.itemsize * 4
        budget.take(size, cursor.what)
    data = _decode(cursor, coder, size)
    return _inverse(data, dtype, shape, transform, step)


def nbytes(array: Array) -> int:
    """The most that unpacking takes from a budget."""
    return array.nbytes + array.size * 4


def read_shape(cursor: Cursor) -> tuple[int, ...]:
    dimensions = cursor.varint()
    if dimensions > MAX_DIMENSIONS:
        raise cursor.corrupt(f"an array of {dimensions} dimensions")
    shape = tuple(cursor.varint() for _ in range(dimensions))
    if any(n >= 1 << 40 for n in shape):
        raise cursor.corrupt("an array's dimension is out of range")
    return shape


def dtype_of(code: object, cursor: Cursor) -> np.dtype[Any]:
    """The dtype of a NumPy type string. Raises Corrupt."""
    if not isinstance(code, str):
        raise cursor.corrupt("an array's dtype is unknown")
    try:
        dtype = np.dtype(code)
    except Exception:
        raise cursor.corrupt("an array's dtype is unknown") from None
    if dtype.kind not in KINDS or dtype.str != code or not 0 < dtype.itemsize <= 1 << 20:
        raise cursor.corrupt("an array's dtype is unknown")
    return dtype


def _decode(cursor: Cursor, coder: int, size: int) -> bytes:
    packed = cursor.blob()
    if coder == RAW:
        if len(packed) != size:
            raise cursor.corrupt(f"an array has {len(packed)} bytes, not {size}")
        return packed
    return inflate(packed, size, cursor.what) if coder == DEFLATE else unlzma2(packed, size, cursor.what)


def _word_bytes(dtype: np.dtype[Any]) -> int:
    """Bytes of one number of an item: half a complex number, one character of a string."""
    if dtype.kind == "c":
        return dtype.itemsize // 2
    return 4 if dtype.kind == "U" else dtype.itemsize


def _columns(words: Array) -> Array:
    """The first axis (time) last, so that the samples of a channel are adjacent."""
    return np.ascontiguousarray(np.moveaxis(words, 0, -1)) if words.ndim > 1 else words


def _forward(array: Array, transform: int, step: float) -> bytes:
    if transform == PLAIN:
        return array.tobytes()
    if transform == STEPS:
        words: Array = np.rint(array.astype(np.float64) / step).astype(np.int64).astype(np.uint32)
    else:
        width = _word_bytes(array.dtype)
        order = array.dtype.str[0] if array.dtype.str[0] in "<>" else "<"
        parts = array.dtype.itemsize // width
        words = np.frombuffer(array.tobytes(), f"{order}u{width}").astype(f"<u{width}")
        words = words.reshape(*array.shape, parts) if parts > 1 else words.reshape(array.shape)
    columns = _columns(np.atleast_1d(words))
    if transform != SHUFFLED:
        columns = np.diff(columns, axis=-1, prepend=columns.dtype.type(0))
    return columns.reshape(-1, 1).view(np.uint8).T.tobytes()


def _inverse(data: bytes, dtype: np.dtype[Any], shape: tuple[int, ...], transform: int, step: float) -> Array:
    if transform == PLAIN:
        return np.frombuffer(data, dtype).reshape(shape).copy()
    width = 4 if transform == STEPS else _word_bytes(dtype)
    parts = 1 if transform == STEPS else dtype.itemsize // width
    full = (*shape, parts) if parts > 1 else shape or (1,)
    columns_shape = (*full[1:], full[0])
    columns = np.frombuffer(data, np.uint8).reshape(width, -1).T.copy().view(f"<u{width}").reshape(columns_shape)
    if transform != SHUFFLED:
        columns = np.cumsum(columns, axis=-1, dtype=columns.dtype)
    words = np.ascontiguousarray(np.moveaxis(columns, -1, 0))
    if transform == STEPS:
        return (words.view("<i4").astype(np.float64) * step).astype(dtype).reshape(shape)
    order = dtype.str[0] if dtype.str[0] in "<>" else "<"
    return np.frombuffer(words.astype(f"{order}u{width}").tobytes(), dtype).reshape(shape).copy()


def _step(array: Array) -> float:
    """The step of which all values are exact integer multiples (converter counts × scale); 0 if there is none."""
    if array.dtype.kind != "f":
        return 0.0
    values = array.reshape(-1).astype(np.float64)
    if not np.isfinite(values).all():
        return 0.0
    sample = np.unique(np.abs(values[:: max(1, values.size >> 14)]))
    gaps = np.diff(np.concatenate([[0.0], sample[sample > 0]]))
    largest = np.abs(values).max()
    gap = gaps[gaps > largest * 1e-9].min(initial=np.inf)
    if not np.isfinite(gap) or largest / gap >= 1 << 31:
        return 0.0
    for candidate in (gap, largest / np.rint(largest / gap), float(np.float32(largest / np.rint(largest / gap)))):
        with np.errstate(over="ignore"):
            restored = (np.rint(values / candidate) * candidate).astype(array.dtype)
        if np.abs(values / candidate).max() < (1 << 31) - 1 and restored.tobytes() == array.tobytes():
            return float(candidate)
    return 0.0
