# pyright: strict
"""Archives on web servers and in stores: catalogue and priors are copied once, shards are read by ranges.

URL ─► catalogue.sqlite, priors ─► a temporary folder ─► Catalogue        URL/shards/… ─range requests─► a recording
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import tempfile
import weakref
from contextlib import closing
from pathlib import Path

from ..container.byte_sources import byte_source, is_url
from ..container.remote_sources import MOST_AHEAD_BYTES
from ..errors import BadInput, Corrupt
from ..file_range import FileRange
from . import encoding, shards
from .catalogue import NAME
from .rows import Row

__all__ = ["LocalCopy", "is_url", "local_folder", "place_of"]


NEEDED: set[LocalCopy] = set()
"""Copies with priors."""


class LocalCopy:
    """A temporary folder with the catalogue of a remote archive and the priors that its recordings need.

    The folder is removed with this object, by the process that made it; one with priors at the end of the process,
    since open recordings need them. Raises BadInput if they cannot be fetched.
    """

    def __init__(self, url: str) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="mocodec-"))
        self.remove = weakref.finalize(self, _remove, self.folder, os.getpid())
        try:
            fetch(f"{url}/{NAME}", self.folder / NAME)
        except BadInput as error:
            self.remove()
            raise BadInput(f"{url}: there is no archive here ({error})") from error
        try:
            for hash_ in _priors(self.folder / NAME):
                path = encoding.prior_path(self.folder, hash_)
                path.parent.mkdir(exist_ok=True)
                fetch(f"{url}/{path.relative_to(self.folder).as_posix()}", path)
                NEEDED.add(self)
        except BaseException:
            self.remove()
            raise


def fetch(url: str, path: Path) -> None:
    """Copy a remote file, a few MB at a time. Raises BadInput, Truncated."""
    source, part = byte_source(url), path.with_name(f"{path.name}.part")
    try:
        with open(part, "wb") as file:
            for start in range(0, source.size, MOST_AHEAD_BYTES):
                file.write(source.read(start, min(MOST_AHEAD_BYTES, source.size - start)))
        part.replace(path)
    finally:
        source.close()


def local_folder(where: str | os.PathLike[str], purpose: str) -> Path:
    """The folder of an archive. Raises BadInput for a URL, which says that `purpose` needs a local copy."""
    if is_url(os.fspath(where)):
        raise BadInput(f"{os.fspath(where)}: {purpose} needs the archive on this machine; copy its folder first")
    return Path(where)


def place_of(folder: str, row: Row, block: bytes | None) -> FileRange:
    """Where the bytes of a recording are. folder: the path or URL of the archive. block: what they need."""
    path = shards.path_of(Path(), row.shard)
    where = f"{folder}/{path.as_posix()}" if is_url(folder) else str(Path(folder) / path)
    return FileRange(where, row.start, row.stored_bytes, f"{folder}: {row.name}", block)


def _priors(catalogue: Path) -> list[str]:
    """Hashes of the priors that recordings need. Raises Corrupt."""
    try:
        with closing(sqlite3.connect(catalogue)) as connection:
            found = connection.execute("SELECT DISTINCT prior FROM recordings WHERE prior != ''").fetchall()
    except sqlite3.DatabaseError as error:
        raise Corrupt(f"the catalogue is damaged ({error}); it may have been fetched while it was written") from error
    hashes = [str(hash_) for (hash_,) in found]
    if not all(hash_.isalnum() for hash_ in hashes):
        raise Corrupt("the catalogue names a prior that is no hash")
    return hashes


def _remove(folder: Path, maker: int) -> None:
    """Remove the folder, unless this process was forked from its maker."""
    if os.getpid() == maker:
        shutil.rmtree(folder, ignore_errors=True)
