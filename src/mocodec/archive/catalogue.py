# pyright: strict
"""The catalogue: an SQLite database with one row per recording, its place in the shards and its properties.

    recordings   one row each (COLUMNS)          shards     committed length of each shard
    options      what recordings were coded with  failures   sources that could not be read or coded, and why

A change is one transaction. The bytes it refers to are on the disk before it: a reader sees the archive before or
after the change.
"""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, cast

from ..errors import BadInput, Corrupt, TooNew

NAME = "catalogue.sqlite"
APPLICATION_ID = 0x6D6F6361
"""SQLite's field for the program that a database belongs to: "moca"."""
VERSION = 1
MOST_SHARDS = 10**9
SECONDS_TO_WAIT = 10.0
"""How long a reader waits while a builder commits."""


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
    content: hash of the .mocz. shard, start: where the .mocz begins. prior: id of the prior of its own that it needs,
    or "".
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


COLUMNS = tuple(field.name for field in fields(Row))
_SELECT = ", ".join(f'"{name}"' for name in COLUMNS)
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
_SUMMED = ("frames", "seconds", "bytes", "side_bytes", "raw_bytes")
HUGE = 1 << 62
SUMS_ARE_SOUND = "coalesce(min({}), 1)".format(
    " AND ".join(
        [f"typeof({c}) IN ('integer', 'real') AND {c} >= 0 AND {c} < {HUGE}" for c in _SUMMED]
        + [f"({c} IS NULL OR typeof({c}) = 'real' AND {c} >= 0 AND {c} < {HUGE})" for c in ("mean_error", "max_error")]
    )
)
"""SQL: 1 if all values that `sums` adds up are numbers of a plausible size."""


def _column(name: str) -> str:
    kind = "TEXT" if name in _TEXT else "REAL" if name in _REAL else "INTEGER"
    return f'"{name}" {kind}' + (" PRIMARY KEY" if name == "name" else "")


SCHEMA = (
    f"CREATE TABLE recordings ({', '.join(map(_column, COLUMNS))}) WITHOUT ROWID",
    "CREATE INDEX by_stem ON recordings (stem)",
    "CREATE INDEX by_content ON recordings (content)",
    "CREATE TABLE shards (number INTEGER PRIMARY KEY, bytes INTEGER)",
    "CREATE TABLE options (number INTEGER PRIMARY KEY, text TEXT UNIQUE)",
    "CREATE TABLE failures (path TEXT PRIMARY KEY, name TEXT, reason TEXT)",
    f"PRAGMA application_id = {APPLICATION_ID}",
    f"PRAGMA user_version = {VERSION}",
)


def _text(data: bytes) -> str:
    """Text of the catalogue; bytes that are no UTF-8 as surrogates, which no sound column has."""
    return data.decode("utf-8", "surrogateescape")


def whole(value: object) -> bool:
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
    return whole(value)


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
    }
    return next((name for name, is_right in checks.items() if not is_right), "")


class Catalogue:
    """An open catalogue. Raises BadInput where there is none, TooNew for a later version, Corrupt if it is damaged.

    create: make one where there is none; Corrupt if there are shards, which a catalogue without rows would give up.
    """

    def __init__(self, folder: Path, create: bool = False) -> None:
        self.path = folder / NAME
        self.folder = folder
        if not create and not self.path.is_file():
            raise BadInput(f"{folder}: there is no archive here ({NAME} is missing)")
        with self._errors():
            # "rw" also for reading: after a builder was killed, the next to open rolls its transaction back
            uri = f"{self.path.absolute().as_uri()}?mode={'rwc' if create else 'rw'}"
            self.connection = sqlite3.connect(
                uri, uri=True, timeout=SECONDS_TO_WAIT, isolation_level=None, check_same_thread=False
            )
            self.connection.text_factory = _text
            self._prepare(create)

    def _prepare(self, create: bool) -> None:
        try:
            (id_,) = self.connection.execute("PRAGMA application_id").fetchone()
            (version,) = self.connection.execute("PRAGMA user_version").fetchone()
            (tables,) = self.connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
            if create and tables == 0 and next((self.folder / "shards").glob("*.mocs"), None):
                raise Corrupt(f"{self.path}: the catalogue is lost; make it again with `mocodec archive repair`")
            if create and tables == 0:
                with self.transaction():
                    for statement in SCHEMA:
                        self.connection.execute(statement)
            elif id_ != APPLICATION_ID:
                raise Corrupt(f"{self.path}: this is not the catalogue of an archive; restore it from a copy")
            elif version > VERSION:
                raise TooNew(
                    f"{self.path}: a catalogue of version {version}; this mocodec reads up to version {VERSION}: "
                    "upgrade it"
                )
            else:
                self._require_tables()
        except BaseException:
            self.connection.close()
            raise

    def _require_tables(self) -> None:
        """Raises Corrupt if a table is missing, or is a view, or if anything but tables and indices is there."""
        found = self.connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
        tables = {
            name for type_, name, sql in found if type_ == "table" and str(sql).upper().startswith("CREATE TABLE")
        }
        if not {"recordings", "shards", "options", "failures"} <= tables:
            raise self.damaged("a table is missing")
        if any(type_ not in ("table", "index") for type_, _, _ in found):
            raise self.damaged("it has a view or a trigger")

    @contextmanager
    def _errors(self) -> Generator[None, None, None]:
        """Errors of SQLite as those of mocodec."""
        try:
            yield
        except sqlite3.OperationalError as error:
            raise BadInput(f"{self.path}: {error}") from error
        except sqlite3.DatabaseError as error:
            raise self.damaged(str(error)) from error

    @contextmanager
    def transaction(self) -> Generator[None, None, None]:
        """All changes inside, or none. Raises BadInput if they cannot be written."""
        with self._errors():
            self.connection.execute("BEGIN IMMEDIATE")
            try:
                yield
                self.connection.execute("COMMIT")
            except BaseException:
                if self.connection.in_transaction:
                    self.connection.execute("ROLLBACK")
                raise

    def rows(self, where: str = "1", constants: Sequence[Any] = (), order: str = "name") -> Iterator[Row]:
        """The rows that meet a condition, in order of names. Raises Corrupt for one that cannot be."""
        for found in self.rows_or_problems(where, constants, order):
            if isinstance(found, tuple):
                raise self.damaged(f"{found[1]} of recording {found[0]}")
            yield found

    def rows_or_problems(
        self, where: str = "1", constants: Sequence[Any] = (), order: str = "name"
    ) -> Iterator[Row | tuple[str, str]]:
        """The rows that meet a condition; for one that cannot be, its name and what is wrong."""
        with self._errors():
            cursor = self.connection.execute(
                f"SELECT {_SELECT} FROM recordings WHERE {where} ORDER BY {order}", constants
            )
            for values in cursor:
                problem = problem_of(values)
                yield (str(values[0]), f"wrong {problem}") if problem else Row(*values)

    def names(self, where: str = "1", constants: Sequence[Any] = ()) -> list[str]:
        """The names of the rows that meet a condition, sorted. Raises Corrupt."""
        with self._errors():
            found = self.connection.execute(f"SELECT name FROM recordings WHERE {where} ORDER BY name", constants)
            names = [name for (name,) in found]
        if not all(name and is_sound("name", name) for name in names):
            raise self.damaged("a name is no text")
        return names

    def row(self, name: str) -> Row | None:
        """The row of exactly this name."""
        return next(self.rows("name = ?", [name]), None)

    def values(self, what: str, where: str = "1", constants: Sequence[Any] = ()) -> tuple[Any, ...]:
        """Sums and counts over the rows that meet a condition: one tuple."""
        with self._errors():
            return self.connection.execute(f"SELECT {what} FROM recordings WHERE {where}", constants).fetchone()

    def shards(self) -> dict[int, int]:
        """Bytes of each shard that count, by number. Raises Corrupt if these are no numbers."""
        with self._errors():
            found = self.connection.execute("SELECT number, bytes FROM shards").fetchall()
        if not all(isinstance(number, int) and 0 < number < MOST_SHARDS and whole(size) for number, size in found):
            raise self.damaged("its table of shards has no sizes")
        return dict(found)

    def require_counted(self) -> None:
        """Raises Corrupt if a recording lies outside the bytes of its shard that count: then nothing may be written."""
        with self._errors():
            found = self.connection.execute(
                "SELECT recordings.name FROM recordings LEFT JOIN shards ON number = shard "
                "WHERE NOT coalesce(start + recordings.bytes <= shards.bytes, 0) LIMIT 1"
            ).fetchone()
        if found is not None:
            raise self.damaged(f"the recording {found[0]} lies outside the bytes of its shard that count")

    def damaged(self, why: str) -> Corrupt:
        """The error of a damaged catalogue, with what can be done about it."""
        return Corrupt(
            f"{self.path}: the catalogue is damaged ({why}); restore it from a copy, or make it again with "
            "`mocodec archive repair`"
        )

    def failures(self) -> list[tuple[str, str]]:
        """Path and reason of each source that failed."""
        with self._errors():
            found = self.connection.execute("SELECT path, reason FROM failures ORDER BY path").fetchall()
        if not all(isinstance(text, str) for failure in found for text in failure):
            raise self.damaged("its table of failures has no texts")
        return found

    def options(self, number: int) -> dict[str, Any]:
        """What recordings with this number were coded with."""
        with self._errors():
            found = self.connection.execute("SELECT text FROM options WHERE number = ?", [number]).fetchone()
        try:
            options: Any = {} if found is None else json.loads(found[0])
        except (TypeError, ValueError, RecursionError):
            options = None
        if not isinstance(options, dict):
            raise self.damaged(f"its options {number}")
        return cast("dict[str, Any]", options)

    def option_number(self, options: Mapping[str, Any]) -> int:
        """The number of these options, which are stored if they are new."""
        text = json.dumps(options, sort_keys=True)
        with self._errors():
            self.connection.execute("INSERT OR IGNORE INTO options (text) VALUES (?)", [text])
            return self.connection.execute("SELECT number FROM options WHERE text = ?", [text]).fetchone()[0]

    def put(self, row: Row) -> None:
        """Insert a row, in place of one of its name; its source has not failed then."""
        marks = ", ".join("?" * len(COLUMNS))
        self.connection.execute(
            f"INSERT OR REPLACE INTO recordings ({_SELECT}) VALUES ({marks})", [getattr(row, c) for c in COLUMNS]
        )
        self.connection.execute("DELETE FROM failures WHERE path = ?", [row.path])

    def put_failure(self, path: str, name: str, reason: str) -> None:
        """Note why a source failed."""
        self.connection.execute("INSERT OR REPLACE INTO failures VALUES (?, ?, ?)", [path, name, reason])

    def put_shards(self, sizes: Mapping[int, int]) -> None:
        """From now on, these numbers of bytes of the shards count."""
        self.connection.executemany("INSERT OR REPLACE INTO shards VALUES (?, ?)", sorted(sizes.items()))

    def remove(self, name: str) -> None:
        """Remove a row; its bytes stay in the shard until the archive is merged into another."""
        self.connection.execute("DELETE FROM recordings WHERE name = ?", [name])

    def close(self) -> None:
        self.connection.close()
