"""A `.mocz` opened for random access: header and index are read at once, extras and chunks when they are used.

file ──► first block ──► header          last block ──► index ──► byte range of each chunk
chunks[k] ──► its bytes ──► checksum ──► payload: damage in one chunk affects only reads of that chunk
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from typing import Any, NamedTuple, Self, cast, overload

import numpy as np

from ..encoded import Chunk, Encoded
from ..errors import BadInput, Corrupt, MocodecError, Truncated
from ..geometry import joint_tree
from ..motion import Deferred, Motion, require_events
from ..pointcloud import PointClouds
from ..typing import Integers
from . import values
from .byte_sources import ByteSource, byte_source
from .locate import find_index, read_header, read_index, walk_chunks
from .records import CHECKSUM_BYTES, CHUNK, HEADER, VERSION, chunk_bytes, most_frames
from .remote_sources import RemoteFile
from .stored_signals import Section
from .wire import checksum

SEPARATE = ("names", "skeleton", "settings", "source", "shared")
"""Header fields that `info` counts as parts of their own."""


class Layout(NamedTuple):
    """Byte offsets of the parts of a file."""

    extras: int
    signals: int
    chunks: int
    index_at: int
    end: int


@contextmanager
def errors_name(file: ByteSource) -> Iterator[None]:
    """Put the file's name before the message of errors that are raised inside.

    Any other exception that bytes with right checksums cause becomes Corrupt; BadInput if memory does not suffice.
    """
    try:
        yield
    except MocodecError as error:
        if file.name and not str(error).startswith(file.name):
            error.args = (f"{file.name}: {error}", *error.args[1:])
        raise
    except MemoryError as error:
        raise BadInput(f"{file.name or 'the file'}: not enough memory; decode fewer frames at a time") from error
    except OSError:
        raise
    except Exception as error:
        where = f"{file.name or 'the file'}: cannot be decoded although its checksums hold"
        raise Corrupt(f"{where} ({type(error).__name__}: {error})") from error


class StoredChunk(Chunk):
    """A chunk whose payload is read and checked at first use. Raises Corrupt, Truncated.

    stop: the number of the chunk behind the last that will be used too; from a remote file they come in one request.
    """

    def __init__(self, chunks: StoredChunks, number: int, stop: int) -> None:
        object.__setattr__(self, "start", int(chunks.starts[number]))
        object.__setattr__(self, "frames", int(chunks.frames[number]))
        object.__setattr__(self, "_where", (chunks, number, stop))

    @cached_property
    def payload(self) -> bytes:  # pyright: ignore[reportIncompatibleVariableOverride]
        chunks, number, stop = cast("tuple[StoredChunks, int, int]", self.__dict__["_where"])
        return chunks.payload(number, stop)


class StoredChunks(Sequence[Chunk]):
    """The chunks of a file; a chunk is read when its payload is used.

    frames, lengths (chunks,): frames of each, and bytes of its payload. starts, offsets (chunks + 1,): the first frame
    of each, and where it begins in the file; then those behind the last chunk.
    """

    def __init__(self, file: ByteSource, offset: int, frames: Integers, lengths: Integers, sizes: Integers) -> None:
        self.source = file
        self.frames = frames
        self.lengths = lengths
        self.starts, self.offsets = np.zeros((2, len(frames) + 1), np.int64)
        np.cumsum(frames, out=self.starts[1:])
        np.cumsum(sizes, out=self.offsets[1:])
        self.offsets += offset

    def __len__(self) -> int:
        return len(self.frames)

    @overload
    def __getitem__(self, index: int) -> Chunk: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Chunk]: ...
    def __getitem__(self, index: int | slice) -> Chunk | Sequence[Chunk]:
        if isinstance(index, slice):
            numbers = range(len(self))[index]
            return [StoredChunk(self, number, max(number + 1, numbers.stop)) for number in numbers]
        number = range(len(self))[index]
        return StoredChunk(self, number, number + 1)

    def payload(self, number: int, stop: int) -> bytes:
        """The payload of one chunk, those up to number `stop` being used next. Raises Corrupt, Truncated."""
        with errors_name(self.source):
            return self.checked_payload(number, stop)

    def checked_payload(self, number: int, stop: int) -> bytes:
        """As `payload`, but errors do not name the file."""
        offset, end = self.offsets[number : number + 2].tolist()
        if isinstance(self.source, RemoteFile):
            data = self.source.read(offset, end - offset, int(self.offsets[stop]) - offset)
        else:
            data = self.source.read(offset, end - offset)
        head = CHUNK.pack({"frames": int(self.frames[number]), "length": int(self.lengths[number])})
        body, crc = data[:-CHECKSUM_BYTES], data[-CHECKSUM_BYTES:]
        if checksum(body) != crc or not body.startswith(head):
            start = self.starts[number]
            raise Corrupt(
                f"chunk {number} (frames {start} to {start + self.frames[number]}, byte {self.offsets[number]}) is "
                f"damaged{'; the other chunks can still be read' * (len(self) > 1)}: restore the file from a copy, or "
                "salvage it"
            )
        return body[len(head) :]


def _range(numbers: Integers) -> list[int]:
    """The smallest and the largest; 0 and 0 of none."""
    return [int(numbers.min()), int(numbers.max())] if len(numbers) else [0, 0]


class Reader:
    """An open `.mocz`; `encoded` is the input of the codec's `decode`.

    where: a path, a URL, bytes or a binary file object. salvage: open a file that is truncated or has a
    damaged index, with the chunks that can be found; `intact_runs()` then lists the frames that decode.
    Raises Truncated, Corrupt, TooNew, UnknownCodec, BadInput.
    """

    def __init__(self, where: Any, salvage: bool = False) -> None:
        self.source = byte_source(where)
        try:
            with errors_name(self.source):
                self._open(salvage)
        except BaseException:
            self.source.close()
            raise

    def _open(self, salvage: bool) -> None:
        self.header, header_end = read_header(self.source)
        signals_at = chunks_at = header_end
        if self.header["extras"]:
            section, _, signals = self.header["extras"]
            signals_at += section + CHECKSUM_BYTES
            chunks_at = signals_at + signals
        self.problems: list[str] = []
        try:
            index, end = find_index(self.source, chunks_at)
            frames, lengths, sizes = read_index(self.source, chunks_at, index, end)
        except MocodecError as error:
            if not salvage:
                raise
            self.problems.append(str(error))
            frames, lengths, index = walk_chunks(self.source, chunks_at)
            sizes = chunk_bytes(frames, lengths)
            end = self.source.size
        most = most_frames(len(self.header["names"]) if self.header["kind"] == "motion" else None)
        if frames.max(initial=0) > most:
            raise Corrupt(f"a chunk of {frames.max()} frames; at this number of points the limit is {most}")
        self.layout = Layout(header_end, signals_at, chunks_at, index, end)
        self.chunks = StoredChunks(self.source, chunks_at, frames, lengths, sizes)
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
            skeleton, has_rotations = header["skeleton"] or (None, False)
            return Motion(
                positions=np.empty((0, len(header["names"]), 3)),
                rate=header["rate"],
                names=header["names"],
                up=header["up"],
                skeleton=skeleton,
                rotations=np.empty((0, len(header["names"]), 4)) if has_rotations else None,
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
        """The extras: data that the codec does not code. Raises Corrupt if they are damaged."""
        with errors_name(self.source):
            return self._extras()[0]

    def _extras(self) -> tuple[dict[str, Any], Section]:
        """The extras, and the signals among them, whose chunks are read when they are used."""
        stored, size, signal_bytes = self.header["extras"]
        data = self.source.read(self.layout.extras, stored + CHECKSUM_BYTES)
        if checksum(data[:stored]) != data[stored:]:
            raise Corrupt(
                "the extras (analog channels, events, parameters) are damaged; the motion itself can still be read"
            )
        try:
            signals = Section(self._read_signals, signal_bytes)
            extras = values.unpack_extras(data[:stored], size, signals)
            require_events(extras)
        except BadInput as error:
            raise Corrupt(f"the extras: {error}") from None
        return extras, signals

    def _signal_head_bytes(self) -> int:
        """Bytes of the extras section that belong to signals; 0 if the section is damaged."""
        if self.layout.chunks == self.layout.signals:
            return 0
        try:
            return self._extras()[1].head_bytes
        except (Corrupt, Truncated):
            return 0

    def _read_signals(self, start: int, count: int) -> bytes:
        return self.source.read(self.layout.signals + start, count)

    def errors_name_file(self) -> AbstractContextManager[None]:
        """Put the file's name before the message of errors that are raised inside."""
        return errors_name(self.source)

    def verify(self) -> None:
        """Read and check the whole file. Raises Corrupt that lists every damaged part."""
        problems = self.problems + [message for _, message in self.damage()]
        with errors_name(self.source):
            if problems:
                raise Corrupt("; ".join(problems))

    def damage(self) -> list[tuple[int | None, str]]:
        """(chunk number, message) of each damaged part; the number is None for the extras and signals."""
        damaged_parts: list[tuple[int | None, str]] = []
        if self.header["extras"]:
            try:
                for samples in self._extras()[1].all:
                    for number in range(len(samples.offsets)):
                        samples.payload(number)
            except (Corrupt, Truncated) as error:
                damaged_parts.append((None, str(error)))
        for number in range(len(self.chunks)):
            try:
                self.chunks.checked_payload(number, len(self.chunks))
            except (Corrupt, Truncated) as error:
                damaged_parts.append((number, str(error)))
        return damaged_parts

    def intact_runs(self) -> list[tuple[int, int]]:
        """Runs of frames [start, stop) that decode: their chunks, and the margin around these, are undamaged."""
        margin = self.encoded.margin
        damaged = {number for number, _ in self.damage() if number is not None}
        is_truncated = bool(self.problems)
        runs: list[tuple[int, int]] = []
        starts = self.chunks.starts.tolist()
        for number, start in enumerate(starts[:-1]):
            needs = range(max(0, number - margin), number + margin + 1)
            is_past_end = is_truncated and needs.stop > len(self.chunks)
            if is_past_end or not damaged.isdisjoint(needs):
                continue
            if runs and runs[-1][1] == start:
                start = runs.pop()[0]
            runs.append((start, starts[number + 1]))
        return runs

    def info(self) -> dict[str, Any]:
        """Facts about the file, as JSON values; reads no chunk, and the extras only if there are signals."""
        header, layout = self.header, self.layout
        about = self.encoded.about
        chunks = self.chunks
        frames, payloads = int(chunks.starts[-1]), int(chunks.lengths.sum())
        points = about.points if isinstance(about, Motion) else None
        fields = {part["field"]: part["bytes"] for part in self.fields()}
        heads = self._signal_head_bytes()
        chunk_overhead = layout.index_at - layout.chunks - payloads
        sizes = {
            "header": layout.extras - sum(fields.get(name, 0) for name in SEPARATE),
            **{name: fields.get(name, 0) for name in SEPARATE},
            "extras": layout.signals - layout.extras - heads,
            "signals": layout.chunks - layout.signals + heads,
            "chunks": payloads,
            "framing": chunk_overhead,
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
            "rotations": bool(header["skeleton"] and header["skeleton"][1]),
            "source": header["source"] or {},
            "bytes": layout.end,
            "bytes_by_part": sizes,
            "raw_bytes_float32": raw,
            "ratio": None if raw is None or not layout.end else raw / layout.end,
            **(joint_tree.described(about) if isinstance(about, Motion) else {}),
            "chunks": {
                "count": len(chunks),
                "frames": _range(chunks.frames),
                "bytes": _range(chunks.lengths),
                "margin": self.encoded.margin,
            },
        }

    def fields(self) -> list[dict[str, Any]]:
        """The header's fields: name, bytes, meaning."""
        return HEADER.describe(self.header)

    def close(self) -> None:
        self.source.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
