# pyright: strict
"""The catalogue: an SQLite database with one row per recording, its place in the shards and its properties.

    recordings   one row each (COLUMNS)          shards     committed length of each shard
    options      what recordings were coded with  failures   sources that could not be read or coded, and why
    blocks       heads that recordings of a shard share (`container.compact`), as in the shard

A change is one transaction. The bytes it refers to are on the disk before it: a reader sees the archive before or
after the change.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

from ..container import compact
from ..errors import BadInput, Corrupt, TooNew
from .rows import COLUMNS, MOST_SHARDS, Row, column, is_sound, is_whole, problem_of

NAME = "catalogue.sqlite"
APPLICATION_ID = 0x6D6F6361
"""SQLite's field for the program that a database belongs to: "moca"."""
VERSION = 2
"""Version 1 has no blocks, and no columns that say how a recording is stored: every content is a whole `.mocz`."""
SECONDS_TO_WAIT = 10.0
"""How long a reader waits while a builder commits."""


_SELECT = ", ".join(f'"{name}"' for name in COLUMNS)
_BLOCKS = "CREATE TABLE blocks (shard INTEGER, number INTEGER, bytes BLOB, PRIMARY KEY (shard, number))"
_RECORDINGS_1 = "(SELECT *, bytes AS stored_bytes, 0 AS block FROM recordings)"
"""The rows of a catalogue of version 1, with the columns of this version."""
_FROM_1_TO_2 = (
    "ALTER TABLE recordings ADD COLUMN stored_bytes INTEGER",
    "ALTER TABLE recordings ADD COLUMN block INTEGER",
    "UPDATE recordings SET stored_bytes = bytes, block = 0",
    _BLOCKS,
    f"PRAGMA user_version = {VERSION}",
)
SCHEMA = (
    f"CREATE TABLE recordings ({', '.join(map(column, COLUMNS))}) WITHOUT ROWID",
    "CREATE INDEX by_stem ON recordings (stem)",
    "CREATE INDEX by_content ON recordings (content)",
    "CREATE TABLE shards (number INTEGER PRIMARY KEY, bytes INTEGER)",
    _BLOCKS,
    "CREATE TABLE options (number INTEGER PRIMARY KEY, text TEXT UNIQUE)",
    "CREATE TABLE failures (path TEXT PRIMARY KEY, name TEXT, reason TEXT)",
    f"PRAGMA application_id = {APPLICATION_ID}",
    f"PRAGMA user_version = {VERSION}",
)


def _text(data: bytes) -> str:
    """Text of the catalogue; bytes that are no UTF-8 as surrogates, which no sound column has."""
    return data.decode("utf-8", "surrogateescape")


class Catalogue:
    """An open catalogue. Raises BadInput where there is none, TooNew for a later version, Corrupt if it is damaged.

    create: make one where there is none, and bring one of an earlier version to this one; Corrupt if there are shards,
    which a catalogue without rows would give up.
    """

    def __init__(self, folder: Path, create: bool = False) -> None:
        self._blocks: dict[int, list[bytes]] = {}
        self._table = "recordings"
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
                self._require_tables(version)
                if version < VERSION and create:
                    with self.transaction():
                        for statement in _FROM_1_TO_2:
                            self.connection.execute(statement)
                elif version < VERSION:
                    self._table = _RECORDINGS_1
        except BaseException:
            self.connection.close()
            raise

    def _require_tables(self, version: int) -> None:
        """Raises Corrupt if a table is missing, or is a view, or if anything but tables and indices is there."""
        found = self.connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
        tables = {
            name for type_, name, sql in found if type_ == "table" and str(sql).upper().startswith("CREATE TABLE")
        }
        if not {"recordings", "shards", "options", "failures"} <= tables or (
            version >= VERSION and "blocks" not in tables
        ):
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
        except UnicodeDecodeError as error:  # of a message of SQLite, which quotes a damaged table
            raise self.damaged("text that is not UTF-8") from error

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
        """The rows that meet a condition, in order of names. Raises Corrupt for an invalid row."""
        for found in self.rows_or_problems(where, constants, order):
            if isinstance(found, tuple):
                raise self.damaged(f"{found[1]} of recording {found[0]}")
            yield found

    def rows_or_problems(
        self, where: str = "1", constants: Sequence[Any] = (), order: str = "name"
    ) -> Iterator[Row | tuple[str, str]]:
        """The rows that meet a condition; for a damaged one its name and the error."""
        with self._errors():
            cursor = self.connection.execute(
                f"SELECT {_SELECT} FROM {self._table} WHERE {where} ORDER BY {order}", constants
            )
            for values in cursor:
                problem = problem_of(values)
                yield (str(values[0]), f"wrong {problem}") if problem else Row(*values)

    def names(self, where: str = "1", constants: Sequence[Any] = ()) -> list[str]:
        """The names of the rows that meet a condition, sorted. Raises Corrupt."""
        with self._errors():
            found = self.connection.execute(f"SELECT name FROM {self._table} WHERE {where} ORDER BY name", constants)
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
            return self.connection.execute(f"SELECT {what} FROM {self._table} WHERE {where}", constants).fetchone()

    def blocks(self, shard: int) -> list[bytes]:
        """The blocks of a shard, in order of their numbers. Raises Corrupt if one is missing or too long for a head."""
        if shard not in self._blocks:
            found: list[Any] = []
            if self._table == "recordings":
                with self._errors():
                    found = self.connection.execute(
                        "SELECT number, CASE WHEN length(bytes) <= ? THEN bytes END FROM blocks WHERE shard = ? "
                        "ORDER BY number",
                        [compact.MOST_BYTES, shard],
                    ).fetchall()
            if [number for number, _ in found] != list(range(len(found))) or not all(
                isinstance(block, bytes) for _, block in found
            ):
                raise self.damaged(f"the blocks of shard {shard}")
            self._blocks[shard] = [block for _, block in found]
        return self._blocks[shard]

    def block_of(self, row: Row) -> bytes | None:
        """The block that a recording needs, or None. Raises Corrupt."""
        if not row.block:
            return None
        if row.block > len(self.blocks(row.shard)):
            self._blocks.pop(row.shard)  # a builder may have added some
        blocks = self.blocks(row.shard)
        if row.block > len(blocks):
            raise self.damaged(f"wrong block of recording {row.name}")
        return blocks[row.block - 1]

    def block_bytes(self, where: str = "1", constants: Sequence[Any] = ()) -> int:
        """Bytes of the blocks that the rows which meet a condition need, each once."""
        with self._errors():
            rows = f"SELECT DISTINCT shard, block FROM {self._table} WHERE block > 0 AND ({where})"
            found = self.connection.execute(rows, constants).fetchall()
        return sum(len(block) for shard in {s for s, _ in found} for block in self._used(shard, found))

    def _used(self, shard: int, found: Sequence[tuple[Any, Any]]) -> list[bytes]:
        numbers = {number for s, number in found if s == shard}
        return [block for number, block in enumerate(self.blocks(shard), 1) if number in numbers]

    def shards(self) -> dict[int, int]:
        """Bytes of each shard that count, by number. Raises Corrupt if these are no numbers."""
        with self._errors():
            found = self.connection.execute("SELECT number, bytes FROM shards").fetchall()
        if not all(isinstance(number, int) and 0 < number < MOST_SHARDS and is_whole(size) for number, size in found):
            raise self.damaged("its table of shards has no sizes")
        return dict(found)

    def require_counted(self) -> None:
        """Raises Corrupt if a recording lies outside the bytes of its shard that count: then nothing may be written."""
        with self._errors():
            found = self.connection.execute(
                "SELECT recordings.name FROM recordings LEFT JOIN shards ON number = shard "
                "WHERE NOT coalesce(start + stored_bytes <= shards.bytes, 0) LIMIT 1"
            ).fetchone()
        if found is not None:
            raise self.damaged(f"the recording {found[0]} lies outside the bytes of its shard that count")

    def require_consistent(self) -> None:
        """Raises Corrupt if tables and indices contradict each other, as after a flipped bit in a name. Reads all."""
        with self._errors():
            (found,) = self.connection.execute("PRAGMA integrity_check(1)").fetchone()
        if found != "ok":
            raise self.damaged(str(found).replace("\n", " "))

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

    def put_blocks(self, blocks: Mapping[int, Sequence[bytes]]) -> None:
        """Have these blocks of each shard, in order of their numbers."""
        rows = [(shard, number, block) for shard, found in blocks.items() for number, block in enumerate(found)]
        self.connection.executemany("INSERT OR REPLACE INTO blocks VALUES (?, ?, ?)", rows)

    def put_shards(self, sizes: Mapping[int, int]) -> None:
        """From now on, these numbers of bytes of the shards count."""
        self.connection.executemany("INSERT OR REPLACE INTO shards VALUES (?, ?)", sorted(sizes.items()))

    def remove(self, name: str) -> None:
        """Remove a row; its bytes stay in the shard until the archive is merged into another."""
        self.connection.execute("DELETE FROM recordings WHERE name = ?", [name])

    def close(self) -> None:
        self.connection.close()
