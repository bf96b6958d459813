"""CSV: a table of points and signals in one of the headers that programs write.

    time,LASI.x,LASI.y,LASI.z,Fz            one row of labels; a row of units may follow
    Frame,Time,LASI,,,RASI,,                names, one every three columns,
    ,,X,Y,Z,X,Y,Z                           then axes; a row of units may follow
    Trajectories · rate · names · axes · units      Vicon Nexus: Trajectories has the points, other sections signals
    Format Version,1.23,… Type · Name · ID · Position · axes      OptiTrack Motive

Cells are separated by commas, semicolons (with decimal points or commas) or tabs.
"""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import BadInput
from ..motion import Motion, Signal
from ..typing import Floats
from . import nexus, replace_whole
from .columns import Clock, Point, Table, cell, clock, clock_of_numbers, columns_of, find_points, motion_of
from .conventions import metres_in, start_s, unit_of, unit_option
from .opensim import numbers
from .text import is_gap, read_text
from .zeros import parked_of, zeros_are_gaps

HOLDS = frozenset({"signals", "columns", "times", "zero_samples"})
"""What a CSV stores beside the positions."""

TIMES = re.compile(r"^time\b.*$|^t$|^t \(s\)$", re.IGNORECASE)
FRAMES = re.compile(r"^(frame|frames|frame#|frame number|sub frame|#|index|sample)$", re.IGNORECASE)
UNIT_WORDS = re.compile(
    r"^\[?(s|ms|sec|seconds|deg|rad|n|nmm|nm|n\.mm|n\.m|w|v|mv|%|mm/s.*|m/s.*|deg/s.*|hz|)\]?$", re.IGNORECASE
)
COMMENT = re.compile(r"^#(?!\s*[,;\t])")
"""A line that begins with # and is no header whose first label is #."""
SEPARATOR_LINE = re.compile(r"\"?sep=.\"?\s*$", re.IGNORECASE)
"""A first line that tells spreadsheets the separator."""
HEADER_ROWS = 30
CUT_OFF = "cut off: its last row ends early; --salvage (salvage=True) leaves it out"


class _Columns(NamedTuple):
    """labels and units of all columns; points; first row of numbers; rate and unit that the header declares."""

    labels: list[str]
    units: list[str]
    points: list[Point]
    first_row: int
    rate: float | None
    unit: str | None


def read(
    path: str | Path,
    up: str | None = None,
    unit: str | float | None = None,
    rate: float | None = None,
    gaps: str | None = None,
    salvage: bool = False,
) -> Motion:
    """A CSV as a motion: columns of positions are points, all others `extras["signals"]`.

    up, unit, rate: in place of what the file says; without a unit it is metres, a guess. gaps: "keep" takes points at
    exactly (0, 0, 0) as positions. salvage: leave out a last row that is cut off. Raises BadInput.
    """
    try:
        return _read(read_text(path), up, unit, rate, zeros_are_gaps(gaps), salvage)
    except BadInput as error:
        raise error if str(error).startswith(str(path)) else BadInput(f"{path}: {error}") from None
    except csv.Error as error:
        raise BadInput(f"{path}: cannot be read as a CSV ({error})") from None


def _read(
    text: str, up: str | None, unit: str | float | None, rate: float | None, zeros: bool, salvage: bool
) -> Motion:
    notes: list[str] = []
    comments, found = opened(text.split("\n"))
    rows = list(found)
    if not rows:
        raise BadInput("has no rows")
    sections: dict[str, list[list[str]]] = {}
    if has_sections(rows[0]):
        sections = nexus.sections(rows, notes)
        title = nexus.main_title(sections)
        rows = sections.pop(title)
        columns = _section(title, rows)
    else:
        columns = columns_of_rows(rows)
    body = [row for row in rows[columns.first_row :] if any(row)]
    values = _values(body, len(columns.labels), salvage, notes)
    table, keep, source = table_of(columns, comments, values, up, unit, rate, notes)
    motion = motion_of(
        table.labels, values[:, keep], table.points, table.timing, table.times, table.units, table.unit, table.up,
        zeros, source, notes,
    )  # fmt: skip
    return _with_sections(motion, sections) if sections else motion


def has_sections(first: Sequence[str]) -> bool:
    """Whether a file with this first row is an export of Vicon Nexus."""
    return first[0].lower() in nexus.TITLES and not any(first[1:])


def columns_of_rows(rows: list[list[str]]) -> _Columns:
    """The columns of a file without sections, by its first rows. Raises BadInput."""
    return _motive(rows) if rows[0][0].lower() == "format version" else _plain(rows)


def table_of(
    columns: _Columns,
    comments: Mapping[str, str],
    values: Floats,
    up: str | None,
    unit: str | float | None,
    rate: float | None,
    notes: list[str],
) -> tuple[Table, list[int], dict[str, Any]]:
    """What the header and the numbers (rows, columns) say: the table, its columns among all, and the source."""
    declared = float(comments["rate"]) if _is_number(comments.get("rate", "")) else columns.rate
    timing, times, drop = _timing(columns, values, declared, rate, notes)
    unnamed = {column for column, label in enumerate(columns.labels) if not label}
    drop |= {column for column in unnamed if np.isnan(values[:, column]).all()}
    keep = [column for column in range(len(columns.labels)) if column not in drop]
    place = {column: at for at, column in enumerate(keep)}
    points = [
        Point(point.name, (place[x], place[y], place[z])) for point in columns.points for x, y, z in [point.columns]
    ]
    source: dict[str, Any] = {"format": "csv"}
    units = [columns.units[column] for column in keep]
    declared_unit = columns.unit or comments.get("unit")
    if unit is None and points and not declared_unit:
        source["unit_guessed"] = True
    chosen = unit_option(unit if unit is not None else declared_unit or "m")
    up = up or (comments.get("up") if comments.get("up") in ("x", "y", "z") else None)
    labels = [columns.labels[column] or f"column {column + 1}" for column in keep]
    _note_signals(labels, points, notes)
    return Table(labels, units, points, timing, times, chosen, up), keep, source


def _note_signals(labels: Sequence[str], points: Sequence[Point], notes: list[str]) -> None:
    """Note what users may have taken for positions: columns without any point, and those of a label that repeats."""
    if labels and not points:
        notes.append("no columns are positions (three of a point: A.x, A.y, A.z): all are signals")
    repeated = [label for label, times in Counter(labels).items() if times > 1]
    if repeated:
        notes.append(f"of the columns of one label, all but the first are signals: {', '.join(repeated[:5])}")


def opened(lines: Iterable[str]) -> tuple[dict[str, str], Iterator[list[str]]]:
    """Comments among the first lines, by key, and the rows of cells that are not all empty."""
    rest = iter(lines)
    head = list(islice(rest, HEADER_ROWS))
    if head and SEPARATOR_LINE.match(head[0]):
        head = [*head[1:], *islice(rest, 1)]
    comments: dict[str, str] = {}
    for line in head:
        if COMMENT.match(line):
            key, _, value = line[1:].partition(":")
            comments[key.strip().lower()] = value.strip()
    return comments, _rows(line for line in chain(head, rest) if not COMMENT.match(line))


def _rows(lines: Iterator[str]) -> Iterator[list[str]]:
    """The cells of all lines without empty ones, by the separator that the lines have; decimal commas are points."""
    head = list(islice(lines, 2 * HEADER_ROWS))
    filled = [line for line in head if line.strip()]
    separator = next((mark for mark in "\t;," if sum(mark in line for line in filled) * 2 > len(filled)), ",")
    stripped = ([cell.strip() for cell in row] for row in csv.reader(chain(head, lines), delimiter=separator))
    rows = (row for row in stripped if any(row))
    if separator == ",":
        return rows
    first = list(islice(rows, HEADER_ROWS))
    rows = chain(first, rows)
    decimal = re.compile(r"^[-+]?\d*,\d+(e[-+]?\d+)?$", re.IGNORECASE)
    if not any(decimal.match(cell) for row in first for cell in row):
        return rows
    return ([cell.replace(",", ".") if decimal.match(cell) else cell for cell in row] for row in rows)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _plain(rows: list[list[str]]) -> _Columns:
    """A header of one to three rows: labels or names, axes, units."""
    first = next((i for i, row in enumerate(rows[:HEADER_ROWS]) if _is_data(row)), len(rows))
    if not 1 <= first <= 3:
        raise BadInput("it does not begin with one to three rows of labels and then numbers")
    for row in rows[1:first]:
        if fault := _fault_of_data(row):
            raise BadInput(f"{fault!r:.40} in a row of numbers is not a number")
    head = rows[:first]
    width = max([*map(len, head), *sorted(map(len, rows[first : first + 2]))[:1]])
    head = [row + [""] * (width - len(row)) for row in head]
    units = [""] * width
    if len(head) > 1 and all(UNIT_WORDS.match(text) or metres_in(text) for text in head[-1]):
        units = [text.strip("[]") for text in head.pop()]
    if len(head) == 2:
        labels, points = _two_rows(*head)
    elif len(head) == 1:
        labels = []
        for column, text in enumerate(head[0]):  # units may stand in the labels: LASI.x (mm)
            match = re.match(r"^(.+?)\s*[(\[]([^()\[\]]+)[)\]]$", text)
            is_unit = match is not None and (metres_in(match[2]) or UNIT_WORDS.match(match[2]))
            labels.append(match[1] if match and is_unit else text)
            units[column] = match[2] if match and is_unit else units[column]
        points = find_points(labels)
    else:
        raise BadInput("its header has more rows than names, axes and units")
    return _Columns(labels, units, points, first, None, _unit_of_points(units, points))


def _is_data(row: Sequence[str]) -> bool:
    """Whether a row has numbers and nothing else."""
    texts = [text for text in row if text]
    return any(map(_is_number, texts)) and all(_is_number(text) or is_gap(text) for text in texts)


def _fault_of_data(row: Sequence[str]) -> str | None:
    """The first text of a row most of whose cells are numbers; None for other rows."""
    texts = [text for text in row if text]
    faults = [text for text in texts if not _is_number(text) and not is_gap(text)]
    return faults[0] if faults and len(faults) * 2 < len(texts) else None


def _two_rows(names: list[str], axes: list[str]) -> tuple[list[str], list[Point]]:
    """Labels and points of a row of names, each above the first of its columns or above all, and a row of axes."""
    labels: list[str] = []
    points: list[Point] = []
    name, start = "", 0
    for column, (text, axis) in enumerate(zip(names, axes, strict=True)):
        if text and (text != name or column >= start + 3):
            name, start = text, column
        if axis.lower() == "x" and [a.lower() for a in axes[column : column + 3]] == ["x", "y", "z"] and name:
            points.append(Point(name, (column, column + 1, column + 2)))
        labels.append(f"{name}.{axis}" if name and axis and text != axis else axis or text)
    return labels, points


def _unit_of_points(units: Sequence[str], points: Sequence[Point]) -> str | None:
    """The unit of the columns of points, or None. Raises BadInput if they differ."""
    found = dict.fromkeys(units[column] for point in points for column in point.columns if units[column])
    if len(found) > 1:
        raise BadInput(f"its points have different units, {', '.join(found)}; use unit= (--unit)")
    return next(iter(found), None)


def _section(title: str, section: list[list[str]]) -> _Columns:
    """The columns of a section of a Vicon Nexus export. Raises BadInput."""
    rate = nexus.rate_of(section)
    if math.isnan(rate):
        raise BadInput(f"its section {title} has no rate, names, axes and units")
    width = max(map(len, section[: nexus.HEAD_ROWS + 1]))
    names, axes, units = ([*row, *[""] * (width - len(row))] for row in section[2 : nexus.HEAD_ROWS])
    labels, points = _two_rows(names, axes)
    points = points if title == "trajectories" else []
    return _Columns(labels, units, points, nexus.HEAD_ROWS, rate, _unit_of_points(units, points))


def _with_sections(motion: Motion, found: dict[str, list[list[str]]]) -> Motion:
    """The motion of one section of a Vicon Nexus export with the others as signals, `extras["sections"]`."""
    notes: list[str] = list(motion.source.get("notes", ()))
    signals: dict[str, Signal] = {}
    for title, section in found.items():
        if title == "events":
            notes.append("the section events is not read")
            continue
        columns = _section(title, section)
        body = [row for row in section[columns.first_row :] if any(row)]
        values = _values(body, len(columns.labels), False, notes)
        if values.shape[1] < 3 or not len(values):
            continue
        first = 1 + round(start_s(motion.source, motion.rate) * motion.rate)
        signal = nexus.signal(
            title, values, columns.rate or math.nan, columns.labels[2:], columns.units[2:],
            first, len(motion), motion.rate, notes,
        )  # fmt: skip
        signals |= {} if signal is None else {title: signal}
    source = {**motion.source, "notes": notes} if notes else motion.source
    return replace(motion, source=source, extras={**motion.extras, "sections": signals} if signals else motion.extras)


def _motive(rows: list[list[str]]) -> _Columns:
    """An OptiTrack Motive export: markers are points, rotations of rigid bodies and all others are signals."""
    facts = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    axes_at = next((i for i, row in enumerate(rows[:HEADER_ROWS]) if row[0].lower() == "frame"), None)
    if axes_at is None or axes_at < 3:
        raise BadInput("its header has no row that begins with Frame")
    width = len(rows[axes_at])
    head = {row[1].lower(): [*row, *[""] * (width - len(row))] for row in rows[1:axes_at] if len(row) > 1 and row[1]}
    unlabelled = [[*row, *[""] * (width - len(row))] for row in rows[1 : axes_at - 1] if not any(row[:2])]
    names = head.get("name") or (unlabelled[1] if len(unlabelled) > 1 else [""] * width)  # below the row of types
    what = [*rows[axes_at - 1], *[""] * (width - len(rows[axes_at - 1]))]
    axes = rows[axes_at]
    labels = [f"{name}.{kind}.{axis}" if kind else axis for name, kind, axis in zip(names, what, axes, strict=True)]
    points = [
        Point(names[c] or f"P{c}", (c, c + 1, c + 2))
        for c in range(width - 2)
        if axes[c : c + 3] == ["X", "Y", "Z"] and what[c].lower() == "position"
    ]
    rates = (facts.get(f"{kind} Frame Rate", "") for kind in ("Export", "Capture"))
    rate = next((float(text) for text in rates if _is_number(text)), None)
    return _Columns(labels, [""] * width, points, axes_at + 1, rate, facts.get("Length Units") or None)


def _values(body: list[list[str]], columns: int, salvage: bool, notes: list[str]) -> Floats:
    """Rows of cells as numbers (rows, columns). Shorter rows end in gaps, but for the last, which may be cut off."""
    values = cells(body, columns)
    if len(body) > 1 and len(body[-1]) < min(map(len, body[:-1])):
        if not salvage:
            raise BadInput(CUT_OFF)
        values = values[:-1]
        notes.append(f"cut off: its last row is left out, {len(values)} rows are read")
    return values


def cells(body: list[list[str]], columns: int) -> Floats:
    """Rows of cells as numbers (rows, columns), NaN where rows are shorter. Raises BadInput."""
    widths = [len(row) for row in body]
    if len(body) * columns > 64 * sum(widths) + 4096:
        raise BadInput(f"its rows have at most {max(widths)} cells, there are {columns} labels")
    if body and max(widths) > columns:
        extra = next(row for row in body if len(row) > columns)
        if any(extra[columns:]):
            raise BadInput(f"a row has {len(extra)} cells, there are {columns} labels")
    return numbers([[*row[:columns], *[""] * (columns - len(row))] for row in body], columns)


def _timing(
    columns: _Columns, values: Floats, declared: float | None, rate: float | None, notes: list[str]
) -> tuple[Clock, Floats, set[int]]:
    """The clock of the rows, their times, and the columns of times and frame numbers."""
    used = {column for point in columns.points for column in point.columns}
    free = [column for column in range(len(columns.labels)) if column not in used]
    time_at = next((c for c in free if TIMES.match(columns.labels[c])), None)
    frame_at = next((c for c in free[:3] if FRAMES.match(columns.labels[c])), None)
    drop = {c for c in (time_at, frame_at) if c is not None}
    sub_at = next((c for c in free[:3] if columns.labels[c].lower() == "sub frame"), None)
    drop |= {sub_at} if sub_at is not None else set()
    if time_at is not None and len(values):
        is_ms = "ms" in columns.labels[time_at].lower() or columns.units[time_at].lower() == "ms"
        times = values[:, time_at] * (1e-3 if is_ms else 1.0)
        return clock(times, declared, rate, notes), times, drop
    hertz = rate or declared
    if hertz is None:
        raise BadInput("it has neither times nor a rate; use rate= (--rate)")
    ids = values[:, frame_at] if frame_at is not None else np.arange(1.0, len(values) + 1)
    if sub_at is not None and len(values) and values[:, sub_at].any():  # the rate is that of the samples in a frame
        ids = (ids - 1) * (values[:, sub_at].max() + 1) + values[:, sub_at] + 1
    return clock_of_numbers(ids, hertz, notes), (ids - 1) / hertz, drop


def write(path: str | Path, motion: Motion) -> None:
    """Write a CSV: comments with unit, rate and vertical axis; labels `time,NAME.x,NAME.y,NAME.z,…`; units; rows.

    Points are in the source's unit, metres for other sources; signals at the frame rate follow. Gaps are empty cells.
    Numbers read back the same. Raises BadInput for names with line breaks.
    """
    is_own = motion.source.get("format") == "csv" and "unit_m" in motion.source
    unit, unit_m = (str(motion.source["units"]), unit_of(motion.source)) if is_own else ("m", 1.0)
    labels, values = columns_of(motion, (".x", ".y", ".z"), unit_m, parked_of(motion))
    if any(not label.strip() or set(label) & set("\r\n") or label != label.strip() for label in labels):
        raise BadInput("a CSV cannot hold a column whose name is empty or has line breaks or spaces around it")
    begin = start_s(motion.source, motion.rate)
    times = [begin + frame / motion.rate for frame in range(len(motion))]
    if "times" in motion.extras and len(motion.extras["times"].values) == len(motion):
        times = motion.extras["times"].values.tolist()
    signals = motion.extras.get("signals")
    of_signals = dict(zip(signals.labels, signals.units, strict=False)) if signals is not None else {}
    of_points = {f"{name}.{axis}" for name in motion.names for axis in "xyz"}
    units = [unit if label in of_points else of_signals.get(label, "") for label in labels]
    lines = [f"# unit: {unit_m!r}" if metres_in(unit) is None else f"# unit: {unit}"]
    lines += [f"# rate: {motion.rate!r}", f"# up: {motion.up}", ",".join(["time", *map(_quoted, labels)])]
    if any(of_signals.values()) and all(metres_in(text) or UNIT_WORDS.match(text) for text in units):
        lines.append(",".join(["s", *units]))
    for time, row in zip(times, values.tolist(), strict=True):
        lines.append(",".join([cell(float(f"{time:.12g}")), *map(cell, row)]))
    replace_whole(path, ("\n".join(lines) + "\n").encode("utf-8"))


def _quoted(text: str) -> str:
    """A label as a cell."""
    return '"' + text.replace('"', '""') + '"' if set(text) & set(',;"#') else text
