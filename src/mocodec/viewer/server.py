"""The server behind `mocodec view`: one page and its frames, for this computer only.

    GET /TOKEN/                             the page
    GET /TOKEN/session.json                 the session
    GET /TOKEN/r/N/decoded?from=a&to=b      frames [a, b) of recording N, and of its original: …/original
    GET /TOKEN/priors/ID.npz                a prior of tempo, for .mocz files that are dropped on the page
    GET /TOKEN/clips.json?text=…&query=…    of an archive: the recordings that match
    GET /TOKEN/clip/NAME/…                  of one of them: session.json, pose.json, r/0/decoded

It listens on 127.0.0.1. The token is random, so that other pages in the browser cannot guess the address; requests
for another host name are refused, so that a foreign name that resolves to this computer reaches nothing. Connections
beyond MOST_CONNECTIONS are closed.
"""

from __future__ import annotations

import contextlib
import json
import re
import secrets
import threading
import webbrowser
from collections.abc import Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, cast
from urllib.parse import parse_qs, quote, unquote, urlsplit

import numpy as np

from ..archive import Archive
from ..errors import MocodecError
from ..motion import Motion
from ..pointcloud import PointClouds
from . import clips, page, session
from .recording import Shown, of_file

Query = dict[str, list[str]]
HTML, JSON, BYTES = "text/html", "application/json", "application/octet-stream"
MOST_OPENED = 16
MOST_CONNECTIONS = 32
"""Connections at a time, each of which has a thread; a browser opens six."""
MOST_BYTES = 64 << 20
"""The largest answer; the page asks for about 8 MB at a time."""

PRIOR = re.compile(r"priors/([0-9a-f]{8})\.npz")
CLIP = re.compile(r"clip/([^/]{1,2000})/(.+)")
PLACE = re.compile(r"r/(\d{1,4})/(decoded|original)")


class Server(ThreadingHTTPServer):
    """Serves recordings to one page. port 0: any free port. `url` is the address to open."""

    daemon_threads = True
    query = "session=session.json"

    def __init__(self, pairs: Sequence[session.Pair], title: str, port: int = 0) -> None:
        self.pairs = pairs
        self.token = secrets.token_urlsafe(12)
        self.session = as_json(session.of_server(pairs, title))
        self.decoding = threading.Lock()  # files are not made for several threads
        self.free_connections = threading.BoundedSemaphore(MOST_CONNECTIONS)
        super().__init__(("127.0.0.1", port), Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection in a thread of its own; close it where there are too many."""
        if self.free_connections.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """As of ThreadingHTTPServer; the connection is free again afterwards."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.free_connections.release()

    @property
    def url(self) -> str:
        """The address of the page."""
        return f"http://127.0.0.1:{self.server_address[1]}/{self.token}/?{self.query}"

    def show(self, in_browser: bool) -> None:
        """Print the address, open the browser, and answer until Ctrl-C."""
        print(f"{self.url}\nShown until you press Ctrl-C.", flush=True)
        if in_browser:
            webbrowser.open(self.url)
        with contextlib.suppress(KeyboardInterrupt):
            self.serve_forever()

    def resource(self, place: str, asked: Query) -> tuple[str, bytes]:
        """Type and bytes of the resource at a place. Raises KeyError, IndexError, ValueError, MocodecError."""
        if place == "":
            return HTML, page.viewer().encode()
        if named := PRIOR.fullmatch(place):
            return BYTES, page.prior(named[1])
        if place == "session.json":
            return JSON, self.session
        if named := PLACE.fullmatch(place):
            return BYTES, self.frames(self.pairs[int(named[1])], named[2], asked)
        raise KeyError(place)

    def frames(self, pair: session.Pair, which: str, asked: Query) -> bytes:
        """The asked frames as the page reads them. Raises KeyError, ValueError, MocodecError."""
        chosen = pair[0] if which == "decoded" else pair[1]
        if chosen is None:
            raise KeyError(which)
        a, b = (int(asked[name][0]) for name in ("from", "to"))
        if not 0 <= a < b <= chosen.frames:
            raise ValueError(f"frames {a} to {b} of {chosen.frames}")
        with self.decoding:
            return as_bytes(chosen, a, b)


class ArchiveServer(Server):
    """Serves the recordings of an archive to one page, which lists and searches them."""

    query = "archive=clips.json"

    def __init__(self, archive: Archive, title: str, port: int = 0) -> None:
        self.archive = archive
        self.opened: dict[str, session.Pair] = {}
        super().__init__([], title, port)

    def resource(self, place: str, asked: Query) -> tuple[str, bytes]:
        """As of Server; also the list of recordings, and of each its session, frames and a pose to draw small."""
        if place == "clips.json":
            with self.decoding:
                return JSON, as_json(
                    clips.found(self.archive, *(asked.get(name, [""])[0] for name in ("text", "query")))
                )
        if not (named := CLIP.fullmatch(place)):
            return super().resource(place, asked)
        name, rest = unquote(named[1]), named[2]
        if rest == "pose.json":
            with self.decoding:
                return JSON, as_json(clips.pose(self.archive[name]))
        pair = self.pair(name)
        if rest == "session.json":
            with self.decoding:
                return JSON, as_json(session.of_server([pair], name, f"clip/{quote(name, safe='')}/"))
        if within := PLACE.fullmatch(rest):
            return BYTES, self.frames(pair, within[2], asked)
        raise KeyError(place)

    def pair(self, name: str) -> session.Pair:
        """The recording of this name; the last ones stay open. Raises BadInput."""
        with self.decoding:
            if name not in self.opened:
                while len(self.opened) >= MOST_OPENED:
                    self.opened.pop(next(iter(self.opened)))
                self.opened[name] = (of_file(name, self.archive.entry(name).open(salvage=True)), None)
            return self.opened[name]


def as_json(value: Any) -> bytes:
    """A value as JSON."""
    return json.dumps(value, allow_nan=False).encode()


def as_bytes(shown: Shown, a: int, b: int) -> bytes:
    """Motion: float32 (frames, points, 3). Point clouds, of each frame: count (uint32), positions (float32), colours
    (bytes, grey without), zeros up to a multiple of 4. Little-endian. Raises ValueError for more than MOST_BYTES.
    """
    if isinstance(shown.about, Motion):
        if (b - a) * shown.about.points * 12 > MOST_BYTES:
            raise ValueError("too many frames at once")
        return shown.positions(a, b).astype("<f4").tobytes()
    return b"".join(cloud_bytes(shown.clouds(a, b), frame) for frame in range(b - a))


def cloud_bytes(clouds: PointClouds, frame: int) -> bytes:
    """One frame of point clouds."""
    points = np.asarray(clouds.positions[frame])
    colours = np.full((len(points), 3), 128, np.uint8) if clouds.colours is None else np.asarray(clouds.colours[frame])
    padding = bytes(-3 * len(points) % 4)
    return len(points).to_bytes(4, "little") + points.astype("<f4").tobytes() + colours.tobytes() + padding


class Handler(BaseHTTPRequestHandler):
    """Answers the requests that the module lists, and no other."""

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "mocodec", ""
    timeout = 60

    def do_GET(self) -> None:
        """Answer one request; errors of decoding are text with status 500."""
        try:
            status, kind, body = self.answer(cast("Server", self.server))
        except MocodecError as error:
            status, kind, body = HTTPStatus.INTERNAL_SERVER_ERROR, "text/plain", str(error).encode()
        except (KeyError, IndexError, ValueError, OverflowError):
            status, kind, body = HTTPStatus.NOT_FOUND, "text/plain", b"there is nothing here"
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8" if kind.startswith("text/") else kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(body)

    def answer(self, server: Server) -> tuple[HTTPStatus, str, bytes]:
        """Status, type and body of the answer. Raises KeyError, IndexError, ValueError, MocodecError."""
        port = server.server_address[1]
        if self.headers.get("Host") not in (f"127.0.0.1:{port}", f"localhost:{port}"):
            return HTTPStatus.FORBIDDEN, "text/plain", b"this server is for its own computer"
        parts = urlsplit(self.path)
        token, _, rest = parts.path.removeprefix("/").partition("/")
        if not secrets.compare_digest(token.encode(), server.token.encode()):
            raise KeyError(token)
        return HTTPStatus.OK, *server.resource(rest, parse_qs(parts.query))

    def handle(self) -> None:
        """Answer requests until the browser is gone."""
        with contextlib.suppress(ConnectionError, TimeoutError):
            super().handle()

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing for each request."""
