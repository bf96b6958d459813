"""TRC: tab-separated marker positions (Motion Analysis; also OpenSim's marker format).

PathFileType …        kind and name of the file
DataRate …            keys of the next line, then their values: rate, counts, unit
Frame#  Time  LASI … names, one every three columns; then X1 Y1 Z1 …
1  0.000  x y z …     one line per frame; an empty cell is a gap
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import BadInput
from ..motion import Motion
from ..typing import Floats
from . import replace_whole, trc_clock
from .c3d.labels import original_labels, unique_names
from .conventions import UNITS_M, first_frame, guess_up, metres_in, start_s, unit_option, with_start
from .text import is_gap, numbers, read_text
from .trc_clock import Declared
from .zeros import parked_at_origin, parked_of, store_parked, zeros_are_gaps

HOLDS: frozenset[str] = frozenset({"zero_samples"})
"""What a TRC stores beside the positions."""

KEYS = (
    "DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames",
)  # fmt: skip
NAMES = re.compile(r"\s*Frame\s*#?\s*\t?\s*Time\b", re.IGNORECASE)
"""The line of marker names."""
QUOTED = re.compile(r'(?<![^\t\n])"([^"\t\n]*)"(?![^\t\n])')
EMPTY_CELL = "-8.3e307"
"""Stands for an empty cell while all cells are parsed in one call."""


class _Header(NamedTuple):
    """The declared rate (hertz), counts and unit; None for what the header lacks."""

    rate: float | None
    frames: int | None
    markers: int | None
    units: str | None


class _Body(NamedTuple):
    """names: cells of the line of marker names. axes: the line below it. rows: lines of data, without blank ones.

    tabs: whether cells are separated by tabs, not spaces.
    """

    names: list[str]
    axes: str
    rows: list[str]
    tabs: bool


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
    return motion_of(read_text(path), path, up, unit, rate, zeros_are_gaps(gaps), salvage)


def motion_of(
    text: str,
    path: str | Path,
    up: str | None,
    unit: str | float | None,
    rate: float | None,
    zeros: bool,
    salvage: bool = False,
    is_part: bool = False,
) -> Motion:
    """As `read`, of the text of a file; path: for messages. is_part: some rows, not as many as the header declares."""
    try:
        lines = _unquoted(text).split("\n")
        if not lines[0].startswith("PathFileType"):
            raise BadInput("not a TRC: it does not begin with PathFileType")
        names_at = next((i for i, line in enumerate(lines[:20]) if NAMES.match(line)), None)
        if names_at is not None and names_at < 3:
            raise BadInput("its header is incomplete: keys (DataRate, …) and their values come before the marker names")
        if names_at is None or names_at == len(lines) - 1:
            raise BadInput("cut off or not a TRC: it has no line of marker names")
        header = _header(lines[1], lines[2])
        units, unit_m = _unit(header.units, unit)
        notes: list[str] = []
        is_cut_in_line = bool(lines[-1].strip())  # a whole line ends with a line break
        body = _body(lines, names_at)
        if salvage:
            header, body = _salvaged(header, body, is_cut_in_line, notes)
        elif is_cut_in_line and _ends_early(body):
            raise BadInput("cut off: its last row ends early; --salvage (salvage=True) leaves it out")
        header = header._replace(frames=len(body.rows)) if header.frames is None or is_part else header
        names, table, decimals = _rows(header, body, str(path), notes)
        clock = trc_clock.of_columns(table[:, :2], decimals, Declared(header.rate, header.frames), rate, notes)
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
        parked = parked_at_origin(positions, gap, is_part)
        store_parked(parked, bool(gap.any()), clock.rate, source, extras, notes)
        positions[parked] = np.nan
    if not math.isnan(clock.start):
        source = with_start(source, clock.rate, clock.start)
    if notes:
        source["notes"] = notes
    names, originals = unique_names(names, len(names))
    if originals:
        source["labels"] = originals
    return Motion(positions, clock.rate, names, up or guess_up(positions), source=source, extras=extras)


def _unquoted(text: str) -> str:
    """A tab-separated text without the quotes that spreadsheets put around cells."""
    return QUOTED.sub(r"\1", text) if '"' in text else text


def _unit(declared: str | None, unit: str | float | None) -> tuple[str, float]:
    """The unit's name and its metres: as given, the header's, or millimetres. Raises BadInput for an unknown one."""
    if unit is not None or declared is None:
        return unit_option("mm" if unit is None else unit)
    unit_m = metres_in(declared)
    if unit_m is None:
        raise BadInput(f"its header has the unknown unit {declared!r:.40}; use unit= (--unit): {', '.join(UNITS_M)}")
    return declared, unit_m


def _header(keys: str, values: str) -> _Header:
    """The header's fields by name. Empty cells are matched by their tabs if names and values differ in number."""
    pair = keys.split(), values.split()
    if len(pair[0]) != len(pair[1]) and "\t" in keys and "\t" in values:
        pair = keys.split("\t"), values.split("\t")
    fields = {key.strip().lower(): value.strip() for key, value in zip(*pair, strict=False)}
    if "datarate" not in fields and "numframes" not in fields:
        raise BadInput("its header does not give rate, frames and markers")
    rate = _number(fields, "datarate")
    frames, markers = (_number(fields, name) for name in ("numframes", "nummarkers"))
    frames, markers = (None if count is None else int(count) for count in (frames, markers))
    return _Header(rate, frames, markers, fields.get("units") or None)


def declared_frames(head: list[str]) -> int | None:
    """The frames that the lines of a header declare. Raises BadInput."""
    if len(head) < 4:
        raise BadInput("cut off or not a TRC: it has no line of marker names")
    return _header(head[1], head[2]).frames


def _number(fields: dict[str, str], name: str) -> float | None:
    """A number of the header, None if it is empty or missing. Raises BadInput for other texts."""
    text = fields.get(name, "")
    if is_gap(text):
        return None
    with suppress(ValueError):
        value = float(text.replace(",", "."))
        if 0 <= value < 1e12:
            return value
    raise BadInput(f"its header does not give {name}, it has {text!r:.40}")


def _body(lines: list[str], names_at: int) -> _Body:
    """The lines after the header; the line of axes may be missing."""
    rows = [line for line in lines[names_at + 1 :] if line.strip()]
    axes = ""
    if rows and _begins_with_axis(rows[0]):
        axes, rows = rows[0], rows[1:]
    tabs = any("\t" in line for line in rows) or not rows
    names = lines[names_at].split("\t") if tabs else lines[names_at].split()
    if any("," in row for row in rows) and not any("." in row for row in rows):
        rows = [row.replace(",", ".") for row in rows]  # decimal commas
    return _Body([name.strip() for name in names[2:]], axes, rows, tabs)


def _begins_with_axis(line: str) -> bool:
    """Whether the first word of a line is neither a number nor a gap."""
    word = line.split()[0]
    with suppress(ValueError):
        float(word.replace(",", "."))
        return False
    return not is_gap(word)


def _ends_early(body: _Body) -> bool:
    """Whether the last row has fewer cells than any other."""
    cells = [row.count("\t") if body.tabs else len(row.split()) for row in body.rows]
    return len(cells) > 1 and cells[-1] < min(cells[:-1])


def _salvaged(header: _Header, body: _Body, is_cut_in_line: bool, notes: list[str]) -> tuple[_Header, _Body]:
    """The header and rows of a truncated file, without the row that the end of the file cuts off; noted."""
    rows, declared = body.rows, header.frames
    if is_cut_in_line:
        rows = rows[:-1]
    elif declared is None or len(rows) >= declared:
        return header, body
    if rows and (declared is None or len(rows) < declared):
        of = "" if declared is None else f" of {declared} declared"
        notes.append(f"cut off: {len(rows)}{of} frames are read")
        header = header._replace(frames=len(rows))
    return header, body._replace(rows=rows)


def _rows(header: _Header, body: _Body, path: str, notes: list[str]) -> tuple[tuple[str, ...], Floats, int]:
    """Names of the markers, the numbers of all rows (rows, 2 + 3 · markers), and decimals of the time column."""
    rows = [line.rstrip("\t ").split("\t") if body.tabs else line.split() for line in body.rows]
    widths = set(map(len, rows))
    if not body.tabs and len(widths) > 1:
        found = f"{min(widths)} to {max(widths)} cells separated by spaces"
        raise BadInput(f"its rows have {found}, which differ in number, so gaps cannot be located")
    declared = header.markers or 0
    width = max(map(len, rows), default=2)
    if stray := _stray_columns(rows, 3 * len(_marker_names(body, 2)), width):
        width -= stray
        _leave_out_stray(rows, width, body, notes)
    names = _marker_names(body, width)
    cells = body.axes.split("\t")[2:] if body.tabs else body.axes.split()
    labelled = -(-max((i + 1 for i, cell in enumerate(cells) if cell.strip()), default=0) // 3)
    if len(names) < declared and labelled > len(names):  # the last columns are labelled and empty in every row
        names += tuple(f"P{i + 1}" for i in range(len(names), min(declared, labelled)))
    columns = max(labelled, -(-(max(map(len, rows), default=2) - 2) // 3))
    is_unsure = len(names) > max(columns, declared) and rows
    if not names or is_unsure or len(rows) * len(names) > 64 * sum(map(len, rows)) + 4096:
        named = f"it names {len(names)} markers and declares" if is_unsure else "its header declares"
        raise BadInput(f"{named} {declared} markers, there are columns for {columns if is_unsure else len(names)}")
    if declared > 64 * len(names):
        raise BadInput(f"its header declares {declared} markers, there are columns for {len(names)}")
    if header.markers is not None and declared != len(names):
        notes.append(f"the header declares {declared} markers, there are columns for {len(names)}: all are read")
    decimals = max((len(row[1].strip().partition(".")[2].rstrip("0")) for row in rows if len(row) > 1), default=0)
    return names, _table(rows, 2 + 3 * len(names), path), decimals


def _stray_columns(rows: list[list[str]], named: int, width: int) -> int:
    """How many of the last columns belong to no point: unnamed ones, of which no row has all three coordinates.

    named: columns of coordinates with a name. width: cells of the longest row.
    """
    stray = 0
    while width - stray > 2 + named:
        begin = 2 + 3 * ((width - stray - 3) // 3)
        if any(len(row) >= begin + 3 and not any(map(is_gap, row[begin : begin + 3])) for row in rows):
            break
        stray = width - max(begin, 2 + named)
    return stray


def _leave_out_stray(rows: list[list[str]], width: int, body: _Body, notes: list[str]) -> None:
    """Cut rows to `width` cells and note it. Raises BadInput where only some rows are longer: a cell too many may have
    shifted the others of its row.
    """
    longer = [number for number, row in enumerate(rows, 1) if len(row) > width]
    if len(longer) < len(rows):
        row = rows[longer[0] - 1]
        raise BadInput(f"row {longer[0]} of its numbers has {len(row)} cells, its {width // 3} markers have {width}")
    notes.append(f"{len(rows[0]) - width} columns after those of the markers have no name and are left out")
    for row in rows:
        del row[width:]


def _marker_names(body: _Body, width: int) -> tuple[str, ...]:
    """Names of the markers, every third cell after two; rows may be wider than the names, or end in gaps."""
    cells = list(body.names)
    while cells and not cells[-1]:
        cells.pop()
    if len(cells) == width - 2 and all(cells) and cells[::3] == cells[1::3] == cells[2::3]:
        cells = [cell for name in cells[::3] for cell in (name, "", "")]  # a name above each of its columns
    elif any(cells[1::3]) or any(cells[2::3]) or not body.tabs:
        cells = [cell for name in filter(None, cells) for cell in (name, "", "")]
    count = max(-(-len(cells) // 3), -(-(width - 2) // 3))
    cells += [""] * (3 * count - len(cells))
    return tuple(name or f"P{i + 1}" for i, name in enumerate(cells[::3]))


def _table(rows: list[list[str]], columns: int, path: str) -> Floats:
    """Rows of cells as numbers (rows, columns); missing and empty cells are NaN."""
    for row in rows:
        row.extend([""] * (columns - len(row)))
        for column, cell in enumerate(row):
            if is_gap(cell):
                row[column] = EMPTY_CELL
    table = numbers("\t".join("\t".join(row) for row in rows), path)
    if table.size != len(rows) * columns:
        raise BadInput(
            f"a cell holds more than one number: {table.size} numbers in {len(rows)} rows of {columns} cells"
        )
    table[table == float(EMPTY_CELL)] = np.nan
    return table.reshape(len(rows), columns)


def write(path: str | Path, motion: Motion) -> None:
    """Write a TRC in the source's unit (millimetres for other sources); gaps are empty cells.

    Frame numbers and times continue those of the source. Numbers have seven decimals of the unit, so a motion in
    millimetres comes back within 1e-10 m. A TRC has no place for analog channels, events, parameters or a skeleton
    (docs/formats.md). Raises BadInput for names with tabs.
    """
    names = original_labels(motion.names, motion.source)
    names = [name if label.isspace() or not label else label for name, label in zip(motion.names, names, strict=True)]
    if any(not name.strip() or set(name) & set("\t\r\n") or name != name.strip() for name in names):
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
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(motion.points) for axis in "XYZ"),
        "",
    ]
    values = np.where(parked_of(motion)[:, :, None], 0.0, motion.positions / unit_m).reshape(count, -1)
    form = "\t".join(["%.7f"] * values.shape[1])
    for frame, row in enumerate(values):
        text = (form % tuple(row.tolist())).replace("nan", "")
        lines.append(f"{first + frame}\t{begin + frame / motion.rate:.6f}\t{text}")
    replace_whole(path, ("\n".join(lines) + "\n").encode("utf-8"))
