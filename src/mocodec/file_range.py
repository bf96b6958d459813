# pyright: strict
"""A range of a file's bytes that is read as if it were a file: one recording among many in a shard."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FileRange:
    """`size` bytes of the file at `path` from byte `start` on. label: what error messages call it.

    block: what the bytes need to become a `.mocz` (`container.compact`), or None if they are one.
    """

    path: str
    start: int
    size: int
    label: str = ""
    block: bytes | None = None
