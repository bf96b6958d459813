"""Signals, written from docs/payloads/signals.md and not made to be fast; of mocodec it reads two tables."""

from __future__ import annotations

import lzma
import struct
import zlib
from typing import Any

import numpy as np

from mocodec.signals.residuals import GAUSS_RATIOS, LAPLACE_RATIOS

from .integers import Bytes, bits_of

TOTAL = 1 << 15


def inflate(data: bytes) -> bytes:
    return zlib.decompress(data, -15)


class Bits:
    def __init__(self, data: bytes) -> None:
        self.bits, self.at = bits_of(data), 0

    def get(self, width: int) -> int:
        value = 0
        for _ in range(width):
            value = value << 1 | (self.bits[self.at] if self.at < len(self.bits) else 0)
            self.at += 1
        return value


# --- head


def head(data: Bytes, dtype: np.dtype[Any], shape: tuple[int, ...]) -> tuple[int, list[tuple[Any, ...]], list[int]]:
    """Samples of a chunk, the form of each channel, the bytes of each chunk."""
    length = data.varint()
    fields = Bytes(inflate(data.blob()))
    assert len(fields.data) == length
    chunk = fields.varint()
    forms = [form(fields, dtype) for _ in range(int(np.prod(shape[1:], dtype=int)))]
    sizes = [fields.varint() for _ in range(-(-shape[0] // chunk))]
    assert not fields.rest()
    return chunk, forms, sizes


def form(fields: Bytes, dtype: np.dtype[Any]) -> tuple[Any, ...]:
    kind = fields.take(1)[0]
    if kind == 0:
        return kind, fields.take(dtype.itemsize)
    if kind == 1:
        return kind, fields.varint()
    if kind in (2, 4):
        return kind, fields.float64(), fields.float64()
    if kind == 3:
        return kind, fields.folded()
    if kind == 6:
        return kind, fields.varint()
    assert kind == 5
    count = fields.varint()
    lengths = inflate(fields.blob())
    assert len(lengths) == count
    bits = Bits(fields.take((sum(max(0, length - 1) for length in lengths) + 7) // 8))
    steps = [1 << length - 1 | bits.get(length - 1) if length else 0 for length in lengths]
    return kind, [sum(steps[: i + 1]) for i in range(count)]


# --- values of integers


def from_bits(bits: int, dtype: np.dtype[Any]) -> Any:
    return np.frombuffer(bits.to_bytes(dtype.itemsize, "little"), dtype.newbyteorder("<"))[0]


def value(form: tuple[Any, ...], k: int, extra: int, dtype: np.dtype[Any]) -> Any:
    size = 8 * dtype.itemsize
    if form[0] == 1:
        return dtype.type(k * form[1])
    if form[0] == 2:
        return dtype.type(float(k) * form[1] + form[2])
    if form[0] == 4:
        near = np.array(float(k) * form[1] + form[2]).astype(dtype.newbyteorder("<"))
        bits = int.from_bytes(near.tobytes(), "little")
        magnitude = bits & ((1 << size - 1) - 1)
        rank = (-magnitude if bits >> size - 1 else magnitude) + extra
        return from_bits(abs(rank) | (rank < 0) << size - 1, dtype)
    if form[0] == 5:
        entry = form[1][k]
        return from_bits(entry - (1 << size - 1) if entry >> size - 1 else entry ^ ((1 << size) - 1), dtype)
    if k == 0:
        return dtype.type(0)
    last, width = last_bit(form, k, dtype)
    mantissa = abs(k) << width | extra if width else abs(k) >> last - form[1]
    return dtype.type(np.ldexp(float(mantissa), last) * (1 if k > 0 else -1))


def last_bit(form: tuple[Any, ...], k: int, dtype: np.dtype[Any]) -> tuple[int, int]:
    m, least = {2: (10, -24), 4: (23, -149), 8: (52, -1074)}[dtype.itemsize]
    last = max(form[1] + abs(k).bit_length() - 1 - m, least)
    return last, max(0, form[1] - last)


# --- residuals


def starts(masses: list[int], f: int) -> list[int]:
    n = len(masses)
    return [
        min(TOTAL - f * (n - i), max(f * i, TOTAL * sum(masses[:i]) // max(1, sum(masses)))) for i in range(n)
    ]  # fmt: skip


def first_tables(context: int) -> tuple[list[int], list[list[int]]]:
    both = []
    for ratio, squared in ((LAPLACE_RATIOS[context], False), (GAUSS_RATIOS[context], True)):
        weights, factor = [1 << 30], ratio
        for _ in range(32):
            weights.append(max(1, weights[-1] * factor >> 30))
            factor = factor * ratio**2 >> 60 if squared else factor
        both.append([(w << 30) // (2 * sum(weights) - weights[0]) for w in weights])
    mass = [both[0][abs(n)] + both[1][abs(n)] for n in range(-32, 32)]
    return starts([sum(mass[i : i + 4]) for i in range(0, 64, 4)], 8), [
        starts(mass[i : i + 4], 64) for i in range(0, 64, 4)
    ]


class Table:
    def __init__(self, starts: list[int], f: int) -> None:
        self.starts, self.f, self.seen = list(starts), f, 0

    def adapt(self, s: int) -> None:
        n, rate = len(self.starts), 7 if self.seen < 64 else 8
        self.seen += 1
        for i in range(n):
            target = self.f * i if i <= s else TOTAL - self.f * (n - i)
            self.starts[i] += (target - self.starts[i]) >> rate


def lane(data: Bytes, count: int) -> list[int]:
    start = data.take(1)[0]
    state = int.from_bytes(data.take(4), "little")
    words = list(struct.unpack(f"<{(n := data.varint())}H", data.take(2 * n)))[::-1]
    stored = data.blob()
    raw = Bits(stored)
    fast = slow = (4 + start % 4) << start // 4
    high_tables: dict[int, Table] = {}
    low_tables: dict[tuple[int, int], Table] = {}

    def symbol(table: Table) -> int:
        nonlocal state
        slot = state % TOTAL
        s = max(i for i, first in enumerate(table.starts) if first <= slot)
        end = [*table.starts, TOTAL][s + 1]
        state = (end - table.starts[s]) * (state // TOTAL) + slot - table.starts[s]
        if state < 1 << 16:
            state = state << 16 | words.pop()
        table.adapt(s)
        return s

    result = []
    for _ in range(count):
        mean = fast + slow
        place = mean.bit_length() - 1
        level = 4 * place + (mean >> place - 2) % 4 - 36
        shift = max(0, level // 4 - 2)
        context = 40 + level % 4 if shift else max(0, level + 28)
        if context not in high_tables:
            high_starts, low_starts = first_tables(context)
            high_tables[context] = Table(high_starts, 8)
            low_tables |= {(context, h): Table(low_starts[h], 64) for h in range(16)}
        high = symbol(high_tables[context])
        if high in (0, 15):
            zeros = 0
            while not raw.get(1):
                zeros += 1
            b = 1 << zeros | raw.get(zeros)
            v = 27 + b if high else -28 - b
        else:
            v = 4 * high + symbol(low_tables[context, high]) - 32
        result.append((v << shift) + raw.get(shift))
        size = 256 * min(abs(result[-1]), 1 << 30)
        fast = max(2, fast + ((size - fast) >> 3))
        slow = max(2, slow + ((size - slow) >> 6))
    assert state == 1 << 16
    assert not words
    assert (raw.at + 7) // 8 == len(stored)
    return result


# --- chunks


class Record:
    """A record, read; `integers` of all samples for channels that refer to it."""

    def __init__(self, data: Bytes, form: tuple[Any, ...], dtype: np.dtype[Any], samples: int, before: bytes) -> None:
        self.form, self.dtype, self.predictor, self.codes = form, dtype, None, bytes(samples)
        flags = data.take(1)[0]
        self.items = lzma_items(data.blob(), dtype) if flags == 16 else None
        if self.items is not None:
            return
        self.special: list[bytes] = []
        if flags & 1:
            self.codes = before if flags & 2 else inflate(data.blob())
            count = self.codes.count(2)
            if flags & 4:
                self.special = [data.take(dtype.itemsize)] * count if count else []
            else:
                joined = inflate(data.blob())
                self.special = [joined[i * dtype.itemsize :][: dtype.itemsize] for i in range(count)]
        self.kept = self.codes.count(0)
        if not self.kept:
            return
        self.first = data.folded()
        if flags & 8:
            shift, order, count = data.take(3)
            channels = [data.varint() for _ in range(count)]
            bias, own = data.folded(), [data.folded() for _ in range(order)]
            self.predictor = shift, bias, own, [(c, [data.folded() for _ in range(3)]) for c in channels]
        self.residuals = lane(data, self.kept)
        self.extra = lane(data, self.kept) if form[0] == 4 else [0] * self.kept
        self.lower = data.blob() if form[0] == 3 else b""

    def restore(self, records: dict[int, Record]) -> list[int]:
        """The integers of the kept samples."""
        if not self.kept:
            return []
        if self.predictor is None:
            return [self.first + residual for residual in self.residuals]
        shift, bias, own, references = self.predictor
        others = [(records[c].held(records), taps) for c, taps in references]
        times = [t for t, code in enumerate(self.codes) if code == 0]
        result: list[int] = []
        for place, (t, residual) in enumerate(zip(times, self.residuals, strict=True)):
            total = bias + ((1 << shift) >> 1)
            for i, tap in enumerate(own):
                total += tap * (result[place - 1 - i] if place > i else self.first)
            for y, taps in others:
                total += sum(tap * y[max(0, t - j)] for j, tap in enumerate(taps))
            total = (total + (1 << 63)) % (1 << 64) - (1 << 63)
            result.append(residual + min(1 << 29, max(-(1 << 29), total >> shift)))
        return result

    def held(self, records: dict[int, Record]) -> list[int]:
        """The integers of all samples."""
        kept = iter(self.restore(records))
        result: list[int] = []
        for code in self.codes:
            result.append(next(kept) if code == 0 else 0 if code == 2 else result[-1])
        return result

    def values(self, records: dict[int, Record]) -> list[bytes]:
        """The items of all samples."""
        if self.items is not None:
            return self.items
        integers = self.restore(records)
        if self.form[0] == 3 and integers:
            bits = Bits(self.lower)
            self.extra = [bits.get(last_bit(self.form, k, self.dtype)[1]) if k else 0 for k in integers]
            assert (bits.at + 7) // 8 == len(self.lower)
        result: list[bytes] = []
        numbers, specials = iter(range(self.kept)), iter(self.special)
        for code in self.codes:
            if code == 0:
                i = next(numbers)
                item = value(self.form, integers[i], self.extra[i], self.dtype)
                result.append(np.array(item).astype(self.dtype).tobytes())
            else:
                result.append(result[-1] if code == 1 else next(specials))
        return result


def lzma_items(data: bytes, dtype: np.dtype[Any]) -> list[bytes]:
    items = lzma.decompress(data, lzma.FORMAT_RAW, filters=[{"id": lzma.FILTER_LZMA2, "dict_size": 1 << 22}])
    return [items[i : i + dtype.itemsize] for i in range(0, len(items), dtype.itemsize)]


def chunk(payload: bytes, forms: list[tuple[Any, ...]], dtype: np.dtype[Any], samples: int) -> np.ndarray:
    """(samples, channels)"""
    data, before = Bytes(payload), bytes(samples)
    records: dict[int, Record] = {}
    for channel, channel_form in enumerate(forms):
        if channel_form[0] not in (0, 6):
            records[channel] = record = Record(data, channel_form, dtype, samples, before)
            before = record.codes if record.items is None and any(record.codes) else before
    assert not data.rest()
    columns: list[list[bytes]] = []
    for i, channel_form in enumerate(forms):
        if channel_form[0] == 0:
            columns.append([channel_form[1]] * samples)
        else:
            columns.append(columns[channel_form[1]] if channel_form[0] == 6 else records[i].values(records))
    return np.stack([np.frombuffer(b"".join(column), dtype) for column in columns], axis=1)


def signal(
    data: Bytes, chunks: Bytes, dtype: np.dtype[Any], shape: tuple[int, ...], checksum_bytes: int = 4
) -> np.ndarray:
    """All samples; data: at the head; chunks: at the first of the signal's chunks, each with its checksum."""
    length, forms, sizes = head(data, dtype, shape)
    parts = []
    for number, size in enumerate(sizes):
        payload = chunks.take(size)
        assert zlib.crc32(payload).to_bytes(4, "little") == chunks.take(checksum_bytes)
        parts.append(chunk(payload, forms, dtype, min(length, shape[0] - number * length)))
    return np.concatenate(parts).astype(dtype).reshape(shape)
