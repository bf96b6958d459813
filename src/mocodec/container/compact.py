"""A short `.mocz` without what a reader can make again: its head, if others have the same, checksums and index.

    .mocz ─split─► head, tail, sections, chunks ─pack─► bytes that need a block of another head ─join─► the same .mocz

    packed: flags · varint number of the block · delta? · tail? · sections? · chunks without checksums · CRC-32

docs/archive.md specifies it. Archives store short recordings so: the recordings of one person share their head.
"""

from __future__ import annotations

from typing import NamedTuple

from ..entropy.compressors import deflate, inflate
from ..errors import Corrupt, MocodecError
from ..fields import Values
from . import records
from .records import CHECKSUM_BYTES, CHUNK, END_MAGIC, HEADER, INDEX, MAGIC, VERSION
from .wire import Cursor, blob, checksum, varint

MOST_BYTES = 1 << 16
"""A longer `.mocz` stays whole: it is read in parts, and its head is a small share of it."""
DELTA, TAIL, SECTIONS = 1, 2, 4
"""Bits of the flags: the head, deflated with the block as dictionary, its tail, and extras or signals are there."""
MOST_FLAGS = DELTA | TAIL | SECTIONS
MOST_SHARED_BYTES = 16
"""Longer shared bytes are seldom those of another recording: they are the tail, and not in the head."""


class Parts(NamedTuple):
    """head: the header's fields, without those of the tail. tail: the field of shared bytes, if it is long. sections:
    extras and signals, with checksums. chunks: without checksums."""

    head: bytes
    tail: bytes
    sections: bytes
    chunks: bytes


def split(file: bytes) -> Parts | None:
    """The parts of a `.mocz`; None if it is long, or `join` would not give the same bytes again."""
    if len(file) > MOST_BYTES or not file.startswith(MAGIC + bytes([VERSION])):
        return None
    cursor = Cursor(file, "a .mocz", at=len(MAGIC) + 1)
    try:
        length = cursor.varint()
        start = cursor.at
        header = HEADER.read(cursor)
        cursor.at = start + length + CHECKSUM_BYTES
        fields, (head, tail) = header["extras"], _cut(file[start : start + length], header)
        sections = cursor.take(fields[0] + CHECKSUM_BYTES + fields[2]) if fields else b""
        chunks = bytearray()
        while file[cursor.at]:
            start = cursor.at
            cursor.varint()
            cursor.take(cursor.varint())
            chunks += file[start : cursor.at]
            cursor.take(CHECKSUM_BYTES)
    except (MocodecError, IndexError):
        return None
    parts = Parts(head, tail, sections, bytes(chunks))
    return parts if _joined(parts) == file else None


def _cut(head: bytes, header: Values) -> tuple[bytes, bytes]:
    """The header's fields with the shared bytes, if these are short, and the rest."""
    shared = records.pack_shared(header["shared"])
    at = len(head) - len(shared) if len(shared) > MOST_SHARED_BYTES else len(head)
    return head[:at], head[at:]


def pack(parts: Parts, block: bytes, number: int) -> bytes:
    """The bytes that are stored; block: the head of another recording, or the same; number: what readers find it by."""
    delta = b"" if parts.head == block else varint(len(parts.head)) + blob(deflate(parts.head, block))
    tail, sections = (blob(part) if part else b"" for part in (parts.tail, parts.sections))
    flags = DELTA * bool(delta) + TAIL * bool(tail) + SECTIONS * bool(sections)
    body = bytes([flags]) + varint(number) + delta + tail + sections + parts.chunks
    return body + checksum(parts.head, body)


def block_number(packed: bytes) -> int | None:
    """The number of the block that a stored recording needs, from its first bytes; None for a whole `.mocz`.

    Raises Truncated.
    """
    cursor = Cursor(packed, "a recording")
    return cursor.varint() if cursor.byte() <= MOST_FLAGS else None


def join(block: bytes, packed: bytes) -> bytes:
    """The `.mocz` that was packed. Raises Corrupt if it is not the same, to the byte."""
    body = packed[:-CHECKSUM_BYTES]
    cursor = Cursor(body, "the recording")
    try:
        flags = cursor.byte()
        cursor.varint()
        head = _inflated(cursor, block) if flags & DELTA else block
        tail, sections = (cursor.blob() if flags & bit else b"" for bit in (TAIL, SECTIONS))
        file = _joined(Parts(head, tail, sections, cursor.rest()))
    except MocodecError as error:
        raise Corrupt(f"the recording is damaged ({error})") from None
    if flags > MOST_FLAGS or checksum(head, body) != packed[-CHECKSUM_BYTES:]:
        raise Corrupt("the recording is damaged: its checksum does not match; restore the archive from a copy")
    return file


def _inflated(cursor: Cursor, block: bytes) -> bytes:
    size = cursor.varint()
    if size > MOST_BYTES:
        raise cursor.corrupt(f"a head of {size} bytes")
    return inflate(cursor.blob(), size, "the head", block)


def _joined(parts: Parts) -> bytes:
    """A `.mocz` of these parts, as `Writer` writes it."""
    head = MAGIC + bytes([VERSION]) + varint(len(parts.head) + len(parts.tail)) + parts.head + parts.tail
    file = bytearray(head + checksum(head) + parts.sections)
    chunks = Cursor(parts.chunks, "the chunks")
    frames: list[int] = []
    lengths: list[int] = []
    while chunks.left:
        start = chunks.at
        chunk = CHUNK.read(chunks)
        chunks.take(chunk["length"])
        frames.append(chunk["frames"])
        lengths.append(chunk["length"])
        file += parts.chunks[start : chunks.at] + checksum(parts.chunks[start : chunks.at])
    index = b"\0" + (INDEX.pack({"frames": frames, "lengths": lengths}) if len(frames) != 1 else b"")
    index += checksum(index)
    return bytes(file + index + varint(len(index))[::-1] + END_MAGIC)
