"""`mocodec compare`: how far one recording is from another."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from .. import metrics, plots
from ..errors import BadInput
from ..metrics import point_clouds
from ..motion import Motion
from ..pointcloud import PointClouds
from . import files, quantities

CLOUD_FRAMES = 12


@click.command("compare")
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@click.option("--json", "as_json", is_flag=True, help="As JSON, lengths in metres.")
@click.option(
    "--plot", type=click.Path(dir_okay=False), metavar="FILE.png", help="Draw the error over time and per point."
)
@click.option("--poses", type=click.Path(dir_okay=False), metavar="FILE.png", help="Draw poses of both, side by side.")
@files.reader_options
def command(a: str, b: str, as_json: bool, plot: str | None, poses: str | None, **options: Any) -> None:
    """Measure B against A; either may be a .mocz or any other recording. --asf, --unit and their like are for A, and
    for B where it is of the same format.

    The ratio is A's positions as float32 over the bytes of the .mocz, where one of the two is one.
    """
    if a == b == "-":
        raise click.UsageError("only one of the two can be standard input")
    for path in filter(None, (plot, poses)):
        if Path(path).suffix.lower() not in plots.SUFFIXES:
            raise click.UsageError(f"{path}: pictures are written as {', '.join(plots.SUFFIXES)}")
    with files.working(f"reading {a} and {b}"):
        original, other = (files.read(name, **options_for(name, a, options)) for name in (a, b))
    if isinstance(original, PointClouds) and isinstance(other, PointClouds):
        if plot or poses:
            raise click.UsageError("--plot and --poses draw motions, not point clouds")
        click.echo(clouds(original, other, stored_bytes(b) or stored_bytes(a), as_json))
        return
    if not isinstance(original, Motion) or not isinstance(other, Motion):
        raise BadInput("one of the two holds point clouds, the other a motion")
    result = metrics.compare(original, other, stored_bytes(b) or stored_bytes(a))
    click.echo(result.to_json() if as_json else "\n".join(table(result)))
    for path in (plot, poses):
        if path:
            draw = plots.errors if path == plot else plots.recording
            plots.save(draw(original, other, title(a, b, result)), path)


def title(a: str, b: str, result: metrics.Comparison) -> str:
    """What a picture compares."""
    ratio = f", {result.ratio:.0f} : 1" if result.ratio is not None else ""
    return f"{Path(b).name} against {Path(a).name}: {result.frames:,} frames of {result.points} points{ratio}"


def options_for(name: str, a: str, options: dict[str, Any]) -> dict[str, Any]:
    """The readers' options that concern this file."""
    if name == "-":
        return options
    alike = Path(name).suffix.lower() == Path(a).suffix.lower()
    return {**options, "format_": None} if alike else {}


def clouds(a: PointClouds, b: PointClouds, stored: int | None, as_json: bool) -> str:
    """How far point clouds are from others, over at most CLOUD_FRAMES of their frames, evenly spaced."""
    if len(a) != len(b):
        raise BadInput(f"cannot compare {len(a)} frames of points with {len(b)}")
    frames = sorted({round(i * (len(a) - 1) / (CLOUD_FRAMES - 1)) for i in range(CLOUD_FRAMES)}) if len(a) else []
    frames = [f for f in frames if point_clouds.has_points(a, f) and point_clouds.has_points(b, f)]
    result: dict[str, Any] = {"frames": len(a), "measured_frames": len(frames)}
    if frames:
        result |= point_clouds.compare(a, b, frames)
    if stored:
        result["ratio"] = a.raw_bytes / stored
    if as_json:
        return json.dumps({k: None if v != v else v for k, v in result.items()}, indent=2)
    units = {"m": lambda v: quantities.length(v), "db": lambda v: f"{v:.2f} dB"}
    result = {k: v for k, v in result.items() if v == v}  # without colours, luma has no error
    shown = (units.get(k.rpartition("_")[2], lambda v: f"{v:.6g}")(v) for k, v in result.items())
    return "\n".join(f"{k.removesuffix('_m').removesuffix('_db'):16}{v}" for k, v in zip(result, shown, strict=True))


def stored_bytes(name: str) -> int | None:
    """Size of a .mocz file on disk."""
    return Path(name).stat().st_size if files.is_mocz(name) and not files.is_url(name) else None


def table(result: metrics.Comparison) -> list[str]:
    """A comparison as lines for people; points in order of their largest error."""
    where = f" at frame {result.max_at[0]}, {files.printable(result.max_at[1])}" if result.max_at else ""
    lines = [
        f"{result.frames:,} frames, {result.points} points",
        f"mean error  {quantities.length(result.mean_error)}",
        f"p99 error   {quantities.length(result.p99_error)}",
        f"max error   {quantities.length(result.max_error)}{where}",
        f"rms         {quantities.length(result.rms)}",
        f"d           {result.d_percent:.3g} %",
        f"gaps        {'equal' if result.gaps_equal else 'NOT EQUAL'}",
    ]
    if result.ratio is not None:
        lines.append(f"ratio       {result.ratio:.1f} : 1 against float32")
    if result.per_point:
        width = max(map(len, result.per_point))
        lines += ["", f"{'point':{width}}  {'mean':>10}  {'p99':>10}  {'max':>10}"]
        for name, error in sorted(result.per_point.items(), key=lambda item: -item[1]["max_error"]):
            values = (quantities.length(error[key]) for key in ("mean_error", "p99_error", "max_error"))
            lines.append(f"{files.printable(name):{width}}  " + "  ".join(f"{value:>10}" for value in values))
    return lines
