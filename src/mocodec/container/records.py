"""Every record of a `.mocz`, described once: written, read and printed from the same list of fields.

    file     HEAD magic · version · length · HEADER · checksum     extras?     signals?     chunk …     index     tail
    chunk    CHUNK frames, length · payload · checksum
    index    0 · INDEX (nothing for one chunk) · checksum · length · magic

docs/format.md says the same in words, with the reasons.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ..encoded import CLOUD_SAMPLES, MAX_CHUNK_SAMPLES, most_chunk_frames
from ..errors import UnknownCodec
from ..fields import Field, Record, Values, unsigned
from ..motion import UP_AXES, Skeleton
from ..typing import Integers
from . import names, skeletons, values
from .tables import CODEC_IDS, RATES
from .wire import Cursor, text, varint

MAGIC = b"mocz"
END_MAGIC = b"cz"
VERSION = 1
CHECKSUM_BYTES = 4
MAX_HEADER_BYTES = 1 << 28
MAX_CHUNK_FRAMES = MAX_CHUNK_SAMPLES
MAX_FRAMES = 1 << 40
MAX_PAYLOAD_BYTES = 1 << 30
MAX_MARGIN = 8
KINDS = ("motion", "clouds")


# flags: what the first byte of a header packs


def flags(kind: str, up: str, present: Mapping[int, bool]) -> int:
    """bit 0 kind, bits 1–2 the vertical axis, bits 3–7 which optional fields are there."""
    return KINDS.index(kind) | UP_AXES.index(up) << 1 | sum(there << bit for bit, there in present.items())


def _read_flags(cursor: Cursor, _: Mapping[str, Any]) -> int:
    value = cursor.byte()
    if value >> 1 & 3 == 3:
        raise cursor.corrupt("a vertical axis that is reserved")
    return value


def with_flags(header: Values) -> Values:
    """The header's values with those that its flags hold: kind of data and vertical axis."""
    bits = header["flags"]
    return {**header, "kind": KINDS[bits & 1], "up": UP_AXES[bits >> 1 & 3]}


def _of_kind(kind: str) -> Callable[[Mapping[str, Any]], bool]:
    return lambda known: KINDS[known["flags"] & 1] == kind


def _with_bit(bit: int) -> Callable[[Mapping[str, Any]], bool]:
    return lambda known: bool(known["flags"] >> bit & 1)


def _has_skeleton(known: Mapping[str, Any]) -> bool:
    return _of_kind("motion")(known) and _with_bit(SKELETON)(known)


# kinds of fields: write beside read


def _write_codec(name: str, _: Mapping[str, Any]) -> bytes:
    number = next((n for n, known in CODEC_IDS.items() if known == name), 0)
    return varint(number) if number else b"\0" + text(name)


def _read_codec(cursor: Cursor, _: Mapping[str, Any]) -> str:
    number = cursor.varint()
    if number and number not in CODEC_IDS:
        raise UnknownCodec(f"the file was made by codec number {number}, which this mocodec does not have: upgrade it")
    return CODEC_IDS[number] if number else cursor.text()


def _write_rate(rate: float, _: Mapping[str, Any]) -> bytes:
    for number, (top, bottom) in enumerate(RATES[1:], 1):
        if top / bottom == rate:
            return varint(number)
    from fractions import Fraction

    fraction = Fraction(rate).limit_denominator(10_000)
    if 0 < fraction.numerator < 1 << 31 and fraction.numerator / fraction.denominator == rate:
        return b"\0" + varint(fraction.denominator) + varint(fraction.numerator)
    return b"\0\0" + struct.pack("<d", rate)


def _read_rate(cursor: Cursor, _: Mapping[str, Any]) -> float:
    number = cursor.varint()
    if number >= len(RATES):
        raise cursor.corrupt("a frame rate that is reserved")
    top, bottom = RATES[number]
    if not number:
        bottom = cursor.varint()
        if bottom == 0:
            rate = cursor.float64()
            if not 0 < rate < float("inf"):
                raise cursor.corrupt("a frame rate that is not positive")
            return rate
        top = cursor.varint()
        if top == 0:
            raise cursor.corrupt("a frame rate that is not positive")
    return top / bottom


def _write_skeleton(value: tuple[Skeleton, bool], record: Mapping[str, Any]) -> bytes:
    """Bytes of a skeleton and of whether rotations are coded."""
    skeleton, has_rotations = value
    pack = skeletons.pack_with_rotations if has_rotations else skeletons.pack
    return pack(skeleton, record["names"], exact=record["codec"] == "lossless")


def pack_shared(blobs: tuple[bytes, ...]) -> bytes:
    """The last field of a header: the shared bytes."""
    return varint(len(blobs)) + b"".join(varint(len(data) << 1) + data for data in blobs)


def _read_shared(cursor: Cursor, _: Mapping[str, Any]) -> tuple[bytes, ...]:
    return tuple(_read_shared_blob(cursor) for _ in range(cursor.count()))


def _read_shared_blob(cursor: Cursor) -> bytes:
    head = cursor.varint()
    if head & 1:
        raise cursor.corrupt("shared bytes kept elsewhere, which this version does not read")
    return cursor.take(head >> 1)


def _write_sizes(sizes: tuple[int, int, int], _: Mapping[str, Any]) -> bytes:
    section, unpacked, signals = sizes
    return (b"\0" if signals else b"") + b"".join(map(varint, (section, unpacked, *([signals] if signals else []))))


def _read_sizes(cursor: Cursor, _: Mapping[str, Any]) -> tuple[int, int, int]:
    section = cursor.varint()
    if section:
        return section, cursor.varint(), 0
    section, unpacked, signals = cursor.varint(), cursor.varint(), cursor.varint()
    if not (section and signals):
        raise cursor.corrupt("the bytes of extras or signals are 0")
    return section, unpacked, signals


MARGIN, SKELETON, SETTINGS, SOURCE, EXTRAS = 3, 4, 5, 6, 7

HEADER = Record(
    "the header",
    Field("flags", lambda value, _: bytes([value]), _read_flags, "kind, vertical axis, which fields follow"),
    Field("codec", _write_codec, _read_codec, "number in the table of codecs, or 0 and a name"),
    Field("rate", _write_rate, _read_rate, "frames a second"),
    unsigned(
        "margin", most=MAX_MARGIN, meaning="neighbouring chunks that a chunk needs on each side", when=_with_bit(MARGIN)
    ),
    Field(
        "names",
        lambda value, _: names.pack(value),
        lambda c, _: names.unpack(c),
        "of the points",
        when=_of_kind("motion"),
    ),
    unsigned("channels", most=3, meaning="bit 0 colours, bit 1 normals", when=_of_kind("clouds")),
    Field(
        "skeleton",
        _write_skeleton,
        lambda c, record: skeletons.unpack_any(c, record["names"]),
        "tree and offsets; whether rotations are coded, and joint limits",
        when=_has_skeleton,
    ),
    Field(
        "settings",
        lambda value, _: values.pack(value, "settings"),
        lambda c, _: values.unpack(c),
        "of the codec, where they differ from its defaults",
        when=_with_bit(SETTINGS),
    ),
    Field(
        "source",
        lambda value, _: values.pack_source(value),
        lambda c, _: values.unpack_source(c),
        "how the file was that the motion came from",
        when=_with_bit(SOURCE),
    ),
    Field(
        "extras",
        _write_sizes,
        _read_sizes,
        "bytes of the extras section, bytes that it unpacks to, and bytes of the signals behind it",
        when=_with_bit(EXTRAS),
    ),
    Field("shared", lambda value, _: pack_shared(value), _read_shared, "bytes that all chunks need"),
)

CHUNK = Record(
    "a chunk",
    unsigned("frames", most=MAX_CHUNK_FRAMES, meaning="frames of the chunk, at least 1; 0 starts the index"),
    unsigned("length", most=MAX_PAYLOAD_BYTES, meaning="bytes of the payload"),
)


def _write_runs(frames: list[int], _: Mapping[str, Any]) -> bytes:
    """(how many chunks, frames of each), in turn, until all chunks have had theirs."""
    out = varint(len(frames))
    at = 0
    while at < len(frames):
        end = at
        while end < len(frames) and frames[end] == frames[at]:
            end += 1
        out += varint(end - at) + varint(frames[at])
        at = end
    return out


def _read_runs(cursor: Cursor, _: Mapping[str, Any]) -> Integers:
    count = cursor.count()  # each chunk's length, at least a byte, follows
    plain, ends = cursor.plain(2 * count)
    frames: list[int] = []
    chunks = plain[: len(plain) // 2 * 2 : 2].cumsum()
    needed = int(chunks.searchsorted(count)) + 1
    if count and needed <= len(chunks) and chunks[needed - 1] == count:  # the loop finds what is wrong with others
        used = plain[: 2 * needed]
        runs, sizes = used[::2], used[1::2]
        if used.min() > 0 and sizes.max() <= MAX_CHUNK_FRAMES:
            cursor.at = int(ends[2 * needed - 1])
            return sizes.repeat(runs)
    while len(frames) < count:
        run, each = cursor.varint(), cursor.varint()
        if not 0 < run <= count - len(frames) or not 0 < each <= MAX_CHUNK_FRAMES:
            raise cursor.corrupt("a run of chunks is out of range")
        frames += [each] * run
    return np.array(frames, np.int64)


def _read_lengths(cursor: Cursor, record: Mapping[str, Any]) -> Integers:
    lengths = cursor.varint_array(len(record["frames"]))
    if lengths.max(initial=0) > MAX_PAYLOAD_BYTES:
        raise cursor.corrupt("a payload is out of range")
    return lengths


INDEX = Record(
    "the index",
    Field("frames", _write_runs, _read_runs, "how many chunks, then runs of (chunks, frames of each)"),
    Field("lengths", lambda value, _: b"".join(map(varint, value)), _read_lengths, "bytes of each payload"),
)


def most_frames(points: int | None) -> int:
    """The most frames that a chunk may have; points: None for point clouds."""
    return most_chunk_frames(CLOUD_SAMPLES if points is None else points)


def chunk_bytes(frames: Sequence[int] | Integers, lengths: Sequence[int] | Integers) -> Integers:
    """What each chunk takes in the file, its frame and checksum included; frames and payload lengths of each."""
    counts, sizes = np.asarray(frames, np.int64), np.asarray(lengths, np.int64)
    return varint_bytes(counts) + varint_bytes(sizes) + sizes + CHECKSUM_BYTES


def varint_bytes(numbers: Integers) -> Integers:
    """How many bytes each number takes."""
    size = np.ones(numbers.shape, np.int64)
    for bits in range(7, int(numbers.max(initial=0)).bit_length(), 7):
        size += numbers >= 1 << bits
    return size
