# pyright: strict
"""A row of the catalogue: what it says about a recording, and which values its columns can have."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

MOST_SHARDS = 10**9


@dataclass(frozen=True)
class Row:
    """What the catalogue says about a recording.

    name: unique, with folders: "86/86_02"; stem: its last part. subject, trial, labels: read from the name; labels are
    words between spaces. path: of the source, relative to what was named; origin: where that was. format: its suffix.
    kind: "motion" or "clouds". frames, rate (Hz), seconds, points, joints (points with a skeleton), rotations (0 or 1).
    layout: hash of the names of the points, equal where these are equal. codec. mean_error, max_error: measured on all
    samples, metres; None where the source was a .mocz. bytes: of the .mocz; side_bytes: of these, extras and signals;
    raw_bytes: as float32 positions; ratio: raw_bytes / (bytes − side_bytes). source_hash: of the source, 128 bits of
    SHA-256; source_bytes, source_time_ns: its size and time of change. options: number in the table `options`.
    content: hash of the .mocz. shard, start: where the recording begins. prior: id of the prior of its own that it
    needs, or "". stored_bytes: what it takes in the shard. block: number of the block of its shard that it needs to
    become a .mocz, counted from 1, or 0 for a whole .mocz.
    """

    name: str
    stem: str
    subject: int | None
    trial: int | None
    labels: str
    path: str
    origin: str
    format: str
    kind: str
    frames: int
    rate: float
    seconds: float
    points: int
    joints: int
    rotations: int
    layout: str
    codec: str
    mean_error: float | None
    max_error: float | None
    bytes: int
    side_bytes: int
    raw_bytes: int
    ratio: float | None
    source_hash: str
    source_bytes: int
    source_time_ns: int
    options: int
    content: str
    shard: int
    start: int
    prior: str = ""
    stored_bytes: int = 0
    block: int = 0


COLUMNS = tuple(field.name for field in fields(Row))
_TEXT = (
    "name",
    "stem",
    "labels",
    "path",
    "origin",
    "format",
    "kind",
    "layout",
    "codec",
    "source_hash",
    "content",
    "prior",
)
_REAL = ("rate", "seconds", "mean_error", "max_error", "ratio")
_OPTIONAL = ("subject", "trial", "mean_error", "max_error", "ratio")
_OF_A_FOLDER = ("source_bytes", "source_time_ns")
"""Columns that are -1 for a folder of files; a file's time may be before 1970."""
_SUMMED = ("frames", "seconds", "bytes", "side_bytes", "raw_bytes", "stored_bytes")
HUGE = 1 << 62
SUMS_ARE_SOUND = "coalesce(min({}), 1)".format(
    " AND ".join(
        [f"typeof({c}) IN ('integer', 'real') AND {c} >= 0 AND {c} < {HUGE}" for c in _SUMMED]
        + [f"({c} IS NULL OR typeof({c}) = 'real' AND {c} >= 0 AND {c} < {HUGE})" for c in ("mean_error", "max_error")]
    )
)
"""SQL: 1 if all values that `sums` adds up are numbers of a plausible size."""


def column(name: str) -> str:
    kind = "TEXT" if name in _TEXT else "REAL" if name in _REAL else "INTEGER"
    return f'"{name}" {kind}' + (" PRIMARY KEY" if name == "name" else "")


def is_whole(value: object) -> bool:
    """Whether a value is a whole number that can be a size or a place."""
    return isinstance(value, int) and 0 <= value < HUGE


def is_sound(name: str, value: object) -> bool:
    """Whether a column can have this value: text without NUL, or a number that is finite and not negative."""
    if value is None:
        return name in _OPTIONAL
    if name in _TEXT:
        return isinstance(value, str) and "\0" not in value and not any("\ud800" <= c <= "\udfff" for c in value)
    if name in _REAL:
        return isinstance(value, float) and 0 <= value < math.inf
    if name in _OF_A_FOLDER:
        return isinstance(value, int)
    return is_whole(value)


def problem_of(values: Sequence[Any]) -> str:
    """The column of a row whose value cannot be, or ""."""
    for name, value in zip(COLUMNS, values, strict=True):
        if not is_sound(name, value):
            return name
    row = Row(*values)
    checks = {
        "name": row.name != "",
        "kind": row.kind in ("motion", "clouds"),
        "rate": row.rate > 0,
        "rotations": row.rotations in (0, 1),
        "side_bytes": row.side_bytes <= row.bytes,
        "prior": row.prior == "" or (row.prior.isascii() and row.prior.isalnum()),
        "shard": 0 < row.shard < MOST_SHARDS,
        "stored_bytes": row.block > 0 or row.stored_bytes == row.bytes,
    }
    return next((name for name, is_right in checks.items() if not is_right), "")
