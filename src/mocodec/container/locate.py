"""Where the parts of a `.mocz` are: its header from the front, its index from the end, its chunks one after another."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..entropy.varint import MAX_BYTES as MAX_VARINT_BYTES
from ..errors import BadInput, Corrupt, TooNew, Truncated
from ..typing import Integers
from . import records
from .byte_sources import ByteSource
from .records import CHECKSUM_BYTES, CHUNK, END_MAGIC, HEADER, INDEX, MAGIC, VERSION, chunk_bytes
from .remote_sources import BLOCK_BYTES
from .wire import Cursor, checksum, varint

MAX_CHUNK_HEAD_BYTES = 2 * MAX_VARINT_BYTES


def read_header(file: ByteSource) -> tuple[dict[str, Any], int]:
    """The header's fields and its end, a byte offset. Raises BadInput for other files, TooNew, Truncated, Corrupt."""
    block = file.read(0, min(file.size, BLOCK_BYTES))
    if not block.startswith(MAGIC):
        if MAGIC.startswith(block):
            raise Truncated(f"the file ends after {len(block)} bytes" if block else "the file is empty")
        if _has_end_magic(file):
            raise Corrupt("the first bytes of the file are damaged")
        raise BadInput("this is not a .mocz file")
    cursor = Cursor(block, "the header", at=len(MAGIC))
    version = cursor.byte()
    length = cursor.varint()
    end = cursor.at + length + CHECKSUM_BYTES
    if length > records.MAX_HEADER_BYTES:
        raise Corrupt(f"the header's length is damaged: {length} bytes, at most {records.MAX_HEADER_BYTES} are allowed")
    if end > file.size:
        raise (
            Corrupt("the header's length is damaged")
            if _has_end_magic(file)
            else Truncated("the file ends in its header")
        )
    if end > len(block):
        block += file.read(len(block), end - len(block))
    head, crc = block[: end - CHECKSUM_BYTES], block[end - CHECKSUM_BYTES : end]
    if checksum(head) != crc:
        raise Corrupt("the header is damaged: its checksum does not match")
    if version > VERSION:
        raise TooNew(f"format version {version}; this mocodec reads up to version {VERSION}: upgrade it")
    if version == 0:
        raise Corrupt("format version 0, which is reserved")
    cursor = Cursor(head, "the header", at=cursor.at)
    try:
        header = records.with_flags(HEADER.read(cursor))
    except Truncated as error:
        raise Corrupt(f"the header contradicts itself: {error}") from None
    except BadInput as error:
        raise Corrupt(f"the header: {error}") from None
    cursor.done()
    return header, end


def _has_end_magic(file: ByteSource) -> bool:
    """Whether the file ends with the end magic: then it is damaged, not truncated."""
    return file.size >= len(END_MAGIC) and file.read(file.size - len(END_MAGIC), len(END_MAGIC)) == END_MAGIC


def find_index(file: ByteSource, chunks_at: int) -> tuple[int, int]:
    """Byte offsets of the index and of the end of the file. Raises Truncated without the end magic, Corrupt."""
    count = min(MAX_VARINT_BYTES + len(END_MAGIC), file.size)
    tail = file.read(file.size - count, count)
    if not tail.endswith(END_MAGIC):
        if _index_follows(file, walk_chunks(file, chunks_at)[2]):
            raise Corrupt("the end of the file is damaged; its chunks can be salvaged")
        raise Truncated("the file ends too early: its index is missing; fetch it again, or salvage its chunks")
    backwards = Cursor(tail[: -len(END_MAGIC)][::-1], "the index's length")
    try:
        length = backwards.varint()
    except Truncated:
        raise Corrupt("the index's length is damaged; the chunks can be salvaged") from None
    index = file.size - len(END_MAGIC) - backwards.at - length
    if index < chunks_at or length < 1 + CHECKSUM_BYTES:
        raise Corrupt("the index's length is damaged; the chunks can be salvaged")
    return index, file.size


def _index_follows(file: ByteSource, index: int) -> bool:
    """Whether an undamaged index starts at byte `index`, followed by exactly its length and the end magic."""
    length = _index_bytes(file.size - index - len(END_MAGIC))
    if length <= CHECKSUM_BYTES:
        return False
    data = file.read(index, length)
    return checksum(data[:-CHECKSUM_BYTES]) == data[-CHECKSUM_BYTES:]


def _index_bytes(room: int) -> int:
    """The length of an index that fills `room` bytes together with its length field; 0 if no length does."""
    return next((room - n for n in range(1, MAX_VARINT_BYTES + 1) if room > n and len(varint(room - n)) == n), 0)


def read_index(file: ByteSource, chunks_at: int, index: int, end: int) -> tuple[Integers, Integers, Integers]:
    """Frames and payload bytes of every chunk, from the index, and its bytes in the file. Raises Corrupt."""
    data = file.read(index, _index_bytes(end - index - len(END_MAGIC)))
    body = data[:-CHECKSUM_BYTES]
    if checksum(body) != data[-CHECKSUM_BYTES:] or body[0] != 0:
        raise Corrupt("the index is damaged; the chunks can be salvaged")
    cursor = Cursor(body, "the index", at=1)
    try:
        if cursor.left:
            record = INDEX.read(cursor)
        else:
            frame = Cursor(file.read(chunks_at, min(MAX_CHUNK_HEAD_BYTES, index - chunks_at)), "the only chunk")
            chunk = CHUNK.read(frame)
            record = {"frames": np.array([chunk["frames"]]), "lengths": np.array([chunk["length"]])}
        cursor.done()
    except Truncated as error:
        raise Corrupt(f"the index contradicts itself: {error}") from None
    frames, lengths = record["frames"], record["lengths"]
    if frames.min(initial=1) < 1 or frames.sum() > records.MAX_FRAMES:
        raise Corrupt("the number of frames is out of range")
    sizes = chunk_bytes(frames, lengths)
    if chunks_at + sizes.sum() != index:  # lengths are not negative, so none exceeds the sum
        raise Corrupt("the index does not match the chunks; they can be salvaged")
    return frames, lengths, sizes


def walk_chunks(file: ByteSource, chunks_at: int) -> tuple[Integers, Integers, int]:
    """Scan the chunks from the front, without the index.

    Returns frames and payload bytes of each complete chunk, and the byte offset where the last one ends.
    """
    frames: list[int] = []
    lengths: list[int] = []
    at = chunks_at
    while at < file.size:
        cursor = Cursor(file.read(at, min(MAX_CHUNK_HEAD_BYTES, file.size - at)), "a chunk")
        try:
            chunk = CHUNK.read(cursor)
        except (Truncated, Corrupt):
            break
        size = int(chunk_bytes([chunk["frames"]], [chunk["length"]])[0])
        if chunk["frames"] == 0 or at + size > file.size:
            break
        frames.append(chunk["frames"])
        lengths.append(chunk["length"])
        at += size
    return np.array(frames, np.int64), np.array(lengths, np.int64), min(at, file.size)
