"""Random access to the bytes of a file: in memory, by path, by file object, by URL, or a range of a file."""

from __future__ import annotations

import io
import os
import re
import time
from threading import Lock
from typing import Any, BinaryIO, Protocol, cast

from ..errors import BadInput, Truncated
from ..file_range import FileRange

BLOCK_BYTES = 1 << 14
TIMEOUT_S = 30.0
"""How long a web server may be silent."""
DEADLINE_S = 300.0
"""How long a request may take in all, so that a server that sends a byte now and then does not hold a program up."""
MAX_DOWNLOAD_BYTES = 1 << 30
"""The most bytes of one answer: of a whole file, from a server without range requests."""


class ByteSource(Protocol):
    """Bytes that can be read at any offset. name: for messages, or "". size: bytes in total."""

    name: str
    size: int

    def read(self, start: int, count: int) -> bytes:
        """Exactly `count` bytes from byte `start` on. Raises Truncated if the file ends before."""
        ...

    def close(self) -> None: ...


def byte_source(where: Any) -> ByteSource:
    """Random access to bytes, a path, a URL (http, https), a binary file object or a FileRange. Raises BadInput."""
    if isinstance(where, FileRange):
        return OpenRange(where)
    if isinstance(where, (bytes, bytearray, memoryview)):
        return InMemory(bytes(where))
    if isinstance(where, str) and re.match(r"[a-z][a-z0-9+.-]+://", where, re.IGNORECASE):
        return Url(where)
    if isinstance(where, (str, os.PathLike)):
        return LocalFile(cast("str | os.PathLike[str]", where))
    if hasattr(where, "read"):
        return _file_object(where)
    raise BadInput(f"open a .mocz from a path, URL, bytes or a binary file object, not from {type(where).__name__}")


class InMemory:
    """Bytes in memory."""

    def __init__(self, data: bytes) -> None:
        self.name = ""
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
        except IsADirectoryError as error:
            raise BadInput(f"{os.fspath(path)}: this is a folder; mocodec.open_archive opens an archive") from error
        except OSError as error:
            raise BadInput(f"{os.fspath(path)}: {error.strerror}") from error

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


class Url:
    """A file on a web server, by range requests (RFC 9110, 14); fetched whole from a server without them."""

    def __init__(self, url: str) -> None:
        if not re.match(r"https?://", url, re.IGNORECASE):
            raise BadInput(f"{url}: a .mocz is opened over http or https; download it first")
        self.url = self.name = url
        self.start = 0
        self.block = b""
        self.size = 0
        self.requests = 0
        self._fetch(0, BLOCK_BYTES, first=True)
        self.head = self.block

    def read(self, start: int, count: int) -> bytes:
        if start + count > self.size:
            raise Truncated(f"{self.url} ends {start + count - self.size} bytes before it should")
        for at, block in ((0, self.head), (self.start, self.block)):
            if at <= start and start + count <= at + len(block):
                return block[start - at : start - at + count]
        self._fetch(start, max(count, BLOCK_BYTES))
        return _exactly(self.block[start - self.start : start - self.start + count], count)

    def _fetch(self, start: int, count: int, first: bool = False) -> None:
        """Fetch bytes from `start` on into `block`; the first request also sets `size`."""
        from http.client import HTTPException
        from urllib.request import Request, urlopen

        stop = start + count if first else min(start + count, self.size)
        request = Request(self.url, headers={"Range": f"bytes={start}-{stop - 1}", "Accept-Encoding": "identity"})
        self.requests += 1
        try:
            with urlopen(request, timeout=TIMEOUT_S) as response:
                content_range = re.fullmatch(
                    r"bytes (\d{1,18})-(\d{1,18})/(\d{1,18})", response.headers.get("Content-Range", "")
                )
                if response.status == 206 and content_range is not None and int(content_range[1]) == start:
                    self.start, self.block = start, self._receive(response, stop - start)
                    size = int(content_range[3])
                elif response.status == 200:
                    self.start, self.block = 0, self._receive(response, MAX_DOWNLOAD_BYTES + 1)
                    size = len(self.block)
                    self.head = self.block
                else:
                    raise BadInput(f"{self.url}: the server answered a range request with status {response.status}")
        except (OSError, HTTPException, UnicodeError) as error:
            if getattr(error, "code", None) == 416:
                raise Truncated(f"{self.url} is empty") from error
            raise BadInput(f"{self.url}: {error}") from error
        if len(self.block) > MAX_DOWNLOAD_BYTES:
            raise BadInput(
                f"{self.url}: more than {MAX_DOWNLOAD_BYTES:,} bytes from a server without range requests; download it "
                "first"
            )
        if first:
            self.size = size
        elif size != self.size:
            raise BadInput(f"{self.url} changed while it was being read; open it again")

    def _receive(self, response: Any, count: int) -> bytes:
        """At most `count` bytes of an answer. Raises BadInput after DEADLINE_S."""
        until = time.monotonic() + DEADLINE_S
        data = bytearray()
        while len(data) < count:
            part = response.read1(min(count - len(data), BLOCK_BYTES << 4))
            if not part:
                break
            data += part
            if time.monotonic() > until:
                raise BadInput(f"{self.url}: no complete answer within {DEADLINE_S:g} s; download it first")
        return bytes(data)

    def close(self) -> None:
        self.block = self.head = b""
