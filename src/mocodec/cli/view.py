"""`mocodec view`: show recordings in the browser, or write them as one page."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any, TypeVar

import click

from .. import cloud_plots, plots, viewer
from ..archive import is_archive, open_archive
from ..errors import BadInput
from ..motion import Motion
from ..pointcloud import PointClouds
from ..viewer import film, page, session
from ..viewer.recording import Shown, of_path
from ..viewer.server import ArchiveServer, Server
from . import compare, files, sections

ServerT = TypeVar("ServerT", bound=Server)


@click.command("view", cls=sections.Command)
@click.argument("sources", metavar="FILE…", nargs=-1, required=True)
@click.option("--against", metavar="ORIGINAL", help="Show the error against this recording, and its points in grey.")
@click.option(
    "--html",
    "html_path",
    type=click.Path(dir_okay=False),
    metavar="OUT.html",
    help="Write one page with everything inside, to be mailed or published, instead of serving it.",
)
@click.option(
    "--png",
    "png_path",
    type=click.Path(dir_okay=False),
    metavar="OUT.png",
    help="Draw poses (with --against also the error over time), without a browser; needs the [plot] extra.",
)
@click.option(
    "--mp4",
    "mp4_path",
    type=click.Path(dir_okay=False),
    metavar="OUT.mp4",
    help="Film the recording, without a browser; needs the [cloud] extra.",
)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, metavar="N", help="Port on 127.0.0.1; default: any free one."
)
@click.option("--no-browser", is_flag=True, help="Print the address, but open no browser.")
@files.reader_options
def command(
    sources: tuple[str, ...],
    against: str | None,
    html_path: str | None,
    png_path: str | None,
    mp4_path: str | None,
    port: int,
    no_browser: bool,
    **options: Any,
) -> None:
    """Show recordings in the browser: figures, markers or point clouds, with the error against an original.

    FILE is a .mocz or any format that can be read; several are shown beside each other. Of an archive, the page lists
    the recordings and finds them by name or condition; ARCHIVE/NAME is one of them. The page is served to this
    computer only, until Ctrl-C. Reader options such as --asf and --unit apply to each file whose format takes them.
    """
    files.require_suffix(html_path, "a page", (".html", ".htm"))
    files.require_suffix(png_path, "a picture", plots.SUFFIXES)
    files.require_suffix(mp4_path, "a film", (".mp4",))
    if (png_path or mp4_path) and len(sources) > 1:
        raise click.UsageError("--png and --mp4 show one recording; name one FILE")
    if len(sources) == 1 and is_archive(sources[0]):
        if against or html_path or png_path or mp4_path:
            raise click.UsageError("an archive is only served; name a recording of it for a page, a picture or a film")
        with ExitStack() as opened:
            archive = opened.enter_context(open_archive(sources[0]))
            serve(opened.enter_context(server_at(ArchiveServer, archive, Path(sources[0]).name, port)), not no_browser)
        return
    names = (*sources, *((against,) if against else ()))
    if "-" in names:
        raise click.UsageError("a recording on standard input cannot be shown; save it in a file first")
    with ExitStack() as opened:
        with files.working(f"reading {', '.join(names)}"):
            original = None if against is None else read(against, names, options, opened)
            pairs = [session.matched(read(name, names, options, opened), original) for name in sources]
        title = Path(sources[0]).name if len(sources) == 1 else f"{len(sources)} recordings"
        if html_path:
            with files.working(f"writing {html_path}"):
                made = page.with_session(session.of_page(pairs, title))
                viewer.save(html_path, made)
            files.echo(f"{html_path}: {len(made):,} bytes; opens in any browser, without a network", err=True)
        if png_path:
            plots.save(picture(*pairs[0]), png_path)
        if mp4_path:
            with files.working(f"writing {mp4_path}"):
                film.write(mp4_path, *pairs[0])
        if html_path or png_path or mp4_path:
            return
        with files.working("measuring"):
            server = server_at(Server, pairs, title, port)
        with server:
            serve(server, not no_browser)


def server_at(kind: type[ServerT], content: Any, title: str, port: int) -> ServerT:
    """A server at a port. Raises BadInput if it is taken."""
    try:
        return kind(content, title, port)
    except OSError as error:
        raise BadInput(f"port {port} cannot be used ({error.strerror}); without --port, a free one is taken") from error


def serve(server: Server, in_browser: bool) -> None:
    """Show the page until Ctrl-C."""
    server.show(in_browser)
    files.echo("closed", err=True)


def picture(shown: Shown, original: Shown | None) -> Any:
    """Poses of a recording, over those of its original; without one, the recording alone."""
    recording, before = shown.in_memory, None if original is None else original.in_memory
    if isinstance(recording, Motion):
        if isinstance(before, Motion):
            return plots.recording(before, recording, shown.name, shown.promise)
        return plots.poses(recording, shown.name)
    return cloud_plots.side_by_side(before if isinstance(before, PointClouds) else recording, recording, shown.name)


def read(name: str, names: tuple[str, ...], options: dict[str, Any], opened: ExitStack) -> Shown:
    """A recording to show; notes of its reader are shown on the page and on standard error."""
    if files.is_compressed(name):
        return viewer.shown(name, opened)
    both = (name, next((other for other in names if other != name), name))
    return of_path(name, Path(name).name, files.read(name, **compare.options_for(name, both, options)))
