"""Causes of differences between two readings of a file, from its bytes: one rule for each cause (`RULES`).

A rule returns a sentence if the bytes show its cause, else "".
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mocodec.formats.c3d.parameters import BLOCK, Parameters, parse

from .witnesses import Reading

UNEXPLAINED = "unexplained"


class Bytes:
    """A C3D or TRC as bytes: words of the header and parameters of a C3D, lines of a TRC."""

    def __init__(self, path: Path) -> None:
        self.data = path.read_bytes()
        self.is_c3d = path.suffix == ".c3d"
        self.words: tuple[int, ...] = ()
        self.parameters = Parameters()
        self.lines: list[list[str]] = []
        if self.is_c3d:
            self.words = struct.unpack_from("<256H", self.data)
            section = (self.data[0] - 1) * BLOCK
            self.parameters = parse(self.data, section, self.data[section + 3], (self.words[8] - 1) * BLOCK)
        else:
            self.lines = [line.split("\t") for line in self.data.decode("latin-1").splitlines()]


def explanation(path: Path, reader: str, quantity: str, ours: Reading | str, theirs: Reading | str) -> str:
    """The reader that is right about a quantity, with the reason; UNEXPLAINED if no rule applies."""
    file = Bytes(path)
    sentences = (rule(file, reader, quantity, ours, theirs) for rule in RULES)
    return next(filter(None, sentences), UNEXPLAINED)


def _is_cut_off(file: Bytes, reader: str, quantity: str, ours: Any, theirs: Any) -> str:
    if not (file.is_c3d and quantity == "file" and isinstance(ours, str)):
        return ""
    points, analog, first, last, block = (file.words[i] for i in (1, 2, 3, 4, 8))
    scale = file.parameters.number("POINT", "SCALE") or 0.0
    frame_bytes = (4 if scale < 0 else 2) * (4 * points + analog)
    there = (len(file.data) - (block - 1) * BLOCK) // frame_bytes
    if there >= last - first + 1:
        return ""
    return (
        f"mocodec is right: the header declares {last - first + 1} frames of {frame_bytes} bytes, and the file ends "
        f"after {there}. {reader} reads these without an error; mocodec does with `--salvage`, compared below"
    )


def _is_cut_off_trc(file: Bytes, reader: str, quantity: str, ours: Any, theirs: Any) -> str:
    if file.is_c3d or quantity != "file" or len(file.lines) > 5:
        return ""
    return f"both are right: the file ends in line {len(file.lines)}, before the names of the markers"


def _has_two_dimensional_fields(file: Bytes, reader: str, quantity: str, ours: Any, theirs: Any) -> str:
    value = file.parameters.groups.get("TRIAL", {}).get("ACTUAL_START_FIELD")
    if quantity != "file" or isinstance(ours, str) or not isinstance(value, np.ndarray) or value.ndim < 2:
        return ""
    shape = " × ".join(map(str, value.shape))
    return f"mocodec is right: TRIAL:ACTUAL_START_FIELD is a table of {shape} words, where {reader} expects a list"


def _has_no_point_rate(file: Bytes, reader: str, quantity: str, ours: Any, theirs: Any) -> str:
    if not file.is_c3d or quantity != "rates" or file.parameters.number("POINT", "RATE"):
        return ""
    (rate,) = struct.unpack_from("<f", file.data, 20)
    if not np.isclose(rate, ours.rates[0]):
        return ""
    analog = file.parameters.number("ANALOG", "RATE") or 0.0
    return (
        f"mocodec is right: the parameters lack POINT:RATE, the header has {rate:g} Hz at byte 20, and ANALOG:RATE is "
        f"{analog:g}"
    )


def _counts_from_zero(file: Bytes, reader: str, quantity: str, ours: Any, theirs: Any) -> str:
    if not file.is_c3d or quantity != "first frame" or file.words[3] != ours.first_frame:
        return ""
    return (
        f"mocodec is right: the header's first frame is {file.words[3]} (byte 6), though frames should count from 1; "
        f"{reader} counts from 0 and cannot show it"
    )


def _has_columns_without_name(file: Bytes, reader: str, quantity: str, ours: Any, theirs: Any) -> str:
    if file.is_c3d or quantity != "labels" or len(file.lines) < 6:
        return ""
    named = sum(bool(cell.strip()) for cell in file.lines[3][2:])
    same = all(a == b for a, b in zip(ours.labels[:named], theirs.labels[:named], strict=True))
    if not same or named == len(ours.labels) or any(theirs.labels[named:]):
        return ""
    return f"both are right: columns after the {named} that the file names have no name; mocodec numbers them"


Rule = Callable[[Bytes, str, str, Any, Any], str]
RULES: tuple[Rule, ...] = (
    _is_cut_off,
    _is_cut_off_trc,
    _has_two_dimensional_fields,
    _has_no_point_rate,
    _counts_from_zero,
    _has_columns_without_name,
)
