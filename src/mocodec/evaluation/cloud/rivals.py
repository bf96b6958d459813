"""What a user could pick for point clouds instead, and what the paper compared itself with: PointClouds ⇄ bytes.

    zlib                    float32 positions and colours as they are, deflated                          no loss
    draco                   Draco: a kd-tree of positions of `knob` bits and colours               one frame at a time
    yang-zlib, yang-jpeg    Yang et al. 2006, two schemes: maps of six views, depth without loss   one frame at a time
    h264, h265, av1         maps of six views, depth and colour each as one video, a mask beside them

The last five see the person in `maps`: six depth and colour maps whose pixels are as many as a frame has points. All
need packages of the [bench] extra but zlib and yang-zlib. Each is a small class with `knobs`, `encode`, `decode` and
`version`, so that one loop drives them all; the bytes carry all that decoding needs.
"""

from __future__ import annotations

import io
import itertools
import lzma
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ...entropy import varint
from ...motion import Floats
from ...pointcloud import PointClouds
from ..rivals import installed_version, needs
from . import maps, splats

Image = NDArray[np.uint8]
Frame = tuple[Floats, Image]
Planes = tuple[NDArray[Any], ...]
DEPTH_STEP = 0.001  # metres: of depth maps coded without loss, in 16 bits
HEAD = struct.Struct("<dBI")
X265 = "log-level=none:pools=1:frame-threads=1:keyint=-1"
CAMERAS = struct.Struct("<6f")


class Rival(Protocol):
    """What the runner needs. knobs: the settings that it is measured at; knob_name: what they are; counted: what its
    bytes hold.
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
        """Raises MissingExtra where the package is not there, CannotEncode for clouds without a point."""
        ...

    def decode(self, data: bytes) -> PointClouds: ...

    def version(self) -> str: ...


@dataclass(frozen=True)
class Zlib:
    """The raw bytes, deflated at the highest level: positions by axis, then colours."""

    name: str = "zlib"
    knobs: tuple[int, ...] = (9,)
    knob_name: str = "level"
    counted: str = "every frame"

    def encode(self, clouds: PointClouds, knob: int) -> bytes:
        blobs = list[bytes]()
        for frame in range(len(clouds)):
            points, colours = splats.finite(clouds, frame)
            raw = points.astype("<f4").T.tobytes() + (b"" if colours is None else colours.T.tobytes())
            blobs.append(zlib.compress(raw, knob))
        return _pack(clouds, blobs)

    def decode(self, data: bytes) -> PointClouds:
        about, blobs = _unpack(data)
        frames = list[Frame]()
        for raw in map(zlib.decompress, blobs):
            count = len(raw) // (15 if about.coloured else 12)
            points = np.frombuffer(raw, "<f4", 3 * count).reshape(3, count).T.astype(np.float64)
            frames.append((points, np.frombuffer(raw, np.uint8, offset=12 * count).reshape(3, -1).T))
        return _clouds(about, frames)

    def version(self) -> str:
        return zlib.ZLIB_RUNTIME_VERSION


@dataclass(frozen=True)
class Draco:
    """Draco's point clouds at its best compression, positions of `knob` bits in each frame's own box."""

    name: str = "draco"
    knobs: tuple[int, ...] = (11, 9, 7)
    knob_name: str = "bits"
    counted: str = "every frame"

    def encode(self, clouds: PointClouds, knob: int) -> bytes:
        draco = needs("DracoPy")
        blobs = list[bytes]()
        for frame in range(len(clouds)):
            points, colours = splats.finite(clouds, frame)
            settings = {"quantization_bits": knob, "compression_level": 10, "colors": colours}
            blobs.append(draco.encode(points.astype(np.float32), **settings) if len(points) else b"")
        return _pack(clouds, blobs)

    def decode(self, data: bytes) -> PointClouds:
        draco = needs("DracoPy")
        about, blobs = _unpack(data)
        empty = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
        found = (draco.decode(blob) if blob else None for blob in blobs)
        frames = [empty if f is None else (np.asarray(f.points, np.float64), f.colors) for f in found]
        return _clouds(about, frames)

    def version(self) -> str:
        return installed_version("DracoPy")


@dataclass(frozen=True)
class YangZlib:
    """Yang et al. (2006), first scheme: colours reduced to `knob` bits a channel, the background removed, then zlib
    over depth and colour together; depth loses nothing.
    """

    name: str = "yang-zlib"
    knobs: tuple[int, ...] = (6, 4)
    knob_name: str = "colour bits"
    counted: str = "six views of every frame, cameras"

    def encode(self, clouds: PointClouds, knob: int) -> bytes:
        seen_by = maps.cameras(clouds)
        blobs = list[bytes]()
        for depth, colour in _maps_of(clouds, seen_by):
            shown = depth != 0
            reduced = colour[shown] >> (8 - knob)
            blobs.append(zlib.compress(_planes(depth) + reduced.T.tobytes(), 6))
        return _pack(clouds, blobs, CAMERAS.pack(*seen_by.numbers()) + bytes([knob]))

    def decode(self, data: bytes) -> PointClouds:
        about, blobs = _unpack(data)
        seen_by, bits = _cameras(about), about.more[-1]
        frames = list[Frame]()
        for raw in map(zlib.decompress, blobs):
            depth, at = _from_planes(raw, seen_by)
            reduced = np.frombuffer(raw, np.uint8, offset=at).reshape(3, -1).T
            colour = np.zeros((*depth.shape, 3), np.uint8)
            colour[depth != 0] = (reduced << (8 - bits)) + (1 << (7 - bits) if bits < 8 else 0)
            frames.append(maps.inverse(_metres(depth), colour, seen_by))
        return _clouds(about, frames)

    def version(self) -> str:
        return zlib.ZLIB_RUNTIME_VERSION


@dataclass(frozen=True)
class YangJpeg:
    """Yang et al. (2006), second scheme: colour as motion JPEG of quality `knob`; depth by run lengths and a Huffman
    code (deflate's, with matches of distance one only), without loss.
    """

    name: str = "yang-jpeg"
    knobs: tuple[int, ...] = (75, 40)
    knob_name: str = "quality"
    counted: str = "six views of every frame, cameras"

    def encode(self, clouds: PointClouds, knob: int) -> bytes:
        image = needs("PIL.Image")
        seen_by = maps.cameras(clouds)
        blobs = list[bytes]()
        for depth, colour in _maps_of(clouds, seen_by):
            runs = zlib.compressobj(9, strategy=zlib.Z_RLE)
            blobs.append(runs.compress(_planes(depth)) + runs.flush())
            out = io.BytesIO()
            flat = maps.padded(maps.atlas(colour).astype(float), maps.atlas(depth) != 0)
            image.fromarray(np.rint(flat).astype(np.uint8)).save(out, "JPEG", quality=knob, optimize=True)
            blobs.append(out.getvalue())
        return _pack(clouds, blobs, CAMERAS.pack(*seen_by.numbers()))

    def decode(self, data: bytes) -> PointClouds:
        image = needs("PIL.Image")
        about, blobs = _unpack(data)
        seen_by = _cameras(about)
        frames = list[Frame]()
        for runs, still in zip(blobs[::2], blobs[1::2], strict=True):
            depth, _ = _from_planes(zlib.decompress(runs), seen_by)
            colour = np.asarray(image.open(io.BytesIO(still)))
            frames.append(maps.inverse(_metres(depth), maps.cut(colour), seen_by))
        return _clouds(about, frames)

    def version(self) -> str:
        return f"Pillow {installed_version('pillow')}"


@dataclass(frozen=True)
class Video:
    """Depth and colour maps of six views as two videos, each the six views in one picture, at constant quality.

    knob: the codec's quantiser (crf) of colour. Depth's is lower by `depth_finer`, chosen by trial: bytes do more for
    D1 and for what is seen there than in colour. Depth is the luma of 10-bit pictures over the depth of the scene (a
    step is about 2 mm), with flat chroma; colour is 8-bit 4:2:0 of full range. Both are filled smoothly beyond the
    silhouette; which pixels show the person is a mask, one bit each, without loss (LZMA). Planes are written into the
    frames as they are: a conversion between pixel formats would rescale depth to the limited range of video. One
    picture of each video is coded by itself, the others from their neighbours.
    """

    name: str
    encoder: str
    decoder: str
    knobs: tuple[int, ...]
    depth_finer: int
    options: tuple[tuple[str, str], ...]
    knob_name: str = "crf"
    counted: str = "depth video, colour video, masks, cameras"

    def encode(self, clouds: PointClouds, knob: int) -> bytes:
        seen_by = maps.cameras(clouds)
        reach = 2 * seen_by.across / 1023
        masks, depths, colours = list[Image](), list[Planes](), list[Planes]()
        for frame in range(len(clouds)):
            depth, colour = maps.forward(*splats.finite(clouds, frame), seen_by)
            mask, flat = maps.atlas(np.isfinite(depth)), maps.atlas(depth)
            masks.append(np.packbits(mask.T))  # down the body, where runs are longest
            levels = np.clip(np.rint((maps.padded(flat[..., None], mask)[..., 0] + seen_by.across) / reach), 0, 1023)
            flat_chroma = np.full((len(levels) // 2, len(levels[0]) // 2), 512, np.uint16)
            depths.append((levels.astype(np.uint16), flat_chroma, flat_chroma))
            colours.append(to_video(maps.padded(maps.atlas(colour).astype(float), mask)))
        blobs = [lzma.compress(np.stack(masks).tobytes(), format=lzma.FORMAT_ALONE)]
        finer = max(1, knob - self.depth_finer)
        blobs += [
            self.film(depths, "yuv420p10le", finer, clouds.rate),
            self.film(colours, "yuv420p", knob, clouds.rate),
        ]
        return _pack(clouds, blobs, CAMERAS.pack(*seen_by.numbers()))

    def decode(self, data: bytes) -> PointClouds:
        about, (packed, depths, colours) = _unpack(data)
        seen_by = _cameras(about)
        reach = 2 * seen_by.across / 1023
        shape = 2 * seen_by.rows, 3 * seen_by.columns
        masks = np.unpackbits(np.frombuffer(lzma.decompress(packed), np.uint8)).reshape(about.frames, *shape[::-1])
        frames = list[Frame]()
        pictures = zip(self.pictures(depths, "yuv420p10le"), self.pictures(colours, "yuv420p"), strict=True)
        for mask, ((luma, *_), planes) in zip(masks, pictures, strict=True):
            depth = np.where(mask.T, luma * reach - seen_by.across, np.nan)
            frames.append(maps.inverse(maps.cut(depth), maps.cut(from_video(planes)), seen_by))
        return _clouds(about, frames)

    def film(self, pictures: Sequence[Planes], layout: str, crf: int, rate: float) -> bytes:
        """A video's packets, each with its length before it; no file format around them."""
        av = needs("av")
        os.environ.setdefault("SVT_LOG", "1")  # SVT-AV1 writes its settings on standard error otherwise
        codec = av.CodecContext.create(self.encoder, "w")
        codec.height, codec.width = pictures[0][0].shape
        codec.pix_fmt = layout
        codec.framerate = Fraction(rate).limit_denominator(1001)
        codec.time_base = 1 / codec.framerate
        codec.thread_count = 1
        codec.options = {**dict(self.options), "crf": str(crf), "g": "9999"}
        packets = list[bytes]()
        for time, planes in enumerate(pictures):
            frame = av.VideoFrame(codec.width, codec.height, layout)
            for plane, values in zip(frame.planes, planes, strict=True):
                rows = np.zeros((plane.height, plane.line_size // values.itemsize), values.dtype)
                rows[:, : plane.width] = values
                plane.update(rows)
            frame.pts = time
            packets += [bytes(packet) for packet in codec.encode(frame)]
        packets += [bytes(packet) for packet in codec.encode(None)]
        return b"".join(varint.write([len(p)]) + p for p in packets)

    def pictures(self, data: bytes, layout: str) -> Iterator[Planes]:
        """The planes of a video's pictures."""
        av = needs("av")
        codec = av.CodecContext.create(self.decoder, "r")
        codec.thread_count = 1
        at = 0
        packets = list[Any]()
        while at < len(data):
            (size,), at = varint.read(data, 1, at)
            packets.append(av.Packet(data[at : at + size]))
            at += size
        for packet in (*packets, None):
            for frame in codec.decode(packet):
                assert frame.format.name == layout, frame.format.name
                kind = np.dtype(np.uint8 if layout == "yuv420p" else "<u2")
                yield tuple(
                    np.frombuffer(plane, kind).reshape(plane.height, -1)[:, : plane.width] for plane in frame.planes
                )

    def version(self) -> str:
        needs("av")
        return f"{self.encoder} in av {installed_version('av')}"


RIVALS: dict[str, Rival] = {
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


# --- colour -----------------------------------------------------------------------------------------------------------


def to_video(rgb: Floats) -> Planes:
    """(rows, columns, 3), 0 to 255, as 8-bit planes of luma and of chroma at half the size: BT.601 of full range."""
    red, green, blue = np.moveaxis(rgb, -1, 0)
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    chroma = ((blue - luma) / 1.772 + 128, (red - luma) / 1.402 + 128)
    halves = (c.reshape(c.shape[0] // 2, 2, c.shape[1] // 2, 2).mean(axis=(1, 3)) for c in chroma)
    return tuple(np.clip(np.rint(p), 0, 255).astype(np.uint8) for p in (luma, *halves))


def from_video(planes: Planes) -> Image:
    """The inverse of `to_video`, (rows, columns, 3)."""
    luma = planes[0].astype(float)
    cb, cr = (p.repeat(2, axis=0).repeat(2, axis=1).astype(float) - 128 for p in planes[1:])
    red, blue = luma + 1.402 * cr, luma + 1.772 * cb
    green = (luma - 0.299 * red - 0.114 * blue) / 0.587
    return np.clip(np.rint(np.stack([red, green, blue], axis=-1)), 0, 255).astype(np.uint8)


# --- depth without loss -----------------------------------------------------------------------------------------------


def _maps_of(clouds: PointClouds, seen_by: maps.Cameras) -> Iterator[tuple[NDArray[np.uint16], Image]]:
    """Each frame's depth in steps (0: nothing there) and colour."""
    for frame in range(len(clouds)):
        depth, colour = maps.forward(*splats.finite(clouds, frame), seen_by)
        steps = np.rint(np.nan_to_num(depth) / DEPTH_STEP) + 32768
        yield np.where(np.isfinite(depth), np.clip(steps, 1, 65535), 0).astype(np.uint16), colour


def _metres(depth: NDArray[np.uint16]) -> Floats:
    return np.where(depth != 0, (depth.astype(float) - 32768) * DEPTH_STEP, np.nan)


def _planes(depth: NDArray[np.uint16]) -> bytes:
    """The high bytes, then the low ones: runs and matches are longer so."""
    return (depth >> 8).astype(np.uint8).tobytes() + depth.astype(np.uint8).tobytes()


def _from_planes(raw: bytes, seen_by: maps.Cameras) -> tuple[NDArray[np.uint16], int]:
    """Depth maps, and where their bytes end."""
    shape = maps.VIEWS, seen_by.rows, seen_by.columns
    pixels = int(np.prod(shape))
    high, low = np.frombuffer(raw, np.uint8, 2 * pixels).reshape(2, *shape).astype(np.uint16)
    return (high << 8 | low).astype(np.uint16), 2 * pixels


# --- bytes ------------------------------------------------------------------------------------------------------------


class About(NamedTuple):
    """A stream's header: the clouds' rate, up and frames, whether they have colours, and what a rival adds."""

    rate: float
    up: str
    coloured: bool
    frames: int
    more: bytes


def _pack(clouds: PointClouds, blobs: Sequence[bytes], more: bytes = b"") -> bytes:
    head = HEAD.pack(clouds.rate, splats.AXES[clouds.up] | (clouds.colours is not None) << 2, len(clouds))
    return head + varint.write([len(more), len(blobs), *map(len, blobs)]) + more + b"".join(blobs)


def _unpack(data: bytes) -> tuple[About, list[bytes]]:
    rate, kind, frames = HEAD.unpack_from(data)
    (extra, count), at = varint.read(data, 2, HEAD.size)
    sizes, at = varint.read(data, count, at)
    ends = [*itertools.accumulate(sizes, initial=at + extra)]
    about = About(rate, "xyz"[kind & 3], bool(kind & 4), frames, data[at : at + extra])
    return about, [data[i:j] for i, j in itertools.pairwise(ends)]


def _cameras(about: About) -> maps.Cameras:
    return maps.Cameras.of(CAMERAS.unpack_from(about.more), about.up)


def _clouds(about: About, frames: Sequence[Frame]) -> PointClouds:
    colours = [c for _, c in frames] if about.coloured else None
    return PointClouds([p for p, _ in frames], about.rate, colours, up=about.up)
