"""Numbers with units: parsing and formatting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import click
import pytest

from mocodec.cli import quantities
from mocodec.errors import BadInput


@dataclass(frozen=True)
class Settings:
    """Settings of every type."""

    name: ClassVar[str] = "example"
    components: int = 30
    tolerance: float = 0.001
    feet: tuple[str, ...] = ("LHEE",)
    closed: bool = False
    how: str = "ppca"
    max_error: float | None = None
    chunk_frames: int | None = None
    pairs: tuple[tuple[str, int], ...] | None = None
    kind: Literal["a", "b"] = "a"


@pytest.mark.parametrize(
    ("text", "metres"),
    [("2mm", 0.002), ("0.3cm", 0.003), ("0.002m", 0.002), ("500um", 0.0005), (".5 mm", 0.0005), ("1e-3m", 0.001)],
)
def test_lengths(text: str, metres: float) -> None:
    assert quantities.LENGTH.convert(text, None, None) == pytest.approx(metres)


@pytest.mark.parametrize("text", ["2", "mm", "2 parsec", "-1mm", "0mm", "1e999m", "nanmm", "", "2mm3"])
def test_invalid_lengths(text: str) -> None:
    with pytest.raises(click.BadParameter):
        quantities.LENGTH.convert(text, None, None)


def test_times() -> None:
    assert quantities.TIME.convert("12.5s", None, None) == (12.5, None)
    assert quantities.TIME.convert("1.5min", None, None) == (90, None)
    assert quantities.TIME.convert("1500f", None, None) == (None, 1500)
    for text in ("12", "-1s", "1.5f", "soon"):
        with pytest.raises(click.BadParameter):
            quantities.TIME.convert(text, None, None)


@pytest.mark.parametrize(
    ("kind", "texts", "number"),
    [
        (quantities.DEGREES, ("1", "1deg", "1°"), 1),
        (quantities.HERTZ, ("59.94", "59.94Hz"), 59.94),
        (quantities.DURATION, ("2", "2s"), 2),
        (quantities.RATIO, ("100",), 100),
        (quantities.DECIBELS, ("40", "40dB"), 40),
        (quantities.RESIDUAL, ("25", "25%"), 25),
    ],
)
def test_numbers_with_or_without_their_unit(kind: click.ParamType, texts: tuple[str, ...], number: float) -> None:
    assert [kind.convert(text, None, None) for text in texts] == [number] * len(texts)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (quantities.DEGREES, "0"), (quantities.DEGREES, "181"), (quantities.DEGREES, "1rad"),
        (quantities.HERTZ, "0"), (quantities.HERTZ, "1e999"), (quantities.RATIO, "0.5"), (quantities.RATIO, "100:1"),
        (quantities.DURATION, "-1"), (quantities.DECIBELS, "0"), (quantities.RESIDUAL, "101"),
    ],
)  # fmt: skip
def test_numbers_out_of_range(kind: click.ParamType, text: str) -> None:
    with pytest.raises(click.BadParameter, match="is not a"):
        kind.convert(text, None, None)


def test_sizes() -> None:
    assert quantities.SIZE.convert("50kB", None, None) == 50_000
    assert quantities.SIZE.convert("2MiB", None, None) == 2 * 2**20
    assert quantities.SIZE.convert("700", None, None) == 700
    for text in ("0", "50 kilos", "1e99GB"):
        with pytest.raises(click.BadParameter):
            quantities.SIZE.convert(text, None, None)


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("components=40", "components", 40),
        ("tolerance=2mm", "tolerance", 0.002),
        ("tolerance=2", "tolerance", 2.0),
        ('feet=["LHEE","LTOE"]', "feet", ("LHEE", "LTOE")),
        ("feet=LHEE, LTOE", "feet", ("LHEE", "LTOE")),
        ("closed=true", "closed", True),
        ("how=pca", "how", "pca"),
        ("max-error=3mm", "max_error", 0.003),
        ("max_error=null", "max_error", None),
        ("chunk_frames=100", "chunk_frames", 100),
        ('pairs=[["a", 1]]', "pairs", (["a", 1],)),
        ("kind=b", "kind", "b"),
    ],
)
def test_settings(text: str, name: str, value: object) -> None:
    assert quantities.setting(Settings, text) == (name, value)


@pytest.mark.parametrize(
    "text",
    [
        "components",
        "component=1",
        "components=many",
        "components=1.5",
        "closed=1",
        "feet=3",
        "chunk_frames=x",
        "kind=1",
        "max_error=x",
    ],
)
def test_invalid_settings(text: str) -> None:
    with pytest.raises(BadInput, match=text.partition("=")[0]):
        quantities.setting(Settings, text)


def test_formatting() -> None:
    assert [quantities.bound(m) for m in (0.002, 0.003, 0.0015)] == ["2 mm", "3 mm", "1.5 mm"]
    assert [quantities.length(m) for m in (0, 2e-8, 0.00123456, 0.5, 3)] == [
        "0 mm",
        "2.0e-05 mm",
        "1.23 mm",
        "500 mm",
        "3.00 m",
    ]
    assert quantities.size(12345) == "12,345 bytes"
