# pyright: strict
"""TRC in pieces: the header once, then rows in blocks. Rows that the numbering skips are gaps, between blocks too."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..motion import Motion
from . import text_lines, trc
from .blocks import Blocks
from .conventions import first_frame
from .zeros import zeros_are_gaps


def read_blocks(
    path: str | Path,
    up: str | None = None,
    unit: str | float | None = None,
    rate: float | None = None,
    gaps: str | None = None,
) -> Blocks:
    """As `trc.read`, in pieces. Columns without a name must be there in the first rows. Raises BadInput."""
    path, zeros = Path(path), zeros_are_gaps(gaps)
    head, declared, rows = _opened(path)
    block = next(text_lines.blocks(rows), None)
    if block is None:
        raise BadInput(f"{path}: has no frames")
    first = trc.motion_of(_text(head, block), path, up, unit, rate, zeros, is_part=True)
    about = replace(first[:0], source={k: v for k, v in first.source.items() if k != "gaps"}, extras={})

    def parts() -> Iterator[Motion]:
        unit_m, expected, count = float(first.source["unit_m"]), first_frame(first.source), 0
        for block in text_lines.blocks(_opened(path)[2]):
            motion = trc.motion_of(_text(head, block), path, first.up, unit_m, first.rate, zeros, is_part=True)
            skipped = first_frame(motion.source) - expected
            if skipped < 0 or skipped > trc.MAX_DROPPED_SHARE * len(block):
                raise BadInput(f"{path}: the numbers of its frames do not increase near frame {expected}")
            positions = np.full((skipped + len(motion), about.points, 3), np.nan)
            if motion.names != about.names[: motion.points]:
                raise BadInput(f"{path}: near frame {expected} it has more columns than in its first rows")
            positions[skipped:, : motion.points] = motion.positions
            expected, count = expected + len(positions), count + len(block)
            yield replace(about, positions=positions)
        if declared is not None and count < declared:
            raise BadInput(f"{path}: cut off: its header declares {declared} frames, the file has {count}")

    return Blocks(about, declared, parts)


def _opened(path: Path) -> tuple[list[str], int | None, Iterator[str]]:
    """The lines to those of marker names and axes, the declared frames, and the lines of rows. Raises BadInput."""
    rows = text_lines.lines(path)
    head: list[str] = []
    for row in text_lines.header(rows, path, "line of marker names"):
        head.append(row)
        if trc.NAMES.match(row):
            break
    axes = next(rows, "")
    return [*head, axes], trc.declared_frames(head), rows


def _text(head: list[str], block: list[str]) -> str:
    """A TRC of some rows."""
    return "\n".join([*head, *block, ""])
