"""`mocodec encode`: a recording to a .mocz file, which is decoded and measured before it is written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from .. import api, codecs, metrics, progress
from ..codecs.base import Codec
from ..encoded import TARGETS, Recording
from ..errors import BadInput, CannotEncode
from ..motion import Motion
from . import files, quantities, verify


@click.command("encode")
@click.argument("source", metavar="IN")
@click.option(
    "-o", "--output", required=True, metavar="OUT.mocz", help='The file to write, or "-" for standard output.'
)
@click.option("--codec", type=click.Choice(list(codecs.CODECS)), help="Default: tempo; bodycast for point clouds.")
@click.option("--max-error", type=quantities.LENGTH, help="No point of any frame is farther off than this: 2mm.")
@click.option(
    "--mean-error", type=quantities.LENGTH, help="The average distance over all points and frames is at most this: 1mm."
)
@click.option("--ratio", type=click.FloatRange(1), help="At least this many times smaller than float32 positions: 100.")
@click.option("--size", type=quantities.SIZE, help="The file is at most this large: 50kB.")
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A setting of the codec; can be repeated.")
@click.option(
    "--skeleton",
    type=click.Path(),
    metavar="FILE",
    help="For point clouds: a .bvh or .amc whose first frame has the pose of the first frame.",
)
@click.option(
    "--residual",
    type=quantities.RESIDUAL,
    metavar="PERCENT|exact",
    help="For point clouds: share of the residual to store; 'exact' (bodycast only) keeps every point.",
)
@click.option("--bare", is_flag=True, help="Leave out analog channels, events and parameters.")
@click.option("-q", "--quiet", is_flag=True, help="Print no summary.")
@files.reader_options
def command(
    source: str, output: str, codec: str | None, settings: tuple[str, ...], bare: bool, quiet: bool, **options: Any
) -> None:
    """Compress the recording IN (.c3d .trc .bvh .amc .npz …, a folder of .ply, or "-") into a .mocz file.

    The file is decoded and measured before it is written; the summary on standard error shows the measured error.
    """
    targets = files.given(**{name: options.pop(name) for name in TARGETS})
    cloud_settings = files.given(**{name: options.pop(name) for name in ("skeleton", "residual")})
    settings += tuple(f"{name}={value}" for name, value in cloud_settings.items())
    if output != "-" and Path(output).suffix and not files.is_mocz(output):
        raise click.UsageError(f"{output}: encode writes .mocz files; `mocodec cut` converts between other formats")
    with files.working(f"reading {source}"):
        recording = files.read(source, **options)
    if bare:
        recording = replace(recording, extras={})
    chosen = codec_with(codec or api.default_codec(recording), settings, targets)
    with files.working(f"encoding {source} with {chosen.name}"):
        with progress.phase(0.0, 0.9):
            blob = api.pack(chosen, recording)
        with progress.phase(0.9, 1.0), api.open(blob) as opened:
            decoded, facts = opened[:], opened.info
    if isinstance(recording, Motion):
        _, broken = verify.check(targets, recording, decoded, facts)
        if broken:
            raise CannotEncode(f"{chosen.name} did not keep its promise, so nothing was written: {'; '.join(broken)}")
    files.write_bytes(output, blob)
    if not quiet:
        click.echo(summary(output, recording, decoded, facts), err=True)
        if isinstance(recording, Motion) and recording.rotations is not None:
            files.note(source, "joint positions are stored; rotations are not stored yet")


def codec_with(codec: str, settings: tuple[str, ...], targets: dict[str, float]) -> Codec[Any]:
    """The codec with these settings and targets. Raises a usage error for settings that it does not have."""
    kind = codecs.codec_class(codec)
    try:
        return api.with_options(codec, **dict(quantities.setting(kind, text) for text in settings), **targets)
    except (BadInput, TypeError) as error:
        raise click.UsageError(str(error)) from error


def summary(output: str, recording: Recording, decoded: Recording, facts: dict[str, Any]) -> str:
    """One line: bytes, ratio and, for a motion, the measured error."""
    name = "standard output" if output == "-" else output
    stored, extras = facts["bytes"], facts["bytes_by_part"]["extras"]
    if isinstance(recording, Motion) and not recording.points:
        return f"{name}: {quantities.size(stored)}, no points, {extras:,} bytes of signals and other extras"
    line = f"{name}: {quantities.size(stored)}, {recording.raw_bytes / stored:.1f} : 1 against float32"
    if extras > stored / 100:
        points = recording.raw_bytes / (stored - extras)
        line += f" ({points:.1f} : 1 without {extras:,} bytes of analog channels, parameters and other extras)"
    if isinstance(recording, Motion) and isinstance(decoded, Motion):
        error = metrics.compare(recording, decoded, stored)
        line += f", mean error {quantities.length(error.mean_error)}, max {quantities.length(error.max_error)}"
    return line
