"""A `.mocz` opened for random access: header and index at once; extras and each chunk when they are asked for.

source ──► head (one block) ──► header          tail (one block) ──► index ──► where each chunk is
chunks[k] ──► its bytes ──► checksum ──► payload: damage in one chunk is met by who needs that chunk, by no one else
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from itertools import accumulate
from typing import Any, NamedTuple, Self, cast, overload

import numpy as np

from ..encoded import Chunk, Encoded
from ..entropy.varint import MAX_BYTES as MAX_VARINT_BYTES
from ..errors import BadInput, Corrupt, MocodecError, TooNew, Truncated
from ..motion import Deferred, Motion, require_events
from ..pointcloud import PointClouds
from . import records, values
from .records import CHECKSUM_BYTES, CHUNK, END_MAGIC, HEADER, INDEX, MAGIC, VERSION, chunk_bytes
from .sources import BLOCK_BYTES, Source, source
from .wire import Cursor, checksum, varint

FRAME_BYTES = 2 * MAX_VARINT_BYTES


class Layout(NamedTuple):
    """Where things are, in bytes from the start of the file."""

    extras: int
    chunks: int
    index_at: int
    end: int


@contextmanager
def naming(where: Source) -> Iterator[None]:
    """Errors within say which file they are about."""
    try:
        yield
    except MocodecError as error:
        if where.name and not str(error).startswith(where.name):
            error.args = (f"{where.name}: {error}",)
        raise


class StoredChunk(Chunk):
    """A chunk whose payload is read, and its checksum tested, when it is asked for. Raises Corrupt, Truncated."""

    def __init__(self, chunks: StoredChunks, number: int) -> None:
        object.__setattr__(self, "start", chunks.starts[number])
        object.__setattr__(self, "frames", chunks.frames[number])
        object.__setattr__(self, "_where", (chunks, number))

    @cached_property
    def payload(self) -> bytes:  # pyright: ignore[reportIncompatibleVariableOverride]
        chunks, number = cast("tuple[StoredChunks, int]", self.__dict__["_where"])
        return chunks.payload(number)


class StoredChunks(Sequence[Chunk]):
    """The chunks of a file, by place; none is read before its payload is asked for."""

    def __init__(self, where: Source, offset: int, frames: Sequence[int], lengths: Sequence[int]) -> None:
        self.source = where
        self.frames = frames
        self.lengths = lengths
        self.starts = list(accumulate(frames, initial=0))
        self.offsets = list(accumulate(chunk_bytes(frames, lengths).tolist(), initial=offset))

    def __len__(self) -> int:
        return len(self.frames)

    @overload
    def __getitem__(self, index: int) -> Chunk: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Chunk]: ...
    def __getitem__(self, index: int | slice) -> Chunk | Sequence[Chunk]:
        if isinstance(index, slice):
            return [StoredChunk(self, number) for number in range(len(self))[index]]
        return StoredChunk(self, range(len(self))[index])

    def payload(self, number: int) -> bytes:
        """Raises Corrupt where the chunk's frame, payload or checksum are damaged, Truncated where they are missing."""
        with naming(self.source):
            return self.tested(number)

    def tested(self, number: int) -> bytes:
        """As `payload`; its errors do not say which file."""
        data = self.source.read(self.offsets[number], self.offsets[number + 1] - self.offsets[number])
        frame = CHUNK.pack({"frames": self.frames[number], "length": self.lengths[number]})
        body, crc = data[:-CHECKSUM_BYTES], data[-CHECKSUM_BYTES:]
        if checksum(body) != crc or not body.startswith(frame):
            start = self.starts[number]
            raise Corrupt(
                f"chunk {number} (frames {start} to {start + self.frames[number]}, byte {self.offsets[number]}) is "
                f"damaged{'; the other chunks can still be read' * (len(self) > 1)}: restore the file from a copy, or "
                "salvage it"
            )
        return body[len(frame) :]


class Reader:
    """An open `.mocz`.

    where: a path, an http(s) URL, bytes or a binary file object. salvage: of a file that was cut off or whose index is
    damaged, take what chunks there are; `whole()` then says which frames decode.
    encoded: what codecs decode. Raises Truncated, Corrupt, TooNew, UnknownCodec, BadInput.
    """

    def __init__(self, where: Any, salvage: bool = False) -> None:
        self.source = source(where)
        try:
            with naming(self.source):
                self._open(salvage)
        except BaseException:
            self.source.close()
            raise

    def _open(self, salvage: bool) -> None:
        self.header, header_end = _read_header(self.source)
        chunks_at = header_end
        if self.header["extras"]:
            chunks_at += self.header["extras"][0] + CHECKSUM_BYTES
        self.problems: list[str] = []
        try:
            index, end = _find_index(self.source, chunks_at)
            frames, lengths = _read_index(self.source, chunks_at, index, end)
        except MocodecError as error:
            if not salvage:
                raise
            self.problems.append(str(error))
            frames, lengths, index = _walk(self.source, chunks_at)
            end = self.source.size
        self.layout = Layout(header_end, chunks_at, index, end)
        self.chunks = StoredChunks(self.source, chunks_at, frames, lengths)
        self.encoded: Encoded[Any] = Encoded(
            codec=self.header["codec"],
            about=cast(Motion, self._about()),
            chunks=self.chunks,
            shared=self.header["shared"],
            margin=self.header["margin"] or 0,
            settings=self.header["settings"] or {},
        )

    def _about(self) -> Motion | PointClouds:
        header = self.header
        extras: Mapping[str, Any] = Deferred(self.extras) if header["extras"] else {}
        if header["kind"] == "motion":
            return Motion(
                positions=np.empty((0, len(header["names"]), 3)),
                rate=header["rate"],
                names=header["names"],
                up=header["up"],
                skeleton=header["skeleton"],
                source=header["source"] or {},
                extras=extras,
            )
        return PointClouds(
            positions=(),
            rate=header["rate"],
            colours=() if header["channels"] & 1 else None,
            normals=() if header["channels"] & 2 else None,
            up=header["up"],
            source=header["source"] or {},
            extras=extras,
        )

    def extras(self) -> dict[str, Any]:
        """What the codec does not code. Raises Corrupt where it is damaged."""
        with naming(self.source):
            return self._extras()

    def _extras(self) -> dict[str, Any]:
        stored, size = self.header["extras"]
        data = self.source.read(self.layout.extras, stored + CHECKSUM_BYTES)
        if checksum(data[:stored]) != data[stored:]:
            raise Corrupt("the extras (what the codec does not code) are damaged; the motion itself can still be read")
        try:
            extras = values.unpack_extras(data[:stored], size)
            require_events(extras)
        except BadInput as error:
            raise Corrupt(f"the extras: {error}") from None
        return extras

    def naming(self) -> AbstractContextManager[None]:
        """Errors within say which file they are about."""
        return naming(self.source)

    def verify(self) -> None:
        """Reads all of it. Raises Corrupt (or Truncated) that names every part that is damaged."""
        problems = self.problems + [message for _, message in self.damage()]
        with naming(self.source):
            if problems:
                raise Corrupt("; ".join(problems))

    def damage(self) -> list[tuple[int | None, str]]:
        """(chunk, message) for each part that is damaged; the number is None for the extras."""
        found: list[tuple[int | None, str]] = []
        if self.header["extras"]:
            try:
                self._extras()
            except (Corrupt, Truncated) as error:
                found.append((None, str(error)))
        for number in range(len(self.chunks)):
            try:
                self.chunks.tested(number)
            except (Corrupt, Truncated) as error:
                found.append((number, str(error)))
        return found

    def whole(self) -> list[tuple[int, int]]:
        """Runs of frames (start, stop) whose chunks, and the neighbours that those need, are all undamaged."""
        margin = self.encoded.margin
        bad = {number for number, _ in self.damage() if number is not None}
        cut_off = bool(self.problems)
        runs: list[tuple[int, int]] = []
        for number, start in enumerate(self.chunks.starts[:-1]):
            needs = range(max(0, number - margin), number + margin + 1)
            past_end = cut_off and needs.stop > len(self.chunks)
            if past_end or not bad.isdisjoint(needs):
                continue
            if runs and runs[-1][1] == start:
                start = runs.pop()[0]
            runs.append((start, self.chunks.starts[number + 1]))
        return runs

    def info(self) -> dict[str, Any]:
        """What the file holds, as JSON values; reads no chunk."""
        header, layout = self.header, self.layout
        about = self.encoded.about
        frames = self.chunks.starts[-1]
        points = about.points if isinstance(about, Motion) else None
        fields = {part["field"]: part["bytes"] for part in self.fields()}
        framing = layout.index_at - layout.chunks - sum(self.chunks.lengths)
        sizes = {
            "header": layout.extras - sum(fields.get(name, 0) for name in SEPARATE),
            **{name: fields.get(name, 0) for name in SEPARATE},
            "extras": layout.chunks - layout.extras,
            "chunks": sum(self.chunks.lengths),
            "framing": framing,
            "index": layout.end - layout.index_at,
        }
        raw = None if points is None else frames * points * 12
        return {
            "format_version": VERSION,
            "kind": header["kind"],
            "codec": header["codec"],
            "settings": header["settings"] or {},
            "promise": self.encoded.promise,
            "frames": frames,
            "points": points,
            "rate": header["rate"],
            "seconds": frames / header["rate"],
            "up": header["up"],
            "names": list(about.names) if isinstance(about, Motion) else [],
            "skeleton": header["skeleton"] is not None,
            "source": header["source"] or {},
            "bytes": layout.end,
            "bytes_by_part": sizes,
            "raw_bytes_float32": raw,
            "ratio": None if raw is None or not layout.end else raw / layout.end,
            "chunks": {
                "count": len(self.chunks),
                "frames": [min(self.chunks.frames, default=0), max(self.chunks.frames, default=0)],
                "bytes": [min(self.chunks.lengths, default=0), max(self.chunks.lengths, default=0)],
                "margin": self.encoded.margin,
            },
        }

    def fields(self) -> list[dict[str, Any]]:
        """The header field by field: name, bytes, meaning."""
        return HEADER.describe(self.header)

    def close(self) -> None:
        self.source.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


SEPARATE = ("names", "skeleton", "settings", "source", "shared")


def _read_header(where: Source) -> tuple[dict[str, Any], int]:
    """The header's fields, and where it ends. Raises BadInput for other files, TooNew, Truncated, Corrupt."""
    block = where.read(0, min(where.size, BLOCK_BYTES))
    if not block.startswith(MAGIC):
        if MAGIC.startswith(block):
            raise Truncated(f"the file ends after {len(block)} bytes" if block else "the file is empty")
        if _has_end(where):
            raise Corrupt("the first bytes of the file are damaged")
        raise BadInput("this is not a .mocz file")
    cursor = Cursor(block, "the header", at=len(MAGIC))
    version = cursor.byte()
    length = cursor.varint()
    end = cursor.at + length + CHECKSUM_BYTES
    if length > records.MAX_HEADER_BYTES:
        raise Corrupt(f"a header of {length} bytes, more than may be")
    if end > where.size:
        raise Corrupt("the header's length is damaged") if _has_end(where) else Truncated("the file ends in its header")
    if end > len(block):
        block += where.read(len(block), end - len(block))
    head, crc = block[: end - CHECKSUM_BYTES], block[end - CHECKSUM_BYTES : end]
    if checksum(head) != crc:
        raise Corrupt("the header is damaged: its checksum does not hold")
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


def _has_end(where: Source) -> bool:
    """Whether the last bytes are those of a file that was finished: then it is damaged, not cut off."""
    return where.size >= len(END_MAGIC) and where.read(where.size - len(END_MAGIC), len(END_MAGIC)) == END_MAGIC


def _find_index(where: Source, chunks_at: int) -> tuple[int, int]:
    """Where the index starts, and where the file ends. Raises Truncated where the end is missing, Corrupt."""
    count = min(MAX_VARINT_BYTES + len(END_MAGIC), where.size)
    tail = where.read(where.size - count, count)
    if not tail.endswith(END_MAGIC):
        if _index_follows(where, _walk(where, chunks_at)[2]):
            raise Corrupt("the end of the file is damaged; its chunks can be salvaged")
        raise Truncated("the file ends too early: its index is missing; fetch it again, or salvage what is there")
    backwards = Cursor(tail[: -len(END_MAGIC)][::-1], "the index's length")
    try:
        length = backwards.varint()
    except Truncated:
        raise Corrupt("the index's length is damaged; the chunks can be salvaged") from None
    index = where.size - len(END_MAGIC) - backwards.at - length
    if index < chunks_at or length < 1 + CHECKSUM_BYTES:
        raise Corrupt("the index's length is damaged; the chunks can be salvaged")
    return index, where.size


def _index_follows(where: Source, index: int) -> bool:
    """Whether an undamaged index starts here, with just so much after it as its length and the magic take."""
    length = _index_bytes(where.size - index - len(END_MAGIC))
    if length <= CHECKSUM_BYTES:
        return False
    data = where.read(index, length)
    return checksum(data[:-CHECKSUM_BYTES]) == data[-CHECKSUM_BYTES:]


def _index_bytes(room: int) -> int:
    """The length of an index that, with that length written behind it, fills the room; 0 if none does."""
    return next((room - n for n in range(1, MAX_VARINT_BYTES + 1) if room > n and len(varint(room - n)) == n), 0)


def _read_index(where: Source, chunks_at: int, index: int, end: int) -> tuple[list[int], list[int]]:
    """Frames and payload bytes of every chunk. Raises Corrupt."""
    data = where.read(index, _index_bytes(end - index - len(END_MAGIC)))
    body = data[:-CHECKSUM_BYTES]
    if checksum(body) != data[-CHECKSUM_BYTES:] or body[0] != 0:
        raise Corrupt("the index is damaged; the chunks can be salvaged")
    cursor = Cursor(body, "the index", at=1)
    try:
        if cursor.left:
            record = INDEX.read(cursor)
        else:
            frame = Cursor(where.read(chunks_at, min(FRAME_BYTES, index - chunks_at)), "the only chunk")
            chunk = CHUNK.read(frame)
            record = {"frames": [chunk["frames"]], "lengths": [chunk["length"]]}
        cursor.done()
    except Truncated as error:
        raise Corrupt(f"the index contradicts itself: {error}") from None
    frames, lengths = record["frames"], record["lengths"]
    if min(frames, default=1) < 1 or sum(frames) > records.MAX_FRAMES:
        raise Corrupt("the number of frames is out of range")
    if max(lengths, default=0) > index or chunks_at + int(chunk_bytes(frames, lengths).sum()) != index:
        raise Corrupt("the index does not fit the chunks; they can be salvaged")
    return frames, lengths


def _walk(where: Source, chunks_at: int) -> tuple[list[int], list[int], int]:
    """Chunk after chunk from the front, without the index: frames, payload bytes, where the last complete one ends."""
    frames: list[int] = []
    lengths: list[int] = []
    at = chunks_at
    while at < where.size:
        cursor = Cursor(where.read(at, min(FRAME_BYTES, where.size - at)), "a chunk")
        try:
            chunk = CHUNK.read(cursor)
        except (Truncated, Corrupt):
            break
        size = int(chunk_bytes([chunk["frames"]], [chunk["length"]])[0])
        if chunk["frames"] == 0 or at + size > where.size:
            break
        frames.append(chunk["frames"])
        lengths.append(chunk["length"])
        at += size
    return frames, lengths, min(at, where.size)
