# pyright: strict
"""BVH in pieces: the hierarchy once, then frames in blocks of lines. A frame must be one line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from ...errors import BadInput
from ...motion import Motion
from .. import text_lines
from ..blocks import Blocks
from . import reading


def read_blocks(
    path: str | Path, unit: str | float | None = None, rate: float | None = None, up: str | None = None
) -> Blocks:
    """As `reading.read`, in pieces. Raises BadInput."""
    path = Path(path)
    head, declared, frame_time, rows = _opened(path)
    block = next(text_lines.blocks(rows), None)
    if block is None:
        raise BadInput(f"{path}: has no frames")
    first = reading.motion_of(_text(head, frame_time, block), path, unit, rate, up)
    # Channels that are constant in the first frames may change later.
    source = {name: value for name, value in first.source.items() if name != "constant"}
    first = replace(first, source=source)

    def parts() -> Iterator[Motion]:
        head, declared, frame_time, rows = _opened(path)
        unit_m, frames = float(first.source["unit_m"]), 0
        for block in text_lines.blocks(rows):
            motion = reading.motion_of(_text(head, frame_time, block), path, unit_m, first.rate, first.up)
            frames += len(motion)
            yield replace(motion, skeleton=first.skeleton, source=first.source)
        if abs(frames - declared) > reading.MAX_FRAME_MISMATCH:
            raise BadInput(f"{path}: declares {declared} frames and has {frames}: cut off, or frames of several lines")

    return Blocks(first[:0], declared, parts)


def _opened(path: Path) -> tuple[str, int, str, Iterator[str]]:
    """The text to MOTION, the declared frames, the frame time, and the lines of frames. Raises BadInput."""
    rows = text_lines.lines(path)
    head: list[str] = []
    found: dict[str, str] = {}
    for row in text_lines.header(rows, path, "Frames: and Frame Time:"):
        match = reading.TIMING.match(row)
        if match is None:
            head.append(row)
            continue
        found["frames" if match["frames"] else "time"] = match["frames"] or match["time"].replace(",", ".")
        if len(found) == 2:
            break
    return "\n".join(head), int(found["frames"]), found["time"], rows


def _text(head: str, frame_time: str, block: list[str]) -> str:
    """A BVH of some frames."""
    return "\n".join([head, f"Frames: {len(block)}", f"Frame Time: {frame_time}", *block, ""])
