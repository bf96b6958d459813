# pyright: strict
"""CSV in pieces: its numbers are put into a temporary file, column after column; then frames are read where
they are asked for."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..motion import Motion
from ..typing import Floats
from . import columns, delimited, text_lines, zeros
from .blocks import Blocks, block_frames, named_errors, of_ranges
from .scratch import Columns


def read_blocks(
    path: str | Path,
    up: str | None = None,
    unit: str | float | None = None,
    rate: float | None = None,
    gaps: str | None = None,
) -> Blocks:
    """As `delimited.read`, in pieces. Raises BadInput, also for files of several sections."""
    path = Path(path)
    with named_errors(path):
        try:
            return _blocks(path, up, unit, rate, zeros.zeros_are_gaps(gaps))
        except csv.Error as error:
            raise BadInput(f"cannot be read as a CSV ({error})") from None


def _blocks(path: Path, up: str | None, unit: str | float | None, rate: float | None, zeros_are_gaps: bool) -> Blocks:
    comments, rows = delimited.opened(text_lines.lines(path))
    first = list(islice(rows, delimited.HEADER_ROWS))
    if not first:
        raise BadInput("has no rows")
    if delimited.has_sections(first[0]):
        raise BadInput("has sections, and is read as a whole only")
    header = delimited.columns_of_rows(first)
    values = _values(path, chain(first[header.first_row :], rows), len(header.labels))
    notes: list[str] = []
    table, keep, source = delimited.table_of(header, comments, values, up, unit, rate, notes)
    points, frames, count = table.points, table.timing.frames, table.timing.total
    if not points or not count:
        raise BadInput("has no points, and in pieces only files with points are read")

    def numbers(begin: int, end: int) -> Floats:
        """(frames, columns): of frames [begin, end), NaN without a row."""
        low, high = np.searchsorted(frames, (begin, end))
        found = np.full((end - begin, len(keep)), np.nan)
        found[frames[low:high] - begin] = values[low:high][:, keep]
        return found

    others = columns.others_of(table.labels, points)
    signals = Columns(count, (len(others),), np.float64)
    places = Columns(count, (len(points),), np.uint8)
    other_gaps, each = False, block_frames(len(points) + len(others) // 3)
    for begin in range(0, count, each):
        block = numbers(begin, min(count, begin + each))
        signals.add(block[:, others])
        positions = columns.positions_of(block, points, table.unit[1])
        gap = np.isnan(positions[:, :, 0])
        other_gaps |= bool(gap.any())
        places.add(zeros.places(positions, gap))
    parked = zeros.parked_columns(places) if zeros_are_gaps else None

    def positions_between(begin: int, end: int) -> Floats:
        found = columns.positions_of(numbers(begin, end), points, table.unit[1])
        if parked is not None:
            found[parked[begin:end].astype(bool)] = np.nan
        return found

    head = positions_between(0, min(count, each))
    about = columns.described(table, head, signals.values, parked, other_gaps, source, notes)

    def between(begin: int, end: int) -> Motion:
        return Motion(positions_between(begin, end), about.rate, about.names, about.up, source=about.source)

    return of_ranges(about, count, between, each)


def _values(path: Path, rows: Iterable[list[str]], width: int) -> Floats:
    """The numbers of all rows (rows, columns)."""
    lines = sum(1 for _ in text_lines.lines(path))
    values, count, narrowest, last = Columns(lines, (width,), np.float64), 0, width, width
    for block in _runs(rows):
        values.add(delimited.cells(block, width))
        widths = [last, *map(len, block)] if count else list(map(len, block))
        narrowest, last = min([narrowest, *widths[:-1]]), widths[-1]
        count += len(block)
    if count > 1 and last < narrowest:
        raise BadInput(delimited.CUT_OFF.partition(";")[0])
    return values.values[:count]


def _runs(rows: Iterable[list[str]]) -> Iterator[list[list[str]]]:
    """Rows in runs, without those of empty cells."""
    filled = (row for row in rows if any(row))
    while run := list(islice(filled, text_lines.BLOCK_LINES)):
        yield run
