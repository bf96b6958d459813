"""STO and MOT: tables of OpenSim and SIMM, with a header that ends in `endheader`, then labels, then rows.

    Coordinates                 name
    version=1                   keys, in any order: nRows, nColumns, inDegrees, DataType …
    nRows=2 …
    endheader
    time  pelvis_tilt  LASI_x LASI_y LASI_z …
    0.0   0.12 …

Three columns of a position are a point; joint coordinates, forces and all others are signals.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BadInput
from ..motion import Motion
from ..typing import Floats
from . import replace_whole
from .columns import Point, cell, clock, columns_of, find_points, motion_of
from .conventions import start_s, unit_of, unit_option
from .text import is_gap, read_text
from .zeros import parked_of, zeros_are_gaps

HOLDS = frozenset({"signals", "columns", "times", "zero_samples"})
"""What a STO or MOT stores beside the positions."""

KEY = re.compile(r"^\s*([A-Za-z_]\w*)\s*(?:=\s*|\s+)(\S+)\s*$")
ROWS, COLUMNS = ("nrows", "datarows"), ("ncolumns", "datacolumns")
PARTS = {"vec3": 3, "quaternion": 4, "vec6": 6, "spatialvec": 6, "mat33": 9}
"""Numbers in a cell of a table whose header has this DataType."""
MAX_HEADER_LINES = 1000


def read(
    path: str | Path,
    up: str | None = None,
    unit: str | float | None = None,
    rate: float | None = None,
    gaps: str | None = None,
    salvage: bool = False,
) -> Motion:
    """A STO or MOT file as a motion; lengths are metres unless `unit` says otherwise.

    Columns NAME_x, NAME_y, NAME_z (or .x, [x], _px, _1 …) are points, all others `extras["signals"]` with their units.
    rate: in place of that of the times. gaps: "keep" takes points at exactly (0, 0, 0) as positions. salvage: read
    a file that is cut off. Raises BadInput.
    """
    try:
        return _read(read_text(path), up, unit, rate, zeros_are_gaps(gaps), salvage)
    except BadInput as error:
        raise error if str(error).startswith(str(path)) else BadInput(f"{path}: {error}") from None


def _read(
    text: str, up: str | None, unit: str | float | None, rate: float | None, zeros: bool, salvage: bool
) -> Motion:
    lines = text.split("\n")
    end = next((i for i, line in enumerate(lines[:MAX_HEADER_LINES]) if line.strip().lower() == "endheader"), None)
    if end is None:
        raise BadInput("cut off, or not a STO or MOT file: its header has no line endheader")
    header = lines[:end]
    keys = {match[1].lower(): match[2] for line in header if (match := KEY.match(line))}
    body = [line for line in lines[end + 1 :] if line.strip()]
    if not body:
        raise BadInput("cut off: it has no line of labels")
    notes: list[str] = []
    parts = PARTS.get(keys.get("datatype", "double").lower(), 1)
    if parts == 1 and any("," in line for line in body[1:]) and not any("." in line for line in body[1:]):
        body[1:] = [line.replace(",", ".") for line in body[1:]]
    labels, values = _table(body, parts, salvage, notes)
    if not labels or labels[0].lower() not in ("time", "t"):
        raise BadInput(f"its first column is {labels[0] if labels else ''!r:.40}, not time")
    _check_counts(keys, labels, values, parts, salvage, notes)
    times, labels, values = values[:, 0], labels[1:], values[:, 1:]
    points = find_points(labels) if parts == 1 else []
    if parts == 3:
        points = [Point(labels[i].removesuffix("_1"), (i, i + 1, i + 2)) for i in range(0, len(labels), 3)]
    source: dict[str, Any] = {"format": "sto", "header": [line.rstrip() for line in header]}
    if unit is None and points and not any("s.i." in line.lower() for line in header):
        source["unit_guessed"] = True
    units = _units(labels, keys.get("indegrees", "").lower())
    declared = _number(keys.get("datarate"))
    timing = clock(times, declared, rate, notes)
    given = unit_option(unit or "m")
    return motion_of(labels, values, points, timing, times, units, given, up, zeros, source, notes)


def _table(body: Sequence[str], parts: int, salvage: bool, notes: list[str]) -> tuple[list[str], Floats]:
    """Labels of all columns, time among them, and numbers (rows, columns)."""
    has_tabs = "\t" in body[0]
    rows = [[cell.strip() for cell in line.rstrip().split("\t")] if has_tabs else line.split() for line in body]
    labels, rows = rows[0], rows[1:]
    if rows and salvage and len(rows[-1]) < len(labels):
        rows.pop()
        notes.append("its last row is cut off and left out")
    if wrong := next((i for i, row in enumerate(rows) if len(row) != len(labels)), None):
        raise BadInput(f"row {wrong + 1} has {len(rows[wrong])} cells, there are {len(labels)} labels")
    if rows and len(rows[0]) != len(labels):
        raise BadInput(f"row 1 has {len(rows[0])} cells, there are {len(labels)} labels")
    if parts > 1:
        labels = [labels[0], *(f"{label}_{i + 1}" for label in labels[1:] for i in range(parts))]
        rows = [[row[0], *(part for cell in row[1:] for part in _parts(cell, parts))] for row in rows]
    return labels, numbers(rows, len(labels))


def _parts(text: str, parts: int) -> list[str]:
    """The numbers of a cell such as ~[1,2,3] or 1,2,3."""
    found = text.strip("~[]()").split(",")
    if len(found) != parts:
        raise BadInput(f"a cell has {len(found)} numbers, not {parts}: {text!r:.40}")
    return found


def numbers(rows: Sequence[Sequence[str]], columns: int) -> Floats:
    """Cells as numbers (rows, columns); empty cells and words for gaps are NaN. Raises BadInput."""
    flat = ["nan" if is_gap(text) else text for row in rows for text in row]
    try:
        return np.array(list(map(float, flat)), np.float64).reshape(len(rows), columns)
    except ValueError:
        for text in flat:
            try:
                float(text)
            except ValueError:
                raise BadInput(f"{text!r:.40} is not a number") from None
        wrong = next(number for number, row in enumerate(rows, 1) if len(row) != columns)
        raise BadInput(f"row {wrong} of its numbers has {len(rows[wrong - 1])} cells, not {columns}") from None


def _check_counts(
    keys: dict[str, str], labels: list[str], values: Floats, parts: int, salvage: bool, notes: list[str]
) -> None:
    """The declared numbers of rows and columns against those that are there. Raises BadInput for missing rows."""
    declared = next((_number(keys[name]) for name in ROWS if name in keys), None)
    rows = len(values)
    if declared is not None and rows < declared:
        if not salvage or not rows:
            raise BadInput(
                f"cut off: its header declares {declared:.0f} rows, the file has {rows}; --salvage (salvage=True) "
                "reads these"
            )
        notes.append(f"cut off: {rows} of {declared:.0f} declared rows are read")
    elif declared is not None and rows > declared:
        notes.append(f"the header declares {declared:.0f} rows, the file has {rows}: all are read")
    count = 1 + (len(labels) - 1) // parts
    columns = next((_number(keys[name]) for name in COLUMNS if name in keys), None)
    if columns is not None and columns != count:
        notes.append(f"the header declares {columns:.0f} columns, there are labels for {count}: the labels are used")


def _number(text: str | None) -> float | None:
    try:
        value = float(text) if text else None
    except ValueError:
        return None
    return value if value is not None and abs(value) < 1e12 else None


def _units(labels: Sequence[str], in_degrees: str) -> list[str]:
    """The units of columns that follow from OpenSim's conventions: degrees or radians, metres, newtons."""
    angle = {"yes": "deg", "true": "deg", "no": "rad", "false": "rad"}.get(in_degrees, "")
    units = []
    for label in labels:
        name = label.lower()
        if re.search("torque|moment", name):
            units.append("Nm")
        elif re.search(r"force.*_v[xyz]$|force(_[xyz])?$", name):
            units.append("N")
        elif re.search(r"_[tp][xyz]$", name):
            units.append("m")
        else:
            units.append(angle if angle and not re.search("speed|activation|length|excitation", name) else "")
    return units


def write(path: str | Path, motion: Motion) -> None:
    """Write a STO or MOT: points as NAME_x, NAME_y, NAME_z in metres, then the signals at the frame rate.

    A motion that was read from such a file keeps its header and the order of its columns. Gaps are "nan". Numbers read
    back the same. Raises BadInput for names with tabs or spaces at their ends.
    """
    is_own = motion.source.get("format") == "sto"
    unit_m = unit_of(motion.source) if is_own and "unit_m" in motion.source else 1.0
    labels, values = columns_of(motion, ("_x", "_y", "_z"), unit_m, parked_of(motion))
    if any(not label.strip() or set(label) & set("\t\r\n") or label != label.strip() for label in labels):
        raise BadInput("a STO cannot hold a column whose name is empty or has tabs or spaces around it")
    kept = motion.source.get("header") if is_own else None
    lines = [str(line) for line in kept] if isinstance(kept, list | tuple) else []
    if not lines:
        lines = [Path(path).stem, "version=1", "nRows=0", "nColumns=0", "inDegrees=yes"]
    begin = start_s(motion.source, motion.rate)
    times = [begin + frame / motion.rate for frame in range(len(motion))]
    if "times" in motion.extras and len(motion.extras["times"].values) == len(motion):
        times = motion.extras["times"].values.tolist()
    lines = [_with_count(line, len(motion), 1 + len(labels)) for line in lines]
    lines += ["endheader", "\t".join(["time", *labels])]
    for time, row in zip(times, values.tolist(), strict=True):
        lines.append("\t".join([cell(float(f"{time:.12g}")), *(cell(value) or "nan" for value in row)]))
    replace_whole(path, ("\n".join(lines) + "\n").encode("utf-8"))


def _with_count(line: str, rows: int, columns: int) -> str:
    """A line of the header with the numbers of rows and columns of this table."""
    match = KEY.match(line)
    name = match[1].lower() if match else ""
    if match and name in (*ROWS, *COLUMNS):
        at = match.start(2)
        return line[:at] + str(rows if name in ROWS else columns)
    return "DataType=double" if name == "datatype" else line
