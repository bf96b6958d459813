"""`mocodec decode`: a .mocz file to a format of the field."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import click
import numpy as np

from .. import api, container, formats
from ..encoded import restore
from ..errors import BadInput, Corrupt
from ..motion import Motion
from ..pointcloud import PointClouds
from . import DAMAGED, files


@click.command("decode")
@click.argument("source", metavar="IN.mocz")
@click.option("-o", "--output", required=True, metavar="OUT", help="The file to write; its suffix is the format.")
@click.option("--format", "format_", metavar="NAME", help='The format for "-o -": c3d, trc, npz, …')
@click.option("--salvage", is_flag=True, help="Of a damaged file, write what is left; lost frames become gaps.")
def command(source: str, output: str, format_: str | None, salvage: bool) -> int | None:
    """Decode IN.mocz (a path, a URL or "-") into OUT: .c3d .trc .npz … by suffix, a folder for point clouds.

    Of point clouds, OUT.bvh gives the motion of the body that they were coded through, OUT.glb that with its surface.

    With --salvage a file that is damaged or cut short gives what can be had of it, and the exit code is still 4.
    """
    if Path(source).suffix.lower() in formats.FORMATS and not files.is_url(source):
        raise click.UsageError(f"{source} is no .mocz; `mocodec cut {source} -o {output}` writes it in another format")
    lost: list[str] = []
    beside: dict[str, Any] = {}
    with files.working(f"decoding {source}"):
        if salvage:
            recording, lost = what_is_left(container.Reader(files.source_of(source), salvage=True))
        else:
            suffix = Path(f"x.{format_.lstrip('.')}" if format_ else output).suffix.lower()
            recording, beside = played(source, suffix)
    with files.working(f"writing {output}"):
        files.write(output, recording, format_, **beside)
    for line in lost:
        click.echo(f"mocodec: {source}: {line}", err=True)
    return DAMAGED if lost else None


def played(source: str, suffix: str) -> tuple[Motion | PointClouds, dict[str, Any]]:
    """The recording, and options for its writer; of point clouds coded through a body, the body's motion where a
    motion's format is asked for, and its surface where that can show one.
    """
    with api.open(files.source_of(source)) as opened:
        if len(opened.shape) == 3 or suffix not in formats.FORMATS or suffix in formats.CLOUDS:
            return opened[:], {}
        if not hasattr(opened.codec, "track"):
            raise BadInput(f"{source} holds point clouds without a body; name a folder for .ply files")
        shows = suffix == ".glb" and hasattr(opened.codec, "surface")
        beside = {"surface": opened.codec.surface(opened.encoded)} if shows else {}
        return opened.codec.track(opened.encoded), beside


def what_is_left(reader: container.Reader) -> tuple[Motion, list[str]]:
    """The motion of a damaged file, with gaps where frames are lost, and what is lost, in words.

    Raises Corrupt where nothing is left, BadInput for point clouds.
    """
    with api.File(reader) as opened:
        if len(opened.shape) != 3:
            raise BadInput("--salvage is for motions, not point clouds")
        runs = reader.intact_runs()
        lost = [*reader.problems, *(message for _, message in reader.damage())]
        if not runs:
            raise Corrupt("nothing can be salvaged: " + "; ".join(lost))
        positions = np.full(opened.shape, np.nan)
        for start, stop in runs:
            positions[start:stop] = opened[start:stop].positions
        encoded: Any = opened.encoded
        if any(number is None for number, _ in reader.damage()):
            encoded = dataclasses.replace(encoded, about=dataclasses.replace(encoded.about, extras={}))
        missing = opened.shape[0] - sum(stop - start for start, stop in runs)
        lost += [f"{missing} frames are gaps"] if missing else []
        return restore(encoded, positions), lost
