"""Byte stream of the rivals: a header, and one or more blobs per frame."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Sequence
from typing import NamedTuple

from mocodec.entropy import varint
from mocodec.metrics import splats
from mocodec.pointcloud import PointClouds
from mocodec.typing import Bytes, Floats

from . import maps

Frame = tuple[Floats, Bytes]
"""Points (n, 3) and colours (n, 3)."""
HEADER = struct.Struct("<dBI")
CAMERAS = struct.Struct("<6f")


class Header(NamedTuple):
    """Frame rate, vertical axis, whether there are colours, number of frames, and extra bytes of a rival."""

    rate: float
    up: str
    coloured: bool
    frames: int
    extra: bytes


def pack(clouds: PointClouds, blobs: Sequence[bytes], extra: bytes = b"") -> bytes:
    """Header, the rival's extra bytes, and the blobs with their sizes."""
    head = HEADER.pack(clouds.rate, splats.AXES[clouds.up] | (clouds.colours is not None) << 2, len(clouds))
    return head + varint.write([len(extra), len(blobs), *map(len, blobs)]) + extra + b"".join(blobs)


def unpack(data: bytes) -> tuple[Header, list[bytes]]:
    """Reads the output of `pack`."""
    rate, kind, frames = HEADER.unpack_from(data)
    (extra, count), start = varint.read(data, 2, HEADER.size)
    sizes, start = varint.read(data, count, start)
    ends = [*itertools.accumulate(sizes, initial=start + extra)]
    header = Header(rate, "xyz"[kind & 3], bool(kind & 4), frames, data[start : start + extra])
    return header, [data[i:j] for i, j in itertools.pairwise(ends)]


def pack_cameras(views: maps.Cameras) -> bytes:
    """The cameras of depth maps, for a header's extra bytes."""
    return CAMERAS.pack(*views.numbers())


def cameras(header: Header) -> maps.Cameras:
    """The cameras at the start of a header's extra bytes."""
    return maps.Cameras.of(CAMERAS.unpack_from(header.extra), header.up)


def clouds_from(header: Header, frames: Sequence[Frame]) -> PointClouds:
    """Decoded frames as PointClouds."""
    colours = [c for _, c in frames] if header.coloured else None
    return PointClouds([p for p, _ in frames], header.rate, colours, up=header.up)
