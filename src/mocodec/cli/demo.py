"""`mocodec demo`: the whole journey on the small real recording inside the package.

recording.mocz ─decode─► walk.trc ─encode─► one .mocz per codec and bound ─► verify ─► a table and a picture
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from .. import api, data, metrics
from ..errors import MissingExtra
from ..motion import Motion
from . import files, quantities

RUNS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("tempo", {"max_error": 0.002}),
    ("tempo", {"max_error": 0.005}),
    ("tempo", {"max_error": 0.01}),
    ("hou2014", {"max_error": 0.01}),
    ("liu2006", {"max_error": 0.01}),
    ("lossless", {}),
)


@click.command("demo")
@click.option("-o", "--output", default="mocodec-demo", metavar="DIR", help="Folder to write into [mocodec-demo].")
def command(output: str) -> None:
    """Decode the recording inside the package to TRC, encode that afresh, measure it, and draw the outcome."""
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    trc = folder / "jumps.trc"
    recording = api.decode(data.RECORDING)
    api.write(trc, recording)
    original = api.read(trc)
    assert isinstance(original, Motion)
    click.echo(
        f"{trc}: {len(original):,} frames of {original.points} joints at {original.rate:g} Hz, {original.seconds:.1f} s"
    )
    click.echo(f"  from {data.RECORDING.name} inside the package, {quantities.size(data.RECORDING.stat().st_size)}\n")
    columns = f"{'codec':8}  {'promise':12}  {'bytes':>9}  {'ratio':>6}  {'mean':>9}  {'max':>9}"
    click.echo(f"{columns}  {'frames/s in':>11}  {'out':>9}")
    for codec, options in RUNS:
        click.echo(row(original, codec, options, folder))
    drawn = draw(replace(original, skeleton=recording.skeleton), folder)  # which TRC does not hold
    click.echo(f"\nacknowledgement: {data.ACKNOWLEDGEMENT}\n\nNow try:")
    first = folder / file_name(*RUNS[0])
    for line in (f"info {first}", f"verify {first} --against {trc}", f"decode {first} -o {folder / 'back.trc'}"):
        click.echo(f"  mocodec {line}")
    click.echo(f"  and look at {drawn}" if drawn else "  (no picture: pip install 'mocodec[plot]')")


def file_name(codec: str, options: dict[str, Any]) -> str:
    """jumps-tempo-2mm.mocz."""
    bound = f"-{options['max_error'] * 1000:g}mm" if options else ""
    return f"jumps-{codec}{bound}.mocz"


def row(original: Motion, codec: str, options: dict[str, Any], folder: Path) -> str:
    """Encode, decode and measure once; a line of the table."""
    path = folder / file_name(codec, options)
    with files.working(f"encoding with {codec}"):
        begun = time.perf_counter()
        api.write(path, original, codec=codec, **options)
        encoded = time.perf_counter()
        decoded = api.decode(path)
        done = time.perf_counter()
    stored = path.stat().st_size
    error = metrics.compare(original, decoded, stored)
    promise = f"max {quantities.bound(options['max_error'])}" if options else "none"
    return (
        f"{codec:8}  {promise:12}  {stored:>9,}  {error.ratio:>6.1f}  {quantities.length(error.mean_error):>9}  "
        f"{quantities.length(error.max_error):>9}  {len(original) / (encoded - begun):>11,.0f}  "
        f"{len(original) / (done - encoded):>9,.0f}"
    )


def draw(original: Motion, folder: Path) -> Path | None:
    """The picture of the second run; None where matplotlib is not installed."""
    from .. import plots

    codec, options = RUNS[1]
    path = folder / file_name(codec, options)
    ratio = original.raw_bytes / path.stat().st_size
    title = f"{len(original):,} frames in {quantities.size(path.stat().st_size)}, {ratio:.0f} : 1"
    try:
        plots.save(plots.recording(original, api.decode(path), title), folder / "jumps.png")
    except MissingExtra:
        return None
    return folder / "jumps.png"
