"""`mocodec encode`: a recording to a .mocz file, measured against what went in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from .. import api, codecs, metrics
from ..errors import BadInput, CannotEncode
from ..motion import Motion
from ..pointcloud import PointClouds
from . import files, quantities, verify


@click.command("encode")
@click.argument("source", metavar="IN")
@click.option("-o", "--output", required=True, metavar="OUT.mocz", help='The file to write; "-" is standard output.')
@click.option("--codec", type=click.Choice(list(codecs.CODECS)), help="Default: tempo; bodycast for point clouds.")
@click.option("--max-error", type=quantities.LENGTH, help="No point of any frame is farther off than this: 2mm.")
@click.option("--mean-error", type=quantities.LENGTH, help="The average distance over all points and frames: 1mm.")
@click.option("--ratio", type=click.FloatRange(1), help="This many times smaller than float32 positions: 100.")
@click.option("--size", type=quantities.SIZE, help="No larger than this: 50kB.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A setting of the codec; may be repeated.")
@click.option(
    "--skeleton", type=click.Path(), metavar="FILE", help="For point clouds: a .bvh or .amc in the first frame's pose."
)
@click.option(
    "--residual",
    type=quantities.RESIDUAL,
    metavar="PERCENT|exact",
    help="For point clouds: how much of the residual, percent; bodycast has exact, every point as it is.",
)
@click.option("--bare", is_flag=True, help="Leave out analog channels, events and parameters; they are kept otherwise.")
@click.option("-q", "--quiet", is_flag=True, help="No summary.")
@files.reader_options
def command(
    source: str, output: str, codec: str | None, settings: tuple[str, ...], bare: bool, quiet: bool, **options: Any
) -> None:
    """Compress the recording IN (.c3d .trc .bvh .amc .npz …, a folder of .ply, or "-") into a .mocz file.

    Every file that is written has been decoded and measured first; the error is in the summary, on standard error.
    """
    targets = {name: options.pop(name) for name in ("max_error", "mean_error", "ratio", "size")}
    about_clouds = files.named(**{name: options.pop(name) for name in ("skeleton", "residual")})
    settings += tuple(f"{name}={value}" for name, value in about_clouds.items())
    if output != "-" and Path(output).suffix and not files.is_mocz(output):
        raise click.UsageError(f"{output}: encode writes .mocz files; `mocodec decode` writes the formats of the field")
    with files.working(f"reading {source}"):
        recording = files.read(source, **options)
    if bare:
        recording = replace(recording, extras={})
    chosen = choose(codec or api.default_codec(recording), settings, files.named(**targets))
    with files.working(f"encoding {source} with {chosen.name}"):
        blob = api.pack(chosen, recording)
        with api.open(blob) as opened:
            decoded, facts = opened[:], opened.info
    if isinstance(recording, Motion):
        _, broken = verify.hold(files.named(**targets), recording, decoded, facts)
        if broken:
            raise CannotEncode(f"{chosen.name} does not keep its promise, nothing was written: {'; '.join(broken)}")
    files.write_bytes(output, blob)
    if not quiet:
        click.echo(summary(output, recording, decoded, facts), err=True)
        for note in notes(recording):
            click.echo(f"note: {note}", err=True)


def choose(codec: str, settings: tuple[str, ...], targets: dict[str, float]) -> Any:
    """The codec with these settings and targets. Raises a usage error for those that it does not have."""
    kind = codecs.codec_class(codec)
    try:
        return api.with_options(codec, **dict(quantities.setting(kind, text) for text in settings), **targets)
    except (BadInput, TypeError) as error:
        raise click.UsageError(str(error)) from error


def notes(recording: Motion | PointClouds) -> Iterator[str]:
    """What of the recording does not go into a .mocz, or may not be as it was meant, in words."""
    if isinstance(recording, Motion) and recording.rotations is not None:
        yield "joint positions are stored; rotations are not stored yet"
    if missing := recording.source.get("missing_numbers"):
        yield f"{missing} numbers are missing between those of the files, which are taken as one frame after another"
    if ignored := recording.source.get("ignored"):
        yield f"properties that are left out: {', '.join(ignored)}"
    if recording.source.get("residuals") == "left out":
        yield "residuals and camera masks of the samples are left out; --residuals keeps them"


def summary(output: str, recording: Motion | PointClouds, decoded: Any, facts: dict[str, Any]) -> str:
    """One line: bytes, ratio and, for a motion, the error that was measured."""
    name = "standard output" if output == "-" else output
    stored, extras = facts["bytes"], facts["bytes_by_part"]["extras"]
    line = f"{name}: {quantities.size(stored)}, {recording.raw_bytes / stored:.1f} : 1 against float32"
    if extras > stored / 100:
        points = recording.raw_bytes / (stored - extras)
        line += f" ({points:.1f} : 1 without the {extras:,} bytes of analog channels, parameters and the like)"
    if isinstance(recording, Motion):
        error = metrics.compare(recording, decoded, stored)
        line += f", mean error {quantities.length(error.mean_error)}, max {quantities.length(error.max_error)}"
    return line
