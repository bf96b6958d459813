"""Files on web servers and in object stores, read by ranges.

read ──in a piece that was fetched──► bytes
  └──not yet──► one request: at least BLOCK_BYTES, and what the caller says that it reads next ──► piece

Opening a file over http asks for its beginning and its end in one request (RFC 9110, 14.2: several ranges), so that
header and index are there after it. A server that refuses is asked for one range at a time.
"""

from __future__ import annotations

import re
import time
from collections import OrderedDict
from importlib import import_module
from threading import Lock
from typing import Any

from ..errors import BadInput, MissingExtra, Truncated
from ..file_range import FileRange

BLOCK_BYTES = 1 << 14
"""The smallest request."""
END_BYTES = 40 << 10
"""Bytes that opening asks for from the end of a file: they hold the index of ten hours."""
SMALL_BYTES = 4 * BLOCK_BYTES
"""A file of at most this size is fetched whole."""
MOST_AHEAD_BYTES = 8 << 20
"""Bytes that are fetched ahead of a reader, at most."""
CACHE_BYTES = 16 << 20
"""Pieces that stay in memory, of each open file."""
TIMEOUT_S = 30.0
"""How long a web server may be silent."""
DEADLINE_S = 300.0
"""How long a request may take in all, so that a server that sends a byte now and then does not hold a program up."""
MAX_DOWNLOAD_BYTES = 1 << 30
"""The most bytes of one answer: of a whole file, from a server without range requests."""
WHOLE_BYTES = 1 << 18
"""A file of at most this many bytes is taken as a whole if a server sends it so."""
FINAL_STATUS = (401, 403, 404, 410)
"""Answers that do not change if another range is asked for."""
VALIDATORS = ("ETag", "Last-Modified")
"""Headers that tell versions of a file apart (RFC 9110, 8.8); the first that two answers share is compared."""

Piece = tuple[int, bytes]
"""Offset in the file, and the bytes from there on."""


def remote_file(url: str, part: FileRange | None = None) -> RemoteFile:
    """A file by URL, or a part of one. Raises BadInput; MissingExtra without fsspec for all but http and https."""
    return Url(url, part) if re.match(r"https?://", url, re.IGNORECASE) else StoreFile(url, part)


class RemoteFile:
    """A file, or a part of one, that is read by ranges. requests: how many were sent.

    Offsets count from the beginning of the part.
    """

    def __init__(self, url: str, part: FileRange | None) -> None:
        self.url = url
        self.name = url if part is None else part.label or url
        self.origin = 0 if part is None else part.start
        self.size = 0 if part is None else part.size
        self.requests = 0
        self._pieces: OrderedDict[int, bytes] = OrderedDict()
        self._lock = Lock()

    def read(self, start: int, count: int, ahead: int = 0) -> bytes:
        """Exactly `count` bytes from byte `start` on. ahead: bytes from `start` on that will be read next, together.

        Raises Truncated if the file ends before, BadInput if it cannot be read.
        """
        stop = start + count
        if stop > self.size:
            raise Truncated(f"{self.name} ends {stop - self.size} bytes before it should")
        data = bytearray()
        with self._lock:
            while (at := start + len(data)) < stop:
                offset, piece = self._piece(at) or self._fetched(at, max(stop, start + min(ahead, MOST_AHEAD_BYTES)))
                data += piece[at - offset : stop - offset]
        return bytes(data)

    def _piece(self, at: int) -> Piece | None:
        """The piece that holds byte `at`."""
        for offset, piece in self._pieces.items():
            if offset <= at < offset + len(piece):
                self._pieces.move_to_end(offset)
                return offset, piece
        return None

    def _fetched(self, start: int, stop: int) -> Piece:
        """A new piece from `start` on, to `stop` at least, but for what a piece before `stop` holds already."""
        if self.size <= SMALL_BYTES:
            start, stop = 0, self.size
        stop = min(max(stop, start + BLOCK_BYTES), self.size)
        start = max(0, min(start, stop - BLOCK_BYTES))
        stop = min([stop, *(o for o, piece in self._pieces.items() if start < o < stop <= o + len(piece))])
        data = self._fetch(start, stop)
        if len(data) < stop - start:
            raise Truncated(f"{self.name} ends {stop - start - len(data)} bytes before it should")
        self._keep(start, data)
        return start, data

    def _keep(self, offset: int, data: bytes) -> None:
        """Add a piece, and drop the least recently used ones beyond CACHE_BYTES."""
        self._pieces[offset] = data
        self._pieces.move_to_end(offset)
        while len(self._pieces) > 1 and sum(map(len, self._pieces.values())) > CACHE_BYTES:
            self._pieces.popitem(last=False)

    def _fetch(self, start: int, stop: int) -> bytes:
        """Bytes [start, stop), by one request. Raises BadInput."""
        raise NotImplementedError

    def close(self) -> None:
        """Forget the pieces; extras may be read later all the same."""
        with self._lock:
            self._pieces.clear()


class StoreFile(RemoteFile):
    """A file in a store that fsspec knows: s3://, gs://, memory://, …"""

    def __init__(self, url: str, part: FileRange | None = None) -> None:
        super().__init__(url, part)
        self.files, self.path = file_system(url)
        if part is None:
            size = self._requested(lambda: self.files.info(self.path)["size"])
            if not isinstance(size, int):
                raise BadInput(f"{url}: its size is unknown; download it first")
            self.size = size

    def _fetch(self, start: int, stop: int) -> bytes:
        first, past = self.origin + start, self.origin + stop
        return self._requested(lambda: self.files.cat_file(self.path, start=first, end=past))

    def _requested(self, request: Any) -> Any:
        """The result of a request, which is counted; its errors as BadInput."""
        self.requests += 1
        try:
            return request()
        except (OSError, ValueError, ImportError, KeyError) as error:
            raise BadInput(f"{self.url}: {error or type(error).__name__}") from error


def file_system(url: str) -> tuple[Any, str]:
    """The fsspec file system of a URL, and the path there. Raises MissingExtra, BadInput."""
    try:
        core: Any = import_module("fsspec.core")
    except ImportError:
        raise MissingExtra(f"{url}: reading from a URL that is not http or https", "remote") from None
    try:
        return core.url_to_fs(url)
    except (ValueError, ImportError, OSError) as error:
        raise BadInput(f"{url}: {error}") from error


class Url(RemoteFile):
    """A file on a web server, by range requests (RFC 9110, 14); fetched whole from a server without them."""

    def __init__(self, url: str, part: FileRange | None = None) -> None:
        super().__init__(url, part)
        self.whole_size = 0
        self._version = dict[str, str]()
        if part is not None and part.size <= SMALL_BYTES:
            return
        head = f"bytes={self.origin}-{self.origin + BLOCK_BYTES - 1}"
        end = self.origin + self.size
        tail = f"{max(end - END_BYTES, self.origin + BLOCK_BYTES)}-{end - 1}" if part else f"-{END_BYTES}"
        try:
            answer = self._request(f"{head},{tail}", WHOLE_BYTES)
        except SeveralRangesRefused:
            answer = self._request(head)
        self.size = answer[0] if part is None else self.size
        for offset, data in answer[1]:
            if offset >= self.origin:
                self._keep(offset - self.origin, data)

    def _fetch(self, start: int, stop: int) -> bytes:
        first, past = self.origin + start, self.origin + stop
        _, [(offset, data), *_] = self._request(f"bytes={first}-{past - 1}")
        if offset > first:
            raise BadInput(f"{self.url}: the server sent other bytes than were asked for")
        return data[first - offset : past - offset]

    def _request(self, ranges: str, most_whole: int | None = None) -> tuple[int, list[Piece]]:
        """Size of the file and the pieces that one request brings. ranges: the value of the header Range.

        most_whole: the largest file that is taken whole from a server that does not send these ranges, but could send
        others. Raises SeveralRangesRefused for larger ones, BadInput, Truncated for an empty file.
        """
        from http.client import HTTPException
        from urllib.error import HTTPError
        from urllib.request import Request, urlopen

        request = Request(self.url, headers={"Range": ranges, "Accept-Encoding": "identity"})
        self.requests += 1
        try:
            with urlopen(request, timeout=TIMEOUT_S) as response:
                size, pieces = self._pieces_of(response, most_whole)
        except (OSError, HTTPException, UnicodeError) as error:
            code = getattr(error, "code", None)
            if isinstance(error, HTTPError):
                error.close()
            is_refused = code not in FINAL_STATUS if isinstance(error, HTTPError) else isinstance(error, HTTPException)
            if most_whole is not None and is_refused:
                raise SeveralRangesRefused from error
            if code == 416 and self.whole_size:
                raise self._changed() from error
            if code == 416:
                where = f"ends before byte {self.origin:,}" if self.origin else "is empty"
                raise Truncated(f"{self.url} {where}") from error
            raise BadInput(f"{self.url}: {error}") from error
        if self.whole_size not in (0, size):
            raise self._changed()
        self.whole_size = size
        return size, pieces

    def _changed(self) -> BadInput:
        """The error for a file that is not the one that was opened."""
        return BadInput(f"{self.url} changed while it was being read; open it again")

    def _require_same_version(self, headers: Any) -> None:
        """Raises BadInput if the first validator that this answer shares with earlier ones differs."""
        seen = {name: value for name in VALIDATORS if (value := headers.get(name))}
        shared = [name for name in VALIDATORS if name in seen and name in self._version]
        if shared and seen[shared[0]] != self._version[shared[0]]:
            raise self._changed()
        self._version = seen | self._version

    def _pieces_of(self, response: Any, most_whole: int | None) -> tuple[int, list[Piece]]:
        """What an answer contains: size of the file, and its pieces."""
        headers = response.headers
        self._require_same_version(headers)
        parts = re.match(r"multipart/byteranges", headers.get("Content-Type", ""), re.IGNORECASE)
        if response.status == 206 and parts and most_whole is not None:
            return several_parts(self._receive(response, END_BYTES + 2 * BLOCK_BYTES), self.url)
        found = CONTENT_RANGE.fullmatch(headers.get("Content-Range", ""))
        if response.status == 206 and found is not None:
            start, stop, size = int(found[1]), int(found[2]) + 1, int(found[3])
            return size, [(start, self._receive(response, min(stop - start, MAX_DOWNLOAD_BYTES)))]
        if response.status != 200:
            raise BadInput(f"{self.url}: the server answered a range request with status {response.status}")
        length = headers.get("Content-Length", "")
        is_long = length.isdigit() and most_whole is not None and int(length) > most_whole
        if is_long and headers.get("Accept-Ranges", "").lower() == "bytes":
            raise SeveralRangesRefused
        whole = self._receive(response, MAX_DOWNLOAD_BYTES + 1)
        if len(whole) > MAX_DOWNLOAD_BYTES:
            raise BadInput(
                f"{self.url}: more than {MAX_DOWNLOAD_BYTES:,} bytes from a server without range requests; download it "
                "first"
            )
        return len(whole), [(0, whole)]

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


CONTENT_RANGE = re.compile(r"bytes (\d{1,18})-(\d{1,18})/(\d{1,18})")


class SeveralRangesRefused(Exception):
    """The server did not answer a request for two ranges; it may answer one for one."""


def several_parts(body: bytes, url: str) -> tuple[int, list[Piece]]:
    """Size of the file and pieces of the body of a multipart/byteranges answer (RFC 9110, 14.6). Raises BadInput."""
    size, pieces, at = 0, list[Piece](), 0
    while (head_end := body.find(b"\r\n\r\n", at)) >= 0:
        head = body[at:head_end].decode("latin-1")
        found = re.search(rf"^content-range: *{CONTENT_RANGE.pattern} *\r?$", head, re.IGNORECASE | re.MULTILINE)
        if found is None:
            break
        start, stop, size = int(found[1]), int(found[2]) + 1, int(found[3])
        data = body[head_end + 4 : head_end + 4 + max(0, stop - start)]
        if not 0 <= start < stop <= size or len(data) < stop - start:
            raise BadInput(f"{url}: the server's answer with two ranges is incomplete")
        pieces.append((start, data))
        at = head_end + 4 + len(data)
    if not pieces:
        raise BadInput(f"{url}: the server's answer with two ranges cannot be read")
    return size, pieces
