# pyright: strict
"""The catalogue: an SQLite database with one row per recording, its place in the shards and its properties.

    recordings   one row each (COLUMNS)          shards     committed length of each shard
    options      what recordings were coded with  failures   sources that could not be read or coded, and why

A change is one transaction. The bytes it refers to are on the disk before it: a reader sees the archive before or
after the change.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from ..errors import BadInput, Corrupt, TooNew

NAME = "catalogue.sqlite"
APPLICATION_ID = 0x6D6F6361
"""SQLite's field for the program that a database belongs to: "moca"."""
VERSION = 1
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
        except BaseException:
            self.connection.close()
            raise

    @contextmanager
    def _errors(self) -> Generator[None, None, None]:
        """Errors of SQLite as those of mocodec."""
        try:
            yield
        except sqlite3.OperationalError as error:
            raise BadInput(f"{self.path}: {error}") from error
        except sqlite3.DatabaseError as error:
            raise Corrupt(
                f"{self.path}: the catalogue is damaged ({error}); restore it from a copy, or make it again with "
                "`mocodec archive repair`"
            ) from error

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
        """The rows that meet a condition, in order of names."""
        with self._errors():
            cursor = self.connection.execute(
                f"SELECT {_SELECT} FROM recordings WHERE {where} ORDER BY {order}", constants
            )
            for values in cursor:
                yield Row(*values)

    def names(self, where: str = "1", constants: Sequence[Any] = ()) -> list[str]:
        """The names of the rows that meet a condition, sorted."""
        with self._errors():
            found = self.connection.execute(f"SELECT name FROM recordings WHERE {where} ORDER BY name", constants)
            return [name for (name,) in found]

    def row(self, name: str) -> Row | None:
        """The row of exactly this name."""
        return next(self.rows("name = ?", [name]), None)

    def values(self, what: str, where: str = "1", constants: Sequence[Any] = ()) -> tuple[Any, ...]:
        """Sums and counts over the rows that meet a condition: one tuple."""
        with self._errors():
            return self.connection.execute(f"SELECT {what} FROM recordings WHERE {where}", constants).fetchone()

    def shards(self) -> dict[int, int]:
        """Bytes of each shard that count, by number."""
        with self._errors():
            return dict(self.connection.execute("SELECT number, bytes FROM shards").fetchall())

    def failures(self) -> list[tuple[str, str]]:
        """Path and reason of each source that failed."""
        with self._errors():
            return self.connection.execute("SELECT path, reason FROM failures ORDER BY path").fetchall()

    def options(self, number: int) -> dict[str, Any]:
        """What recordings with this number were coded with."""
        with self._errors():
            found = self.connection.execute("SELECT text FROM options WHERE number = ?", [number]).fetchone()
        return {} if found is None else json.loads(found[0])

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
        """From now on, so many bytes of the shards count."""
        self.connection.executemany("INSERT OR REPLACE INTO shards VALUES (?, ?)", sorted(sizes.items()))

    def remove(self, name: str) -> None:
        """Remove a row; its bytes stay in the shard until the archive is merged into another."""
        self.connection.execute("DELETE FROM recordings WHERE name = ?", [name])

    def close(self) -> None:
        self.connection.close()
