"""Tables with a column for each coordinate or signal (STO, MOT, CSV): columns to points and signals, times to a rate.

labels ─► three columns NAME.x NAME.y NAME.z that are no forces, angles, … ─► positions of a point
       └─ all others ─► `extras["signals"]`, with labels and units, bit for bit
times ─► rate, start, and the frame of each row
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..motion import Motion, Signal
from ..typing import Floats, Integers
from .conventions import USUAL_RATES, guess_up, with_start
from .zeros import parked_at_origin, store_parked

AXIS = re.compile(r"^(?P<name>.+?)(?P<mark>[.:_ |-]p?|\[)(?P<axis>[xyzXYZ]|(?<=_)[123])(?P<end>\]?)$")
"""A label of a coordinate: LASI.x, LASI_X, LASI[x], LASI_px, LASI_1."""
AXIS_FIRST = re.compile(r"^(?P<axis>[xyzXYZ])(?P<mark>[.:_])(?P<name>(?![xyzXYZ]$).+)$")
"""A label of a coordinate whose axis comes first: X_LASI, x:LASI, X_1."""
NO_POSITION = re.compile(
    "force|moment|torque|veloc|accel|angle|angular|rotation|quaternion|euler|orientation|gyro|magnet|emg|power|grf|"
    "impulse|jerk|activation|fiber|muscle|tendon|speed",
    re.IGNORECASE,
)
"""Words of labels whose three columns are no position."""
RATE_TOLERANCE = 5e-4
"""Relative difference between a declared rate and the times that needs no note."""
MAX_STEP_ERROR = 0.05
"""Share by which the shortest step of the times may differ from a frame of the declared rate."""
MAX_DROPPED_SHARE = 16
"""Rows that the times may skip, as a multiple of those that are there; more is taken for damage."""


class Point(NamedTuple):
    """A point and the columns of its x, y and z."""

    name: str
    columns: tuple[int, int, int]


def find_points(labels: Sequence[str]) -> list[Point]:
    """The points of a table by the labels of its columns; their columns may be in any order and place.

    The axis comes last, LASI_X, or first, X_LASI, where all three axes of that name are there.

    NAME_px belongs to a force plate, and is no point, where NAME_vx is there too; nor is NAME_1, … where NAME_4 is
    there, a quaternion.
    """
    found = _with_axis_first(labels)
    taken_first = {column for columns in found.values() for column in columns.values()}
    for column, label in enumerate(labels):
        match = None if column in taken_first else AXIS.match(label.strip())
        if match and not NO_POSITION.search(label):
            axis = match["axis"].lower().translate(str.maketrans("123", "xyz"))
            kind = match["mark"] + match["axis"].translate(str.maketrans("xyzXYZ123", "lllUUUnnn"))
            found.setdefault((match["name"], kind), {}).setdefault(axis, column)
    taken = {label.strip() for label in labels}
    points = []
    for (name, kind), columns in found.items():
        is_quaternion = kind.endswith("n") and f"{name}_4" in taken
        if (
            len(columns) == 3
            and not is_quaternion
            and not (kind.startswith(("_p", ".p")) and f"{name}{kind[0]}vx" in taken)
        ):
            points.append(Point(name, (columns["x"], columns["y"], columns["z"])))
    return points


def _with_axis_first(labels: Sequence[str]) -> dict[tuple[str, str], dict[str, int]]:
    """Columns of points by (name, kind of label) and axis, whose labels begin with the axis and are there for all."""
    found: dict[tuple[str, str], dict[str, int]] = {}
    for column, label in enumerate(labels):
        match = AXIS_FIRST.match(label.strip())
        if match and not NO_POSITION.search(label):
            kind = ("U" if match["axis"].isupper() else "l") + match["mark"]
            found.setdefault((match["name"], kind), {}).setdefault(match["axis"].lower(), column)
    return {key: columns for key, columns in found.items() if len(columns) == 3}


class Clock(NamedTuple):
    """frames (rows,): frame of each row, from 0; start: time of the first, seconds; is_regular: times fit the rate."""

    frames: Integers
    rate: float
    start: float
    is_regular: bool

    @property
    def total(self) -> int:
        """Frames, those without a row included."""
        return int(self.frames[-1]) + 1 if len(self.frames) else 0


def clock(times: Floats, declared: float | None, given: float | None, notes: list[str]) -> Clock:
    """Rate, start and frames of rows at these times; contradictions are noted.

    declared: the file's rate, hertz. given: the rate in place of both. Times that skip whole frames leave gaps.
    Raises BadInput for times that do not increase, and for no rate at all.
    """
    rows = len(times)
    counted = np.arange(rows)
    start = float(times[0]) if rows and math.isfinite(times[0]) else 0.0
    if rows < 2 or not np.isfinite(times).all():
        rate = given or declared
        if not rate:
            raise BadInput("its times do not give a frame rate; use rate= (--rate)")
        return Clock(counted, rate, start, True)
    steps = np.diff(times)
    if not (steps > 0).all():
        raise BadInput("its times do not increase")
    period = float(np.median(steps))
    if declared and abs(declared * steps.min() - 1) < MAX_STEP_ERROR:  # most rows may be missing
        period = 1 / declared
    index = np.concatenate([[0.0], np.cumsum(np.rint(steps / period))])
    fit = (times[-1] - times[0]) / index[-1]
    errors = np.abs(times - times[0] - index * fit)
    if errors.max() > 0.25 * period or index[-1] > MAX_DROPPED_SHARE * rows + 100:
        rate = given or declared or (rows - 1) / float(times[-1] - times[0])
        notes.append(
            f"its times step by {steps.min():.6g} to {steps.max():.6g} s: frames are taken as equally spaced at "
            f"{rate:.6g} Hz, and the times are kept as a signal"
        )
        return Clock(counted, rate, start, False)
    _note_missing(index, "times", notes)
    return Clock(index.astype(np.int64), _rate(fit, errors, declared, given, notes), start, True)


def clock_of_numbers(numbers: Floats, rate: float, notes: list[str]) -> Clock:
    """Start and frames of rows with these frame numbers, from 1, at a rate. Numbers that are skipped leave gaps.

    Raises BadInput for numbers that do not increase, and that skip far more frames than there are.
    """
    if not (math.isfinite(rate) and np.isfinite(numbers).all() and (np.diff(numbers) > 0).all()):
        raise BadInput("its frame numbers do not increase")
    if not len(numbers):
        return Clock(np.zeros(0, np.int64), rate, 0.0, True)
    index = numbers - numbers[0]
    if (index != np.rint(index)).any() or index[-1] > MAX_DROPPED_SHARE * len(numbers) + 100:
        raise BadInput(f"its frame numbers {numbers[0]:g} to {numbers[-1]:g} do not fit its {len(numbers)} rows")
    _note_missing(index, "frame numbers", notes)
    return Clock(index.astype(np.int64), rate, float(numbers[0] - 1) / rate, True)


def _note_missing(index: Floats, what: str, notes: list[str]) -> None:
    """Note the frames without a row. index (rows,): frame of each row, from 0."""
    if missing := int(index[-1]) + 1 - len(index):
        notes.append(f"{missing} frames are missing from the file's {what}: they are gaps")


def _rate(period: float, errors: Floats, declared: float | None, given: float | None, notes: list[str]) -> float:
    """The rate of equally spaced times: as given, the declared one if they agree, or a usual one."""
    if given:
        return given
    if declared and abs(declared * period - 1) <= RATE_TOLERANCE:
        return declared
    tolerance = max(1e-6, 2 * float(errors.max()) / (period * max(1, len(errors) - 1)))
    usual = min(USUAL_RATES, key=lambda rate: abs(rate * period - 1))
    rate = float(usual) if abs(usual * period - 1) <= min(tolerance, RATE_TOLERANCE) else 1 / period
    if declared:
        notes.append(
            f"the declared rate is {declared:g} Hz, the times run at {rate:.6g} Hz: the times are used "
            f"(--rate {declared:g} takes the other)"
        )
    return rate


def motion_of(
    labels: Sequence[str],
    values: Floats,
    points: Sequence[Point],
    timing: Clock,
    times: Floats,
    units: Sequence[str],
    unit: tuple[str, float],
    up: str | None,
    zeros: bool,
    source: dict[str, Any],
    notes: list[str],
) -> Motion:
    """The motion of a table. values (rows, columns); units of each column; unit of the points: name and metres."""
    frames = timing.total
    table = np.full((frames, values.shape[1]), np.nan)
    table[timing.frames] = values
    positions = positions_of(table, points, unit[1])
    gap = np.isnan(positions[:, :, 0])
    parked = parked_at_origin(positions, gap) if zeros else None
    others = np.ascontiguousarray(table[:, others_of(labels, points)])
    if parked is not None:
        positions[parked] = np.nan
    found = Table(list(labels), list(units), list(points), timing, times, unit, up)
    about = described(found, positions, others, parked, bool(gap.any()), source, notes)
    return replace(about, positions=positions)


class Table(NamedTuple):
    """The header of a table. units: of each column; unit: of the points, name and metres."""

    labels: list[str]
    units: list[str]
    points: list[Point]
    timing: Clock
    times: Floats
    unit: tuple[str, float]
    up: str | None


def positions_of(table: Floats, points: Sequence[Point], unit_m: float) -> Floats:
    """(frames, points, 3): positions in metres, NaN for gaps; table (frames, columns)."""
    positions = np.full((len(table), len(points), 3), np.nan)
    for at, point in enumerate(points):
        positions[:, at] = table[:, point.columns] * unit_m
    positions[~np.isfinite(positions).all(axis=2)] = np.nan
    return positions


def others_of(labels: Sequence[str], points: Sequence[Point]) -> list[int]:
    """The columns that are no points."""
    used = {column for point in points for column in point.columns}
    return [column for column in range(len(labels)) if column not in used]


def described(
    table: Table,
    positions: Floats,
    signals: Floats,
    parked: NDArray[Any] | None,
    other_gaps: bool,
    source: dict[str, Any],
    notes: list[str],
) -> Motion:
    """The motion without frames: names, axes, source and extras.

    positions (frames, points, 3): of some frames. signals (frames, columns): of the columns that are no points. parked,
    other_gaps: as in `store_parked`, None without.
    """
    labels, points, timing = table.labels, table.points, table.timing
    others = others_of(labels, points)
    extras: dict[str, Any] = {}
    if others:
        names, of_names = (tuple(texts[column] for column in others) for texts in (labels, table.units))
        extras["signals"] = Signal(signals, timing.rate, names, of_names)
    if not timing.is_regular:
        extras["times"] = Signal(table.times.copy(), timing.rate, ("time",), ("s",))
    if points and others and others != list(range(len(labels) - len(others), len(labels))):
        extras["columns"] = np.array(others, np.int32)
    source |= {"units": table.unit[0], "unit_m": table.unit[1]}
    if table.up is None and points:
        source["up_guessed"] = True
    if parked is not None:
        store_parked(parked, other_gaps, timing.rate, source, extras, notes)
    if timing.start:
        source = with_start(source, timing.rate, timing.start)
    if notes:
        source["notes"] = notes
    names = unique_names([point.name for point in points])
    up = table.up or (guess_up(positions) if points else "y")
    return Motion(positions[:0], timing.rate, names, up, source=source, extras=extras)


def unique_names(names: Sequence[str]) -> tuple[str, ...]:
    """Names that differ: a repeated one gets a number."""
    seen: dict[str, int] = {}
    result = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        result.append(name if seen[name] == 1 else f"{name}_{seen[name]}")
    return tuple(result)


def columns_of(motion: Motion, axis_labels: Sequence[str], unit_m: float, parked: Any) -> tuple[list[str], Floats]:
    """Labels and numbers (frames, columns) of a table: points as three columns each, and `extras["signals"]`.

    axis_labels: what follows a name, such as ".x", ".y", ".z". parked (frames, points): gaps that are zeros.
    """
    frames = len(motion)
    values = np.where(parked[:, :, None], 0.0, motion.positions / unit_m).reshape(frames, -1)
    if unit_m != 1:
        shorter = np.array([float(f"{v:.15g}") for v in values.ravel().tolist()]).reshape(values.shape)
        exact = shorter * unit_m == motion.positions.reshape(frames, -1)
        values = np.where(exact, shorter, values)
    labels = [f"{name}{axis}" for name in motion.names for axis in axis_labels]
    signal = motion.extras.get("signals")
    if not isinstance(signal, Signal):
        return labels, values
    if signal.values.shape != (frames, len(signal.labels)):
        raise BadInput(f"its signals {signal.values.shape} do not fit {frames} frames")
    others = np.asarray(motion.extras.get("columns", np.empty(0, np.int32)))
    total = values.shape[1] + len(signal.labels)
    if len(others) != len(signal.labels) or (len(others) and others.max() >= total):
        return [*labels, *signal.labels], np.concatenate([values, signal.values.astype(np.float64)], axis=1)
    table, all_labels = np.empty((frames, total)), [""] * total
    free = [column for column in range(total) if column not in set(others.tolist())]
    for columns, part, texts in ((free, values, labels), (others.tolist(), signal.values, signal.labels)):
        table[:, columns] = part
        for column, label in zip(columns, texts, strict=True):
            all_labels[column] = label
    return all_labels, table


def cell(value: float) -> str:
    """A number in the shortest form that reads back the same; "" for a gap."""
    return "" if math.isnan(value) else repr(value).removesuffix(".0")
