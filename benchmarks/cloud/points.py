"""Points within a bound against Draco at equal D1: `scripts/bench cloud-points`.

    clip ─► recorded frames ─┬─ bodycast, max_error so that D1 is 5, 2, 1, 0.5 mm ─► bytes of the whole file, errors
                             └─ Draco at 6 to 13 bits ─► bytes of a frame, D1 ─interpolated─► bytes at that D1

All bytes count. With colours: Draco keeps them without loss, bodycast with the step that suits the bound.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import click
import numpy as np

from mocodec import api, formats
from mocodec.codecs.bodycast import Bodycast, lattice
from mocodec.metrics import point_clouds
from mocodec.pointcloud import PointClouds
from mocodec.testing import sequences

from .. import datasets
from .. import markdown as md
from ..machine import machine_description, measured_on
from ..packages import needs
from ..progress import progress
from ..results import read_json, rounded, write_json
from . import makehuman, tracking
from .records import LONG

D1_MM = (5.0, 2.0, 1.0, 0.5)
DRACO_BITS = (6, 7, 8, 9, 10, 11, 12, 13)
POINTS, RATE = 10_000, 15.0
MEASURED_FRAMES = 4


@dataclass
class PointResult:
    """One clip at one bound. Bytes are those of a frame; `once` those of a file that do not grow with the frames."""

    clip: str
    coloured: bool
    frames: int
    max_error_mm: float
    bytes: float
    once: int
    d1_mm: float
    d2_mm: float
    largest_mm: float
    psnr_db: float | None
    draco_bytes: float
    encode_fps: float
    decode_fps: float


def draco_curve(clouds: PointClouds) -> list[tuple[float, float]]:
    """(D1 in metres, bytes of a frame) of Draco at each of DRACO_BITS, as means over MEASURED_FRAMES frames."""
    draco, curve = needs("DracoPy"), list[tuple[float, float]]()
    frames = chosen_frames(clouds)
    for bits in DRACO_BITS:
        sizes, decoded = list[int](), list(clouds.positions)
        for frame in frames:
            colours = {} if clouds.colours is None else {"colors": clouds.colours[frame]}
            points = np.asarray(clouds.positions[frame], np.float32)
            blob = draco.encode(points, quantization_bits=bits, compression_level=10, **colours)
            sizes.append(len(blob))
            decoded[frame] = np.asarray(draco.decode(blob).points, np.float64)
        other = PointClouds(decoded, clouds.rate)
        d1 = float(np.mean([point_clouds.d1(clouds, other, frame) for frame in frames]))
        curve.append((d1, float(np.mean(sizes))))
    return curve


def bytes_at(curve: Sequence[tuple[float, float]], d1: float) -> float:
    """Bytes of a frame at this D1, interpolated in the logarithm of D1."""
    ordered = sorted(curve)
    return float(np.interp(np.log(d1), [np.log(point[0]) for point in ordered], [point[1] for point in ordered]))


def chosen_frames(clouds: PointClouds) -> list[int]:
    """The frames that are measured, evenly spaced."""
    return np.unique(np.linspace(0, len(clouds) - 1, MEASURED_FRAMES).round().astype(int)).tolist()


def at_length(result: PointResult, frames: int = LONG) -> float:
    """Bytes a frame if the same model, header and index were sent once for this many frames."""
    return result.bytes - result.once / result.frames + result.once / frames


def measure(clip: str, frames: int, data: Path, with_colours: Sequence[bool]) -> Iterator[PointResult]:
    """All bounds of a clip, without and with colours; none if its recording is not there."""
    performance = tracking.perform(makehuman.find(), data, clip, frames, RATE)
    if performance is None:
        return
    recorded = sequences.record(performance, POINTS, normals=True, seed=1)
    for coloured in with_colours:
        clouds = recorded if coloured else replace(recorded, colours=None)
        curve = draco_curve(clouds)
        for d1_mm in D1_MM:
            bound = d1_mm / 1000 / lattice.RMS_PER_BOUND
            started = time.perf_counter()
            codec = Bodycast(max_error=bound, skeleton=performance.skeleton()[:1])
            blob = api.encode(replace(clouds, normals=None), codec)
            encoded = time.perf_counter()
            decoded = api.decode(blob, PointClouds)
            done = time.perf_counter()
            found = point_clouds.errors(clouds, decoded)
            with api.open(blob) as file:
                once = len(blob) - sum(len(chunk.payload) for chunk in file.encoded.chunks)
            d2 = float(np.mean([point_clouds.d2(clouds, decoded, frame) for frame in chosen_frames(clouds)]))
            yield PointResult(
                clip, coloured, len(clouds), 1000 * bound, len(blob) / len(clouds), once, 1000 * found.d1, 1000 * d2,
                1000 * found.max_error, found.psnr if coloured else None, bytes_at(curve, found.d1),
                len(clouds) / (encoded - started), len(clouds) / (done - encoded),
            )  # fmt: skip


def markdown(results: Sequence[PointResult], machine: str) -> str:
    """A table of all clips, and one of their means."""
    parts = [
        "# Points within a bound, against Draco",
        f"Made by `scripts/bench cloud-points`: {POINTS:,} fresh points a frame of the actor at {RATE:g} Hz, the first "
        "pose given. Bytes are those of whole files (model, poses, points, header, index) over the frames. Draco's are "
        f"interpolated between {DRACO_BITS[0]} and {DRACO_BITS[-1]} bits to the same D1; its colours are lossless, "
        "those of bodycast have the PSNR in the table. Every file keeps its bound: the largest distance to the nearest "
        "point in both directions is in the table. The share at "
        f"{LONG:,} frames spreads what is sent once (the body and its surface) over that many.",
        machine,
    ]
    for coloured, heading in ((False, "Geometry alone"), (True, "With colours")):
        chosen = [r for r in results if r.coloured == coloured]
        rows = [
            [
                f"{d1:g}", str(len(same)), f"{np.mean([r.bytes for r in same]):,.0f}",
                f"{np.mean([r.draco_bytes for r in same]):,.0f}",
                f"{np.mean([r.bytes / r.draco_bytes for r in same]):.2f}",
                f"{np.mean([at_length(r) / r.draco_bytes for r in same]):.2f}",
                f"{max(at_length(r) / r.draco_bytes for r in same):.2f}",
                f"{np.mean([r.encode_fps for r in same]):.1f}, {np.mean([r.decode_fps for r in same]):.1f}",
            ]
            for d1 in D1_MM
            if (same := [r for r in chosen if abs(r.max_error_mm * lattice.RMS_PER_BOUND - d1) < 1e-3])
        ]  # fmt: skip
        if not rows:
            continue
        head = [
            "D1 mm",
            "clips",
            "bytes a frame",
            "Draco",
            "of Draco",
            f"of Draco, {LONG:,} frames",
            "largest of these",
        ]
        head.append("encode, decode frames/s")
        parts += [f"## {heading}", md.table(head, rows)]
        rows = [
            [
                r.clip, str(r.frames), f"{r.max_error_mm:.3g}", f"{r.largest_mm:.3g}", f"{r.d1_mm:.3g}",
                f"{r.d2_mm:.3g}", "–" if r.psnr_db is None else f"{r.psnr_db:.1f}", f"{r.bytes:,.0f}", f"{r.once:,}",
                f"{r.draco_bytes:,.0f}", f"{r.bytes / r.draco_bytes:.2f}", f"{at_length(r) / r.draco_bytes:.2f}",
            ]
            for r in chosen
        ]  # fmt: skip
        head = ["clip", "frames", "max error mm", "largest mm", "D1 mm", "D2 mm", "Y dB", "bytes a frame", "sent once"]
        parts.append(md.table([*head, "Draco", "of Draco", f"{LONG:,} frames"], rows))
    return "\n\n".join(parts) + "\n"


def write(folder: Path, results: Sequence[PointResult]) -> list[Path]:
    """Write cloud_points.json and cloud_points.md; return the paths."""
    write_json(
        folder / "cloud_points.json",
        rounded({"machine": machine_description(), "records": [asdict(r) for r in results]}),
    )
    return [folder / "cloud_points.json", write_tables(folder)]


def write_tables(folder: Path) -> Path:
    """Write cloud_points.md from cloud_points.json; return its path."""
    content = read_json(folder / "cloud_points.json")
    results = [PointResult(**record) for record in content["records"]]
    page = markdown(results, measured_on(content["machine"]))
    formats.replace_whole(folder / "cloud_points.md", page.encode())
    return folder / "cloud_points.md"


@click.command("cloud-points")
@click.option("-o", "--output", required=True, type=click.Path(file_okay=False, path_type=Path), help="Result folder.")
@click.option("--data", default=datasets.SHARED, show_default=True, type=click.Path(path_type=Path), help="Recordings.")
@click.option("--frames", default=20, show_default=True, type=click.IntRange(2), help="Frames of every clip.")
@click.option("--quick", is_flag=True, help="Geometry alone.")
def command(output: Path, data: Path, frames: int, quick: bool) -> None:
    """Measure points within a bound at a D1 of 5, 2, 1 and 0.5 mm on eight clips, against Draco at equal D1.

    Takes about a quarter of an hour. Writes cloud_points.json and cloud_points.md after every clip.
    """
    output.mkdir(parents=True, exist_ok=True)
    results, paths = list[PointResult](), list[Path]()
    with_colours = (False,) if quick else (False, True)
    with progress(len(with_colours) * len(D1_MM) * len(tracking.STARTS)) as advance:
        for clip in tracking.STARTS:
            for result in measure(clip, frames, data, with_colours):
                results.append(result)
                advance(f"{clip}, D1 {result.d1_mm:.1f} mm")
            paths = write(output, results)
    for path in paths:
        click.echo(path)
