# pyright: strict
"""Text files line by line, for readers in pieces: memory for a block of lines, not for the file."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from ..errors import BadInput

PROBE_BYTES = 1 << 20
"""Bytes from which the encoding is found."""
BLOCK_LINES = 4096
LONGEST_HEADER = 1 << 16
"""Lines before the first frame, at most."""


def lines(path: Path) -> Iterator[str]:
    """The lines of a file without their ends: UTF-8, or else Windows-1252. Raises BadInput for binary files."""
    with path.open("rb") as file:
        probe = file.read(PROBE_BYTES)
    if probe.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or b"\0" in probe:
        raise BadInput(f"{path}: binary or UTF-16, which is read as a whole only")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(probe)
        encoding = "utf-8-sig"
    except UnicodeDecodeError:
        encoding = "cp1252"
    with path.open(encoding=encoding, errors="replace") as file:
        for line in file:
            yield line.rstrip("\n\x1a")


def blocks(rows: Iterator[str], count: int = BLOCK_LINES) -> Iterator[list[str]]:
    """Lines in runs of `count`, without blank ones."""
    filled = (row for row in rows if row.strip())
    while block := list(islice(filled, count)):
        yield block


def header(rows: Iterator[str], path: Path, ends: str) -> Iterator[str]:
    """At most LONGEST_HEADER lines. Raises BadInput beyond. ends: what ends a header, for the message."""
    for _ in range(LONGEST_HEADER):
        row = next(rows, None)
        if row is None:
            break
        yield row
    raise BadInput(f"{path}: cut off, or not of this format: it has no {ends}")
