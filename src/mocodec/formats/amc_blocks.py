# pyright: strict
"""AMC in pieces: frames are groups of lines that begin with a number."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from ..errors import BadInput
from ..motion import Motion
from . import asf_amc, text_lines
from .blocks import Blocks

BLOCK_FRAMES = 2048


def read_blocks(
    path: str | Path,
    asf: str | Path | None = None,
    rate: float | None = None,
    unit: str | float | None = None,
) -> Blocks:
    """As `asf_amc.read`, in pieces; frames must be numbered one by one. Raises BadInput."""
    path = Path(path)
    acclaim = asf_amc.acclaim_for(path, asf, unit)
    first = asf_amc.motion_of(next(_texts(path)), path, acclaim, rate)

    def parts() -> Iterator[Motion]:
        expected = int(first.source["first_frame"])
        for text in _texts(path):
            motion = asf_amc.motion_of(text, path, acclaim, rate)
            if motion.source["first_frame"] != expected or "notes" in motion.source:
                raise BadInput(f"{path}: near frame {expected} its numbering skips frames: it is read as a whole only")
            expected += len(motion)
            yield replace(motion, source=first.source)

    return Blocks(first[:0], None, parts)


def _texts(path: Path) -> Iterator[str]:
    """AMCs of some frames each: the header, then their lines. Raises BadInput."""
    rows = text_lines.lines(path)
    head: list[str] = []
    frame: list[str] = []
    for row in text_lines.header(rows, path, "line with a frame's number"):
        if row.strip().isdigit():
            frame = [row]
            break
        head.append(row)
    frames: list[list[str]] = []
    for row in rows:
        if row.strip().isdigit():
            frames.append(frame)
            frame = []
            if len(frames) == BLOCK_FRAMES:
                yield "\n".join([*head, *(line for lines in frames for line in lines), ""])
                frames = []
        frame.append(row)
    yield "\n".join([*head, *(line for lines in [*frames, frame] for line in lines), ""])
