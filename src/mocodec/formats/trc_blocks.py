# pyright: strict
"""TRC in pieces: the header once, then rows in blocks. Rows that the numbering skips are gaps, between blocks too."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BadInput
from ..motion import Motion
from . import text_lines, trc, trc_clock, zeros
from .blocks import Blocks, named_errors
from .conventions import first_frame, guess_up
from .scratch import Rows

ZERO = r"[-+]?(?=[.,]*0)[0.,]+(?:[eE][-+]?\d+)?"
ZEROS = re.compile(rf"(?<!\S){ZERO}[\t ]+{ZERO}[\t ]+{ZERO}(?!\S)")
"""Three cells of zeros, which may be those of one marker."""


def read_blocks(
    path: str | Path,
    up: str | None = None,
    unit: str | float | None = None,
    rate: float | None = None,
    gaps: str | None = None,
) -> Blocks:
    """As `trc.read`, in pieces. Columns without a name must be there in the first rows. Raises BadInput."""
    path, zeros_are_gaps = Path(path), zeros.zeros_are_gaps(gaps)
    head, declared, rows = _opened(path)
    block = next(text_lines.blocks(rows), None)
    if block is None:
        raise BadInput(f"{path}: has no frames")
    first = trc.motion_of(_text(head, block), path, up, unit, rate, zeros=False, is_part=True)
    about = replace(first[:0], extras={})

    def with_zeros() -> Iterator[Motion]:
        """Blocks in which markers at the origin are no gaps."""
        unit_m, expected, count = float(first.source["unit_m"]), first_frame(first.source), 0
        for block in text_lines.blocks(_opened(path)[2]):
            motion = trc.motion_of(_text(head, block), path, first.up, unit_m, first.rate, zeros=False, is_part=True)
            skipped = first_frame(motion.source) - expected
            if skipped < 0 or skipped > trc_clock.MAX_DROPPED_SHARE * len(block):
                raise BadInput(f"{path}: the numbers of its frames do not increase near frame {expected}")
            positions = np.full((skipped + len(motion), about.points, 3), np.nan)
            if motion.names != about.names[: motion.points]:
                raise BadInput(f"{path}: near frame {expected} it has more columns than in its first rows")
            positions[skipped:, : motion.points] = motion.positions
            expected, count = expected + len(positions), count + len(block)
            yield replace(about, positions=positions)
        if declared is not None and count < declared:
            raise BadInput(f"{path}: cut off: its header declares {declared} frames, the file has {count}")

    whole = Blocks(about, declared, with_zeros)
    if zeros_are_gaps and any(ZEROS.search(row.replace('"', "")) for row in text_lines.lines(path)):
        with named_errors(path):
            return _without_parked(whole, first, up)
    return whole


def _without_parked(whole: Blocks, first: Motion, up: str | None) -> Blocks:
    """The blocks with gaps where markers are parked at the origin. first: their first frames, for the vertical axis."""
    places, other_gaps = Rows((first.points,), np.uint8), False
    for motion in whole:
        other_gaps |= bool(motion.gaps.any())
        places.add(zeros.places(motion.positions, motion.gaps))
    parked = zeros.parked_columns(places.by_column())
    if parked is None:
        return whole
    source, extras, notes = dict(first.source), dict[str, Any](), list[str](first.source.get("notes", []))
    zeros.store_parked(parked, other_gaps, first.rate, source, extras, notes)
    positions = first.positions.copy()
    positions[parked[: len(first)].astype(bool)] = np.nan
    about = replace(whole.about, source=source | {"notes": notes}, extras=extras, up=up or guess_up(positions))

    def parts() -> Iterator[Motion]:
        start = 0
        for motion in whole:
            positions = motion.positions.copy()
            positions[parked[start : start + len(motion)].astype(bool)] = np.nan
            start += len(motion)
            yield replace(about, positions=positions, extras={})

    return Blocks(about, whole.frames, parts)


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
