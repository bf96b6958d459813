# pyright: strict
"""Reading an archive: recordings by name, and those that meet a condition.

db = mocodec.open_archive("vault")
db["86_02"][1200:1320]                                 a slice of one recording
for entry in db.query("subject == 86 and seconds > 10"):
    clip = entry.open()[:240]
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Self

from .. import api
from ..api import File
from ..codecs.tempo.models import prior
from ..errors import BadInput
from ..file_range import FileRange
from ..selection import counted
from . import catalogue, remote
from .catalogue import Catalogue
from .encoding import PRIORS, bytes_of
from .expressions import Constant, to_sql
from .rows import COLUMNS, SUMS_ARE_SOUND, Row

MAX_LISTED = 5
"""Names in an error message, at most."""


@dataclass(frozen=True)
class Entry:
    """A recording of an archive: its row in the catalogue (`entry.row`, as attributes too), and its bytes."""

    folder: str
    row: Row
    block: bytes | None = None
    """What the stored bytes need to become a `.mocz`."""

    def __getattr__(self, name: str) -> Any:
        """The columns of the row: `entry.subject`, `entry.seconds`, …"""
        if name in COLUMNS:
            return getattr(self.row, name)
        raise AttributeError(f"an entry has no {name!r}; it has: {', '.join(COLUMNS)}")

    @property
    def place(self) -> FileRange:
        """Where the bytes of the `.mocz` are: a source for `mocodec.open` and `mocodec.decode`."""
        return remote.place_of(self.folder, self.row, self.block)

    def open(self, salvage: bool = False) -> File[Any]:
        """The recording, open for random access, as by `mocodec.open`. Raises what that raises."""
        return api.open(self.place, salvage=salvage)

    def read(self) -> bytes:
        """The bytes of the `.mocz`. Raises BadInput, Truncated."""
        return bytes_of(self.place)


class Recordings:
    """Recordings of an archive that meet a condition, in order of their names; all of them in an `Archive`.

    `len(r)`, `for entry in r`, `r["86_02"]` (a File), `r.entry("86_02")`, `r.query(…)` narrows it further.
    """

    def __init__(
        self, archive: Archive, where: str = "1", constants: tuple[Constant, ...] = (), text: str = ""
    ) -> None:
        self._archive, self._where, self._constants, self._text = archive, where, constants, text

    @property
    def folder(self) -> str:
        """The folder of the archive."""
        return self._archive.path

    @property
    def priors(self) -> str:
        """The folder of the priors that its recordings need, on this machine; "" if they need none."""
        return self._archive.priors_folder

    def local_file(self, name: str) -> Path:
        """A file of the archive on this machine, which may not exist; of a remote archive a copy, fetched once.

        Raises BadInput if it cannot be fetched.
        """
        return self._archive.fetched(name)

    @property
    def names(self) -> list[str]:
        """The names of the recordings."""
        return self._archive.catalogue.names(self._where, self._constants)

    def rows(self) -> Iterator[Row]:
        """What the catalogue says about each recording."""
        return self._archive.catalogue.rows(self._where, self._constants)

    def rows_or_problems(self) -> Iterator[Row | tuple[str, str]]:
        """The same; for a row that cannot be, the recording's name and the error, where `rows` raises Corrupt."""
        return self._archive.catalogue.rows_or_problems(self._where, self._constants)

    def query(self, text: str) -> Recordings:
        """Those that meet a condition: "subject == 86 and seconds > 10 and 'walk' in labels".

        A condition compares columns of the catalogue (`mocodec.archive.COLUMNS`) with numbers, texts and None, by
        `== != < <= > >= in`, joined by `and or not`; `like(name, "86_*")` matches a pattern. Nothing is evaluated.
        Raises BadInput for anything else.
        """
        where, constants = to_sql(text, COLUMNS)
        joined = f"({self._where}) AND {where}"
        both = f"{self._text} and {text}" if self._text else text
        return Recordings(self._archive, joined, (*self._constants, *constants), both)

    def sums(self) -> dict[str, Any]:
        """Over all recordings: recordings, frames, seconds, bytes (as .mocz files), stored_bytes (in the shards, with
        the blocks that the recordings share), side_bytes, raw_bytes, mean_error (of all samples) and max_error (m; None
        if unknown). Raises Corrupt if one of these is no number in the catalogue."""
        names = ("recordings", "frames", "seconds", "bytes", "stored_bytes", "side_bytes", "raw_bytes")
        names += ("mean_error", "max_error")
        what = "count(*), total(frames), total(seconds), total(bytes), total(stored_bytes), total(side_bytes)"
        what += ", total(raw_bytes)"
        what += ", sum(mean_error * raw_bytes) / sum(CASE WHEN mean_error IS NULL THEN NULL ELSE raw_bytes END)"
        catalogue = self._archive.catalogue
        found = catalogue.values(f"{what}, max(max_error), {SUMS_ARE_SOUND}", self._where, self._constants)
        if not found[-1]:
            raise catalogue.damaged("a size or an error of a recording is no number")
        values = dict(zip(names, found[:-1], strict=True))
        values["stored_bytes"] += catalogue.block_bytes(self._where, self._constants)
        whole = ("frames", "bytes", "stored_bytes", "side_bytes", "raw_bytes")
        return {name: int(value) if name in whole else value for name, value in values.items()}

    def entry(self, name: str) -> Entry:
        """The recording of this name; the last part of the name suffices where only one has it. Raises BadInput."""
        catalogue = self._archive.catalogue
        rows = list(catalogue.rows(f"({self._where}) AND name = ?", (*self._constants, name)))
        if not rows:
            rows = list(catalogue.rows(f"({self._where}) AND stem = ?", (*self._constants, name)))
        if len(rows) == 1:
            return self.entry_of(rows[0])
        if rows:
            listed = ", ".join(row.name for row in rows[:MAX_LISTED]) + ", …" * (len(rows) > MAX_LISTED)
            raise BadInput(f"{self.folder}: {counted(len(rows), 'recording')} named {name}: {listed}")
        raise BadInput(
            f"{self.folder}: there is no recording named {name}{' that ' + self._text if self._text else ''}"
        )

    def __getitem__(self, name: str) -> File[Any]:
        """The recording of this name, open for random access: `db["86_02"][1200:1320]`. Raises BadInput."""
        return self.entry(name).open()

    def __contains__(self, name: object) -> bool:
        try:
            return isinstance(name, str) and bool(self.entry(name))
        except BadInput:
            return False

    def __iter__(self) -> Iterator[Entry]:
        for row in self.rows():
            yield self.entry_of(row)

    def entry_of(self, row: Row) -> Entry:
        """The recording of a row. Raises Corrupt."""
        return Entry(self.folder, row, self._archive.catalogue.block_of(row))

    def __len__(self) -> int:
        """The number of recordings."""
        return self._archive.catalogue.values("count(*)", self._where, self._constants)[0]

    def __repr__(self) -> str:
        condition = f" with {self._text}" if self._text else ""
        return f"<{type(self).__name__} {self.folder!r}: {counted(len(self), 'recording')}{condition}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Recordings, (self._archive, self._where, self._constants, self._text)


class Archive(Recordings):
    """An open archive: all its recordings. It can be pickled; each process opens the catalogue when it first needs it.

    path: a folder or a URL; of a remote archive the catalogue is copied when it is first needed, and again after
    `close`. A context; closing it closes the catalogue, which the next use opens again.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        super().__init__(self)
        place = os.fspath(path)
        self.path = place.rstrip("/") if remote.is_url(place) else os.path.abspath(place)
        self._open: tuple[int, Catalogue] | None = None
        self._copy: remote.LocalCopy | None = None

    @property
    def catalogue(self) -> Catalogue:
        """The catalogue, open in this process. Raises BadInput, TooNew, Corrupt."""
        if self._open is None or self._open[0] != os.getpid():  # a connection must not be used after a fork
            folder = self._folder()
            self._open = os.getpid(), Catalogue(folder)
            if self.priors_folder:
                prior.search_in(self.priors_folder)
        return self._open[1]

    def fetched(self, name: str) -> Path:
        """As `local_file`."""
        path = self._folder() / name
        if remote.is_url(self.path) and not path.exists():
            path.parent.mkdir(exist_ok=True)
            remote.fetch(f"{self.path}/{name}", path)
        return path

    @property
    def priors_folder(self) -> str:
        """The folder of priors of one's own, on this machine, or ""."""
        folder = os.path.join(self._folder(), PRIORS)
        return folder if os.path.isdir(folder) else ""

    def _folder(self) -> Path:
        """The folder with the catalogue: of the archive, or of a copy."""
        if not remote.is_url(self.path):
            return Path(self.path)
        if self._copy is None:
            self._copy = remote.LocalCopy(self.path)
        return self._copy.folder

    @property
    def failures(self) -> list[tuple[str, str]]:
        """Path and reason of each source that the last builds could not read or code."""
        return self.catalogue.failures()

    def close(self) -> None:
        """Close the catalogue."""
        if self._open is not None and self._open[0] == os.getpid():
            self._open[1].close()
        self._open = self._copy = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return Archive, (self.path,)


def open_archive(path: str | PathLike[str]) -> Archive:
    """Open an archive for reading: a folder, or a URL as `mocodec.open` takes.

        with mocodec.open_archive("vault") as db:
            clip = db["07/walk_02"][60:124]                # a Motion; reads and decodes these frames only
            for entry in db.query("subject == 8"):
                print(entry.name, entry.seconds)

    Raises BadInput, TooNew, Corrupt.
    """
    archive = Archive(path)
    _ = archive.catalogue
    return archive


def is_archive(path: str | PathLike[str]) -> bool:
    """Whether a folder is an archive."""
    return (Path(path) / catalogue.NAME).is_file()


def in_archive(path: str | PathLike[str]) -> tuple[str, str] | None:
    """The archive and the recording's name of ARCHIVE/NAME; None for paths that exist or lead to no archive."""
    if Path(path).exists():
        return None
    folder = next((parent for parent in Path(path).parents if parent.exists()), None)
    if folder is None or not is_archive(folder):
        return None
    return str(folder), Path(path).relative_to(folder).as_posix()
