"""Point clouds in video codecs: depth and colour maps of six views as two videos, and a mask."""

from __future__ import annotations

import lzma
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocodec.entropy import varint
from mocodec.metrics import splats
from mocodec.pointcloud import PointClouds
from mocodec.typing import Bytes, Floats

from ..packages import installed_version, needs
from . import maps, stream

Planes = tuple[NDArray[Any], ...]
"""Luma and the two chroma planes of a picture."""


@dataclass(frozen=True)
class Video:
    """Depth and colour maps of six views as two videos at constant quality; a picture shows all six views.

    knob: the codec's quantiser (crf) for colour. The quantiser for depth is lower by `depth_finer`, chosen by trial:
    bytes reduce D1 and improve the rendered views more in depth than in colour. Depth is the luma of 10-bit pictures
    over the depth range of the scene (a step is about 2 mm) with constant chroma; colour is full-range 8-bit 4:2:0.
    Both are filled smoothly beyond the silhouette. A lossless mask, one bit per pixel (LZMA), marks the person's
    pixels. Planes are written directly to the frames: a conversion of pixel formats would reduce depth to video's
    limited range. Only the first picture of each video is an intra picture.
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
        views = maps.cameras(clouds)
        reach = 2 * views.across / 1023
        masks, depths, colours = list[Bytes](), list[Planes](), list[Planes]()
        for frame in range(len(clouds)):
            depth, colour = maps.forward(*splats.finite_points(clouds, frame), views)
            mask, flat = maps.atlas(np.isfinite(depth)), maps.atlas(depth)
            masks.append(np.packbits(mask.T))  # column by column, since runs are longest along the body
            levels = np.clip(np.rint((maps.padded(flat[..., None], mask)[..., 0] + views.across) / reach), 0, 1023)
            flat_chroma = np.full((len(levels) // 2, len(levels[0]) // 2), 512, np.uint16)
            depths.append((levels.astype(np.uint16), flat_chroma, flat_chroma))
            colours.append(to_video(maps.padded(maps.atlas(colour).astype(float), mask)))
        blobs = [lzma.compress(np.stack(masks).tobytes(), format=lzma.FORMAT_ALONE)]
        finer = max(1, knob - self.depth_finer)
        blobs += [
            self.encode_video(depths, "yuv420p10le", finer, clouds.rate),
            self.encode_video(colours, "yuv420p", knob, clouds.rate),
        ]
        return stream.pack(clouds, blobs, stream.pack_cameras(views))

    def decode(self, data: bytes) -> PointClouds:
        header, (packed, depths, colours) = stream.unpack(data)
        views = stream.cameras(header)
        reach = 2 * views.across / 1023
        shape = 2 * views.rows, 3 * views.columns
        masks = np.unpackbits(np.frombuffer(lzma.decompress(packed), np.uint8)).reshape(header.frames, *shape[::-1])
        frames = list[stream.Frame]()
        pictures = zip(self.decode_video(depths, "yuv420p10le"), self.decode_video(colours, "yuv420p"), strict=True)
        for mask, ((luma, *_), planes) in zip(masks, pictures, strict=True):
            depth = np.where(mask.T, luma * reach - views.across, np.nan)
            frames.append(maps.inverse(maps.cut(depth), maps.cut(from_video(planes)), views))
        return stream.clouds_from(header, frames)

    def encode_video(self, pictures: Sequence[Planes], layout: str, crf: int, rate: float) -> bytes:
        """Encode pictures; returns the packets, each preceded by its length, without a file format."""
        av = needs("av")
        os.environ.setdefault("SVT_LOG", "1")  # otherwise SVT-AV1 writes its settings to standard error
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

    def decode_video(self, data: bytes, layout: str) -> Iterator[Planes]:
        """Decode the packets of `encode_video`; yields the planes of each picture."""
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


def to_video(rgb: Floats) -> Planes:
    """RGB (rows, columns, 3), 0 to 255, as 8-bit luma and half-size chroma planes: full-range BT.601."""
    red, green, blue = np.moveaxis(rgb, -1, 0)
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    chroma = ((blue - luma) / 1.772 + 128, (red - luma) / 1.402 + 128)
    halves = (c.reshape(c.shape[0] // 2, 2, c.shape[1] // 2, 2).mean(axis=(1, 3)) for c in chroma)
    return tuple(np.clip(np.rint(p), 0, 255).astype(np.uint8) for p in (luma, *halves))


def from_video(planes: Planes) -> Bytes:
    """RGB (rows, columns, 3) from the planes of `to_video`."""
    luma = planes[0].astype(float)
    cb, cr = (p.repeat(2, axis=0).repeat(2, axis=1).astype(float) - 128 for p in planes[1:])
    red, blue = luma + 1.402 * cr, luma + 1.772 * cb
    green = (luma - 0.299 * red - 0.114 * blue) / 0.587
    return np.clip(np.rint(np.stack([red, green, blue], axis=-1)), 0, 255).astype(np.uint8)
