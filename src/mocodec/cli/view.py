"""`mocodec view`: show recordings in the browser, or write them as one page."""

from __future__ import annotations

import webbrowser
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from .. import viewer
from ..viewer import page, session
from ..viewer.recording import Shown
from ..viewer.server import Server
from . import compare, files


@click.command("view")
@click.argument("sources", metavar="FILE…", nargs=-1, required=True)
@click.option("--against", metavar="ORIGINAL", help="Show the error against this recording, and its points in grey.")
@click.option(
    "--html",
    "html_path",
    type=click.Path(dir_okay=False),
    metavar="OUT.html",
    help="Write one page with everything inside, to be mailed or published, instead of serving it.",
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port on 127.0.0.1; by default any free one.")
@click.option("--no-browser", is_flag=True, help="Print the address, but open no browser.")
@files.reader_options
def command(
    sources: tuple[str, ...], against: str | None, html_path: str | None, port: int, no_browser: bool, **options: Any
) -> None:
    """Show recordings in the browser: figures, markers or point clouds, with the error against an original.

    FILE is a .mocz or any format that can be read; several are shown beside each other. The page is served to this
    computer only, until Ctrl-C. Reader options such as --asf and --unit apply to each file whose format takes them.
    """
    if html_path and Path(html_path).suffix.lower() not in (".html", ".htm"):
        raise click.UsageError(f"{html_path}: the suffix of a page must be .html")
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
            return
        with files.working("measuring"):
            server = Server(pairs, title, port)
        with server:
            files.echo(f"{server.url}\nShown until you press Ctrl-C.")
            if not no_browser:
                webbrowser.open(server.url)
            try:
                server.serve_forever()
            except KeyboardInterrupt:
                files.echo("closed", err=True)


def read(name: str, names: tuple[str, ...], options: dict[str, Any], opened: ExitStack) -> Shown:
    """A recording to show; notes of its reader are shown on the page and on standard error."""
    if files.is_mocz(name) or files.is_url(name):
        return viewer.shown(name, opened)
    both = (name, next((other for other in names if other != name), name))
    recording = files.read(name, **compare.options_for(name, both, options))
    from .. import formats

    return Shown(Path(name).name, recording, notes=[str(text) for text in formats.notes(recording)])
