# pyright: strict
"""The public functions: read, write, encode, decode, open, compare.

file ─read─► Motion ─encode─► bytes of a .mocz ─decode─► Motion ─write─► file
                                 └─open─► slices, without reading the rest
"""

from __future__ import annotations

import dataclasses
import math
import os
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import cached_property
from importlib import import_module
from os import PathLike
from typing import TYPE_CHECKING, Any, BinaryIO, Generic, Self, cast, overload

from . import codecs, decoded_chunks, formats
from . import progress as progress_
from .channels import Channel, channels
from .codecs import base
from .codecs.base import Codec
from .encoded import TARGETS, Encoded, Recording, RecordingT
from .errors import BadInput, Corrupt, MocodecError
from .metrics import compare
from .motion import Deferred, Motion, with_signals
from .packing import default_codec, pack, with_options
from .pointcloud import PointClouds
from .progress import Callback
from .selection import Frames, counted, frame_steps, point_columns, split_key

if TYPE_CHECKING:
    from .container import Reader  # imported where it is used: it makes `import mocodec` a quarter slower

__all__ = ["File", "compare", "decode", "encode", "not_kept", "open", "read", "write"]

AnyPath = str | PathLike[str]
Source = bytes | bytearray | memoryview | AnyPath | BinaryIO


@overload
def read(path: AnyPath, kind: type[RecordingT], **options: Any) -> RecordingT: ...
@overload
def read(path: AnyPath, kind: None = None, *, asf: AnyPath, **options: Any) -> Motion: ...
@overload
def read(path: AnyPath, kind: None = None, *, fps: float, **options: Any) -> PointClouds: ...
@overload
def read(path: AnyPath, kind: None = None, **options: Any) -> Recording: ...
def read(path: AnyPath, kind: type[Recording] | None = None, **options: Any) -> Recording:
    """Read a .c3d, .trc, .bvh, .amc, .npz, .glb, .ply, a folder of .ply, or a .mocz; the suffix decides.

    kind: `Motion` or `PointClouds`: a file of the other kind is an error, and type checkers know the result. options
    are those of the format's reader (`asf=` for an .amc, `fps=` for a folder of .ply; docs/formats.md).
    Raises BadInput; for a .mocz also what `decode` raises.
    """
    if is_mocz(path):
        if options:
            raise BadInput(f"{os.fspath(path)}: reading a .mocz takes no options, but got {', '.join(options)}")
        return decode(path, kind)
    return _of_kind(formats.read(path, **options), kind, path)


def write(path: AnyPath, recording: Recording, **options: Any) -> None:
    """Write a file in the format of its suffix; for a .mocz, options are those of `encode`.

    The file appears complete or not at all. A format that cannot store all of the recording (a .trc has no analog
    channels) leaves the rest out; `mocodec.formats.dropped(path, recording)` lists it.
    Raises BadInput; for a .mocz also CannotEncode.
    """
    if is_mocz(path):
        formats.replace_whole(path, encode(recording, **options))
    else:
        formats.write(path, recording, **options)


@overload
def encode(
    recording: Motion,
    codec: str | Codec[Motion] | None = None,
    *,
    max_error: float | None = None,
    mean_error: float | None = None,
    ratio: float | None = None,
    size: int | None = None,
    signal_error: str | None = None,
    progress: Callback | None = None,
    **settings: Any,
) -> bytes: ...
@overload
def encode(
    recording: PointClouds,
    codec: str | Codec[PointClouds] | None = None,
    *,
    max_error: float | None = None,
    mean_error: float | None = None,
    ratio: float | None = None,
    size: int | None = None,
    psnr: float | None = None,
    progress: Callback | None = None,
    **settings: Any,
) -> bytes: ...
@overload
def encode(
    recording: Recording,
    codec: str | None = None,
    *,
    max_error: float | None = None,
    mean_error: float | None = None,
    ratio: float | None = None,
    size: int | None = None,
    signal_error: str | None = None,
    progress: Callback | None = None,
    **settings: Any,
) -> bytes: ...
def encode(
    recording: Recording,
    codec: str | Codec[Any] | None = None,
    *,
    signal_error: str | None = None,
    progress: Callback | None = None,
    **settings: Any,
) -> bytes:
    """Encode a motion or point clouds as the bytes of a .mocz.

    codec: a name, or an instance such as `Hou2014(components=40)`; by default "tempo" for motion and "bodycast" for
    point clouds. Targets: `max_error` (no point of any frame is farther off, metres), `mean_error` (metres), `ratio`
    (to float32 positions), `size` (bytes of the file); of point clouds, whose errors are distances to the nearest point
    in both directions, also `psnr` (of the luma, dB). signal_error: how far samples of signals may be off, "12bit" or
    "0.1%" of their range or by label "Fz*=0.5N, EMG*=12bit"; None keeps them exactly. settings: other settings of the
    codec. progress: called with fractions from 0 to 1.
    Raises BadInput for settings that the codec does not have, CannotEncode if it cannot meet them.
    """
    if not isinstance(cast(object, recording), (Motion, PointClouds)):
        raise BadInput(
            f"encode takes a Motion or PointClouds, not {type(recording).__name__}; make one with "
            "mocodec.Motion(positions, rate)"
        )
    chosen = with_options(codec or default_codec(recording), **without_empty_targets(settings))
    with progress_.listening(progress):
        return pack(chosen, recording, signal_error)


def not_kept(recording: Recording, codec: str | Codec[Any] | None = None) -> list[str]:
    """What a codec will not keep of a recording, in words, before anything is encoded: rotations, joint limits.

    codec: a name or an instance; by default that of `encode`. Positions are kept within the target of the codec, and
    `extras` without loss. Offsets of a skeleton are rounded to 10 µm, but for the lossless codec. Raises BadInput.
    """
    return base.not_kept(with_options(codec or default_codec(recording)), recording)


def without_empty_targets(settings: dict[str, Any]) -> dict[str, Any]:
    """The settings without the targets that are None."""
    return {name: value for name, value in settings.items() if value is not None or name not in TARGETS}


@overload
def decode(source: Source, kind: type[RecordingT], *, progress: Callback | None = None) -> RecordingT: ...
@overload
def decode(source: Source, kind: None = None, *, progress: Callback | None = None) -> Recording: ...
def decode(source: Source, kind: type[Recording] | None = None, *, progress: Callback | None = None) -> Recording:
    """Decode a .mocz: bytes, a path, an http(s) URL or a binary file object.

    kind: `Motion` or `PointClouds`, as in `read`. progress: called with fractions from 0 to 1.
    Raises Truncated, Corrupt, TooNew, UnknownCodec, BadInput.
    """
    with progress_.listening(progress), open(source, kind) as f:
        recording = f.decode(slice(0, len(f)))
        if isinstance(recording.extras, Deferred):
            recording = dataclasses.replace(
                recording, extras=with_signals(recording.extras, lambda signal: signal.loaded())
            )
        return recording


@overload
def open(source: Source, kind: type[RecordingT], *, salvage: bool = False) -> File[RecordingT]: ...
@overload
def open(source: Source, kind: None = None, *, salvage: bool = False) -> File[Recording]: ...
def open(source: Source, kind: type[Recording] | None = None, *, salvage: bool = False) -> File[Any]:
    """Open a .mocz for random access: a path, an http(s) URL, bytes or a binary file object.

    Only header and index are read. kind: `Motion` or `PointClouds`, as in `read`. salvage: open the undamaged chunks
    of a file that was cut short; see `File.whole`.
    Raises Truncated, Corrupt, TooNew, UnknownCodec, BadInput.
    """
    from . import container

    reader = container.Reader(source, salvage)
    try:
        _of_kind(reader.encoded.about, kind, reader.source.name)
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

    def __init__(self, reader: Reader, reopen_from: str | bytes | None = None, salvage: bool = False) -> None:
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

    def decode(self, frames: slice, *, keep_chunks: bool = False) -> RecordingT:
        """Frames [start, stop), decoded from the file, or cut from the decoded chunks in memory."""
        decode = self.codec.decode
        with self._reader.errors_name_file():
            _require_memory(frames.stop - frames.start, len(self.names))
            if not keep_chunks or not isinstance(self.encoded.about, Motion):
                return decode(self.encoded, frames)
            encoded, starts = cast("Encoded[Motion]", self.encoded), self._reader.chunks.starts
            of_motion = cast("decoded_chunks.Decode", decode)
            return cast("RecordingT", decoded_chunks.window(self._number, of_motion, encoded, starts, frames))

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


def is_mocz(path: AnyPath) -> bool:
    """Whether a path has the suffix .mocz."""
    return os.fspath(path).lower().endswith(".mocz")


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


def _of_kind(recording: Recording, kind: type[Recording] | None, path: object) -> Recording:
    """The recording. Raises BadInput if it is not of this kind."""
    if kind is not None and not isinstance(recording, kind):
        where = f"{path}: " if path else ""
        raise BadInput(f"{where}this file holds {IN_WORDS[type(recording)]}, not {IN_WORDS[kind]}")
    return recording


IN_WORDS: dict[type, str] = {Motion: "a motion", PointClouds: "point clouds"}


def _reopenable(source: Source) -> str | bytes | None:
    """What opens the same file again, in another folder too; None for a file object."""
    if isinstance(source, (bytes, bytearray, memoryview)):
        return bytes(source)
    if isinstance(source, (str, PathLike)):
        path = os.fspath(source)
        return path if "://" in path else os.path.abspath(path)
    return None


def _open_again(source: str | bytes, salvage: bool) -> File[Any]:
    """Unpickle a File."""
    return open(source, salvage=salvage)
