"""`mocodec decode`: a .mocz file to a format of the field."""

from __future__ import annotations

import click

from .. import api
from . import files


@click.command("decode")
@click.argument("source", metavar="IN.mocz")
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="OUT",
    help="The file to write; its suffix is the format. A folder for point clouds.",
)
@click.option("--format", "format_", metavar="NAME", help='Format for "-o -": c3d, trc, npz, …')
def command(source: str, output: str, format_: str | None) -> None:
    """Decode IN.mocz (a path, a URL or "-") into OUT: .c3d .trc .npz … by suffix, a folder for point clouds."""
    with files.working(f"decoding {source}"):
        recording = api.decode(files.source_of(source))
    with files.working(f"writing {output}"):
        files.write(output, recording, format_)
