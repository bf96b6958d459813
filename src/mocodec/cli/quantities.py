"""Numbers with units, parsed and formatted: 2mm, 12.5s, 50kB, name=value."""

from __future__ import annotations

import json
import math
import re
from dataclasses import Field, fields
from typing import Any

import click

from ..errors import BadInput

METRES = {"um": 1e-6, "µm": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "ft": 0.3048}
SECONDS = {"ms": 1e-3, "s": 1.0, "min": 60.0}
BYTES = {"": 1, "B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30}

NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([^\d\s.]*)")


def split_unit(text: str) -> tuple[float, str] | None:
    """ "2mm" → (2.0, "mm"); None if it is not a number with a unit."""
    match = NUMBER.fullmatch(text.strip())
    return (float(match[1]), match[2]) if match else None


class Length(click.ParamType):
    """A length above zero, in metres."""

    name = "length"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if isinstance(value, float):
            return value
        number, unit = split_unit(value) or (0.0, "")
        if unit not in METRES:
            self.fail(f"{value!r} is not a length; write it with its unit, such as 2mm, 0.3cm or 0.002m", param, ctx)
        if not 0 < number < float("inf"):
            self.fail(f"{value!r} must be above zero", param, ctx)
        return number * METRES[unit]


class Time(click.ParamType):
    """A time from the first frame: (seconds, None) or, for "1500f", (None, frames)."""

    name = "time"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float | None, int | None]:
        if isinstance(value, tuple):
            return value
        number, unit = split_unit(value) or (-1.0, "")
        if (unit not in SECONDS and unit != "f") or not 0 <= number < float("inf"):
            self.fail(f"{value!r} is not a time; write it as 12.5s, 500ms, 1.5min, or 1500f for a frame", param, ctx)
        if unit == "f":
            if number != int(number):
                self.fail(f"{value!r}: a frame number must be a whole number", param, ctx)
            return None, int(number)
        return number * SECONDS[unit], None


class TimeOrSeconds(Time):
    """A time, or a number of seconds without a unit."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float | None, int | None]:
        number, unit = split_unit(str(value)) or (0.0, None)
        return super().convert(f"{number}s" if unit == "" else value, param, ctx)


class Size(click.ParamType):
    """A size in bytes."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        if isinstance(value, int):
            return value
        number, unit = split_unit(value) or (-1.0, "")
        if unit not in BYTES or not 1 <= number * BYTES[unit] < 2**63:
            self.fail(f"{value!r} is not a size; write it as 50kB, 50000 or 2MiB", param, ctx)
        return int(number * BYTES[unit])


class Number(click.ParamType):
    """A number with or without its unit, above `above` or from `least` on, and up to `most`."""

    def __init__(
        self,
        name: str,
        what: str,
        units: tuple[str, ...] = (),
        *,
        above: float = -math.inf,
        least: float = -math.inf,
        most: float = math.inf,
    ) -> None:
        self.name, self.what, self.units = name, what, ("", *units)
        self.above, self.least, self.most = above, least, most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if isinstance(value, float):
            return value
        number, unit = split_unit(value) or (math.nan, "")
        in_range = self.above < number and self.least <= number <= self.most and math.isfinite(number)
        if unit not in self.units or not in_range:
            self.fail(f"{value!r} is not {self.what}", param, ctx)
        return number


class Residual(Number):
    """A percentage from 0 to 100, or "exact"."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if value == "exact" else super().convert(value, param, ctx)


LENGTH, TIME, SIZE = Length(), Time(), Size()
TIME_OR_SECONDS = TimeOrSeconds()
RESIDUAL = Residual("residual", "a percentage from 0 to 100 or 'exact'", ("%",), least=0, most=100)
DECIBELS = Number("decibels", "a number of decibels above zero; write it as 40dB", ("dB",), above=0)
DEGREES = Number("degrees", "an angle above 0 and up to 180 degrees; write it as 1deg", ("deg", "°"), above=0, most=180)
HERTZ = Number("hz", "a number of frames per second above zero; write it as 120 or 59.94", ("Hz", "fps"), above=0)
RATIO = Number("ratio", "a ratio of 1 or more; write it as 100", least=1)
DURATION = Number("seconds", "a number of seconds above zero; write it as 2s", ("s",), above=0)


def setting(codec_class: Any, text: str) -> tuple[str, Any]:
    """ "components=40" as a setting of a codec, in the type that the codec declares; a length can have a unit.

    Raises BadInput for a setting that the codec does not have, or a value of the wrong type.
    """
    name, equals, value = text.partition("=")
    name = name.strip().replace("-", "_")
    known = {f.name: f for f in fields(codec_class)}
    if not equals or name not in known:
        problem = (
            f"{codec_class.name} has no setting {name!r}; it has" if equals else "write NAME=VALUE, with a NAME of"
        )
        raise BadInput(f"--set {text}: {problem}: {', '.join(known)}")
    number, unit = split_unit(value) or (0.0, "")
    if unit in METRES:
        return name, number * METRES[unit]
    try:
        parsed = json.loads(value)
    except ValueError:
        parsed = value
    return name, of_type(parsed, known[name], text)


def of_type(value: Any, field: Field[Any], text: str) -> Any:
    """The value, converted to the declared type of the field. Raises BadInput if that is not possible."""
    declared = str(field.type)
    while "[" in declared:  # tuple[str, ...] | None → tuple | None; a Literal's values are strings
        declared = re.sub(r"\[[^\[\]]*\]", "", declared.replace("Literal", "str"))
    wanted = {name.strip() for name in declared.split("|")}
    if isinstance(value, str) and "tuple" in wanted and "str" not in wanted:
        value = [part.strip() for part in value.split(",")]
    if isinstance(value, list):
        value = tuple(value)
    if type(value) is int and "float" in wanted and "int" not in wanted:
        value = float(value)
    kind = "None" if value is None else type(value).__name__
    if kind in wanted or not wanted <= {"int", "float", "bool", "str", "tuple", "None"}:
        return value
    raise BadInput(f"--set {text}: the value must be of type {' or '.join(sorted(wanted - {'None'}))}")


def length(metres: float) -> str:
    """A measured length as text, with three digits: "1.97 mm"."""
    mm = metres * 1000
    if mm == 0:
        return "0 mm"
    if mm >= 1000:
        return f"{mm / 1000:.2f} m"
    return f"{f'{mm:#.3g}'.rstrip('.')} mm" if mm >= 0.001 else f"{mm:.1e} mm"


def angle(degrees: float) -> str:
    """A measured angle as text, with three digits: "0.123°"."""
    if degrees == 0:
        return "0°"
    return f"{f'{degrees:#.3g}'.rstrip('.')}°" if degrees >= 0.001 else f"{degrees:.1e}°"


def bound(metres: float) -> str:
    """A length that a user chose as text, without trailing zeros: "2 mm"."""
    return f"{metres * 1000:.6g} mm"


def size(count: int) -> str:
    """A number of bytes as text: "12,345 bytes"."""
    return f"{count:,} bytes"
