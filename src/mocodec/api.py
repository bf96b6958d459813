"""The public verbs: read, write, encode, decode, open, compare.

file ─read─► Motion ─encode─► bytes of a .mocz ─decode─► Motion ─write─► file
                                 └─open─► slices, without reading the rest
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, Self

from . import codecs, container, formats
from .encoded import Encoded
from .errors import BadInput
from .metrics import compare
from .motion import Motion, frame_range, point_columns
from .pointcloud import PointClouds

__all__ = ["File", "compare", "decode", "encode", "open", "read", "write"]

Path_ = str | PathLike[str]
TARGETS = ("max_error", "mean_error", "ratio", "size")


def read(path: Path_, **options: Any) -> Motion | PointClouds:
    """Read any file that mocodec knows, by its suffix: .c3d .trc .bvh .amc .npz …, a folder of .ply, or a .mocz.

    options go to the format's reader (`asf=` for an .amc). Raises BadInput, and the container's errors for a .mocz.
    """
    if Path(path).suffix.lower() == ".mocz":
        return decode(Path(path))
    return formats.read(path, **options)


def write(path: Path_, motion: Motion | PointClouds, **options: Any) -> None:
    """Write by suffix; for a .mocz the options are those of `encode`. The file appears whole or not at all."""
    if Path(path).suffix.lower() == ".mocz":
        formats.replace_whole(path, encode(motion, **options))
    else:
        formats.write(path, motion, **options)


def encode(motion: Motion | PointClouds, codec: Any = "tempo", **options: Any) -> bytes:
    """A motion as the bytes of a .mocz.

    codec: a name, or an instance with settings such as `Hou2014(components=40)`. options: settings by keyword, among
    them the targets `max_error`, `mean_error` (metres), `ratio`, `size`. Raises BadInput for a setting the codec does
    not have, CannotEncode where it cannot do what was asked.
    """
    return container.pack(with_options(codec, **options).encode(motion))


def with_options(codec: Any, **options: Any) -> Any:
    """A codec, by name or as it is, with these settings. Raises BadInput for a setting that it does not have."""
    chosen = codecs.codec_class(codec)() if isinstance(codec, str) else codec
    known = [f.name for f in dataclasses.fields(chosen)]
    for name in options:
        if name not in known:
            what = "target" if name in TARGETS else "setting"
            raise BadInput(f"{chosen.name} has no {what} {name!r}; it has: {', '.join(known)}")
    return dataclasses.replace(chosen, **options)


def decode(source: bytes | Path_ | BinaryIO) -> Any:
    """The motion (or point clouds) of a .mocz: bytes, a path or a file object.

    Raises Truncated, Corrupt, TooNew, UnknownCodec.
    """
    with open(source) as f:
        return f[:]


def open(source: Any) -> File:
    """Open a .mocz for random access: a path, URL, bytes or file object. Reads header and index only."""
    return File(container.Reader(source))


class File:
    """An open .mocz: `f[1200:1320]`, `f[1200:1320, ["LKNE"]]`, `f.at(seconds=slice(10.0, 11.0))`, `for chunk in f`."""

    def __init__(self, reader: container.Reader) -> None:
        self._reader = reader
        self.encoded: Encoded[Any] = reader.encoded
        self.codec = codecs.codec_class(self.encoded.codec)

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
        motion = self.codec.decode(self.encoded, frames)
        return motion if names is None else motion.select(names)

    def at(self, seconds: slice) -> Any:
        """Frames whose time falls into [start, stop) seconds."""
        start, stop = ((None if s is None else round(s * self.rate)) for s in (seconds.start, seconds.stop))
        return self[start:stop]

    def __iter__(self) -> Iterator[Any]:
        for chunk in self.encoded.chunks:
            yield self[chunk.start : chunk.stop]

    def close(self) -> None:
        self._reader.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
