# pyright: strict
"""An open `.mocz`: frames, points and signals of it, without reading the rest.

file ─open─► File ──[a:b]──────► Motion, PointClouds     windows are cut from chunks that stay decoded
                  └─positions──► array
"""

from __future__ import annotations

import math
import os
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from os import PathLike
from typing import TYPE_CHECKING, Any, BinaryIO, Generic, Self, cast, overload

import numpy as np
from numpy.typing import DTypeLike, NDArray

from . import codecs, decoded_chunks, parallel
from .channels import Channel, channels
from .codecs.base import Codec
from .encoded import Encoded, Recording, RecordingT
from .errors import BadInput, Corrupt, MocodecError
from .file_range import FileRange
from .motion import Motion
from .pointcloud import PointClouds
from .selection import Frames, counted, frame_steps, point_columns, split_key
from .typing import Integers

if TYPE_CHECKING:
    from .container import Reader  # imported where it is used: it makes `import mocodec` a quarter slower

CHUNKS_AT_A_TIME = 32
"""Chunks that `File.positions` decodes together: enough for several threads, few enough to need little memory."""

Source = bytes | bytearray | memoryview | str | PathLike[str] | BinaryIO | FileRange
Reopenable = str | bytes | FileRange


@overload
def open(source: Source, kind: type[RecordingT], *, salvage: bool = False) -> File[RecordingT]: ...
@overload
def open(source: Source, kind: None = None, *, salvage: bool = False) -> File[Recording]: ...
def open(source: Source, kind: type[Recording] | None = None, *, salvage: bool = False) -> File[Any]:
    """Open a .mocz for random access: only the chunks that a slice needs are read and decoded.

        with mocodec.open("walk.mocz", mocodec.Motion) as f:
            f.shape, f.rate, f.names          # (frames, points, 3), hertz, names; nothing is decoded yet
            second = f[1200:1320]             # a Motion of 120 frames

    source: a path, a URL, bytes or a binary file object; of it, header and index are read. A URL is http(s), read by
    range requests, or of a store that fsspec knows (s3://, gs://, memory://, … with the [remote] extra).
    kind: `Motion` or `PointClouds`, as in `read`.
    salvage: open what is left of a file that was cut short; see `File.whole`.

    Returns a `File`. Raises Truncated, Corrupt, TooNew, UnknownCodec, BadInput.
    """
    from . import container

    reader = container.Reader(source, salvage)
    try:
        of_kind(reader.encoded.about, kind, reader.source.name)
        _require_codec_of_kind(reader)
    except MocodecError:
        reader.close()
        raise
    return File[Any](reader, _reopenable(source), salvage)


class File(Generic[RecordingT]):
    """An open .mocz.

    `f[1200:1320]`, `f[100]`, `f[-1]` and `f[::4]` decode these frames, to a Motion or PointClouds;
    `f[1200:1320, ["LKNE"]]` some points of them; `f.at(seconds=slice(10.0, 11.0))` the frames of this time. Chunks that
    windows of a few frames are cut from stay in memory, 64 MB of them in a process (`decoded_chunks`).
    `for part in f` decodes chunk by chunk. A file can be pickled, unless it was opened from a file object: unpickling
    opens the path, URL or bytes again.
    """

    def __init__(self, reader: Reader, reopen_from: Reopenable | None = None, salvage: bool = False) -> None:
        self._reader = reader
        self._reopen_from = reopen_from
        self._salvage = salvage
        self.encoded: Encoded[RecordingT] = reader.encoded
        self._number = decoded_chunks.next_file()
        self._forget = weakref.finalize(self, decoded_chunks.CACHE.drop, self._number)

    @property
    def codec(self) -> type[Codec[RecordingT]]:
        """The class of the codec that made the file. Raises UnknownCodec; `info` and `names` work without the codec."""
        return codecs.codec_class(self.encoded.codec)

    @property
    def shape(self) -> tuple[int, ...]:
        """(frames, points, 3) of a motion, (frames,) of point clouds."""
        about = self.encoded.about
        return (self.encoded.frames, about.points, 3) if isinstance(about, Motion) else (self.encoded.frames,)

    @property
    def rate(self) -> float:
        """Frames per second."""
        return self.encoded.about.rate

    @property
    def seconds(self) -> float:
        """Duration: frames / rate."""
        return len(self) / self.rate

    @property
    def names(self) -> tuple[str, ...]:
        """One name per point of a motion; () for point clouds."""
        about = self.encoded.about
        return about.names if isinstance(about, Motion) else ()

    @cached_property
    def signals(self) -> Mapping[str, Channel]:
        """The channels of all signals by label: `f.signals["Fz1"][a:b]` reads and decodes these samples only."""
        return channels(self.encoded.about.extras)

    @property
    def info(self) -> dict[str, Any]:
        """The contents of the file as JSON values, with the keys of `mocodec info --json`."""
        return self._reader.info()

    @property
    def is_truncated(self) -> bool:
        """Whether the file was cut short and opened with `salvage`: it has the frames that are left."""
        return bool(self._reader.problems)

    @property
    def chunk_bytes(self) -> list[int]:
        """The size of each chunk's payload, bytes, from the index."""
        return [int(size) for size in self._reader.chunks.lengths]

    def __len__(self) -> int:
        """The number of frames."""
        return self.encoded.frames

    def __repr__(self) -> str:
        about, name = self.encoded.about, self._reader.source.name
        points = f" of {counted(about.points, 'point')}" if isinstance(about, Motion) else " of point clouds"
        facts = [self.encoded.codec, f"{counted(len(self), 'frame')}{points} at {self.rate:g} Hz"]
        facts += [f"{self.seconds:.4g} s"]
        facts += [f"{name}={value:g}" for name, value in self.encoded.promise.items()]
        return f"<File{f' {name!r}' if name else ''}: {', '.join(facts)}>"

    def _repr_html_(self) -> str:
        """The recording as a page that plays it, for notebooks; long ones are thinned out (`viewer.for_notebook`)."""
        return cast(str, import_module("mocodec.viewer").for_notebook(self))

    def __getitem__(self, key: Frames | tuple[Frames, Sequence[str]]) -> RecordingT:
        """Decode a frame or a slice of frames, all points or those of these names.

        Raises BadInput, FrameOutOfRange for a single frame only, and what `decode` raises.
        """
        frames, names = split_key(key)
        start, stop, step = frame_steps(frames, len(self))
        if names is not None:
            point_columns(self.names, names)
        recording = self.decode(slice(start, stop), keep_chunks=True)
        if step > 1:
            recording = cast("RecordingT", recording[::step])
        return recording if names is None else cast("RecordingT", cast(Motion, recording).select(names))

    def decode(self, frames: slice, *, keep_chunks: bool = False, threads: int | None = None) -> RecordingT:
        """Frames [start, stop), decoded from the file, or cut from the decoded chunks in memory.

        threads: as in `decode`. Raises what `decode` raises.
        """
        decode = self.codec.decode
        with self._reader.errors_name_file(), parallel.threads(threads):
            _require_memory(frames.stop - frames.start, len(self.names))
            if not keep_chunks or not isinstance(self.encoded.about, Motion):
                return decode(self.encoded, frames)
            encoded, starts = cast("Encoded[Motion]", self.encoded), self._reader.chunks.starts
            of_motion = cast("decoded_chunks.Decode", decode)
            frames_alone = getattr(self.codec, "decodes_frames_alone", False)
            found = decoded_chunks.window(self._number, of_motion, encoded, starts, frames, frames_alone)
            return cast("RecordingT", found)

    def positions(
        self,
        frames: slice = slice(None),
        dtype: DTypeLike = np.float64,
        out: NDArray[Any] | None = None,
        threads: int | None = None,
    ) -> NDArray[Any]:
        """The positions (frames, points, 3) of a motion, metres, NaN in gaps, as an array of this type, or in `out`.

        frames: a slice without a step. out: an array of this shape and any float type, which is returned. Memory for
        some chunks is needed besides. Raises BadInput, and what `decode` raises.
        """
        if not isinstance(self.encoded.about, Motion):
            raise BadInput("point clouds have no array of positions; decode them, or take them one by one")
        start, stop, step = frame_steps(frames, len(self))
        shape = (stop - start, self.encoded.about.points, 3)
        if step != 1 or (out is not None and out.shape != shape):
            raise BadInput(f"positions of frames without a step go to an array of the shape {shape}")
        whole = np.empty(shape, dtype) if out is None else out
        for a, b in frame_batches(self._reader.chunks.starts, start, stop):
            part = cast(Motion, self.decode(slice(a, b), threads=threads))
            whole[a - start : b - start] = part.positions
        return whole

    def at(self, seconds: slice) -> RecordingT:
        """The frames whose time (frame / rate) is in [start, stop) seconds. Raises BadInput for a step or below 0."""
        if not isinstance(cast(object, seconds), slice) or seconds.step is not None:
            raise BadInput("times are chosen by a slice without a step, such as f.at(seconds=slice(10.0, 11.0))")
        return self[self._frame(seconds.start) : self._frame(seconds.stop)]

    def _frame(self, second: float | None) -> int | None:
        """The first frame at or after this time; the tolerance absorbs the rounding of the product."""
        if second is None:
            return None
        if not second >= 0:
            raise BadInput(f"times count from the first frame and start at 0, not {second}")
        return min(math.ceil(second * self.rate - 1e-6), len(self))

    def errors_name_file(self) -> AbstractContextManager[None]:
        """Errors that a codec raises inside name the file, and all of them are MocodecErrors."""
        return self._reader.errors_name_file()

    def whole(self) -> list[tuple[int, int]]:
        """Runs of frames (start, stop) that are undamaged and decode, also in a file opened with `salvage`."""
        return self._reader.intact_runs()

    def verify(self) -> None:
        """Read every byte and test every checksum. Raises Corrupt, which lists all damaged parts."""
        self._reader.verify()

    def __iter__(self) -> Iterator[RecordingT]:
        """The recording chunk by chunk."""
        for chunk in self.encoded.chunks:
            yield self.decode(slice(chunk.start, chunk.stop))

    def __reduce__(self) -> tuple[Any, ...]:
        if self._reopen_from is None:
            raise BadInput(
                "a File that was opened from a file object cannot be pickled: open it from its path, URL or bytes"
            )
        return _open_again, (self._reopen_from, self._salvage)

    def close(self) -> None:
        """Close the file; extras of slices can still be read."""
        self._forget()
        self._reader.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def frame_batches(starts: Integers, start: int, stop: int) -> Iterator[tuple[int, int]]:
    """Frames [start, stop) in runs of whole chunks, as many as are decoded at a time. starts: of each chunk."""
    edges = [e for e in starts[::CHUNKS_AT_A_TIME].tolist() if start < e < stop]
    yield from pairwise([start, *edges, stop] if start < stop else [])


def _require_codec_of_kind(reader: Reader) -> None:
    """Raises Corrupt for a motion by a codec of point clouds, or the other way round."""
    codec, about = reader.encoded.codec, reader.encoded.about
    if codec in codecs.CODECS and (codec in codecs.CLOUD_CODECS) == isinstance(about, Motion):
        kind = "a motion" if isinstance(about, Motion) else "point clouds"
        raise Corrupt(f"{reader.source.name or 'the file'}: holds {kind}, which {codec} does not code")


def _require_memory(count: int, points: int) -> None:
    """Raises BadInput if the positions of `count` frames exceed the memory of this machine."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # a system that does not say
        memory = 1 << 40
    if count * points * 24 > memory:
        raise BadInput(f"{count:,} frames of {points} points need more memory than there is; decode fewer at a time")


def of_kind(recording: Recording, kind: type[Recording] | None, path: object) -> Recording:
    """The recording. Raises BadInput if it is not of this kind, and for anything else than a kind."""
    if kind is not None and kind not in IN_WORDS:
        raise BadInput(f"the kind is mocodec.Motion or mocodec.PointClouds, not {kind!r}")
    if kind is not None and not isinstance(recording, kind):
        where = f"{path}: " if path else ""
        raise BadInput(f"{where}this file holds {IN_WORDS[type(recording)]}, not {IN_WORDS[kind]}")
    return recording


IN_WORDS: dict[type, str] = {Motion: "a motion", PointClouds: "point clouds"}


def _reopenable(source: Source) -> Reopenable | None:
    """What opens the same file again, in another folder too; None for a file object."""
    if isinstance(source, (bytes, bytearray, memoryview)):
        return bytes(source)
    if isinstance(source, FileRange):
        return source if "://" in source.path else replace(source, path=os.path.abspath(source.path))
    if isinstance(source, (str, PathLike)):
        path = os.fspath(source)
        return path if "://" in path else os.path.abspath(path)
    return None


def _open_again(source: Reopenable, salvage: bool) -> File[Any]:
    """Unpickle a File."""
    return open(source, salvage=salvage)
