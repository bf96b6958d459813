"""Rival coders of point clouds: alternatives for users, and coders of the paper's comparison.

    zlib                    float32 positions and colours, deflated                                    lossless
    draco                   Draco's kd-tree, positions of `knob` bits, and colours                     frame by frame
    yang-zlib, yang-jpeg    Yang et al. 2006, both schemes: maps of six views with lossless depth      frame by frame
    h264, h265, av1         maps of six views, depth and colour as one video each, and a mask          (see `video`)

The last five code the maps of `maps`, which have about as many pixels as a frame has points. All except zlib and
yang-zlib need packages of the [bench] extra. A stream contains everything that its decoder needs.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mocodec.metrics import splats
from mocodec.pointcloud import PointClouds
from mocodec.typing import Bytes, Floats

from ..packages import installed_version, needs
from . import maps, stream
from .video import Video

Depth = NDArray[np.uint16]
DEPTH_STEP = 0.001
"""Step of losslessly coded depth maps, metres."""
X265 = "log-level=none:pools=1:frame-threads=1:keyint=-1"


class CloudRival(Protocol):
    """A coder of point clouds. knobs: its settings, from fine to coarse; knob_name: their name in tables; counted: the
    contents of its bytes.
    """

    @property
    def name(self) -> str: ...

    @property
    def knobs(self) -> tuple[int, ...]: ...

    @property
    def knob_name(self) -> str: ...

    @property
    def counted(self) -> str: ...

    def encode(self, clouds: PointClouds, knob: int) -> bytes:
        """Raises MissingExtra if its package is not installed, CannotEncode for clouds without points."""
        ...

    def decode(self, data: bytes) -> PointClouds: ...

    def version(self) -> str: ...


@dataclass(frozen=True)
class Zlib:
    """Raw positions, axis by axis, then colours, deflated at the highest level."""

    name: str = "zlib"
    knobs: tuple[int, ...] = (9,)
    knob_name: str = "level"
    counted: str = "every frame"

    def encode(self, clouds: PointClouds, knob: int) -> bytes:
        blobs = list[bytes]()
        for frame in range(len(clouds)):
            points, colours = splats.finite_points(clouds, frame)
            raw = points.astype("<f4").T.tobytes() + (b"" if colours is None else colours.T.tobytes())
            blobs.append(zlib.compress(raw, knob))
        return stream.pack(clouds, blobs)

    def decode(self, data: bytes) -> PointClouds:
        header, blobs = stream.unpack(data)
        frames = list[stream.Frame]()
        for raw in map(zlib.decompress, blobs):
            count = len(raw) // (15 if header.coloured else 12)
            points = np.frombuffer(raw, "<f4", 3 * count).reshape(3, count).T.astype(np.float64)
            frames.append((points, np.frombuffer(raw, np.uint8, offset=12 * count).reshape(3, -1).T))
        return stream.clouds_from(header, frames)

    def version(self) -> str:
        return zlib.ZLIB_RUNTIME_VERSION


@dataclass(frozen=True)
class Draco:
    """Draco at its best compression, with positions of `knob` bits within the bounding box of each frame."""

    name: str = "draco"
    knobs: tuple[int, ...] = (11, 9, 7)
    knob_name: str = "bits"
    counted: str = "every frame"

    def encode(self, clouds: PointClouds, knob: int) -> bytes:
        draco = needs("DracoPy")
        blobs = list[bytes]()
        for frame in range(len(clouds)):
            points, colours = splats.finite_points(clouds, frame)
            settings = {"quantization_bits": knob, "compression_level": 10, "colors": colours}
            blobs.append(draco.encode(points.astype(np.float32), **settings) if len(points) else b"")
        return stream.pack(clouds, blobs)

    def decode(self, data: bytes) -> PointClouds:
        draco = needs("DracoPy")
        header, blobs = stream.unpack(data)
        empty = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
        found = (draco.decode(blob) if blob else None for blob in blobs)
        frames = [empty if f is None else (np.asarray(f.points, np.float64), f.colors) for f in found]
        return stream.clouds_from(header, frames)

    def version(self) -> str:
        return installed_version("DracoPy")


@dataclass(frozen=True)
class YangZlib:
    """Yang et al. (2006), first scheme: lossless depth, colours of `knob` bits per channel, no background; depth and
    colour together in zlib.
    """

    name: str = "yang-zlib"
    knobs: tuple[int, ...] = (6, 4)
    knob_name: str = "colour bits"
    counted: str = "six views of every frame, cameras"

    def encode(self, clouds: PointClouds, knob: int) -> bytes:
        views = maps.cameras(clouds)
        blobs = list[bytes]()
        for depth, colour in _maps_of(clouds, views):
            shown = depth != 0
            reduced = colour[shown] >> (8 - knob)
            blobs.append(zlib.compress(_planes(depth) + reduced.T.tobytes(), 6))
        return stream.pack(clouds, blobs, stream.pack_cameras(views) + bytes([knob]))

    def decode(self, data: bytes) -> PointClouds:
        header, blobs = stream.unpack(data)
        views, bits = stream.cameras(header), header.extra[-1]
        frames = list[stream.Frame]()
        for raw in map(zlib.decompress, blobs):
            depth, at = _from_planes(raw, views)
            reduced = np.frombuffer(raw, np.uint8, offset=at).reshape(3, -1).T
            colour = np.zeros((*depth.shape, 3), np.uint8)
            colour[depth != 0] = (reduced << (8 - bits)) + (1 << (7 - bits) if bits < 8 else 0)
            frames.append(maps.inverse(_metres(depth), colour, views))
        return stream.clouds_from(header, frames)

    def version(self) -> str:
        return zlib.ZLIB_RUNTIME_VERSION


@dataclass(frozen=True)
class YangJpeg:
    """Yang et al. (2006), second scheme: colour as motion JPEG of quality `knob`; lossless depth with run lengths and a
    Huffman code (deflate with distance-one matches only).
    """

    name: str = "yang-jpeg"
    knobs: tuple[int, ...] = (75, 40)
    knob_name: str = "quality"
    counted: str = "six views of every frame, cameras"

    def encode(self, clouds: PointClouds, knob: int) -> bytes:
        image = needs("PIL.Image")
        views = maps.cameras(clouds)
        blobs = list[bytes]()
        for depth, colour in _maps_of(clouds, views):
            runs = zlib.compressobj(9, strategy=zlib.Z_RLE)
            blobs.append(runs.compress(_planes(depth)) + runs.flush())
            out = io.BytesIO()
            flat = maps.padded(maps.atlas(colour).astype(float), maps.atlas(depth) != 0)
            image.fromarray(np.rint(flat).astype(np.uint8)).save(out, "JPEG", quality=knob, optimize=True)
            blobs.append(out.getvalue())
        return stream.pack(clouds, blobs, stream.pack_cameras(views))

    def decode(self, data: bytes) -> PointClouds:
        image = needs("PIL.Image")
        header, blobs = stream.unpack(data)
        views = stream.cameras(header)
        frames = list[stream.Frame]()
        for runs, still in zip(blobs[::2], blobs[1::2], strict=True):
            depth, _ = _from_planes(zlib.decompress(runs), views)
            colour = np.asarray(image.open(io.BytesIO(still)))
            frames.append(maps.inverse(_metres(depth), maps.cut(colour), views))
        return stream.clouds_from(header, frames)

    def version(self) -> str:
        return f"Pillow {installed_version('pillow')}"


RIVALS: dict[str, CloudRival] = {
    rival.name: rival
    for rival in (
        Zlib(),
        Draco(),
        YangZlib(),
        YangJpeg(),
        Video("h264", "libx264", "h264", (28, 36, 44), 16, (("preset", "medium"),)),
        Video("h265", "libx265", "hevc", (28, 36, 44), 16, (("preset", "medium"), ("x265-params", X265))),
        Video("av1", "libsvtav1", "libdav1d", (34, 46, 58), 22, (("preset", "6"), ("svtav1-params", "lp=1"))),
    )
}


def _maps_of(clouds: PointClouds, views: maps.Cameras) -> Iterator[tuple[Depth, Bytes]]:
    """Yields depth, in steps of DEPTH_STEP (0: no point), and colour of the maps of each frame."""
    for frame in range(len(clouds)):
        depth, colour = maps.forward(*splats.finite_points(clouds, frame), views)
        steps = np.rint(np.nan_to_num(depth) / DEPTH_STEP) + 32768
        yield np.where(np.isfinite(depth), np.clip(steps, 1, 65535), 0).astype(np.uint16), colour


def _metres(depth: Depth) -> Floats:
    """Depth in metres, NaN without a point."""
    return np.where(depth != 0, (depth.astype(float) - 32768) * DEPTH_STEP, np.nan)


def _planes(depth: Depth) -> bytes:
    """Byte planes: all high bytes, then all low bytes, for longer runs and matches."""
    return (depth >> 8).astype(np.uint8).tobytes() + depth.astype(np.uint8).tobytes()


def _from_planes(raw: bytes, views: maps.Cameras) -> tuple[Depth, int]:
    """Depth maps, and the offset of the end of their bytes."""
    shape = maps.VIEWS, views.rows, views.columns
    pixels = int(np.prod(shape))
    high, low = np.frombuffer(raw, np.uint8, 2 * pixels).reshape(2, *shape).astype(np.uint16)
    return (high << 8 | low).astype(np.uint16), 2 * pixels
