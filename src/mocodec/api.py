"""The public verbs: read, write, encode, decode, open, compare.

file ─read─► Motion ─encode─► bytes of a .mocz ─decode─► Motion ─write─► file
                                 └─open─► slices, without reading the rest
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, Self, cast

from . import codecs, container, formats
from .encoded import TARGETS, Encoded
from .errors import BadInput, CannotEncode
from .metrics import compare
from .motion import Deferred, Motion, frame_range, point_columns
from .pointcloud import PointClouds

__all__ = ["File", "compare", "decode", "encode", "open", "read", "write"]

Path_ = str | PathLike[str]
Source = bytes | bytearray | memoryview | Path_ | BinaryIO
ATTEMPTS = 4  # at a size or a ratio


def read(path: Path_, **options: Any) -> Motion | PointClouds:
    """Read any file that mocodec knows, by its suffix: .c3d .trc .bvh .amc .npz …, a folder of .ply, or a .mocz.

    options go to the format's reader (`asf=` for an .amc). Raises BadInput, and the container's errors for a .mocz.
    """
    if Path(path).suffix.lower() == ".mocz":
        if options:
            raise BadInput(f"{path}: a .mocz is read without options, not with {', '.join(options)}")
        return decode(path)
    return formats.read(path, **options)


def write(path: Path_, motion: Motion | PointClouds, **options: Any) -> None:
    """Write by suffix; for a .mocz the options are those of `encode`. The file appears whole or not at all.

    What a format has no place for beside the positions (a .trc for analog channels, say) is left out;
    `formats.dropped(path, motion)` says what that is. Raises BadInput, and CannotEncode for a .mocz.
    """
    if Path(path).suffix.lower() == ".mocz":
        formats.replace_whole(path, encode(motion, **options))
    else:
        formats.write(path, motion, **options)


def encode(motion: Motion | PointClouds, codec: Any = None, **options: Any) -> bytes:
    """A motion, or point clouds, as the bytes of a .mocz.

    codec: a name, or an instance with settings such as `Hou2014(components=40)`; unless given, "tempo" for motion and
    "bodycast" for point clouds. options: settings by keyword, among them the targets `max_error`, `mean_error`
    (metres), `ratio`, `size`. Raises BadInput for a setting the codec does not have, CannotEncode where it cannot do
    what was asked.
    """
    if not isinstance(cast(object, motion), (Motion, PointClouds)):
        raise BadInput(
            f"encode takes a Motion or PointClouds, not {type(motion).__name__}; see Motion(positions, rate)"
        )
    return pack(with_options(codec or default_codec(motion), **options), motion)


def pack(codec: Any, motion: Motion | PointClouds) -> bytes:
    """A motion coded with this codec, as a file: `size` holds for the whole file, `ratio` for all of it but the extras.

    A codec counts its own bytes only; where the file around them is too much, it is asked for that much less.
    Raises CannotEncode where nothing is left to ask for.
    """
    encoded = codec.encode(motion)
    blob = container.pack(encoded)
    steered_by = next((name for name in ("size", "ratio") if getattr(codec, name, None)), None)
    if steered_by is None:
        return blob
    settings = encoded.settings
    limit = codec.size if steered_by == "size" else motion.raw_bytes / codec.ratio + extras_bytes(blob)
    asked = codec.size if steered_by == "size" else motion.raw_bytes / codec.ratio
    for _ in range(ATTEMPTS):
        if len(blob) <= limit:
            return blob
        asked = math.floor(asked - (len(blob) - limit))
        if asked < 1:
            break
        less = dataclasses.replace(codec, **{steered_by: asked if steered_by == "size" else motion.raw_bytes / asked})
        encoded = dataclasses.replace(less.encode(motion), settings=settings)
        blob = container.pack(encoded)
    if len(blob) <= limit:
        return blob
    raise CannotEncode(
        f"{codec.name} does not come down to {limit:.0f} bytes with the file around it, only to {len(blob)}"
    )


def extras_bytes(blob: bytes) -> int:
    """The bytes in a file of what is beside the points."""
    with open(blob) as f:
        return f.info["bytes_by_part"]["extras"]


def default_codec(motion: Motion | PointClouds) -> str:
    """The codec that is used where none is named."""
    return "tempo" if isinstance(motion, Motion) else "bodycast"


def with_options(codec: Any, **options: Any) -> Any:
    """A codec, by name or as it is, with these settings. Raises BadInput for a setting that it does not have."""
    chosen = codecs.codec_class(codec)() if isinstance(codec, str) else codec
    known = [f.name for f in dataclasses.fields(chosen)]
    for name in options:
        if name not in known:
            what = "target" if name in TARGETS else "setting"
            raise BadInput(f"{chosen.name} has no {what} {name!r}; it has: {', '.join(known)}")
    return dataclasses.replace(chosen, **options)


def decode(source: Source) -> Any:
    """The motion (or point clouds) of a .mocz: bytes, a path, a URL or a file object; extras and all.

    Raises Truncated, Corrupt, TooNew, UnknownCodec, BadInput.
    """
    with open(source) as f:
        motion = f[:]
        if isinstance(motion.extras, Deferred):
            motion = dataclasses.replace(motion, extras=dict(motion.extras))
        return motion


def open(source: Source, salvage: bool = False) -> File:
    """Open a .mocz for random access: a path (str or PathLike), an http(s) URL, bytes or a binary file object.

    Reads header and index only. salvage: open what is left of a file that was cut off; see `File.whole`.
    Raises Truncated, Corrupt, TooNew, UnknownCodec, BadInput.
    """
    return File(container.Reader(source, salvage))


class File:
    """An open .mocz: `f[1200:1320]`, `f[1200:1320, ["LKNE"]]`, `f.at(seconds=slice(10.0, 11.0))`, `for chunk in f`."""

    def __init__(self, reader: container.Reader) -> None:
        self._reader = reader
        self.encoded: Encoded[Any] = reader.encoded

    @property
    def codec(self) -> Any:
        """The class of the codec that made the file. Raises UnknownCodec: names and `info` can be had without it."""
        return codecs.codec_class(self.encoded.codec)

    @property
    def shape(self) -> tuple[int, ...]:
        """(frames, points, 3) of a motion, (frames,) of point clouds."""
        about = self.encoded.about
        return (self.encoded.frames, about.points, 3) if isinstance(about, Motion) else (self.encoded.frames,)

    @property
    def rate(self) -> float:
        return self.encoded.about.rate

    @property
    def names(self) -> tuple[str, ...]:
        about = self.encoded.about
        return about.names if isinstance(about, Motion) else ()

    @property
    def info(self) -> dict[str, Any]:
        """What the file holds, as JSON values: the keys of `mocodec info --json`."""
        return self._reader.info()

    def __len__(self) -> int:
        return self.encoded.frames

    def __getitem__(self, key: slice | tuple[slice, Sequence[str]]) -> Any:
        frames, names = key if isinstance(key, tuple) else (key, None)
        frame_range(frames, len(self))
        if names is not None:
            point_columns(self.names, names)
        with self._reader.errors_name_file():
            motion = self.codec.decode(self.encoded, frames)
        return motion if names is None else motion.select(names)

    def at(self, seconds: slice) -> Any:
        """Frames whose time (frame / rate) falls into [start, stop) seconds. Raises BadInput for a step, or below 0."""
        if not isinstance(cast(object, seconds), slice) or seconds.step is not None:
            raise BadInput("times are chosen by a slice without a step, such as f.at(seconds=slice(10.0, 11.0))")
        return self[self._frame(seconds.start) : self._frame(seconds.stop)]

    def _frame(self, second: float | None) -> int | None:
        """The first frame at or after this time; a rounding error of the product does not make it one later."""
        if second is None:
            return None
        if not second >= 0:
            raise BadInput(f"times count from the first frame, from 0 on, not {second}")
        return min(math.ceil(second * self.rate - 1e-6), len(self))

    def whole(self) -> list[tuple[int, int]]:
        """Runs of frames (start, stop) that are undamaged: slices that decode, also of a file opened with `salvage`."""
        return self._reader.intact_runs()

    def verify(self) -> None:
        """Read every byte and test every checksum. Raises Corrupt that names each damaged part."""
        self._reader.verify()

    def __iter__(self) -> Iterator[Any]:
        for chunk in self.encoded.chunks:
            yield self[chunk.start : chunk.stop]

    def close(self) -> None:
        self._reader.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
