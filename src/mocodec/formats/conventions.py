"""Conventions that files leave open or write in many ways: units of length, vertical axis, frame rate, start time."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import BadInput
from ..typing import Floats

UNITS_M = {"mm": 1e-3, "cm": 1e-2, "dm": 1e-1, "m": 1.0, "in": 0.0254, "ft": 0.3048}
"""Metres in a unit of length."""
UNIT_WORDS = {
    "mm": "millimeters millimetres millimetri millimetro milimetros milimetro milimetry мм миллиметры 毫米",
    "cm": "centimeters centimetres centimetri centimetro centimetros zentimeter centymetry см сантиметры 厘米",
    "dm": "decimeters decimetres decimetri decimetro decimetros dezimeter decymetry дм дециметры 分米",
    "m": "meters metres metri metro metros metry м метры 米",
    "in": "inches inch zoll pollici pollice pouces pouce pulgadas pulgada polegadas polegada",
    "ft": "feet foot fuss fuß piedi piede pieds pied pies",
    "um": "micrometers micrometres microns micron",
    "km": "kilometers kilometres",
}
"""Names of units, singular and plural, in the languages of the programs that write them, without accents."""
MORE_UNITS_M = {"um": 1e-6, "km": 1e3}
"""Metres in units that files may have, but that nobody chooses."""
MIN_UNIT_LETTERS = 4
"""Letters that identify a spelled-out unit that a fixed-width text cuts off, as in "mete"."""

MAX_START_S = 1e11
"""Times since 1970 in seconds are below it."""
MOST_METRES = 200.0
"""Larger extents of a frame are millimetres, where no unit is stored: a person, not a playing field."""

USUAL_RATES = (
    *(10, 12, 12.5, 15, 20, 24, 25, 30, 40, 48, 50, 60, 72, 75, 80, 90, 100, 120, 144, 150, 180, 200, 240, 250, 300),
    *(360, 400, 480, 500, 600, 1000),
    *(numerator / 1001 for numerator in (12000, 15000, 24000, 30000, 60000, 120000, 240000)),
)
"""Frame rates of cameras in hertz; the fractions are locked to video (23.976, 29.97, 59.94, 119.88)."""


def metres_in(unit: str) -> float | None:
    """Metres in a unit by its abbreviation or its name ("mm", "Meters", "mete"); None for an unknown one."""
    letters = unicodedata.normalize("NFKD", unit.strip().strip(".()[]'\" ").lower())
    text = "".join(letter for letter in letters if not unicodedata.combining(letter)).replace("\u03bc", "u")
    known = UNITS_M | MORE_UNITS_M
    if text in known:
        return known[text]
    for short, names in UNIT_WORDS.items():
        words = names.split()
        if text in words or (len(text) >= MIN_UNIT_LETTERS and any(word.startswith(text) for word in words)):
            return known[short]
    return None


def unit_option(unit: str | float, more_units: Mapping[str, float] | None = None) -> tuple[str, float]:
    """The name of a unit and its metres, from an option: a name, or a number of metres. Raises BadInput."""
    names = {name.lower(): name for name in more_units or {}}
    if isinstance(unit, str):
        if unit.lower() in names:
            return names[unit.lower()], dict(more_units or {})[names[unit.lower()]]
        unit_m = metres_in(unit)
        if unit_m is not None:
            return unit, unit_m
        try:
            unit = float(unit)
        except ValueError:
            known = ", ".join(dict.fromkeys([*UNITS_M, *(more_units or {})]))
            raise BadInput(f"unit {unit!r:.40} is neither a number of metres nor one of {known}") from None
    if not 0 < unit < math.inf:
        raise BadInput(f"a unit is a positive number of metres, not {unit}")
    return f"{unit:g} m", float(unit)


def guess_unit(positions: Floats) -> str:
    """The unit of people, "m" or "mm", by the median extent of a frame; positions (frames, points, 3)."""
    sample = positions[:: max(1, len(positions) // 500)]
    sample = sample[~np.isnan(sample[:, :, 0]).all(axis=1)]
    if not sample.size:
        return "m"
    with np.errstate(invalid="ignore", over="ignore"):  # of infinite positions, which `Motion` refuses
        extent = float(np.median((np.nanmax(sample, axis=1) - np.nanmin(sample, axis=1)).max(axis=1)))
    return "mm" if MOST_METRES < extent < math.inf else "m"


def guess_up(positions: Floats) -> str:
    """The vertical axis, "y" or "z", of people on a floor; positions (frames, points, 3) in metres.

    Along it the lowest point of a frame stays where it is while the body extends far: the axis with the smaller
    (standard deviation of the lowest point + 2 cm) / (median extent).
    """
    sample = positions[:: max(1, len(positions) // 500)]
    sample = sample[~np.isnan(sample[:, :, 0]).all(axis=1)]
    if not len(sample):
        return "z"
    lowest, highest = np.nanmin(sample, axis=1), np.nanmax(sample, axis=1)
    with np.errstate(invalid="ignore", over="ignore"):  # of infinite positions, which `Motion` refuses
        scores = (lowest.std(axis=0) + 0.02) / (np.median(highest - lowest, axis=0) + 1e-6)
    return "y" if scores[1] < scores[2] else "z"


def first_frame(source: Mapping[str, Any]) -> int:
    """The number of the first frame in the file's own count; 1 if the source has none, or one out of range."""
    first = source.get("first_frame")
    return first if isinstance(first, int) and 0 <= first < 1 << 31 else 1


def start_s(source: Mapping[str, Any], rate: float) -> float:
    """The time of the first frame in seconds, on the recording's own clock."""
    offset = source.get("time_of_frame_1", 0.0)
    is_time = isinstance(offset, float | int) and abs(offset) < MAX_START_S
    return (offset if is_time else 0.0) + (first_frame(source) - 1) / rate


def with_start(source: Mapping[str, Any], rate: float, time_s: float) -> dict[str, Any]:
    """The source with the first frame at this time.

    It is stored as the time of frame number 1, which cutting frames does not change, and only if that is not 0.
    Raises BadInput for a time that is not finite.
    """
    if not abs(time_s) < MAX_START_S:
        raise BadInput(f"a start time is a number of seconds below {MAX_START_S:g}, not {time_s}")
    first = first_frame(source)
    offset = round(time_s - (first - 1) / rate, 9)
    result = {**source, "first_frame": first, "time_of_frame_1": offset}
    if abs(offset) < 1e-6 * max(1.0, 1 / rate):
        del result["time_of_frame_1"]
        if "first_frame" not in source and first == 1:
            del result["first_frame"]
    return result


def unit_of(source: Mapping[str, Any]) -> float:
    """Metres in the source's unit. Raises BadInput if it has none, or one out of range."""
    unit_m = source.get("unit_m")
    if not isinstance(unit_m, float | int) or not 1e-9 < unit_m < 1e9:
        raise BadInput(f"the motion's source has no usable unit: unit_m is {unit_m!r:.40}")
    return float(unit_m)
