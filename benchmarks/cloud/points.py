"""Points within a bound against Draco at equal D1, and bytes and errors of `residual`: `scripts/bench cloud-points`.

    clip ─► recorded frames ─┬─ bodycast, max_error so that D1 is 5, 2, 1, 0.5 mm ─► bytes of places and of colours
                             ├─ bodycast, residual 0 to 100 and exact ─► bytes, errors
                             └─ Draco at 6 to 13 bits, with and without colours ─► bytes, D1 ─interpolated─► bytes at D1

All bytes count. SciPy's k-d tree measures the errors, in both directions.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.spatial import KDTree

from mocodec import api
from mocodec.codecs.bodycast import Bodycast
from mocodec.codecs.bodycast.body_model import unpack_models
from mocodec.codecs.bodycast.chunk_payload import unpack_chunk
from mocodec.codecs.bodycast.point_layer import PointsHeader, split_references
from mocodec.encoded import Encoded
from mocodec.errors import BadInput
from mocodec.metrics import point_clouds
from mocodec.pointcloud import PointClouds
from mocodec.testing import sequences
from mocodec.testing.sequences import Performance
from mocodec.typing import Floats

from .. import datasets
from ..machine import machine_description
from ..packages import needs
from ..progress import progress
from ..results import rounded, write_json
from . import makehuman, points_report, tracking
from .points_report import D1_MM, DracoPoint, PointResult, ResidualResult

DRACO_BITS = (6, 7, 8, 9, 10, 11, 12, 13)
POINTS, DENSE_POINTS, RATE = 10_000, 100_000, 15.0
DENSE_CLIP, DENSE_FRAMES, DENSE_D1_MM = "01_01", 2, (2.0, 1.0)
RESIDUALS: tuple[float | str, ...] = (0, 10, 25, 26, 40, 55, 70, 85, 100, "exact")
D1_PER_BOUND = {5.0: 0.577, 2.0: 0.591, 1.0: 0.608, 0.5: 0.630}  # expected for 10,000 points; the result is measured
RESIDUAL_CLIP, RESIDUAL_FRAMES = "salsa_09", 3


def measured(clouds: PointClouds, decoded: PointClouds) -> dict[str, float]:
    """D1, D2 and the largest distance in millimetres, and the PSNR of luma: means over frames, or the largest.

    Both clouds need colours, the first needs normals.
    """
    assert clouds.normals is not None
    assert clouds.colours is not None
    assert decoded.colours is not None
    d1, d2, largest, squares = list[float](), list[float](), 0.0, np.zeros((2, 2))
    for frame in range(len(clouds)):
        p, q = np.asarray(clouds.positions[frame]), np.asarray(decoded.positions[frame])
        (there, to_q), (back, to_p) = KDTree(q).query(p), KDTree(p).query(q)
        n = np.asarray(clouds.normals[frame])
        planes = ((p - q[to_q]) * n).sum(axis=1), ((q - p[to_p]) * n[to_p]).sum(axis=1)
        d1.append(max(_rms(there), _rms(back)))
        d2.append(max(map(_rms, planes)))
        largest = max(largest, float(there.max()), float(back.max()))
        a, b = (point_clouds.luma(np.asarray(c)) for c in (clouds.colours[frame], decoded.colours[frame]))
        for k, difference in enumerate((a - b[to_q], b - a[to_p])):
            squares[k] += [float(np.sum(difference**2)), len(difference)]
    return {
        "d1_mm": 1000 * float(np.mean(d1)), "d2_mm": 1000 * float(np.mean(d2)), "largest_mm": 1000 * largest,
        "psnr_db": point_clouds.pooled_psnr(squares),
    }  # fmt: skip


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def draco_curve(clouds: PointClouds) -> list[DracoPoint]:
    """Draco at each of DRACO_BITS: means over the first and the last frame."""
    draco, curve = needs("DracoPy"), list[DracoPoint]()
    frames = sorted({0, len(clouds) - 1})
    assert clouds.colours is not None
    for bits in DRACO_BITS:
        alone, coloured, d1, seconds = list[int](), list[int](), list[float](), np.zeros(2)
        for frame in frames:
            points = np.asarray(clouds.positions[frame], np.float32)
            settings: dict[str, Any] = {"quantization_bits": bits, "compression_level": 10}
            alone.append(len(draco.encode(points, **settings)))
            started = time.process_time()
            blob = draco.encode(points, colors=clouds.colours[frame], **settings)
            encoded = time.process_time()
            decoded = np.asarray(draco.decode(blob).points, np.float64)
            seconds += encoded - started, time.process_time() - encoded
            coloured.append(len(blob))
            one = PointClouds([clouds.positions[frame]], RATE)
            d1.append(1000 * point_clouds.d1(one, PointClouds([decoded], RATE), 0))
        fps = len(frames) / np.maximum(seconds, 1e-9)
        curve.append(
            DracoPoint(
                bits, float(np.mean(d1)), float(np.mean(alone)), float(np.mean(coloured)), float(fps[0]), float(fps[1])
            )
        )
    return curve


def colour_bytes(encoded: Encoded[Any]) -> int:
    """Bytes of the colours in a file of points."""
    bodies, total = len(unpack_models(encoded.shared)), 0
    for chunk in encoded.chunks:
        streams = unpack_chunk(chunk, bodies)
        present = int((~streams.is_absent).sum())
        part, _ = split_references(streams.exact_points, chunk.frames)
        head = PointsHeader.read(part, chunk.frames, bodies, present, coloured=True)
        total += len(part) - head.octrees.stop
    return total


def record(clip: str, frames: int, points: int, data: Path) -> tuple[Performance, PointClouds] | None:
    """A clip on the actor, recorded with colours and normals; None if it does not exist."""
    performance = tracking.perform(makehuman.find(), data, clip, frames, RATE)
    if performance is None:
        return None
    return performance, sequences.record(performance, points, normals=True, seed=1)


def measure(clip: str, frames: int, points: int, d1s_mm: Sequence[float], data: Path) -> Iterator[PointResult]:
    """Yields the results of all bounds of a clip; nothing if its recording does not exist."""
    if (found := record(clip, frames, points, data)) is None:
        return
    performance, clouds = found
    curve = draco_curve(clouds)
    for d1_mm in d1s_mm:
        bound = d1_mm / 1000 / D1_PER_BOUND[d1_mm]
        codec = Bodycast(max_error=bound, skeleton=performance.skeleton()[:1])
        started = time.process_time()
        blob = api.encode(replace(clouds, normals=None), codec)
        encoded = time.process_time()
        decoded = api.decode(blob, PointClouds)
        done = time.process_time()
        errors = measured(clouds, decoded)
        if errors["largest_mm"] > 1000 * bound:
            raise BadInput(f"{clip}: a promise of {1000 * bound:g} mm is broken")
        with api.open(blob) as file:
            colours = colour_bytes(file.encoded)
            once = len(blob) - sum(len(chunk.payload) for chunk in file.encoded.chunks)
        rival = at_d1(curve, errors["d1_mm"])
        yield PointResult(
            clip, points, len(clouds), d1_mm, 1000 * bound, len(blob) / len(clouds), colours / len(clouds), once,
            **errors, draco_bytes=rival.bytes, draco_coloured_bytes=rival.coloured_bytes,
            encode_fps=len(clouds) / (encoded - started), decode_fps=len(clouds) / (done - encoded),
            draco_encode_fps=rival.encode_fps, draco_decode_fps=rival.decode_fps,
        )  # fmt: skip


def at_d1(curve: Sequence[DracoPoint], d1_mm: float) -> DracoPoint:
    """Draco at this D1, interpolated over the logarithm of D1."""
    ordered = sorted(curve, key=lambda point: point.d1_mm)
    known: Floats = np.log([point.d1_mm for point in ordered])
    fields = [asdict(point) for point in ordered]
    return DracoPoint(**{k: float(np.interp(np.log(d1_mm), known, [f[k] for f in fields])) for k in fields[0]})


def measure_residuals(data: Path) -> Iterator[ResidualResult]:
    """Yields the results of RESIDUALS on one clip; nothing if its recording does not exist."""
    if (found := record(RESIDUAL_CLIP, RESIDUAL_FRAMES, POINTS, data)) is None:
        return
    performance, clouds = found
    for residual in RESIDUALS:
        encoded = Bodycast(residual=residual, skeleton=performance.skeleton()[:1]).encode(replace(clouds, normals=None))
        once = sum(map(len, encoded.shared))
        errors = measured(clouds, Bodycast.decode(encoded))
        promise = encoded.promise.get("max_error")
        yield ResidualResult(
            str(residual), len(clouds), once, encoded.payload_bytes / len(clouds),
            None if promise is None else 1000 * promise, **errors,
        )  # fmt: skip


@click.command("cloud-points")
@click.option("-o", "--output", required=True, type=click.Path(file_okay=False, path_type=Path), help="Result folder.")
@click.option("--data", default=datasets.SHARED, show_default=True, type=click.Path(path_type=Path), help="Recordings.")
@click.option("--frames", default=20, show_default=True, type=click.IntRange(2), help="Frames of every clip.")
def command(output: Path, data: Path, frames: int) -> None:
    """Measure points within a bound at a D1 of 5, 2, 1 and 0.5 mm on eight clips and on a dense one, against Draco at
    equal D1, and residuals from 0 to exact on one clip.

    Takes about four minutes of one core for every five frames. Writes cloud_points.json, .md and .png.
    """
    output.mkdir(parents=True, exist_ok=True)
    clips: list[tuple[str, int, int, tuple[float, ...]]] = [(c, frames, POINTS, D1_MM) for c in tracking.STARTS]
    clips.append((DENSE_CLIP, DENSE_FRAMES, DENSE_POINTS, DENSE_D1_MM))
    results, residuals = list[PointResult](), list[ResidualResult]()

    def write() -> None:
        content = {
            "machine": machine_description(),
            "load": os.getloadavg()[2],
            "records": results,
            "residuals": residuals,
        }
        plain = {k: [asdict(r) for r in v] if isinstance(v, list) else v for k, v in content.items()}
        write_json(output / "cloud_points.json", rounded(plain))

    with progress(sum(len(d1s) for *_, d1s in clips) + len(RESIDUALS)) as advance:
        for residual in measure_residuals(data):
            residuals.append(residual)
            advance(f"residual {residual.residual}")
        for clip, count, points, d1s in clips:
            for result in measure(clip, count, points, d1s, data):
                results.append(result)
                advance(f"{clip}, {points:,} points, D1 {result.wanted_d1_mm:g} mm")
            write()
    for path in points_report.write(output):
        click.echo(path)
