# pyright: strict
"""Shards: files that hold many recordings one after another, each a whole `.mocz`.

    magic "mocs" · version 1 · entries
    entry: varint length of the name · name (UTF-8) · varint bytes of the .mocz · checksum of these · the .mocz

The catalogue says where each `.mocz` begins. From the names a lost catalogue can be made again: `entries`
walks through a shard without it. A shard only grows. Bytes beyond its committed length come from a builder that was
killed; the next builder cuts them off.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ..container.byte_sources import byte_source
from ..container.wire import Cursor, checksum, varint
from ..errors import Corrupt, MocodecError, TooNew
from ..file_range import FileRange

MAGIC = b"mocs"
VERSION = 1
HEAD = MAGIC + bytes([VERSION])
CHECKSUM_BYTES = 4
SHARD_BYTES = 256 << 20
"""A shard that has this many bytes is complete, and the next recording begins another."""
FOLDER = "shards"
MAX_NAME_BYTES = 4096


def path_of(folder: Path, number: int) -> Path:
    """The file of a shard, counted from 1."""
    return folder / FOLDER / f"{number:06}.mocs"


def entry_head(name: str, size: int) -> bytes:
    """The bytes before a `.mocz` of `size` bytes."""
    text = name.encode("utf-8", "surrogateescape")
    head = varint(len(text)) + text + varint(size)
    return head + checksum(head)


class Appender:
    """Appends recordings to the last shard of an archive.

    sizes: bytes of each shard that the catalogue counts, by number. What exceeds them is cut off on opening.
    """

    def __init__(self, folder: Path, sizes: dict[int, int], shard_bytes: int = SHARD_BYTES) -> None:
        self.folder = folder
        self.sizes = dict(sizes)
        self.shard_bytes = shard_bytes
        self.file: BinaryIO | None = None
        (folder / FOLDER).mkdir(exist_ok=True)
        for path in (folder / FOLDER).glob("*.mocs"):
            counted = self.sizes.get(int(path.stem)) if path.stem.isdecimal() else None
            if counted is None:
                path.unlink()
            elif path.stat().st_size > counted:
                os.truncate(path, counted)

    def append(self, name: str, blob: bytes) -> tuple[int, int]:
        """Write one recording; returns the shard's number and the byte at which the `.mocz` begins."""
        number = max(self.sizes, default=1)
        if self.sizes.get(number, 0) >= self.shard_bytes:
            self.close()
            number += 1
        if self.file is None:
            self.file = open(path_of(self.folder, number), "ab")  # noqa: SIM115 (open until close)
            if self.sizes.get(number, 0) == 0:
                self.file.write(HEAD)
                self.sizes[number] = len(HEAD)
        head = entry_head(name, len(blob))
        self.file.write(head)
        self.file.write(blob)
        at = self.sizes[number] + len(head)
        self.sizes[number] = at + len(blob)
        return number, at

    def flush(self) -> None:
        """Have the system write everything to the disk: before the catalogue counts it."""
        if self.file is not None:
            self.file.flush()
            os.fsync(self.file.fileno())

    def close(self) -> None:
        """Flush, and close the shard."""
        if self.file is not None:
            file, self.file = self.file, None
            try:
                file.flush()
                os.fsync(file.fileno())
            finally:
                file.close()


def entries(path: Path) -> Iterator[tuple[str, FileRange]]:
    """Name and bytes of every recording of a shard, from the front: what a lost catalogue is rebuilt from.

    Raises Corrupt where an entry's head is damaged: what follows cannot be found. TooNew for a later version.
    """
    size = path.stat().st_size
    whole = byte_source(path)
    try:
        head = whole.read(0, min(size, len(HEAD)))
        if head[:4] != MAGIC:
            raise Corrupt(f"{path}: this is not a shard of an archive")
        if head[4:] != bytes([VERSION]):
            raise TooNew(
                f"{path}: a shard of version {head[4:].hex()}; this mocodec reads version {VERSION}: upgrade it"
            )
        at = len(HEAD)
        while at < size:
            cursor = Cursor(whole.read(at, min(size - at, MAX_NAME_BYTES + 32)), "an entry")
            try:
                name = cursor.take(cursor.varint()).decode("utf-8", "surrogateescape")
                length = cursor.varint()
                body = cursor.at
                is_whole = cursor.take(CHECKSUM_BYTES) == checksum(whole.read(at, body))
            except MocodecError as error:
                raise Corrupt(f"{path}: the entry at byte {at} is damaged ({error})") from None
            start = at + body + CHECKSUM_BYTES
            if not is_whole or start + length > size:
                raise Corrupt(f"{path}: the entry at byte {at} is damaged")
            yield name, FileRange(str(path), start, length, name)
            at = start + length
    finally:
        whole.close()
