# pyright: strict
"""One builder at a time: a lock that the system releases when its process ends or is killed.

An exclusive transaction of SQLite on an empty file beside the catalogue: the locks of SQLite work alike on all systems.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from ..errors import BadInput

NAME = "building.lock"


@contextmanager
def only_builder(folder: Path) -> Generator[None, None, None]:
    """Hold the lock of an archive during the context. Raises BadInput if another process has it."""
    try:
        connection = sqlite3.connect(folder / NAME, timeout=0, isolation_level=None)
        try:
            connection.execute("BEGIN EXCLUSIVE")
            yield
        finally:
            connection.close()
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise BadInput(f"{folder}: another process is changing this archive; wait until it has ended") from None
        raise BadInput(f"{folder}: cannot write here ({error})") from error
    except sqlite3.DatabaseError as error:
        raise BadInput(f"{folder / NAME}: this is no lock of an archive ({error}); delete it") from error
