"""One chunk of a signal to bytes: a lane for each channel that is not constant, and back.

    values ─► integers, special samples (forms) ─► removed samples ─► residuals (prediction) ─► lane (residuals)

Removed samples take part in nothing: those that repeat the one before bit for bit, where many do (a slower converter),
and special ones.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..entropy import bits
from ..entropy.compressors import deflate, inflate, lzma2, unlzma2
from ..entropy.varint import signed as zigzag
from ..errors import Corrupt
from ..fields.cursor import Cursor, blob, varint
from ..typing import Booleans, Bytes, Integers
from . import fitting, forms, prediction, residuals, steps
from .forms import CONSTANT, COPY, CORRECTED, COUNTS, GRID, INTEGERS, Form
from .prediction import Predictor
from .residuals import Lane

Array = NDArray[Any]

KEPT, REPEATS, SPECIAL = 0, 1, 2
HAS_REMOVED, SAME_REMOVED, EQUAL_SPECIALS, HAS_PREDICTOR, ITEMS = 1, 2, 4, 8, 16
ITEMS_GAIN = 1.3
"""LZMA2 is not expected to save more than this against zlib's fastest level."""
ITEMS_SAMPLE = 4096
MOST_DISTINCT = 0.9
"""Floats of which more than this share of a sample are distinct are not tried as items."""
EXACT_COUNTS = (INTEGERS, COUNTS)
WITHOUT_RECORD = (CONSTANT, COPY)
FILL_JUMP = 64.0
"""Zeros fill gaps where the samples beside them are more than this many usual steps away."""
REPEATS_SHARE = 0.3
REPEAT_BITS = 2.0
"""Repeats are removed where their places take less than this for each of them."""


@dataclass(frozen=True, eq=False)
class _Source:
    """A channel in a chunk before it is coded. codes (n,): why samples are removed; integers and extra of the kept."""

    form: Form
    codes: Bytes
    specials: Array
    integers: Integers
    extra: Integers

    @property
    def held(self) -> Integers:
        return _held(self.integers, self.codes)


@dataclass(frozen=True, eq=False)
class Part:
    """A channel in a chunk, coded but not packed. lanes: of the samples, and of the corrections."""

    values: Array
    source: _Source
    predictor: Predictor | None
    lanes: tuple[Lane, ...]

    @property
    def references(self) -> set[int]:
        """The channels that this one refers to."""
        return {channel for channel, _ in self.predictor.references} if self.predictor else set()


def encode(values: Array, channel_forms: Sequence[Form], alone: bool = False) -> list[Part | None]:
    """Each channel of a chunk (samples, channels), None for constants and copies.

    alone: no channel refers to another.
    """
    columns = np.ascontiguousarray(values.T)
    sources = [
        None if form.kind in WITHOUT_RECORD else _source(column, form)
        for column, form in zip(columns, channel_forms, strict=True)
    ]
    ranks = _ranks(channel_forms)
    channels = [
        None
        if source is None or not len(source.integers)
        else fitting.Channel(source.held, source.codes == KEPT, ranks[i], source.form.kind in EXACT_COUNTS)
        for i, source in enumerate(sources)
    ]
    choices = fitting.choose(channels, alone)
    streams: list[Integers] = []
    counts: list[int] = []
    for source, choice in zip(sources, choices, strict=True):
        own = [] if choice is None else [choice.residuals]
        own += [source.extra] if own and source is not None and source.form.kind == CORRECTED else []
        streams += own
        counts.append(len(own))
    lanes = iter(residuals.encode(streams))
    return [
        None if source is None else Part(column, source, choice and choice.predictor, tuple(islice(lanes, count)))
        for column, source, choice, count in zip(columns, sources, choices, counts, strict=True)
    ]


def pack(parts: Sequence[Part | None]) -> list[bytes]:
    """The record of each channel, empty for those without one; joined, they are the chunk."""
    referred = {channel for part in parts if part is not None for channel in part.references}
    out, before = [], b""
    for i, part in enumerate(parts):
        record = b"" if part is None else _pack(part.source, part.predictor, part.lanes, before)
        items = None if part is None or i in referred else _items(part.values, part.source.form, len(record))
        if items is not None and len(items) < len(record):
            record = items
        elif part is not None and part.source.codes.any():
            before = part.source.codes.tobytes()
        out.append(record)
    return out


def _items(values: Array, form: Form, record_bytes: int) -> bytes | None:
    """The record of a channel as plain items, for floats of which many occur more than once; None if a fast compressor
    shows that it is longer than the record that there is."""
    if form.kind in EXACT_COUNTS:
        return None
    some = forms.words(values[:: max(1, len(values) // ITEMS_SAMPLE)])
    if len(steps.distinct_of(some)) > MOST_DISTINCT * len(some):
        return None
    data = values.tobytes()
    if len(zlib.compress(data, 1)) > ITEMS_GAIN * record_bytes:
        return None
    return bytes([ITEMS]) + blob(lzma2(data, 6, lc=0, lp=2, pb=2))


def _ranks(channel_forms: Sequence[Form]) -> list[int]:
    """Channels of counts before those of a grid: forces are sums of what the plate's sensors count."""
    order = sorted(range(len(channel_forms)), key=lambda i: (channel_forms[i].kind not in EXACT_COUNTS, i))
    ranks = [0] * len(order)
    for rank, i in enumerate(order):
        ranks[i] = rank
    return ranks


def _source(values: Array, form: Form) -> _Source:
    integers, special, extra = forms.forward(form, values)
    plain = forms.words(values)
    special = special | _fills(integers, plain == 0)
    codes = special.astype(np.uint8) * np.uint8(SPECIAL)
    repeats = np.concatenate([[False], plain[1:] == plain[:-1]]) & ~special
    repeats[1:] &= ~special[:-1]
    if np.count_nonzero(repeats) > REPEATS_SHARE * len(repeats):
        trial = np.where(repeats, REPEATS, codes).astype(np.uint8)
        if 8 * len(deflate(trial.tobytes())) < REPEAT_BITS * repeats.sum():
            codes = trial
    kept = codes == KEPT
    return _Source(form, codes, values[codes == SPECIAL], integers[kept], extra[kept])


def _fills(integers: Integers, zero: Booleans) -> Booleans:
    """Which samples (n,) are zeros that fill gaps: both ends of their run are far from the samples beside it."""
    if not zero.any() or zero.all():
        return np.zeros(len(zero), bool)
    steps = np.abs(np.diff(integers))
    inside = steps[~zero[1:] & ~zero[:-1]]
    least = FILL_JUMP * (1 + (np.partition(inside, len(inside) // 2)[len(inside) // 2] if len(inside) else np.inf))
    start = np.flatnonzero(zero & ~np.concatenate([[False], zero[:-1]]))
    end = np.flatnonzero(zero & ~np.concatenate([zero[1:], [False]]))
    beside = np.concatenate([[np.inf], steps, [np.inf]])
    is_fill = np.minimum(beside[start], beside[end + 1]) > least
    run = np.cumsum(np.bincount(start, minlength=len(zero)))  # from one on, the last run that has started
    return zero & np.concatenate([[False], is_fill])[run]


def _held(integers: Integers, codes: Bytes) -> Integers:
    """Samples (n,) for other channels to refer to: 0 for special ones, that of the sample before for repeats."""
    if not codes.any():
        return integers
    present = codes != REPEATS
    distinct = np.zeros(max(1, int(present.sum())), np.int64)
    distinct[: present.sum()][codes[present] == KEPT] = integers
    return distinct[np.maximum(np.cumsum(present) - 1, 0)]


def _pack(source: _Source, predictor: Predictor | None, lanes: Sequence[Lane], before: bytes) -> bytes:
    """The record of a channel; before: the codes of the last channel with removed samples."""
    codes, specials = source.codes.tobytes(), source.specials.tobytes()
    item = source.specials[:1].tobytes()
    equal = specials == item * len(source.specials)
    flags, body = HAS_PREDICTOR * (predictor is not None), b""
    if source.codes.any():
        flags |= HAS_REMOVED | SAME_REMOVED * (codes == before) | EQUAL_SPECIALS * equal
        body += b"" if codes == before else blob(deflate(codes))
        body += item if equal else blob(deflate(specials))
    if len(source.integers):
        body += varint(zigzag(int(source.integers[0])))
        body += prediction.pack(predictor) if predictor else b""
        body += b"".join(map(_pack_lane, lanes))
        if source.form.kind == GRID:
            body += blob(forms.lower_bits(source.form, source.integers, source.extra, source.specials.dtype))
    return bytes([flags]) + body


def _pack_lane(lane: Lane) -> bytes:
    """start, state, words, raw bits."""
    head = bytes([lane.start]) + lane.state.to_bytes(4, "little") + varint(len(lane.words))
    return head + lane.words.astype("<u2").tobytes() + blob(lane.raw.tobytes())


def _unpack_lane(cursor: Cursor) -> Lane:
    start, state = cursor.byte(), int.from_bytes(cursor.take(4), "little")
    if start >= residuals.START_CODES or state < residuals.LOWEST:
        raise cursor.corrupt("a lane of samples is out of range")
    words = np.frombuffer(cursor.take(2 * cursor.count(2)), "<u2").astype(np.uint16)
    return Lane(start, state, words, np.frombuffer(cursor.blob(), np.uint8))


@dataclass(frozen=True, eq=False)
class _Record:
    """The record of a channel, read but not decoded. lanes: of the samples, and of the corrections."""

    codes: Bytes
    specials: Array
    first: int
    predictor: Predictor | None
    lanes: tuple[Lane, ...]
    lower: bytes
    items: bytes | None = None


class Decoder:
    """Decodes chunks of a signal with these forms: in the compiled module all channels of a chunk in one call."""

    def __init__(self, channel_forms: Sequence[Form], dtype: np.dtype[Any]) -> None:
        self.forms = channel_forms
        self.dtype = dtype
        kernel = native.kernel("SignalDecoder") if dtype.isnative and dtype != np.float16 else None
        self._compiled = (
            None
            if kernel is None
            else kernel(*forms.as_arrays(channel_forms, dtype), dtype.kind, inflate, unlzma2, *residuals.tables())
        )

    def decode(self, payload: bytes, samples: int, first: int, wanted: Sequence[int], out: Array) -> None:
        """Put the samples of the wanted channels from `first` on into `out` (rows, wanted). samples: of the chunk.

        Raises Corrupt.
        """
        if self._compiled is not None and out.size:
            rows = out.view(np.uint8).reshape(len(out), -1)
            if self._compiled.decode(payload, samples, first, np.array(wanted, np.int64), rows):
                return
        columns = decode(payload, self.forms, self.dtype, samples, wanted)
        for place, i in enumerate(wanted):
            out[:, place] = columns[i][first : first + len(out)]


def decode(
    payload: bytes, channel_forms: Sequence[Form], dtype: np.dtype[Any], samples: int, wanted: Iterable[int]
) -> dict[int, Array]:
    """The values of the wanted channels, by channel. samples: of the chunk. Raises Corrupt."""
    cursor = Cursor(payload, "a chunk of signals", ends_early=Corrupt)
    records: dict[int, _Record] = {}
    before = np.zeros(samples, np.uint8)
    for i, form in enumerate(channel_forms):
        if form.kind not in WITHOUT_RECORD:
            records[i] = record = _read(cursor, form, dtype, before, len(channel_forms))
            before = record.codes if record.items is None and record.codes.any() else before
    cursor.done()
    origin = {i: channel_forms[i].channel if channel_forms[i].kind == COPY else i for i in wanted}
    levels = _levels(records, [i for i in {*origin.values()} if i in records and records[i].items is None])
    integers = _integers(records, levels)
    result: dict[int, Array] = {}
    for i in {*origin.values()}:
        form = channel_forms[i]
        if form.kind == CONSTANT:
            result[i] = np.frombuffer(form.item * samples, dtype)
        elif (items := records[i].items) is not None:
            result[i] = np.frombuffer(unlzma2(items, samples * dtype.itemsize, "a chunk of signals"), dtype)
        else:
            result[i] = _values(records[i], form, integers[i], dtype)
    return {i: result[origin[i]] for i in origin}


def _read(cursor: Cursor, form: Form, dtype: np.dtype[Any], before: Bytes, channels: int) -> _Record:
    flags = cursor.byte()
    if flags == ITEMS:
        return _Record(before, np.zeros(0, dtype), 0, None, (), b"", cursor.blob())
    if flags > 15 or (not flags & HAS_REMOVED and flags & (SAME_REMOVED | EQUAL_SPECIALS)):
        raise cursor.corrupt("reserved flags of a channel")
    codes, specials = np.zeros(len(before), np.uint8), np.zeros(0, dtype)
    if flags & HAS_REMOVED:
        codes = before
        if not flags & SAME_REMOVED:
            codes = np.frombuffer(inflate(cursor.blob(), len(before), cursor.what), np.uint8)
        count = int((codes == SPECIAL).sum())
        if codes.max(initial=0) > SPECIAL:
            raise cursor.corrupt("a sample is removed for an unknown reason")
        if flags & EQUAL_SPECIALS:
            specials = np.frombuffer(cursor.take(dtype.itemsize if count else 0) * count, dtype)
        else:
            specials = np.frombuffer(inflate(cursor.blob(), count * dtype.itemsize, cursor.what), dtype)
    if not (codes == KEPT).any():
        if flags & HAS_PREDICTOR or (codes[:1] == REPEATS).any():
            raise cursor.corrupt("a channel without samples has a predictor")
        return _Record(codes, specials, 0, None, (), b"")
    first = cursor.signed()
    if abs(first) >= forms.MAX_INTEGER:
        raise cursor.corrupt("a first sample is out of range")
    predictor = prediction.unpack(cursor, channels) if flags & HAS_PREDICTOR else None
    lanes = tuple(_unpack_lane(cursor) for _ in range(2 if form.kind == CORRECTED else 1))
    return _Record(codes, specials, first, predictor, lanes, cursor.blob() if form.kind == GRID else b"")


def _levels(records: dict[int, _Record], wanted: list[int]) -> list[list[int]]:
    """The wanted channels and those that they refer to: lists of channels that depend on earlier lists only."""
    needed, stack = set(wanted), list(wanted)
    while stack:
        predictor = records[stack.pop()].predictor
        for channel, _ in predictor.references if predictor else ():
            if channel not in records or records[channel].items is not None:
                raise Corrupt("a chunk of signals: a predictor refers to a channel without integers")
            if channel not in needed:
                needed.add(channel)
                stack.append(channel)
    levels: list[list[int]] = []
    done: set[int] = set()
    while len(done) < len(needed):
        level = [i for i in sorted(needed - done) if _referred(records[i]) <= done]
        if not level:
            raise Corrupt("a chunk of signals: predictors refer to each other in a circle")
        levels.append(level)
        done.update(level)
    return levels


def _referred(record: _Record) -> set[int]:
    return {channel for channel, _ in record.predictor.references} if record.predictor else set()


def _integers(records: dict[int, _Record], levels: list[list[int]]) -> dict[int, tuple[Integers, Integers]]:
    """Integers and corrections of the kept samples of all channels in the levels."""
    order = [i for level in levels for i in level]
    lanes = [lane for i in order for lane in records[i].lanes]
    kept = {i: records[i].codes == KEPT for i in order}
    decoded = iter(residuals.decode(lanes, [int(kept[i].sum()) for i in order for _ in records[i].lanes]))
    streams = {i: [next(decoded) for _ in records[i].lanes] for i in order}
    held: dict[int, Integers] = {}
    result: dict[int, tuple[Integers, Integers]] = {}
    for level in levels:
        active = [i for i in level if streams[i]]
        plain = [i for i in active if records[i].predictor is None]
        restored = {i: streams[i][0] + records[i].first for i in plain}
        predicted = [i for i in active if i not in restored]
        predictors = [p for i in predicted if (p := records[i].predictor) is not None]
        sums = [prediction.known_sums(p, held, kept[i]) for i, p in zip(predicted, predictors, strict=True)]
        inputs = [(streams[i][0], known, records[i].first) for i, known in zip(predicted, sums, strict=True)]
        restored |= dict(zip(predicted, prediction.inverse(inputs, predictors), strict=True))
        for i in level:
            integers = restored.get(i, np.zeros(0, np.int64))
            held[i] = _held(integers, records[i].codes)
            result[i] = integers, streams[i][-1] if streams[i] else integers
    return result


def _values(record: _Record, form: Form, integers: tuple[Integers, Integers], dtype: np.dtype[Any]) -> Array:
    """All samples of a channel, with those that were removed."""
    whole, extra = integers
    if form.kind == GRID and len(whole):
        widths = forms.extra_widths(form, whole, dtype)
        expected = (int(widths.sum()) + 7) // 8
        if expected != len(record.lower):
            raise Corrupt(f"a chunk of signals: a channel has {len(record.lower)} bytes of lower bits, not {expected}")
        extra = bits.unpack(np.unpackbits(np.frombuffer(record.lower, np.uint8)), widths)
    values = forms.inverse(form, whole, extra, dtype)
    if not record.codes.any():
        return values
    present = record.codes != REPEATS
    distinct = np.empty(int(present.sum()), dtype)
    codes = record.codes[present]
    distinct[codes == KEPT], distinct[codes == SPECIAL] = values, record.specials
    return distinct[np.maximum(np.cumsum(present) - 1, 0)]
