"""`mocodec demo`: encode the small real recording in the package with several codecs, and measure the result.

recording.mocz ─decode─► jumps.trc ─encode─► one .mocz per codec and bound ─decode─► a table and a picture
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from .. import api, data, metrics, progress
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
DRAWN_RUN = RUNS[1]

CAVEAT = """\
This recording flatters lossy codecs, tempo most: it is stored in the package with an error of up to 0.7 mm, so it has
less noise than a fresh recording, and tempo's prior was learned from nine people who include this one. The tables in
README.md and docs/evaluation.md are measured on original recordings, without the measured person in the prior."""


@click.command("demo")
@click.option("-o", "--output", default="mocodec-demo", metavar="DIR", help="Folder to write to [mocodec-demo].")
def command(output: str) -> None:
    """Write the recording in the package as TRC, encode it with several codecs, measure the errors, draw a picture."""
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    trc = folder / "jumps.trc"
    recording = api.decode(data.RECORDING, Motion)
    api.write(trc, recording)
    original = api.read(trc, Motion)
    files.echo(
        f"{trc}: {len(original):,} frames of {original.points} joints at {original.rate:g} Hz, {original.seconds:.1f} s"
    )
    files.echo(f"  decoded from {data.RECORDING.name}, {quantities.size(data.RECORDING.stat().st_size)}\n")
    files.echo(f"{'codec':8}  {'promise':9}  {'bytes':>7}  {'ratio':>6}  {'mean':>8}  {'max':>7}")
    speeds: dict[str, list[tuple[float, float]]] = {}
    for codec, options in RUNS:
        text, seconds = row(original, codec, options, folder)
        files.echo(text)
        speeds.setdefault(codec, []).append(seconds)
    files.echo(f"\n{'frames/s':8}  {'encoded':>17}  {'decoded':>17}")
    for codec, seconds in speeds.items():
        files.echo(
            f"{codec:8}  " + "  ".join(f"{speed(len(original), times):>17}" for times in zip(*seconds, strict=True))
        )
    picture = draw(replace(original, skeleton=recording.skeleton), folder)  # TRC cannot store the skeleton
    files.echo(f"\n{CAVEAT}\n\nAcknowledgement: {data.ACKNOWLEDGEMENT}\n\nNow try:")
    first = folder / file_name(*RUNS[0])
    for line in (f"info {first}", f"verify {first} --against {trc}", f"decode {first} -o {folder / 'back.trc'}"):
        files.echo(f"  mocodec {line}")
    files.echo(f"  and look at {picture}" if picture else f"  (no picture: {MissingExtra('drawing', 'plot')})")


def file_name(codec: str, options: dict[str, Any]) -> str:
    """jumps-tempo-2mm.mocz."""
    bound = f"-{options['max_error'] * 1000:g}mm" if options else ""
    return f"jumps-{codec}{bound}.mocz"


def row(original: Motion, codec: str, options: dict[str, Any], folder: Path) -> tuple[str, tuple[float, float]]:
    """Encode, decode and measure: a line of the table, and the seconds of encoding and of decoding."""
    path = folder / file_name(codec, options)
    with files.working(f"encoding with {codec}"):
        start = time.perf_counter()
        with progress.phase(0.0, 0.9):
            api.write(path, original, codec=codec, **options)
        encoded = time.perf_counter()
        with progress.phase(0.9, 1.0):
            decoded = api.decode(path, Motion)
        end = time.perf_counter()
    error = metrics.compare(original, decoded, path.stat().st_size)
    promise = f"max {quantities.bound(options['max_error'])}" if options else "none"
    text = (
        f"{codec:8}  {promise:9}  {path.stat().st_size:>7,}  {error.ratio:>6.1f}  "
        f"{quantities.length(error.mean_error):>8}  {quantities.length(error.max_error):>7}"
    )
    return text, (encoded - start, end - encoded)


def speed(frames: int, seconds: Sequence[float]) -> str:
    """Frames a second, from the slowest to the fastest of the runs."""
    slowest, fastest = frames / max(seconds), frames / min(seconds)
    return f"{slowest:,.0f}" if len(seconds) == 1 else f"{slowest:,.0f} – {fastest:,.0f}"


def draw(original: Motion, folder: Path) -> Path | None:
    """Draw DRAWN_RUN and return the path of the picture; None without matplotlib."""
    from .. import plots

    path = folder / file_name(*DRAWN_RUN)
    ratio = original.raw_bytes / path.stat().st_size
    title = f"{len(original):,} frames in {quantities.size(path.stat().st_size)}, {ratio:.0f} : 1"
    try:
        plots.save(plots.recording(original, api.decode(path, Motion), title), folder / "jumps.png")
    except MissingExtra:
        return None
    return folder / "jumps.png"
