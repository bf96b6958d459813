"""TRC: tab-separated marker positions (Motion Analysis; also OpenSim's marker format).

PathFileType …        kind and name of the file
DataRate …            keys of the next line, then their values: rate, counts, unit
Frame#  Time  LASI … names, one every three columns; then X1 Y1 Z1 …
1  0.000  x y z …     one line per frame; an empty cell is a gap
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import BadInput
from ..motion import Motion
from ..typing import Floats, Integers
from . import replace_whole
from .conventions import USUAL_RATES, first_frame, guess_up, metres_in, start_s, unit_option, with_start
from .text import numbers, read_text
from .zeros import parked_at_origin, parked_of, store_parked, zeros_are_gaps

HOLDS: frozenset[str] = frozenset({"zero_samples"})
"""What a TRC stores beside the positions."""

KEYS = (
    "DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames",
)  # fmt: skip
EMPTY_CELL = "-8.3e307"
"""Stands for an empty cell while all cells are parsed in one call."""
MAX_DROPPED_SHARE = 16
"""Frames that the numbering may skip, as a multiple of those that are there; more is taken for damage."""
RATE_TOLERANCE = 5e-4
"""Relative difference between DataRate and the time column that needs no note."""


class _Header(NamedTuple):
    rate: float
    frames: int
    markers: int
    units: str | None


class _Clock(NamedTuple):
    """frames (rows,): frame of each row, from 0; first: number of the first; start: its time in seconds, or NaN."""

    frames: Integers
    first: int
    start: float
    rate: float


def read(
    path: str | Path,
    up: str | None = None,
    unit: str | float | None = None,
    rate: float | None = None,
    gaps: str | None = None,
    salvage: bool = False,
) -> Motion:
    """A TRC file as a motion, metres. A marker without all three coordinates in a frame is a gap there.

    Columns after the named ones, where some programs store unidentified reflections, become points P34, P35, …:
    NumMarkers counts something else in those programs, so the columns decide. Frames that the numbering skips are
    gaps. up: the vertical axis, which a TRC does not store; by default guessed. unit, rate: in place of the header's.
    Markers at exactly (0, 0, 0) are gaps unless gaps="keep". salvage: read the complete rows of a truncated file.
    Raises BadInput.
    """
    zeros = zeros_are_gaps(gaps)
    lines = read_text(path).split("\n")
    if not lines[0].startswith("PathFileType"):
        raise BadInput(f"{path}: not a TRC: it does not begin with PathFileType")
    names_at = next((i for i, line in enumerate(lines[:20]) if line.startswith("Frame#")), None)
    if names_at is None or not 3 <= names_at < len(lines) - 1:
        raise BadInput(f"{path}: cut off or not a TRC: it has no line of marker names")
    try:
        header = _header(lines[1], lines[2])
        units, unit_m = unit_option(header.units or "mm" if unit is None else unit)
        notes: list[str] = []
        if salvage:
            header, lines = _salvaged(header, lines, names_at, notes)
        names, table, decimals = _rows(header, lines, names_at, str(path))
        clock = _clock(table[:, :2], decimals, header, rate, notes)
    except BadInput as error:
        raise error if str(error).startswith(str(path)) else BadInput(f"{path}: {error}") from None
    count = int(clock.frames[-1]) + 1 if len(clock.frames) else 0
    positions = np.full((count, len(names), 3), np.nan)
    positions[clock.frames] = (table[:, 2:] * unit_m).reshape(-1, len(names), 3)
    gap = np.isnan(positions.sum(axis=2))
    positions[gap] = np.nan
    extras: dict[str, Any] = {}
    source: dict[str, Any] = {"format": "trc", "units": units, "unit_m": unit_m, "first_frame": clock.first}
    if up is None:
        source["up_guessed"] = True
    if header.units is None and unit is None:
        source["unit_guessed"] = True
    if zeros:
        parked = parked_at_origin(positions, gap)
        store_parked(parked, gap, clock.rate, source, extras, notes)
        positions[parked] = np.nan
    if not math.isnan(clock.start):
        source = with_start(source, clock.rate, clock.start)
    if notes:
        source["notes"] = notes
    return Motion(positions, clock.rate, names, up or guess_up(positions), source=source, extras=extras)


def _salvaged(header: _Header, lines: list[str], names_at: int, notes: list[str]) -> tuple[_Header, list[str]]:
    """The header and lines of a truncated file, without the line that the end of the file cuts off; noted."""
    rows = [i for i in range(names_at + 2, len(lines)) if lines[i].strip()]
    if len(rows) >= header.frames and not lines[-1].strip():
        return header, lines
    if lines[-1].strip():  # a whole line ends with a line break
        lines, rows = lines[:-1], rows[:-1]
    if not rows or len(rows) >= header.frames:
        return header, lines
    notes.append(f"cut off: {len(rows)} of {header.frames} declared frames are read")
    return header._replace(frames=len(rows)), lines


def _header(keys: str, values: str) -> _Header:
    fields = dict(zip(keys.split(), values.split(), strict=False))
    try:
        counts = int(fields["NumFrames"]), int(fields["NumMarkers"])
        return _Header(float(fields["DataRate"]), *counts, fields.get("Units"))
    except (KeyError, ValueError) as error:
        raise BadInput(f"its header does not give rate, frames and markers ({error})") from None


def _rows(header: _Header, lines: list[str], names_at: int, path: str) -> tuple[tuple[str, ...], Floats, int]:
    """Names of the markers, the numbers of all rows (rows, 2 + 3 · markers), and decimals of the time column."""
    body = [line for line in lines[names_at + 2 :] if line.strip()]
    has_tabs = any("\t" in line for line in body) or not body
    rows = [line.rstrip("\t ").split("\t") if has_tabs else line.split() for line in body]
    if not has_tabs and len(set(map(len, rows))) > 1:
        raise BadInput("its columns are separated by spaces and differ in number, so gaps cannot be located")
    names = _marker_names(lines[names_at], has_tabs, max(map(len, rows), default=2))
    cells = lines[names_at + 1].split("\t")[2:] if has_tabs else lines[names_at + 1].split()
    labelled = -(-max((i + 1 for i, cell in enumerate(cells) if cell.strip()), default=0) // 3)
    if len(names) < header.markers and labelled > len(names):  # the last columns are labelled and empty in every row
        names += tuple(f"P{i + 1}" for i in range(len(names), min(header.markers, labelled)))
    if not names or len(rows) * len(names) > 64 * sum(map(len, rows)) + 4096:
        raise BadInput(f"its header declares {header.markers} markers, there are columns for {len(names)}")
    if len(names) < header.markers and header.markers > 64 * len(names):
        raise BadInput(f"its header declares {header.markers} markers, there are columns for {len(names)}")
    decimals = max((len(row[1].strip().partition(".")[2].rstrip("0")) for row in rows if len(row) > 1), default=0)
    return names, _table(rows, 2 + 3 * len(names), path), decimals


def _marker_names(line: str, has_tabs: bool, width: int) -> tuple[str, ...]:
    """Names of the markers, every third cell after two; rows may be wider than the names, or end in gaps."""
    cells = [cell.strip() for cell in (line.split("\t") if has_tabs else line.split())[2:]]
    if any(cells[1::3]) or any(cells[2::3]) or not has_tabs:
        cells = [cell for name in filter(None, cells) for cell in (name, "", "")]
    while cells and not cells[-1]:
        cells.pop()
    count = max(-(-len(cells) // 3), -(-(width - 2) // 3))
    cells += [""] * (3 * count - len(cells))
    return tuple(name or f"P{i + 1}" for i, name in enumerate(cells[::3]))


def _table(rows: list[list[str]], columns: int, path: str) -> Floats:
    """Rows of cells as numbers (rows, columns); missing and empty cells are NaN."""
    for row in rows:
        row.extend([""] * (columns - len(row)))
        for column, cell in enumerate(row):
            if not cell or cell.isspace() or cell.strip().lower() == "nan":
                row[column] = EMPTY_CELL
    table = numbers("\t".join("\t".join(row) for row in rows), path)
    if table.size != len(rows) * columns:
        raise BadInput("a cell holds more than one number")
    table[table == float(EMPTY_CELL)] = np.nan
    return table.reshape(len(rows), columns)


def _clock(columns: Floats, decimals: int, header: _Header, rate: float | None, notes: list[str]) -> _Clock:
    """Frame of each row, number and time of the first, and rate; contradictions are settled and noted.

    columns (rows, 2): frame numbers and times.
    """
    rows = len(columns)
    ids, times = columns.T
    if not rows:
        if header.frames:
            raise BadInput(f"cut off: its header declares {header.frames} frames, the file has none")
        return _Clock(np.empty(0, np.int64), 1, math.nan, rate or header.rate)
    if not (math.isfinite(ids[0]) and abs(ids[0]) < 2**53):
        raise BadInput(f"the number of its first frame is {ids[0]}")
    has_times = bool(np.isfinite(times).all() and (np.diff(times) > 0).all())
    digit = 0.5 * 10.0**-decimals
    index = _frame_index(ids, times if has_times else None, header, notes)
    missing = int(index[-1]) + 1 - rows
    if rows < header.frames and int(index[-1]) + 1 < header.frames:
        raise BadInput(
            f"cut off: its header declares {header.frames} frames, the file has {rows}; --salvage reads these"
        )
    if rows > header.frames and int(index[-1]) + 1 != header.frames:
        notes.append(f"the header declares {header.frames} frames, the file has {rows}: all are read")
    if missing:
        notes.append(f"{missing} frames are missing from the file's numbering: they are gaps")
    if rate is None and has_times and rows > 1:
        rate = _rate_of_times(index, times, digit, header.rate, notes)
    start = float(times[0]) if math.isfinite(times[0]) else math.nan
    first = int(ids[0])
    chosen = rate or header.rate
    if not 0 < chosen < math.inf:
        raise BadInput(f"the frame rate must be positive, not {chosen}")
    if abs(start - (first - 1) / chosen) <= digit + 1e-9:
        start = (first - 1) / chosen  # its digits say no more
    return _Clock(index, first, start, chosen)


def _frame_index(ids: Floats, times: Floats | None, header: _Header, notes: list[str]) -> Integers:
    """The frame of each row from 0, by the numbering; by the times if these skip frames that are numbered through.

    Numbers that all step by the same amount are those of a decimated recording, without missing frames.
    """
    rows = len(ids)
    counted = np.arange(rows)
    if rows < 2:
        return counted
    steps = np.diff(ids)
    if not (np.isfinite(steps).all() and (steps >= 1).all() and (steps == np.rint(steps)).all()):
        notes.append("the frame numbers do not increase by whole numbers: frames are counted by rows")
        return counted
    by_time = None
    if times is not None:
        periods = np.diff(times) / np.median(np.diff(times))
        if np.abs(periods - np.rint(periods)).max() < 0.1:
            by_time = np.rint(periods)
    if (steps == steps[0]).all():
        if by_time is None or (by_time == 1).all():
            return counted
        steps = by_time
    elif by_time is not None and (by_time == 1).all() and rows == header.frames:
        notes.append(
            "the frame numbers skip, the times and the number of frames do not: no frames are taken for missing"
        )
        return counted
    index = np.concatenate([[0.0], np.cumsum(steps)])
    if index[-1] > MAX_DROPPED_SHARE * rows + 1000:
        raise BadInput(f"damaged: {rows} rows have frame numbers from {ids[0]:.0f} to {ids[-1]:.0f}")
    return index.astype(np.int64)


def _rate_of_times(index: Integers, times: Floats, digit: float, declared: float, notes: list[str]) -> float | None:
    """The rate of the time column if it contradicts the header's, else None. digit: half the last decimal, seconds."""
    span, frames = float(times[-1] - times[0]), int(index[-1])
    expected = frames / declared if declared > 0 else math.inf
    if abs(span - expected) <= 2 * digit + RATE_TOLERANCE * span or not declared > 0:
        return None
    period_error = 2 * digit / frames
    period = span / frames
    usual = min(USUAL_RATES, key=lambda rate: abs(1 / rate - period))
    rate = float(usual) if abs(1 / usual - period) <= period_error + 1e-4 * period else 1 / period
    notes.append(
        f"DataRate is {declared:g} Hz, the time column runs at {rate:.6g} Hz: the time column is used "
        f"(--rate {declared:g} takes the other)"
    )
    return rate


def write(path: str | Path, motion: Motion) -> None:
    """Write a TRC in the source's unit (millimetres for other sources); gaps are empty cells.

    Frame numbers and times continue those of the source. Numbers have seven decimals of the unit, so a motion in
    millimetres comes back within 1e-10 m. A TRC has no place for analog channels, events, parameters or a skeleton
    (docs/formats.md). Raises BadInput for names with tabs.
    """
    if any(not name.strip() or set(name) & set("\t\r\n") or name != name.strip() for name in motion.names):
        raise BadInput("a TRC cannot hold a marker whose name is empty or has tabs or spaces around it")
    units = str(motion.source.get("units", ""))
    unit_m = metres_in(units)
    if unit_m is None or len(units.split()) != 1:
        units, unit_m = "mm", 1e-3
    first, count = first_frame(motion.source), len(motion)
    rate, begin = f"{motion.rate:.10g}", start_s(motion.source, motion.rate)
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{Path(path).name}",
        "\t".join(KEYS),
        "\t".join([rate, rate, str(count), str(motion.points), units, rate, str(first), str(count)]),
        "Frame#\tTime\t" + "\t\t\t".join(motion.names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(motion.points) for axis in "XYZ"),
        "",
    ]
    values = np.where(parked_of(motion)[:, :, None], 0.0, motion.positions / unit_m).reshape(count, -1)
    form = "\t".join(["%.7f"] * values.shape[1])
    for frame, row in enumerate(values):
        text = (form % tuple(row.tolist())).replace("nan", "")
        lines.append(f"{first + frame}\t{begin + frame / motion.rate:.6f}\t{text}")
    replace_whole(path, ("\n".join(lines) + "\n").encode("utf-8"))
