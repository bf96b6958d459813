"""A tree of values on disk: JSON values, bytes, arrays and signals, each after a type byte; common ones in one byte.

0 null · 1 false · 2 true · 3 integer · 4 decimal · 5 float64 · 6 string · 7 list · 8 dict · 9 bytes ·
10 large integer · 11 array · 12 signal · 13 small array · 14 a word of the second table · 15 coded signal
32…95 the integers 0…63 · 96…127 a string of 0…31 bytes · 128…255 a word of the table
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, cast

import numpy as np

from ..errors import CannotEncode
from ..motion import Signal
from . import arrays, lab_words, stored_signals, tables
from .arrays import Array, Budget
from .stored_signals import CodedSignal
from .tables import MORE_WORDS, SOURCES, WORDS
from .wire import Cursor, blob, deflate, inflate, text, varint, zigzag

NULL, FALSE, TRUE, INTEGER, DECIMAL, FLOAT64, STRING, LIST, DICT, BYTES, LARGE = range(11)
ARRAY, SIGNAL, SMALL_ARRAY, MORE, CODED_SIGNAL = 11, 12, 13, 14, 15
SMALL, SHORT, WORD = 32, 96, 128
WORD_NUMBER = {word: number for number, word in reversed(list(enumerate(WORDS)))}
MORE_WORD_NUMBER = {word: number for number, word in enumerate(MORE_WORDS)}
SMALL_ARRAY_BYTES = 64
"""Arrays up to this size are stored inside the tree, so that deflate codes them with their neighbours."""
MAX_DEPTH, MAX_TREE_BYTES = 64, 1 << 26
LAB_WORDS = 1
SPARE_BYTES = 1 << 28
UNPACK_RATIO = 1024
"""Extras may unpack to SPARE_BYTES + UNPACK_RATIO × their bytes in the file; more is refused as hostile."""


def pack(tree: Mapping[str, Any], what: str) -> bytes:
    """A dict of JSON values as bytes. what: its name in messages. Raises CannotEncode for values of other types."""
    return _wrapped(_TreeWriter(what, arrays_allowed=False).all(tree))


def unpack(cursor: Cursor) -> dict[str, Any]:
    """The inverse of `pack`. Raises Corrupt, Truncated."""
    return _tree(cursor, Budget(MAX_TREE_BYTES), None)


def pack_source(source: Mapping[str, Any]) -> bytes:
    """A source: the number of the entry of SOURCES that it extends, then a dict of the values that differ or follow."""
    candidates = []
    for number, preset in enumerate(SOURCES):
        rest = {key: value for key, value in source.items() if key not in preset or not _same(preset[key], value)}
        if list({**preset, **rest}) == list(source):
            candidates.append(varint(number) + pack(rest, "source"))
    return min(candidates, key=len)


def unpack_source(cursor: Cursor) -> dict[str, Any]:
    """The inverse of `pack_source`. Raises Corrupt, Truncated."""
    number = cursor.varint()
    if number >= len(SOURCES):
        raise cursor.corrupt("a reserved number of a source")
    return {**SOURCES[number], **unpack(cursor)}


def _same(a: Any, b: Any) -> bool:
    return type(a) is type(b) and a == b


@cache
def dictionary() -> bytes:
    """The preset dictionary of deflate: the stream of typical extras. A test holds its checksum."""
    return _TreeWriter("the dictionary", arrays_allowed=True).all(tables.typical_extras())


@cache
def lab_dictionary() -> bytes:
    """The second preset dictionary: the stream of `lab_extras`, then the first one."""
    return _TreeWriter("the dictionary", arrays_allowed=True).all(lab_words.lab_extras()) + dictionary()


@dataclass(frozen=True)
class Extras:
    """Extras as bytes. section: the tree, then its arrays and heads of signals; size: what it unpacks to, signals
    included; signals: the chunks of all signals, stored behind the section."""

    section: bytes
    size: int
    signals: tuple[bytes, ...] = ()

    @property
    def signal_bytes(self) -> int:
        """Bytes of the signals in the file, with a checksum for each chunk."""
        return sum(map(len, self.signals)) + stored_signals.CHECKSUM_BYTES * len(self.signals)


def pack_extras(tree: Mapping[str, Any]) -> Extras:
    """Extras as bytes. Raises CannotEncode."""
    writer = _TreeWriter("extras", arrays_allowed=True)
    stream = writer.all(tree)
    packed, size = _wrapped(stream, True), len(stream)
    for part in writer.parts:
        is_coded = isinstance(part, CodedSignal)
        packed += part.head if is_coded else arrays.pack(part)
        size += part.nbytes if is_coded else arrays.nbytes(part)
    signals = tuple(chunk for part in writer.parts if isinstance(part, CodedSignal) for chunk in part.chunks)
    extras = Extras(packed, size, signals)
    stored = len(packed) + extras.signal_bytes
    if size > unpack_limit(stored):
        raise CannotEncode(f"extras of {size} bytes shrink to {stored}, which readers refuse; store fewer extras")
    return extras


def unpack_extras(data: bytes, size: int, signals: stored_signals.Section | None = None) -> dict[str, Any]:
    """The inverse of `pack_extras`, from its section; allocates no more than `size` declares.

    Raises Corrupt, Truncated. signals: where the chunks of signals are in the file.
    """
    signals = signals or stored_signals.Section(lambda start, count: b"", 0)
    cursor = Cursor(data, "extras")
    budget = Budget(min(size, unpack_limit(len(data) + signals.size)))
    tree = _tree(cursor, budget, budget, signals)
    cursor.done()
    signals.done(cursor)
    return tree


def unpack_limit(stored: int) -> int:
    """The most bytes that an extras section of `stored` bytes may unpack to."""
    return SPARE_BYTES + UNPACK_RATIO * stored


def _wrapped(stream: bytes, with_lab_words: bool = False) -> bytes:
    """The shortest of: varint 2·length and the stream; varint 2·length + 1 and the deflated blob; with lab words,
    LAB_WORDS, varint length and a blob deflated with the second dictionary."""
    size, packed = len(stream), blob(deflate(stream, dictionary()))
    options = [varint(size << 1) + stream, varint(size << 1 | 1) + packed]
    lab = [varint(LAB_WORDS) + varint(size) + blob(deflate(stream, lab_dictionary()))] if with_lab_words else []
    return min(options + lab, key=len)


def _tree(
    cursor: Cursor, budget: Budget, arrays_budget: Budget | None, signals: stored_signals.Section | None = None
) -> dict[str, Any]:
    head = cursor.varint()
    size = cursor.varint() if head == LAB_WORDS else head >> 1
    budget.take(size, cursor.what)
    words = lab_dictionary() if head == LAB_WORDS else dictionary()
    stream = inflate(cursor.blob(), size, cursor.what, words) if head & 1 else cursor.take(size)
    inner = Cursor(stream, cursor.what)
    reader = _TreeReader(inner, cursor, arrays_budget, signals)
    tree = reader.items(0, None)
    return reader.fill_arrays(tree) if reader.has_arrays else tree


class _TreeWriter:
    """Writes values to a stream; arrays and coded signals are collected for the section after it."""

    def __init__(self, what: str, arrays_allowed: bool) -> None:
        self.what = what
        self.parts: list[Array | CodedSignal] = []
        self.arrays_allowed = arrays_allowed

    def all(self, tree: Mapping[str, Any]) -> bytes:
        out = bytearray()
        self.items(out, tree, 0)
        if len(out) > MAX_TREE_BYTES:
            raise CannotEncode(f"{self.what} are {len(out)} bytes of text and structure; a file holds {MAX_TREE_BYTES}")
        return bytes(out)

    def value(self, out: bytearray, value: Any, depth: int) -> None:
        if depth > MAX_DEPTH:
            raise CannotEncode(f"{self.what} are nested more than {MAX_DEPTH} levels deep")
        if isinstance(value, np.generic) and not isinstance(value, (float, str, bytes)):
            value = value.item()
        if value is None or isinstance(value, bool):
            out.append({None: NULL, False: FALSE, True: TRUE}[value])
        elif isinstance(value, int):
            self.integer(out, int(value))
        elif isinstance(value, float):
            self.float(out, float(value))
        elif isinstance(value, str):
            self.string(out, str(value))
        elif isinstance(value, Mapping):
            mapping = cast(Mapping[Any, Any], value)
            out += bytes([DICT]) + varint(len(mapping))
            self.items(out, mapping, depth)
        elif self.arrays_allowed and isinstance(value, (bytes, bytearray, memoryview)):
            out += bytes([BYTES]) + blob(bytes(value))
        elif self.arrays_allowed and isinstance(value, np.ndarray):
            self.array(out, value)
        elif self.arrays_allowed and isinstance(value, Signal):
            self.signal(out, value, depth)
        elif isinstance(value, Sequence) and not isinstance(value, (bytes, bytearray, memoryview)):
            out += bytes([LIST]) + varint(len(value))
            for item in value:
                self.value(out, item, depth + 1)
        else:
            raise CannotEncode(f"{self.what} hold a {type(value).__name__}, which a .mocz cannot store: {value!r:.60}")

    def items(self, out: bytearray, mapping: Mapping[Any, Any], depth: int) -> None:
        for key, item in mapping.items():
            if not isinstance(key, str):
                raise CannotEncode(f"{self.what} have a key that is not a string: {key!r}")
            self.string(out, key)
            self.value(out, item, depth + 1)

    def array(self, out: bytearray, array: Array) -> None:
        arrays.require_storable(array)
        if array.nbytes > SMALL_ARRAY_BYTES:
            out.append(ARRAY)
            self.parts.append(array)
            return
        out.append(SMALL_ARRAY)
        self.string(out, array.dtype.str)
        out += varint(array.ndim) + b"".join(map(varint, array.shape)) + array.tobytes()

    def signal(self, out: bytearray, signal: Signal, depth: int) -> None:
        coded = stored_signals.coded(signal)
        out.append(SIGNAL if coded is None else CODED_SIGNAL)
        for part in (float(signal.rate), list(signal.labels), list(signal.units)):
            self.value(out, part, depth + 1)
        if coded is None:
            self.value(out, np.asarray(signal.values), depth + 1)
        else:
            self.string(out, coded.dtype.str)
            out += varint(len(coded.shape)) + b"".join(map(varint, coded.shape))
            self.parts.append(coded)

    def integer(self, out: bytearray, value: int) -> None:
        if 0 <= value < SHORT - SMALL:
            out.append(SMALL + value)
        elif abs(value) < 1 << 61:
            out += bytes([INTEGER]) + varint(zigzag(value))
        else:
            out += bytes([LARGE]) + blob(value.to_bytes(value.bit_length() // 8 + 1, "little", signed=True))

    def float(self, out: bytearray, value: float) -> None:
        short = decimal(value)
        if short is not None and len(short) < 8:
            out += bytes([DECIMAL]) + short
        else:
            out += bytes([FLOAT64]) + struct.pack("<d", value)

    def string(self, out: bytearray, value: str) -> None:
        data = value.encode("utf-8", "surrogatepass")
        if value in WORD_NUMBER:
            out.append(WORD + WORD_NUMBER[value])
        elif value in MORE_WORD_NUMBER:
            out += bytes([MORE]) + varint(MORE_WORD_NUMBER[value])
        elif len(data) < WORD - SHORT:
            out += bytes([SHORT + len(data)]) + data
        else:
            out += bytes([STRING]) + text(value)


def decimal(value: float) -> bytes | None:
    """A float as digits and a power of ten (0.002 is 2 and −3), or None if that is not exact."""
    match = re.fullmatch(r"(-?)([0-9]+)(?:\.([0-9]+))?(?:e([-+][0-9]+))?", repr(value))
    if match is None or (value == 0 and match[1]):
        return None
    fraction = (match[3] or "").rstrip("0")
    digits = int(match[2] + fraction)
    power = int(match[4] or 0) - len(fraction)
    while digits and digits % 10 == 0:
        digits, power = digits // 10, power + 1
    return varint(zigzag(-digits if match[1] else digits)) + varint(zigzag(power)) if digits < 1 << 53 else None


def from_decimal(cursor: Cursor) -> float:
    """The inverse of `decimal`. Raises Corrupt."""
    digits, power = cursor.signed(), cursor.signed()
    if abs(power) > 400 or abs(digits) >= 1 << 53:
        raise cursor.corrupt("a decimal number is out of range")
    return float(f"{digits}e{power}")


class _TreeReader:
    """Reads the tree; arrays stand after it, so they are put in once the tree is whole."""

    def __init__(
        self,
        stream: Cursor,
        section: Cursor,
        arrays_budget: Budget | None,
        signals: stored_signals.Section | None = None,
    ) -> None:
        self.stream = stream
        self.section = section
        self.budget = arrays_budget
        self.signals = signals
        self.has_arrays = False

    def value(self, depth: int) -> Any:
        stream = self.stream
        if depth > MAX_DEPTH + 1:
            raise stream.corrupt("nested too deep")
        tag = stream.byte()
        if tag >= WORD:
            if tag - WORD >= len(WORDS):
                raise stream.corrupt("a reserved number of a word")
            return WORDS[tag - WORD]
        if tag >= SHORT:
            return self.decoded(stream.take(tag - SHORT))
        if tag >= SMALL:
            return tag - SMALL
        if tag in (NULL, FALSE, TRUE):
            return {NULL: None, FALSE: False, TRUE: True}[tag]
        if tag == INTEGER:
            return stream.signed()
        if tag == DECIMAL:
            return from_decimal(stream)
        if tag == FLOAT64:
            return stream.float64()
        if tag == STRING:
            return stream.text()
        if tag == LIST:
            return [self.value(depth + 1) for _ in range(stream.count())]
        if tag == DICT:
            return self.items(depth, self.stream.count(2))
        if tag == MORE:
            return self.word(stream.varint())
        if tag == LARGE:
            return int.from_bytes(stream.blob(), "little", signed=True)
        if self.budget is not None and tag == BYTES:
            return stream.blob()
        if self.budget is not None and tag == SMALL_ARRAY:
            return self.small_array()
        if self.budget is not None and tag in (ARRAY, SIGNAL):
            self.has_arrays = True
            return _Placeholder(None if tag == ARRAY else [self.value(depth + 1) for _ in range(4)])
        if self.signals is not None and tag == CODED_SIGNAL:
            self.has_arrays = True
            parts = [self.value(depth + 1) for _ in range(3)]
            dtype = arrays.dtype_of(self.value(MAX_DEPTH + 1), stream)
            return _Placeholder([*parts, (dtype, arrays.read_shape(stream))])
        raise stream.corrupt(f"a value of the reserved type {tag}")

    def word(self, number: int) -> str:
        if number >= len(MORE_WORDS):
            raise self.stream.corrupt("a reserved number of a word")
        return MORE_WORDS[number]

    def decoded(self, data: bytes) -> str:
        try:
            return data.decode("utf-8", "surrogatepass")
        except UnicodeDecodeError:
            raise self.stream.corrupt("a string is not UTF-8") from None

    def small_array(self) -> Array:
        dtype = arrays.dtype_of(self.value(MAX_DEPTH + 1), self.stream)
        shape = arrays.read_shape(self.stream)
        size = math.prod(shape) * dtype.itemsize
        if size > SMALL_ARRAY_BYTES:
            raise self.stream.corrupt(f"a small array of more than {SMALL_ARRAY_BYTES} bytes")
        return np.frombuffer(self.stream.take(size), dtype).reshape(shape).copy()

    def items(self, depth: int, count: int | None) -> dict[str, Any]:
        """`count` keys and values; None reads to the end of the stream."""
        result: dict[str, Any] = {}
        while self.stream.left if count is None else len(result) < count:
            key = self.value(MAX_DEPTH + 1)
            if not isinstance(key, str) or key in result:
                raise self.stream.corrupt("a key is not a string, or is repeated")
            result[key] = self.value(depth + 1)
        return result

    def fill_arrays(self, value: Any) -> Any:
        """The tree with its placeholders replaced by arrays and signals, read in tree order."""
        if isinstance(value, dict):
            return {key: self.fill_arrays(item) for key, item in value.items()}
        if isinstance(value, list):
            return [self.fill_arrays(item) for item in value]
        if not isinstance(value, _Placeholder):
            return value
        if value.signal is None:
            return arrays.unpack(self.section, self.budget)
        rate, labels, units, samples = map(self.fill_arrays, value.signal)
        if isinstance(samples, tuple) and self.signals is not None and self.budget is not None:
            dtype, shape = samples
            self.budget.take(math.prod(shape) * dtype.itemsize, self.section.what)
            samples = self.signals.next(self.section, dtype, shape)
        if not (isinstance(rate, float) and isinstance(samples, np.ndarray | stored_signals.StoredSamples)):
            raise self.stream.corrupt("a signal without rate or samples")
        if not all(isinstance(part, list) and all(isinstance(s, str) for s in part) for part in (labels, units)):
            raise self.stream.corrupt("a signal's labels or units are not strings")
        if isinstance(samples, np.ndarray):
            return Signal(samples, rate, tuple(labels), tuple(units))
        return stored_signals.StoredSignal(samples, rate, tuple(labels), tuple(units))


class _Placeholder:
    """Takes the place of an array, or of a signal's four parts, until the arrays are read."""

    def __init__(self, signal: list[Any] | None) -> None:
        self.signal = signal
