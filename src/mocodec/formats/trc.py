"""TRC: tab-separated marker positions (Motion Analysis; also OpenSim's marker format).

PathFileType …        kind of file, and the name it had
DataRate …            keys of the next line, then their values: rate, counts, units
Frame#  Time  LASI … names, one every three columns; then X1 Y1 Z1 …
1  0.000  x y z …     a line a frame; an empty cell is a gap
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..motion import Floats, Motion
from . import replace_whole
from .conventions import UNITS_M, first_frame, guess_up
from .text import numbers, read_text

HOLDS: frozenset[str] = frozenset()  # of what is beside the positions

KEYS = (
    "DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames",
)  # fmt: skip


def read(path: str | Path, up: str | None = None) -> Motion:
    """A TRC file as a motion, metres. A marker without all three coordinates at a frame is a gap there.

    Columns beyond the named ones, where some programs put reflections that they could not identify, become points P34,
    P35, …; NumMarkers of those programs counts something else, so the columns decide. up: the vertical axis, which a
    TRC does not say; guessed from the motion unless told. Raises BadInput.
    """
    lines = read_text(path).split("\n")
    if not lines[0].startswith("PathFileType"):
        raise BadInput(f"{path}: not a TRC: it does not begin with PathFileType")
    names_at = next((i for i, line in enumerate(lines[:20]) if line.startswith("Frame#")), None)
    if names_at is None or names_at < 3:
        raise BadInput(f"{path}: cut off or not a TRC: it has no line of marker names")
    header = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    try:
        frames, markers = int(header["NumFrames"]), int(header["NumMarkers"])
        rate, units = float(header["DataRate"]), header.get("Units", "mm")
    except (KeyError, ValueError) as error:
        raise BadInput(f"{path}: its header does not say rate, frames and markers ({error})") from None
    if units.lower() not in UNITS_M:
        raise BadInput(f"{path}: unknown unit {units!r}; known: {', '.join(UNITS_M)}")
    rows = [line.rstrip("\t ").split("\t") for line in lines[names_at + 2 :] if line.strip()]
    if len(rows) != frames:
        what = "cut off: " if len(rows) < frames else ""
        raise BadInput(f"{path}: {what}its header promises {frames} frames, the file holds {len(rows)}")
    names = _marker_names(lines[names_at], max(map(len, rows), default=2))
    if len(names) < markers and any(map(str.strip, lines[names_at + 1].split("\t")[2 + 3 * len(names) :])):
        names += tuple(f"P{i + 1}" for i in range(len(names), markers))
    if not names or frames * len(names) > 64 * sum(map(len, rows)) + 4096:
        raise BadInput(f"{path}: {markers} markers are promised, there are columns for {len(names)}")
    markers = len(names)
    table = _table(rows, 2 + 3 * markers, path)
    unit_m = UNITS_M[units.lower()]
    positions = (table[:, 2:] * unit_m).reshape(frames, markers, 3)
    positions[np.isnan(positions).any(axis=2)] = np.nan
    first = table[0, 0] if frames else 1
    if not (math.isfinite(first) and abs(first) < 2**53):
        raise BadInput(f"{path}: its first frame's number is {first}")
    source = {"format": "trc", "units": units, "unit_m": unit_m, "first_frame": int(first)}
    if up is None:
        source["up_guessed"] = True
    return Motion(positions, rate, names, up or guess_up(positions), source=source)


def _marker_names(line: str, width: int) -> tuple[str, ...]:
    """Names of the markers, every third cell after two; rows may be wider than the names, or end in gaps."""
    cells = [cell.strip() for cell in line.split("\t")[2:]]
    if any(cells[1::3]) or any(cells[2::3]):
        cells = [cell for name in filter(None, cells) for cell in (name, "", "")]
    while cells and not cells[-1]:
        cells.pop()
    count = max(-(-len(cells) // 3), -(-(width - 2) // 3))
    cells += [""] * (3 * count - len(cells))
    return tuple(name or f"P{i + 1}" for i, name in enumerate(cells[::3]))


def _table(rows: list[list[str]], columns: int, path: str | Path) -> Floats:
    """Rows of cells as numbers (rows, columns); missing and empty cells are NaN."""
    for row in rows:
        row.extend([""] * (columns - len(row)))
        for column, cell in enumerate(row):
            if not cell or cell.isspace() or cell.strip().lower() == "nan":
                row[column] = MISSING
    table = numbers("\t".join("\t".join(row) for row in rows), path)
    if table.size != len(rows) * columns:
        raise BadInput(f"{path}: a cell holds more than one number")
    table[table == float(MISSING)] = np.nan
    return table.reshape(len(rows), columns)


MISSING = "-8.3e307"  # stands for an empty cell while the block is parsed at once


def write(path: str | Path, motion: Motion) -> None:
    """Write a TRC in the source's unit (millimetres for other sources); gaps are empty cells.

    Numbers have seven decimals of the unit, so a motion in millimetres comes back within 1e-10 m. TRC has no place for
    analog channels, events, parameters or a skeleton (docs/formats.md). Raises BadInput for names with tabs.
    """
    if any(not name.strip() or set(name) & set("\t\r\n") or name != name.strip() for name in motion.names):
        raise BadInput("a TRC cannot hold a marker whose name is empty or has tabs or spaces around it")
    known = str(motion.source.get("units", "")).lower() in UNITS_M
    units = str(motion.source["units"]) if known else "mm"
    first, count = first_frame(motion.source), len(motion)
    rate = f"{motion.rate:.10g}"
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{Path(path).name}",
        "\t".join(KEYS),
        "\t".join([rate, rate, str(count), str(motion.points), units, rate, str(first), str(count)]),
        "Frame#\tTime\t" + "\t\t\t".join(motion.names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(motion.points) for axis in "XYZ"),
        "",
    ]
    values = (motion.positions / UNITS_M[units.lower()]).reshape(count, -1)
    form = "\t".join(["%.7f"] * values.shape[1])
    for frame, row in enumerate(values):
        text = (form % tuple(row.tolist())).replace("nan", "")
        lines.append(f"{first + frame}\t{frame / motion.rate:.6f}\t{text}")
    replace_whole(path, ("\n".join(lines) + "\n").encode("utf-8"))
