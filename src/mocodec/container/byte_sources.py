"""Random access to the bytes of a file: in memory, by path, by file object, by URL, or a range of a file.

A source may be read from several threads.
"""

from __future__ import annotations

import io
import os
import re
from dataclasses import replace
from threading import Lock
from typing import Any, BinaryIO, Protocol, cast

from ..errors import BadInput, Corrupt, Truncated
from ..file_range import FileRange
from . import compact
from .remote_sources import remote_file

MAX_PIPED_BYTES = 1 << 30
"""The most that is read from a pipe, which cannot be read at any place."""


class ByteSource(Protocol):
    """Bytes that can be read at any offset. name: for messages, or "". size: bytes in total."""

    name: str
    size: int

    def read(self, start: int, count: int) -> bytes:
        """Exactly `count` bytes from byte `start` on. Raises Truncated if the file ends before."""
        ...

    def close(self) -> None: ...


def byte_source(where: Any) -> ByteSource:
    """Random access to bytes, a path, a URL, a binary file object or a FileRange of a path or URL. Raises BadInput.

    A URL is http or https, or of a store that fsspec knows; that raises MissingExtra without fsspec.
    """
    if isinstance(where, FileRange) and where.block is not None:
        return _joined(where, where.block)
    if isinstance(where, FileRange):
        return remote_file(where.path, where) if is_url(where.path) else OpenRange(where)
    if isinstance(where, (bytes, bytearray, memoryview)):
        return InMemory(bytes(where))
    if isinstance(where, str) and is_url(where):
        return remote_file(where)
    if isinstance(where, (str, os.PathLike)):
        path = cast("str | os.PathLike[str]", where)
        return _piped(path) if os.path.exists(path) and not os.path.isfile(path) else LocalFile(path)
    if hasattr(where, "read"):
        return _file_object(where)
    raise BadInput(f"open a .mocz from a path, URL, bytes or a binary file object, not from {type(where).__name__}")


def _joined(part: FileRange, block: bytes) -> ByteSource:
    """A short recording in an archive, read at once. Raises Corrupt, Truncated, BadInput."""
    stored = byte_source(replace(part, block=None))
    try:
        packed = stored.read(0, stored.size)
    finally:
        stored.close()
    try:
        return InMemory(compact.join(block, packed), part.label)
    except Corrupt as error:
        raise Corrupt(f"{part.label or part.path}: {error}") from None


def is_url(path: str) -> bool:
    """Whether this is a URL; a path otherwise."""
    return "://" in path and re.match(r"[a-z][a-z0-9+.-]+://", path, re.IGNORECASE) is not None


class InMemory:
    """Bytes in memory."""

    def __init__(self, data: bytes, name: str = "") -> None:
        self.name = name
        self.data = data
        self.size = len(data)

    def read(self, start: int, count: int) -> bytes:
        return _exactly(self.data[start : start + count], count)

    def close(self) -> None:
        pass


class LocalFile:
    """A file by path. After `close` each read opens it again for a moment: extras may be read late."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.name = os.fspath(path)
        self.path = os.path.abspath(path)
        try:
            self.file: BinaryIO | None = open(self.path, "rb")  # noqa: SIM115 (open until close)
            self.size = os.fstat(self.file.fileno()).st_size
        except OSError as error:
            missing = isinstance(error, FileNotFoundError)
            raise BadInput(f"{os.fspath(path)}: {'no such file' if missing else error.strerror}") from error
        except ValueError as error:  # a null character
            raise BadInput(f"{os.fspath(path)}: {error}") from error

    def read(self, start: int, count: int) -> bytes:
        try:
            if self.file is None:
                with open(self.path, "rb") as file:
                    return _read(file, start, count)
            return _read_at(self.file, start, count)
        except OSError as error:
            raise BadInput(f"{self.path}: {error.strerror}") from error

    def close(self) -> None:
        if self.file is not None:
            self.file.close()
            self.file = None


def _piped(path: str | os.PathLike[str]) -> ByteSource:
    """What a pipe or a device sends, read at once. Raises BadInput for a folder, and above MAX_PIPED_BYTES."""
    name = os.fspath(path)
    if os.path.isdir(path):
        raise BadInput(f"{name}: this is a folder; mocodec.open_archive opens an archive")
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_PIPED_BYTES + 1)
    except OSError as error:
        raise BadInput(f"{name}: {error.strerror}") from error
    if len(data) > MAX_PIPED_BYTES:
        raise BadInput(f"{name}: more than {MAX_PIPED_BYTES:,} bytes from a pipe; write them to a file first")
    return InMemory(data, name)


class OpenRange(LocalFile):
    """The bytes of a FileRange. Each read opens the file for a moment, so that any number of them can be open."""

    def __init__(self, part: FileRange) -> None:
        super().__init__(part.path)
        self.close()
        self.start, self.name, self.size = part.start, part.label or part.path, part.size

    def read(self, start: int, count: int) -> bytes:
        if start + count > self.size:
            raise Truncated(f"the recording ends {start + count - self.size} bytes before it should")
        return super().read(self.start + start, count)


class FileObject:
    """A seekable binary file object; the caller closes it."""

    def __init__(self, file: BinaryIO) -> None:
        name = getattr(file, "name", "")
        self.name = name if isinstance(name, str) else ""
        self.file = file
        self.size = file.seek(0, io.SEEK_END)

    def read(self, start: int, count: int) -> bytes:
        try:
            with _LOCK:
                return _read(self.file, start, count)
        except ValueError as error:
            raise BadInput(f"the file object was closed before everything was read: {error}") from error

    def close(self) -> None:
        pass


def _file_object(file: Any) -> ByteSource:
    seekable = getattr(file, "seekable", None)
    if seekable is not None and seekable() and isinstance(file.read(0), bytes):
        return FileObject(file)
    data = file.read()
    if not isinstance(data, bytes):
        raise BadInput("the file object returns text; open it in binary mode")
    return InMemory(data)


_LOCK = Lock()
"""Held while a place is sought and read, so that threads may share a file."""


def _read_at(file: BinaryIO, start: int, count: int) -> bytes:
    """As `_read`, but threads, and processes that were forked, may read from the same open file."""
    if not hasattr(os, "pread"):
        with _LOCK:
            return _read(file, start, count)
    data = b""
    while len(data) < count and (part := os.pread(file.fileno(), count - len(data), start + len(data))):
        data += part
    return _exactly(data, count)


def _read(file: BinaryIO, start: int, count: int) -> bytes:
    file.seek(start)
    data = bytearray()
    while len(data) < count:
        part = file.read(count - len(data))
        if not part:
            break
        data += part
    return _exactly(bytes(data), count)


def _exactly(data: bytes, count: int) -> bytes:
    if len(data) != count:
        raise Truncated(f"the file ends {count - len(data)} bytes before it should")
    return data
