# pyright: strict
"""An archive: many recordings as `.mocz` in a few shard files, and a catalogue of them. docs/archive.md has the layout.

build     sources ─► shards and catalogue; goes on where it was stopped
open_archive, Archive, Entry     recordings by name or by a condition
damage, remove, merge, repair    care of an archive
"""

from __future__ import annotations

from .building import Report, build
from .catalogue import COLUMNS, Row
from .database import Archive, Entry, Recordings, open_archive
from .encoding import Options
from .maintenance import damage, merge, remove, repair, unused_bytes
from .pool import dask_cluster

__all__ = [
    "COLUMNS", "Archive", "Entry", "Options", "Recordings", "Report", "Row", "build", "damage", "dask_cluster", "merge",
    "open_archive", "remove", "repair", "unused_bytes",
]  # fmt: skip
