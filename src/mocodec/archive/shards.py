# pyright: strict
"""Shards: files that hold many recordings one after another: a whole `.mocz`, or a short one without its head.

    magic "mocs" · version 2 · entries
    entry: varint length of the name · name (UTF-8) · varint bytes of the content · checksum of these · content
    content: a .mocz, whole or packed by `container.compact`; of an entry without a name: a block, the head of a .mocz

The catalogue says where each content begins. From the names a lost catalogue can be made again: `entries`
walks through a shard without it. A shard only grows. Bytes beyond its committed length come from a builder that was
killed, or are counted by a later catalogue than this one: nothing is cut off, and the next builder begins another
shard.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from ..container import compact
from ..container.byte_sources import byte_source
from ..container.wire import Cursor, checksum, varint
from ..errors import Corrupt, MocodecError, TooNew
from ..file_range import FileRange

MAGIC = b"mocs"
VERSION = 2
"""In version 1 every content is a whole `.mocz`."""
HEAD = MAGIC + bytes([VERSION])
CHECKSUM_BYTES = 4
SHARD_BYTES = 256 << 20
"""A shard that has this many bytes is complete, and the next recording begins another."""
FOLDER = "shards"
MAX_NAME_BYTES = 4096
BLOCKS_TRIED = 16
"""The last blocks of a shard that a head which is in none of them is compared with."""
DELTA_SHARE = 0.25
"""A head is stored by its difference from a block if that takes at most this share of it; otherwise it is a block."""
OLD = os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOFOLLOW", 0)
NEW = OLD | os.O_CREAT | os.O_EXCL
"""How a shard is opened: never through a link, and a new one only where there is no file."""


def path_of(folder: Path, number: int) -> Path:
    """The file of a shard, counted from 1."""
    return folder / FOLDER / f"{number:06}.mocs"


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(len(HEAD))


def entry_head(name: str, size: int) -> bytes:
    """The bytes before a content of `size` bytes."""
    text = name.encode("utf-8", "surrogateescape")
    head = varint(len(text)) + text + varint(size)
    return head + checksum(head)


def numbered(folder: Path) -> dict[int, Path]:
    """The shards of an archive by their numbers, whether the catalogue counts them or not; other files are left out."""
    found = [path for path in (folder / FOLDER).glob("*.mocs") if re.fullmatch(r"[0-9]{6,9}", path.stem)]
    return {int(path.stem): path for path in sorted(found) if path == path_of(folder, int(path.stem))}


def require_file(path: Path) -> None:
    """Raises Corrupt if a shard is a link, which could lead out of the archive, or anything else but a file."""
    if path.is_symlink() or not path.is_file():
        raise Corrupt(f"{path}: a shard must be a file, not a link or a folder")


@dataclass(frozen=True)
class Place:
    """Where a recording is: shard, the byte at which its content begins, bytes of the content, and the number of the
    block of this shard that it needs, counted from 1, or 0 for a whole `.mocz`."""

    shard: int
    start: int
    stored_bytes: int
    block: int


class Appender:
    """Appends recordings to the last shard of an archive, or to a new one where the last has bytes that do not count.

    sizes: bytes of each shard that the catalogue counts, by number; blocks: those of each shard. Nothing that exceeds
    the sizes is changed: it may be of a later catalogue than this one. Raises Corrupt if a shard is a link.
    """

    def __init__(
        self, folder: Path, sizes: dict[int, int], blocks: dict[int, list[bytes]], shard_bytes: int = SHARD_BYTES
    ) -> None:
        self.folder = folder
        self.sizes = dict(sizes)
        self.blocks = blocks
        self.shard_bytes = shard_bytes
        self.file: BinaryIO | None = None
        (folder / FOLDER).mkdir(exist_ok=True)
        found = numbered(folder)
        for path in found.values():
            require_file(path)
        self.number = max((*self.sizes, *found), default=0)
        """The shard that the next recording goes to."""
        counted = self.sizes.get(self.number, 0)
        is_whole = self.number in found and len(HEAD) <= counted == found[self.number].stat().st_size
        if not is_whole or _head(found[self.number]) != HEAD:
            self.number += 1

    def append(self, name: str, blob: bytes) -> Place:
        """Write one recording, a `.mocz`."""
        if self.sizes.get(self.number, 0) >= self.shard_bytes:
            self.close()
            self.number += 1
        parts = compact.split(blob)
        if parts is None:
            return self._write(name, blob, 0)
        number, stored = self._packed(parts)
        blocks = self.blocks.setdefault(self.number, [])
        if number == len(blocks):
            self._write("", parts.head, 0)
            blocks.append(parts.head)
        return self._write(name, stored, number + 1)

    def _packed(self, parts: compact.Parts) -> tuple[int, bytes]:
        """The number of a block, from 0, and the bytes to store; the next number if no block is like the head."""
        blocks = self.blocks.get(self.number, [])
        if parts.head in blocks:
            number = blocks.index(parts.head)
            return number, compact.pack(parts, parts.head, number)
        plain = compact.pack(parts, parts.head, len(blocks))
        tried = [(n, compact.pack(parts, blocks[n], n)) for n in range(len(blocks))[-BLOCKS_TRIED:]]
        number, best = min(tried, key=lambda found: len(found[1]), default=(0, b""))
        if tried and len(best) - len(plain) <= DELTA_SHARE * len(parts.head):
            return number, best
        return len(blocks), plain

    def _write(self, name: str, content: bytes, block: int) -> Place:
        number = self.number
        if self.file is None:
            is_new = number not in self.sizes
            self.file = os.fdopen(os.open(path_of(self.folder, number), NEW if is_new else OLD, 0o666), "ab")
            if is_new:
                self.file.write(HEAD)
                self.sizes[number] = len(HEAD)
        head = entry_head(name, len(content))
        self.file.write(head)
        self.file.write(content)
        at = self.sizes[number] + len(head)
        self.sizes[number] = at + len(content)
        return Place(number, at, len(content), block)

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


@dataclass(frozen=True)
class Found:
    """A recording of a shard: its name, where it is, and its bytes as a `.mocz`."""

    name: str
    place: Place
    bytes: FileRange


def entries(path: Path, blocks: list[bytes]) -> Iterator[Found]:
    """Every recording of a shard, from the front: what a lost catalogue is rebuilt from. blocks: takes its blocks.

    Raises Corrupt where an entry's head is damaged: what follows cannot be found. TooNew for a later version.
    """
    size = path.stat().st_size
    whole = byte_source(path)
    try:
        head = whole.read(0, min(size, len(HEAD)))
        if head[:4] != MAGIC:
            raise Corrupt(f"{path}: this is not a shard of an archive")
        if head[4:] not in (bytes([1]), bytes([VERSION])):
            raise TooNew(
                f"{path}: a shard of version {head[4:].hex()}; this mocodec reads up to version {VERSION}: upgrade it"
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
            if name:
                number = compact.block_number(whole.read(start, min(length, 16)))
                if number is not None and number >= len(blocks):
                    raise Corrupt(f"{path}: the entry at byte {at} needs a block that is not there")
                block = None if number is None else blocks[number]
                place = Place(int(path.stem), start, length, 0 if number is None else number + 1)
                yield Found(name, place, FileRange(str(path), start, length, name, block))
            else:
                blocks.append(whole.read(start, length) if length <= compact.MOST_BYTES else b"")
            at = start + length
    finally:
        whole.close()
