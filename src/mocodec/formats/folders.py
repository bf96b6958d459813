# pyright: strict
"""Recordings in folders: which files are recordings, which belong to others, and whether they have changed."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from . import FRAMES, rgbd

COMPANIONS = {".amc": ".asf", ".gltf": ".bin"}
"""Files beside a source that belong to it, by suffix."""


def below(path: str, suffixes: Collection[str]) -> list[str]:
    """A file as it is; of a folder, files with these suffixes and folders of frames or images, at any depth."""
    if not os.path.isdir(path):
        return [path]
    frames = [suffix for suffix in FRAMES if suffix in suffixes]
    result: list[str] = []
    for folder, inner, names in os.walk(path):
        inner[:] = sorted(name for name in inner if not name.startswith("."))
        visible = [name for name in names if not name.startswith(".")]
        if frames and rgbd.is_sequence(folder):
            result.append(folder)
            inner.clear()
            continue
        if any(name.lower().endswith(tuple(frames)) for name in visible):
            result.append(folder)
        wanted = [s for s in suffixes if s not in frames]
        found = [os.path.join(folder, name) for name in visible if os.path.splitext(name)[1].lower() in wanted]
        result += [file for file in found if os.path.isfile(file) or not os.path.exists(file)]  # no pipe, no device
    return result


def mirrored_name(path: str, base: str) -> str:
    """The path relative to `base`, with "/"; the folder's own name for `base` itself."""
    return os.path.basename(path) if path == base else Path(os.path.relpath(path, base)).as_posix()


def fingerprint(path: str, options: Mapping[str, Any] | None = None) -> list[int]:
    """Bytes and latest time of change (ns) of a file or of the files in a folder, with those that belong to it: its
    companions, and the files that options name. [] for what does not exist, such as a URL."""
    where = Path(path)
    try:
        parts = sorted(where.rglob("*") if rgbd.is_sequence(where) else where.iterdir()) if where.is_dir() else [where]
        companion = COMPANIONS.get(where.suffix.lower())
        if companion is not None and where.parent.is_dir():
            parts += [p for p in where.parent.iterdir() if p.suffix.lower() == companion]
        parts += [Path(value) for value in (options or {}).values() if isinstance(value, str) and os.path.isfile(value)]
        stats = [part.stat() for part in parts]
    except OSError:
        return []
    return [sum(s.st_size for s in stats), max((s.st_mtime_ns for s in stats), default=0)]
