# pyright: strict
"""An archive: many recordings as `.mocz` in a few shard files, and a catalogue of them. docs/archive.md has the layout.

build     sources ─► shards and catalogue; goes on where it was stopped
open_archive, Archive, Entry     recordings by name or by a condition
damage, remove, merge, repair    check and change an archive
index, search, duplicates        find similar motion
train_prior                      a prior of one's own people
"""

from __future__ import annotations

from .building import Report, build
from .database import Archive, Entry, Recordings, in_archive, is_archive, open_archive
from .encoding import Options
from .maintenance import damage, merge, remove, repair, unused_bytes, whole_bytes
from .pool import dask_cluster
from .prior_training import train_prior
from .rows import COLUMNS, Row
from .similarity import Hit, Pair, duplicates, index, search

__all__ = [
    "COLUMNS", "Archive", "Entry", "Hit", "Options", "Pair", "Recordings", "Report", "Row", "build", "damage",
    "dask_cluster", "duplicates", "in_archive", "index", "is_archive", "merge", "open_archive", "remove", "repair",
    "search", "train_prior", "unused_bytes", "whole_bytes",
]  # fmt: skip
