"""`mocodec decode`: a .mocz file to .c3d, .trc, .bvh and other formats."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import click
import numpy as np

from .. import api, container, formats
from ..encoded import Encoded, Recording, restore
from ..errors import BadInput, Corrupt
from ..motion import Motion
from . import DAMAGED, files


@click.command("decode")
@click.argument("source", metavar="IN.mocz")
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="OUT",
    help="The file to write, in the format of its suffix; '-' is standard output.",
)
@click.option("--format", "format_", metavar="NAME", help="Format of standard output: c3d, trc, npz, …")
@click.option("--salvage", is_flag=True, help="Write the undamaged frames of a damaged file; lost frames become gaps.")
def command(source: str, output: str, format_: str | None, salvage: bool) -> int | None:
    """Decode IN.mocz (a path, a URL or "-") into OUT: .c3d .trc .npz … by suffix, a folder for point clouds.

    For point clouds, OUT.bvh is the motion of the tracked body, OUT.glb the same with the surface of the body.

    With --salvage the undamaged frames of a damaged file are written, and the exit code is still 4.
    """
    if Path(source).suffix.lower() in formats.FORMATS and not files.is_url(source):
        raise click.UsageError(f"{source} is not a .mocz file; to convert it, run `mocodec cut {source} -o {output}`")
    lost: list[str] = []
    writer_options: dict[str, Any] = {}
    with files.working(f"decoding {source}"):
        if salvage:
            recording, lost = salvaged(container.Reader(files.source_of(source), salvage=True))
        else:
            suffix = Path(f"x.{format_.lstrip('.')}" if format_ else output).suffix.lower()
            recording, writer_options = decoded_for(source, suffix)
    with files.working(f"writing {output}"):
        files.write(output, recording, format_, **writer_options)
    for line in lost:
        click.echo(f"mocodec: {source}: {line}", err=True)
    return DAMAGED if lost else None


def decoded_for(source: str, suffix: str) -> tuple[Recording, dict[str, Any]]:
    """The recording for a file with this suffix, and options for its writer.

    For point clouds and the suffix of a motion: the motion of the tracked body, for a .glb also its surface.
    """
    with api.open(files.source_of(source)) as opened:
        if len(opened.shape) == 3 or suffix not in formats.FORMATS or suffix in formats.CLOUDS:
            return opened[:], {}
        codec: Any = opened.codec
        if not hasattr(codec, "track"):
            raise BadInput(
                f"{source}: its codec tracks no body, so there is no motion to write; name a folder for .ply files"
            )
        has_surface = suffix == ".glb" and hasattr(codec, "surface")
        return codec.track(opened.encoded), {"surface": codec.surface(opened.encoded)} if has_surface else {}


def salvaged(reader: container.Reader) -> tuple[Motion, list[str]]:
    """The motion of a damaged file, with gaps for lost frames, and what is lost, in words.

    Raises Corrupt if all frames are lost, BadInput for point clouds.
    """
    with api.File[Motion](reader) as opened:
        if len(opened.shape) != 3:
            raise BadInput("--salvage works for motions only, not for point clouds")
        runs = reader.intact_runs()
        lost = [*reader.problems, *(message for _, message in reader.damage())]
        if not runs:
            raise Corrupt(f"{reader.source.name}: no frame can be salvaged: " + "; ".join(lost))
        positions = np.full(opened.shape, np.nan)
        for start, stop in runs:
            positions[start:stop] = opened[start:stop].positions
        encoded: Encoded[Motion] = opened.encoded
        if any(number is None for number, _ in reader.damage()):
            encoded = dataclasses.replace(encoded, about=dataclasses.replace(encoded.about, extras={}))
        missing = opened.shape[0] - sum(stop - start for start, stop in runs)
        lost += [f"{missing} frames are gaps"] if missing else []
        return restore(encoded, positions), lost
