"""Pictures as H.265 packets and back, through PyAV: planes go in and come out as they are, no conversion of range.

    first picture ──► key packet (kept once, with the model) ──┐
    later pictures ──► packets of differences (in chunks) ─────┴──► pictures

Every chunk is coded as if it followed the first picture at once, so that it decodes from the key packet and itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import Corrupt, MissingExtra

Planes = NDArray[np.uint8]  # (3, height, width): Y, U, V
RATE = Fraction(30)  # the video's own clock, which nothing reads
X265 = (
    "log-level=none:info=0:bframes=0:rc-lookahead=0:keyint=-1:scenecut=0:frame-threads=1:pools=none"
    ":psy-rd=0:psy-rdoq=0:aq-mode=0:rdoq-level=2:rd=6:tu-intra-depth=4"  # for numbers, not for eyes: distance is one
)


def _av() -> Any:
    try:
        return import_module("av")
    except ImportError:
        raise MissingExtra("coding a body's atlas as video", "cloud") from None


def encode(pictures: Iterable[Planes], key_quality: int, quality: int, preset: str = "fast") -> list[bytes]:
    """One packet a picture; the first stands alone, and is the same whatever follows it.

    key_quality, quality: x265's rate factors, 0 (best) to 51, of the first picture and of the others.
    """
    av = _av()
    context, packets = None, list[bytes]()
    for i, planes in enumerate(pictures):
        if context is None:
            context = av.CodecContext.create("libx265", "w")
            context.width, context.height, context.pix_fmt = planes.shape[2], planes.shape[1], "yuv444p"
            context.time_base, context.framerate, context.thread_count = 1 / RATE, RATE, 1
            finer = f":ipratio={2 ** (max(quality - key_quality, 0) / 6):.4f}"  # six steps halve the error
            options = {"crf": str(quality), "preset": preset, "tune": "zerolatency", "x265-params": X265 + finer}
            context.options = options
        frame = av.VideoFrame(planes.shape[2], planes.shape[1], "yuv444p")
        for plane, values in zip(frame.planes, planes, strict=True):
            padded = np.zeros((plane.height, plane.line_size), np.uint8)
            padded[:, : values.shape[1]] = values
            plane.update(padded.tobytes())
        frame.pts, frame.time_base = i, 1 / RATE
        packets += [bytes(packet) for packet in context.encode(frame)]
    if context is not None:
        packets += [bytes(packet) for packet in context.encode(None)]
    return packets


def decode(packets: Iterable[bytes], shape: tuple[int, int]) -> Iterator[Planes]:
    """The pictures (3, height, width) of packets in order. Raises Corrupt."""
    av = _av()
    context = av.CodecContext.create("hevc", "r")
    context.thread_count = 1
    context.flags |= 1 << 19  # low delay: every packet gives its picture at once
    packets = list(packets)
    count = 0
    try:
        for packet in [*packets, None]:
            for frame in context.decode(av.Packet(packet) if packet is not None else None):
                if (frame.height, frame.width) != shape or frame.format.name != "yuv444p":
                    raise Corrupt("the atlas has the wrong size")
                count += 1
                rows = [
                    np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)[:, : shape[1]]
                    for plane in frame.planes
                ]
                yield np.stack(rows)
    except av.FFmpegError as error:
        raise Corrupt(f"the atlas is damaged ({error})") from None
    if count != len(packets):
        raise Corrupt(f"the atlas is damaged: {count} pictures of {len(packets)}")
