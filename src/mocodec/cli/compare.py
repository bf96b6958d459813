"""`mocodec compare`: measure the difference between two recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

import click

from .. import api, cloud_plots, metrics, plots
from ..encoded import Recording
from ..errors import BadInput
from ..motion import Motion
from ..pointcloud import PointClouds
from . import clouds, files, quantities, sections


@click.command("compare", cls=sections.Command)
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, lengths in metres.")
@click.option(
    "--plot", type=click.Path(dir_okay=False), metavar="FILE.png", help="Draw the error over time and per point."
)
@click.option(
    "--poses",
    type=click.Path(dir_okay=False),
    metavar="FILE.png",
    help="Draw poses of both recordings over each other.",
)
@click.option(
    "--shell",
    type=quantities.LENGTH,
    metavar="LENGTH",
    default=metrics.SHELL_M,
    help="Distance of shell points from their joints; default: 3cm.",
)
@files.reader_options
def command(a: str, b: str, as_json: bool, plot: str | None, poses: str | None, shell: float, **options: Any) -> None:
    """Measure the error of B against A; each is a .mocz or a recording in another format.

    If both have joint rotations, the errors of shell points (3 cm off the joints, where the skin is) and the angles
    between rotations are measured too.

    Reader options such as --asf and --unit apply to each file whose format takes them. If one of the two is a .mocz,
    the ratio is the size of A as float32 positions over the size of the .mocz.
    """
    if a == b == "-":
        raise click.UsageError("A and B cannot both be standard input")
    for path in (plot, poses):
        files.require_suffix(path, "a picture", plots.SUFFIXES)
    with files.working(f"reading {a} and {b}"):
        original, other = read_both(a, b, options)
    if isinstance(original, PointClouds) and isinstance(other, PointClouds):
        stored = stored_bytes(b) or stored_bytes(a)
        result = clouds.comparison(original, other, stored, tracked_body(b) or tracked_body(a))
        files.echo(clouds.as_text(result, as_json))
        heading = f"{Path(b).name} against {Path(a).name}: {len(original):,} frames of points"
        for path in filter(None, (plot, poses)):
            if path == plot:
                drawn = cloud_plots.errors(original, other, heading, promise(b) or promise(a))
            else:
                drawn = cloud_plots.side_by_side(original, other, heading)
            plots.save(drawn, path)
        return
    if not isinstance(original, Motion) or not isinstance(other, Motion):
        raise BadInput(f"cannot compare a motion with point clouds: {a} holds {kind(original)}, {b} {kind(other)}")
    comparison = metrics.compare(original, other, stored_bytes(b) or stored_bytes(a), shell)
    if as_json:
        files.echo(comparison.to_json())
    else:
        for text in table(comparison):
            files.line(text)
    for path in (plot, poses):
        if path:
            draw = plots.errors if path == plot else plots.recording
            plots.save(draw(original, other, title(a, b, comparison), promise(b) or promise(a)), path)


def tracked_body(name: str) -> Motion | None:
    """The first body that a .mocz of point clouds was coded with; None without one, and for other files."""
    if name == "-" or not files.is_mocz(name):
        return None
    with api.open(files.source_of(name)) as opened:
        if not hasattr(opened.codec, "track") or not len(opened.encoded.shared):
            return None
        return cast("Motion", cast(Any, opened.codec).track(opened.encoded))


def title(a: str, b: str, result: metrics.Comparison) -> str:
    """The title of a picture."""
    ratio = f", {result.ratio:.0f} : 1" if result.ratio is not None else ""
    return f"{Path(b).name} against {Path(a).name}: {result.frames:,} frames of {result.points} points{ratio}"


def read_both(a: str, b: str, options: dict[str, Any]) -> tuple[Recording, Recording]:
    """Both recordings. A .mocz is read first: it knows the rate of files that do not say theirs."""
    found: dict[str, Recording] = {}
    for name in sorted({a, b}, key=lambda name: not files.is_mocz(name)):
        chosen = options_for(name, (a, b), options)
        known = next(iter(found.values()), None)
        found[name] = files.read(name, **files.with_known_rate(name, chosen, known))
    return found[a], found[b]


def options_for(name: str, both: tuple[str, str], options: dict[str, Any]) -> dict[str, Any]:
    """The reader options for one of both files: those that its format takes; for the first also those of no format."""
    chosen = files.given(**options)
    format_ = chosen.pop("format_", None)
    takers = {option: [file for file in both if files.takes(file, format_, option)] for option in chosen}
    mine = {option: chosen[option] for option, taking in takers.items() if name in (taking or both[:1])}
    return {**mine, "format_": format_} if name == "-" else mine


def kind(recording: Recording) -> str:
    """The kind of a recording, in words."""
    return "a motion" if isinstance(recording, Motion) else "point clouds"


def stored_bytes(name: str) -> int | None:
    """The size of a .mocz file on disk; None for other formats and URLs."""
    return Path(name).stat().st_size if files.is_mocz(name) and not files.is_url(name) else None


def promise(name: str) -> Mapping[str, float]:
    """The promises of a .mocz on disk; none for other files."""
    if name == "-" or not files.is_mocz(name) or files.is_url(name):
        return {}
    with api.open(Path(name)) as opened:
        return opened.encoded.promise


def table(result: metrics.Comparison) -> list[str]:
    """A comparison as lines of text; points in order of their largest error."""
    where = f" at frame {result.max_at[0]}, {files.printable(result.max_at[1])}" if result.max_at else ""
    lines = [
        f"{result.frames:,} frames, {result.points} points",
        f"mean error  {quantities.length(result.mean_error)}",
        f"p99 error   {quantities.length(result.p99_error)}",
        f"max error   {quantities.length(result.max_error)}{where}",
        f"rms         {quantities.length(result.rms)}",
        f"distortion  {result.d_percent:.3g} % (d of Liu & McMillan 2006)",
        f"gaps        {'equal' if result.gaps_equal else 'NOT EQUAL'}",
    ]
    if result.ratio is not None:
        lines.append(f"ratio       {result.ratio:.1f} : 1 against float32")
    if result.skeletal is not None:
        lines += ["", *pose_table(result.skeletal)]
    if result.per_point:
        lines += ["", *point_table(result)]
    return lines


def pose_table(pose: metrics.SkeletalErrors) -> list[str]:
    """The errors of shell points and rotations."""
    shell = f"shell points, {quantities.bound(pose.shell_m)} off"
    rows: tuple[tuple[str, metrics.Spread, Callable[[float], str]], ...] = (
        (shell, pose.shell, quantities.length),
        ("joints and shell points", pose.joints_and_shell, quantities.length),
        ("rotation in the world", pose.world_degrees, quantities.angle),
        ("rotation against parent", pose.local_degrees, quantities.angle),
    )
    lines = [f"{'':24}  {'mean':>10}  {'p99':>10}  {'max':>10}"]
    for label, spread, as_text in rows:
        values = "  ".join(f"{as_text(value):>10}" for value in (spread.mean, spread.p99, spread.largest))
        where = f"  frame {spread.at[0]}, {files.printable(spread.at[1])}" if spread.at and spread.largest else ""
        lines.append(f"{label:24}  {values}{where}")
    return lines


def point_table(result: metrics.Comparison) -> list[str]:
    """The errors of each point, the largest first; of joints also those of their shell points and world rotation."""
    width = max(map(len, result.per_point))
    per_joint = result.skeletal.per_joint if result.skeletal else {}
    more = f"  {'shell max':>10}  {'angle max':>10}" if per_joint else ""
    lines = [f"{'point':{width}}  {'mean':>10}  {'p99':>10}  {'max':>10}{more}"]
    for name, error in sorted(result.per_point.items(), key=lambda item: -item[1]["max_error"]):
        values = [quantities.length(error[key]) for key in ("mean_error", "p99_error", "max_error")]
        if name in per_joint:
            values += [quantities.length(per_joint[name]["shell_max"])]
            values += [quantities.angle(per_joint[name]["world_degrees_max"])]
        lines.append(f"{files.printable(name):{width}}  " + "  ".join(f"{value:>10}" for value in values))
    return lines
