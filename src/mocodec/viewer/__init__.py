"""See recordings in a browser: figures, point clouds, and the error against an original.

    view(m)                     serves a page on 127.0.0.1 and opens the browser
    html(m, against=original)   the same page as one file, with all data inside
    for_notebook(m)             the same in a frame: `Motion` and open files show themselves in Jupyter

The page is built from web/viewer (TypeScript, three.js) into static/viewer.html by scripts/web; docs/howto/view.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from html import escape
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from .. import api, formats
from ..archive import in_archive, open_archive
from ..errors import BadInput
from ..motion import Motion
from ..pointcloud import PointClouds
from . import page, session
from .recording import Shown, of_file, of_path
from .server import Server
from .session import Limit, Pair, matched

Viewable = Motion | PointClouds | api.File[Any] | str | PathLike[str]

NOTEBOOK_BYTES = 1_000_000
"""The most that a recording in a notebook takes."""
NOTEBOOK_SAMPLES = 400_000
"""Samples (frames × points) to begin with: about what fits."""


def shown(source: Viewable, opened: ExitStack, name: str | None = None, **options: Any) -> Shown:
    """A recording to show: in memory, an open file, or a path.

    A .mocz and ARCHIVE/NAME, a recording of an archive, are opened; other formats are read.

    opened: closes the files that are opened here. options: of the format's reader. Raises BadInput and the errors of
    `open`.
    """
    if isinstance(source, Motion | PointClouds):
        return Shown(name or str(source.source.get("name") or "recording"), source)
    if isinstance(source, api.File):
        return of_file(name or "recording.mocz", source)
    path = fspath(source)
    name = name or path.rstrip("/").rpartition("/")[2]
    if path.partition("?")[0].lower().endswith(".mocz"):
        return of_file(name, opened.enter_context(api.open(path, salvage=True)))
    if found := in_archive(path):
        folder, within = found
        return of_file(name, opened.enter_context(opened.enter_context(open_archive(folder)).entry(within).open(True)))
    return of_path(path, name, api.read(path, **options))


def pairs_of(sources: Sequence[Viewable], against: Viewable | None, opened: ExitStack, **options: Any) -> list[Pair]:
    """Each recording with its original, which is the same for all. Raises BadInput if they differ in shape."""
    if not sources:
        raise BadInput("there is nothing to show: give at least one recording")
    original = None if against is None else shown(against, opened, **options)
    return [matched(shown(source, opened, **options), original) for source in sources]


def html(*sources: Viewable, against: Viewable | None = None, title: str | None = None, **options: Any) -> str:
    """A page that needs no server and no network, as HTML.

    sources: recordings, open files or paths. against: the original that all are compared with. Long recordings are
    thinned out, which the page says. options: of the format's reader. Raises BadInput, and what `open` raises.
    """
    with ExitStack() as opened:
        pairs = pairs_of(sources, against, opened, **options)
        return page.with_session(session.of_page(pairs, title or pairs[0][0].name))


def view(
    *sources: Viewable, against: Viewable | None = None, port: int = 0, browser: bool = True, **options: Any
) -> None:
    """Serve a page for these recordings on 127.0.0.1 and open the browser; returns when interrupted (Ctrl-C).

    sources, against, options: as for `html`. port: 0 for any free one. browser: False only prints the address.
    Raises BadInput, and what `open` raises; OSError if the port is taken.
    """
    with ExitStack() as opened:
        pairs = pairs_of(sources, against, opened, **options)
        with Server(pairs, pairs[0][0].name, port) as server:
            server.show(browser)


def for_notebook(source: Motion | PointClouds | api.File[Any], name: str = "recording") -> str:
    """HTML for a notebook, at most NOTEBOOK_BYTES: long recordings are thinned out; of an empty one, its repr."""
    if not len(source):
        return f"<code>{escape(repr(source))}</code>"
    with ExitStack() as opened:
        pair = (shown(source, opened, name), None)
        samples = NOTEBOOK_SAMPLES
        while True:
            made = page.in_frame(session.of_page([pair], name, Limit(samples, 2e-4)))
            if len(made) <= NOTEBOOK_BYTES or samples <= 1000:
                return made
            samples = int(samples * min(0.7, 0.8 * NOTEBOOK_BYTES / len(made)))


def save(path: str | PathLike[str], made: str) -> None:
    """Write a page; it appears complete or not at all. Raises BadInput unless the suffix is .html or .htm."""
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise BadInput(f"{fspath(path)}: the suffix of a page must be .html")
    formats.replace_whole(path, made.encode())
