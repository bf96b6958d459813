"""Building blocks and coded integers, written from docs/payloads/index.md and integers.md; no code of mocodec is used.

It is written to be read beside the pages, not to be fast, and checks only what it needs.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from functools import cache
from typing import NamedTuple

# --- docs/payloads/index.md: building blocks


class Bytes:
    """Reads a byte string from front to back."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, count: int) -> bytes:
        assert count <= len(self.data) - self.at, "the data ends too early"
        self.at += count
        return self.data[self.at - count : self.at]

    def rest(self) -> bytes:
        return self.take(len(self.data) - self.at)

    def varint(self) -> int:
        value = shift = 0
        while (byte := self.take(1)[0]) >= 128:
            value |= (byte & 127) << shift
            shift += 7
        return value | byte << shift

    def folded(self) -> int:
        number = self.varint()
        return -((number + 1) // 2) if number % 2 else number // 2

    def blob(self) -> bytes:
        return self.take(self.varint())

    def float64(self) -> float:
        return struct.unpack("<d", self.take(8))[0]


def bits_of(data: bytes) -> list[int]:
    """Bits, the highest of each byte first."""
    return [byte >> 7 - place & 1 for byte in data for place in range(8)]


def number_of(bits: list[int]) -> int:
    return int("".join(map(str, bits)) or "0", 2)


# --- docs/payloads/integers.md: coded integers

MIXTURES = [
    (5, 2, 5, 2, 2, 0, 0), (0, 0, 0, 0, 0, 16, 0), (3, 1, 7, 3, 2, 0, 0), (0, 0, 8, 5, 3, 0, 0),
    (4, 2, 3, 2, 1, 4, 0), (7, 3, 3, 1, 2, 0, 0), (0, 0, 0, 0, 0, 0, 0), (3, 1, 3, 1, 0, 0, 8),
    (2, 0, 2, 0, 0, 4, 8), (1, 0, 1, 0, 0, 2, 12),
]  # fmt: skip
FIELDS = [
    [12, 5, 8, 4, 6, 5, 5, 4, 4, 4], [2, 1], [2] * 4 + [4] * 8 + [6] * 10 + [3] * 6 + [1] * 4,
    [1, 2, 3, 5, 8, 5, 3, 2], [6, 2, 1], [20, 1], [1] * 31 + [120], [1] * 31 + [120],
]  # fmt: skip
TOKENS = 252


def mantissa_bits(token: int) -> int:
    return 0 if token < 16 else (token - 16) // 4 + 2


def token_floor(token: int) -> int:
    return token if token < 16 else (4 + token % 4) << mantissa_bits(token)


def token_of(magnitude: int) -> int:
    return max(t for t in range(TOKENS) if token_floor(t) <= magnitude)


def frequencies(weights: list[int], precision: int) -> list[tuple[int, int]]:
    """(start, frequency) of each symbol."""
    used = [i for i, w in enumerate(weights) if w]
    room, total, below, start, table = 2**precision - len(used), sum(weights), 0, 0, []
    for w in weights:
        frequency = 1 + room * (below + w) // total - room * below // total if w else 0
        table.append((start, frequency))
        below, start = below + w, start + frequency
    return table


def sigma(law: int) -> int:
    return [40, 50, 63][law % 3] << law // 3


@cache
def law_weights(law: int, shape: int, precision: int) -> list[int]:
    s, (linear, square) = sigma(law), [(25, 0), (16, 5)][shape]
    survival, weights = 2**62, []
    for token in range(1, TOKENS):
        a = 4096 * token_floor(token) - 2048
        beyond = 2**62 * (300 * s * s) ** 12 // (300 * s * s + a * (linear * s + square * a)) ** 12
        weights.append(max(1, survival - beyond))
        survival = beyond
        if token > 1 and survival * 2 ** (precision - 1) < 2**62:
            break
    return [*weights, max(1, survival)]


@cache
def law_tables(laws: int, shape: int, precision: int) -> list[list[tuple[int, int]]]:
    """The tables of all laws, and last that of excess."""
    weights = [law_weights(law, shape, precision) for law in range(laws)]
    reach = max(map(len, weights)) if precision == 14 else 64 if laws == 54 else TOKENS
    weights.append([2**20 // (e + 1) ** 2 for e in range(reach)])
    return [frequencies(w, precision) for w in weights]


@cache
def usual_laws() -> list[int]:
    """The law of each expected token in sixteenths."""
    result, law = [0], 0
    for expected in range(1, 4096):
        token = min(expected // 16, TOKENS - 2)
        low, high = token_floor(token), token_floor(token + 1)
        magnitude16 = 16 * low + (high - low) * (expected - 16 * token if expected < 16 * TOKENS else 0)
        scale = 4096 * (15 * magnitude16 + 32) // 256
        while law < 210 and sigma(law) * 9 // 8 < scale:
            law += 1
        result.append(law)
    return result


class Fields(NamedTuple):
    mixture: int
    shape: int
    silent: int
    offset: int
    order: int
    large: int
    rows: int
    columns: int

    @property
    def laws(self) -> int:
        return 210 if self.large else 54

    def law(self, expected: int) -> int:
        return min(max(usual_laws()[expected] + self.offset - 4, 0), self.laws - 1) if expected else self.silent


def find(table: list[tuple[int, int]], slot: int) -> tuple[int, int, int]:
    """(symbol, start, frequency) of a slot."""
    symbol = bisect_right(table, slot, key=lambda entry: entry[0]) - 1
    return (symbol, *table[symbol])


def kept(extent: int, symbol: int) -> int:
    return max(1, -(-extent * (symbol + 1) // 32))


def integers(data: bytes, steps: int, lanes: int, contexts: list[int] | None = None) -> list[list[int]]:
    """The array (steps, lanes) of a stream of coded integers. contexts: of each step, for all lanes alike."""
    hints = [0] * steps if contexts is None else [token_of(c) for c in contexts]
    result = [[0] * lanes for _ in range(steps)]
    if not data or not steps * lanes:
        assert not data
        return result
    if data[:2] == b"\0\0":
        count, size = int.from_bytes(data[2:5], "little"), int.from_bytes(data[5:8], "little")
        place = -1
        values = integers(data[8 + size :], count, 1)
        for (gap,), (value,) in zip(integers(data[8 : 8 + size], count, 1), values, strict=True):
            place += gap
            result[place // lanes][place % lanes] = value
        return result
    if len(data) > 5 and int.from_bytes(data[:2], "little") % 2**14 < 64:
        fields, part = many_states(data, steps, lanes, hints)
    else:
        fields, part = one_state(data, steps, lanes, hints)
    for t, row in enumerate(part):
        result[t][: len(row)] = row
    for _ in range(fields.order):
        for t in range(1, steps):
            result[t] = [a + b for a, b in zip(result[t - 1], result[t], strict=True)]
    return result


def one_state(data: bytes, steps: int, lanes: int, hints: list[int]) -> tuple[Fields, list[list[int]]]:
    size = len(data) if len(data) <= 4 else 4 - len(data) % 2
    x = int.from_bytes(data[:size], "little")
    words = [int.from_bytes(data[i : i + 2], "little") for i in range(size, len(data), 2)][::-1]

    def refill(x: int) -> int:
        return x << 16 | words.pop() if x < 2**16 and words else x

    def symbol(table: list[tuple[int, int]]) -> int:
        nonlocal x
        found, start, frequency = find(table, x % 2**14)
        x = refill(frequency * (x >> 14) + x % 2**14 - start)
        return found

    assert symbol([(0, 64), (64, 2**14 - 64)]) == 1
    fields = Fields(*(symbol(frequencies(w, 14)) for w in FIELDS))
    tables = law_tables(fields.laws, fields.shape, 14)
    steps, lanes = kept(steps, fields.rows), kept(lanes, fields.columns)
    tokens: dict[tuple[int, int], int] = {}
    means = [0] * lanes

    def around(t: int, lane: int, dt: int, dl: int) -> int:
        """The token at (t − dt, lane − dl), or what stands for it outside the array."""
        if lane < dl:
            t, lane, dt, dl = (t, 0, 0, 0) if lane else (t, 0, 1, 0)
        t, lane = t - dt, lane - dl
        return (tokens[0, lane - 1] if lane else 0) if t < 0 else tokens[t, lane]

    for t in range(steps):
        for lane in range(lanes):
            if t == 0:
                means[lane] = around(0, lane, 1, 0) << 8
            near = [around(t, lane, *d) for d in ((1, 0), (2, 0), (0, 1), (0, 2), (1, 1))]
            *weights, mean_weight, hint_weight = MIXTURES[fields.mixture]
            expected = sum(w * n for w, n in zip(weights, near, strict=True)) + (mean_weight * means[lane] >> 8)
            expected += hint_weight * hints[t]
            law = fields.law(expected)
            token = symbol(tables[law])
            if token == len(tables[law]) - 1:
                token += symbol(tables[-1])
            tokens[t, lane] = token
            means[lane] += (token << 8) - means[lane] >> (1 if t == 0 else 2 if t < 3 else 3)

    there = [(t, lane) for t in range(steps) for lane in range(lanes) if tokens[t, lane]]
    total = sum(1 + mantissa_bits(tokens[place]) for place in there)
    raw: list[int] = []
    for count in [8] * (total // 8) + [total % 8]:
        raw = [x >> i & 1 for i in reversed(range(count))] + raw
        x = refill(x >> count)
    assert (x, words) == (1, []), "the stream does not end where it should"
    result = [[0] * lanes for _ in range(steps)]
    for t, lane in there:
        bits = mantissa_bits(tokens[t, lane])
        magnitude = token_floor(tokens[t, lane]) + number_of(raw[1 : 1 + bits])
        result[t][lane] = -magnitude if raw[0] else magnitude
        raw = raw[1 + bits :]
    return fields, result


def many_states(data: bytes, steps: int, lanes: int, hints: list[int]) -> tuple[Fields, list[list[int]]]:
    rest = int.from_bytes(data[2:5], "little")
    fields = Fields(
        rest >> 15 & 15, rest >> 22 & 1, rest >> 10 & 31, rest >> 19 & 7,
        data[0] - 1, rest >> 23, rest & 31, rest >> 5 & 31,
    )  # fmt: skip
    tables = law_tables(fields.laws, fields.shape, 12)
    shape = kept(steps, fields.rows), kept(lanes, fields.columns)
    long, short = max(shape), min(shape)
    groups = -(-short // 64)
    lanes = -(-short // groups)
    pieces = max(1, min(4096 // short, long // 128))
    steps = -(-long // pieces)
    pieces = -(-long // steps)
    wide_groups = short - groups * (lanes - 1)
    states = -(-min(steps, lanes) * groups * pieces // data[5])

    nibbles = [n for byte in data[6 : 6 + (states + 1) // 2] for n in (byte >> 4, byte & 15)][:states]
    at = 6 + (states + 1) // 2
    size = -(-(16 * states + sum(nibbles)) // 8)
    heads, at = bits_of(data[at : at + size]), at + size
    x, used = [], 0
    for k in nibbles:
        x.append(1 << 16 + k | number_of(heads[used : used + 16 + k]))
        used += 16 + k

    def symbols(wanted: list[list[tuple[int, int]]]) -> list[int]:
        """One symbol under each of these tables, in runs of as many as there are states."""
        nonlocal at
        result = []
        for i, table in enumerate(wanted):
            s = i % states
            found, start, frequency = find(table, x[s] % 2**12)
            x[s] = frequency * (x[s] >> 12) + x[s] % 2**12 - start
            if x[s] < 2**16:
                x[s] = x[s] << 16 | int.from_bytes(data[at : at + 2], "little")
                at += 2
            result.append(found)
        return result

    segments = [(g, p) for g in range(groups) for p in range(pieces)]
    token = {segment: {} for segment in segments}
    means = {segment: [0] * lanes for segment in segments}

    def around(segment: tuple[int, int], t: int, lane: int) -> int:
        known = token[segment]
        if lane < 0:  # the first lane's token on the same diagonal
            t, lane = t + lane, 0
        if t < 0:
            return known.get((0, lane - 1), 0) if lane and t >= -2 else 0
        return known[t, lane]

    def hint(segment: tuple[int, int], t: int, lane: int) -> int:
        """The context of a place, 0 in the padding of the last piece."""
        group, piece = segment
        a, b = piece * steps + t, group * lanes - max(0, group - wide_groups) + lane
        return 0 if a >= long else hints[b if shape[1] > shape[0] else a]

    *weights, mean_weight, hint_weight = MIXTURES[fields.mixture]
    for diagonal in range(steps + lanes - 1):
        places = [
            (segment, diagonal - lane, lane)
            for lane in range(max(0, diagonal - steps + 1), min(lanes, diagonal + 1))
            for segment in segments
            if lane < lanes - 1 or segment[0] < wide_groups
        ]
        laws = []
        for segment, t, lane in places:
            if t == 0:
                means[segment][lane] = around(segment, -1, lane) << 8
            near = [around(segment, t - dt, lane - dl) for dt, dl in ((1, 0), (2, 0), (0, 1), (0, 2), (1, 1))]
            mean = (means[segment][lane] >> 4) * mean_weight >> 4
            expected = sum(w * n for w, n in zip(weights, near, strict=True)) + mean
            laws.append(fields.law(expected + hint_weight * hint(segment, t, lane)))
        found = symbols([tables[law] for law in laws])
        escaped = [i for i, law in enumerate(laws) if found[i] == len(tables[law]) - 1]
        for i, beyond in zip(escaped, symbols([tables[-1]] * len(escaped)), strict=True):
            found[i] += beyond
        for (segment, t, lane), new in zip(places, found, strict=True):
            token[segment][t, lane] = new
            speed = 1 if t == 0 else 2 if t < 3 else 3
            means[segment][lane] += (new << 8 - speed) - (means[segment][lane] >> speed)

    assert all(s >> 16 == 1 for s in x), "the stream does not end where it should"
    raw = [s >> i & 1 for s in x for i in reversed(range(16))] + bits_of(data[at:])
    plain = [[0] * shape[1] for _ in range(shape[0])]
    for g, p in segments:
        first = g * lanes - max(0, g - wide_groups)
        for (t, lane), value in token[g, p].items():
            a, b = p * steps + t, first + lane
            if a < long:
                row, column = (b, a) if shape[1] > shape[0] else (a, b)
                plain[row][column] = value
    there = [(t, lane) for t in range(shape[0]) for lane in range(shape[1]) if plain[t][lane]]
    signs, raw = raw[: len(there)], raw[len(there) :]
    widths = [mantissa_bits(plain[t][lane]) for t, lane in there]
    low = {}
    for i, width in enumerate(widths):
        if width >= 32:
            low[i], raw = number_of(raw[:32]), raw[32:]
    at = 0
    for i, ((t, lane), width) in enumerate(zip(there, widths, strict=True)):
        high = width - 32 * (i in low)
        mantissa = number_of(raw[at : at + high])
        at += high
        if i in low:
            mantissa = mantissa << 32 | low[i]
        magnitude = token_floor(plain[t][lane]) + mantissa
        plain[t][lane] = -magnitude if signs[i] else magnitude
    return fields, plain
