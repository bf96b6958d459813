"""Pictures as H.265 packets and back, through PyAV. Planes are coded as they are, without conversion of range.

    key picture ────► key packet (stored once, with the model) ──┐
    later pictures ─► predicted packets (in chunks) ─────────────┴──► pictures

The pictures of every chunk are coded as if they followed the key picture directly. So a chunk decodes from the key
packet and itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from importlib import import_module
from typing import Any

import numpy as np

from ...errors import Corrupt, MissingExtra
from ...typing import Bytes

NOMINAL_RATE = Fraction(30)  # pictures a second; x265 needs one, no decoder uses it
LOW_DELAY = 1 << 19  # FFmpeg's flag: a packet yields its picture at once
STEPS_PER_HALVING = 6  # of the rate factor, that halve the error
X265 = (
    "log-level=none:info=0:bframes=0:rc-lookahead=0:keyint=-1:scenecut=0:frame-threads=1:pools=none"
    ":psy-rd=0:psy-rdoq=0:aq-mode=0:rdoq-level=2:rd=6:tu-intra-depth=4"  # minimise squared error, not visible error
)


def _av() -> Any:
    try:
        return import_module("av")
    except ImportError:
        raise MissingExtra("coding a body's atlas as video", "cloud") from None


def encode(pictures: Iterable[Bytes], key_crf: int, crf: int, preset: str = "fast") -> list[bytes]:
    """One packet for each picture (3, height, width) of Y, Cb, Cr.

    The first packet decodes alone, and does not depend on the pictures that follow. key_crf, crf: x265's rate factors,
    0 (best) to 51, of the first picture and of the others. Raises MissingExtra.
    """
    av = _av()
    context, packets = None, list[bytes]()
    for i, planes in enumerate(pictures):
        if context is None:
            context = av.CodecContext.create("libx265", "w")
            context.width, context.height, context.pix_fmt = planes.shape[2], planes.shape[1], "yuv444p"
            context.time_base, context.framerate, context.thread_count = 1 / NOMINAL_RATE, NOMINAL_RATE, 1
            ratio = f":ipratio={2 ** (max(crf - key_crf, 0) / STEPS_PER_HALVING):.4f}"
            options = {"crf": str(crf), "preset": preset, "tune": "zerolatency", "x265-params": X265 + ratio}
            context.options = options
        frame = av.VideoFrame(planes.shape[2], planes.shape[1], "yuv444p")
        for plane, values in zip(frame.planes, planes, strict=True):
            padded = np.zeros((plane.height, plane.line_size), np.uint8)
            padded[:, : values.shape[1]] = values
            plane.update(padded.tobytes())
        frame.pts, frame.time_base = i, 1 / NOMINAL_RATE
        packets += [bytes(packet) for packet in context.encode(frame)]
    if context is not None:
        packets += [bytes(packet) for packet in context.encode(None)]
    return packets


def decode(packets: Iterable[bytes], shape: tuple[int, int]) -> Iterator[Bytes]:
    """The pictures (3, height, width) of packets in order. shape: (height, width). Raises Corrupt, MissingExtra."""
    av = _av()
    context = av.CodecContext.create("hevc", "r")
    context.thread_count = 1
    context.flags |= LOW_DELAY
    packets = list(packets)
    count = 0
    try:
        for packet in [*packets, None]:
            for frame in context.decode(av.Packet(packet) if packet is not None else None):
                if (frame.height, frame.width) != shape or frame.format.name != "yuv444p":
                    size = f"{frame.height} × {frame.width} {frame.format.name}"
                    raise Corrupt(f"bodycast: a picture is {size}, not {shape[0]} × {shape[1]} yuv444p")
                count += 1
                rows = [
                    np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)[:, : shape[1]]
                    for plane in frame.planes
                ]
                yield np.stack(rows)
    except av.FFmpegError as error:
        raise Corrupt(f"bodycast: a picture is damaged ({error})") from None
    if count != len(packets):
        raise Corrupt(f"bodycast: {len(packets)} packets of video hold {count} pictures")
