"""Tables 2 and 3 and figures 3 and 4 of Liu and McMillan (2006), our results beside the printed ones.

The paper does not name its four recordings, but prints their numbers of frames. A C3D file with one of these numbers of
frames and 41 markers counts as one of them.
"""

from __future__ import annotations

import statistics as stats
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocodec import formats, metrics
from mocodec.codecs.liu2006 import Liu2006, global_pca, marker_groups, paper_tables, piecewise_pca, statistics
from mocodec.codecs.liu2006.decoding import read_shared
from mocodec.motion import Motion
from mocodec.stages.segment import Curve

from .. import datasets
from ..figures import pyplot, remove_frame, save_png
from ..machine import machine_description
from ..results import read_json, write_json

MARKERS = 41
PUBLISHED: dict[int, dict[str, Any]] = {
    4592: {"sequence": 1, "segments": 6, "components": 4.6, "control_points": 117, "scalar_ratio": 55.2, "d": 5.1,
           "encode_ms": 1.3, "decode_ms": 0.7, "global_pca": (5.3, 4.2), "piecewise_pca": (8.0, 4.1)},
    4499: {"sequence": 2, "segments": 9, "components": 10.9, "control_points": 211, "scalar_ratio": 18.4, "d": 7.1,
           "encode_ms": 1.4, "decode_ms": 0.7, "global_pca": (3.7, 5.8), "piecewise_pca": (5.0, 5.4)},
    10590: {"sequence": 3, "segments": 10, "components": 3.1, "control_points": 235, "scalar_ratio": 61.7, "d": 5.1,
            "encode_ms": 1.3, "decode_ms": 0.7, "global_pca": (6.4, 4.9), "piecewise_pca": (9.4, 4.3)},
    9206: {"sequence": 4, "segments": 9, "components": 4.2, "control_points": 221, "scalar_ratio": 56.0, "d": 5.4,
           "encode_ms": 1.2, "decode_ms": 0.7, "global_pca": (5.3, 4.5), "piecewise_pca": (8.4, 4.5)},
}  # fmt: skip
"""Tables 2 and 3 by the number of frames; the paper's rivals as (ratio, d %)."""

REPEATS = 9
"""Number of runs; the fastest counts."""


def run(data: Path = datasets.SHARED, output: Path | None = None) -> dict[str, Any]:
    """Measure the sequences of the paper in `data`; with `output`, write JSON, tables and figures there."""
    codec = Liu2006()
    rows: list[dict[str, Any]] = []
    drawings: list[tuple[int, Sequence[Curve], Motion, Motion]] = []
    for path, motion in sequences(data):
        row, curves, decoded = measure(codec, motion)
        rows.append({"file": path.name, **row})
        drawings.append((row["published"]["sequence"], curves, motion, decoded))
    results = {
        "paper": "Liu & McMillan 2006, tables 2 and 3",
        "codec": codec.name,
        "settings": {k: v for k, v in asdict(codec).items() if v is not None},
        "machine": machine_description(),
        "rows": sorted(rows, key=lambda row: row["published"]["sequence"]),
    }
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        write_json(output / "liu2006.json", results)
        write_tables(output)
        for sequence, curves, motion, decoded in drawings:
            figure_3(output / f"liu2006_figure3_sequence{sequence}.png", curves, motion.rate)
            figure_4(output / f"liu2006_figure4_sequence{sequence}.png", motion, decoded, curves)
    return results


def sequences(data: Path) -> list[tuple[Path, Motion]]:
    """The C3D files in a folder that count as sequences of the paper, with their motions."""
    found: list[tuple[Path, Motion]] = []
    for path in sorted(data.rglob("*.c3d")):
        if frames_of(path) in PUBLISHED:
            motion = formats.read(path)
            if isinstance(motion, Motion) and motion.points == MARKERS:
                found.append((path, motion))
    return found


def frames_of(path: Path) -> int:
    """Number of frames in the header of a C3D file: words 4 and 5 are the first and the last frame."""
    with open(path, "rb") as file:
        header = file.read(10)
    first, last = struct.unpack("<6xHH", header) if len(header) == 10 else (0, 0)
    return last - first + 1


def measure(codec: Liu2006, motion: Motion) -> tuple[dict[str, Any], Sequence[Curve], Motion]:
    """Measurements of one sequence, the curves of its segmentation, and the decoded motion."""
    encode_ms, encoded = timed(lambda: codec.encode(motion), len(motion))
    decode_ms, decoded = timed(lambda: codec.decode(encoded), len(motion))
    groups = read_shared(encoded)[1]
    counts = statistics(encoded)
    segmentation = codec.segment_motion(motion.positions, groups, motion.up)
    compared = metrics.compare(motion, decoded, encoded.payload_bytes)
    row = {
        "content": datasets.content_hash(motion),
        "frames": len(motion),
        "published": PUBLISHED[len(motion)],
        "ours": {
            **asdict(counts),
            "average_components_of_all_groups_together": stats.fmean(map(sum, counts.components)),
            "d_normalised": paper_tables.d_normalised(motion, decoded.positions, groups),
            "d_world": compared.d_percent,
            "payload_bytes": encoded.payload_bytes,
            "byte_ratio_to_float32": compared.ratio,
            "mean_error_m": compared.mean_error,
            "p99_error_m": compared.p99_error,
            "max_error_m": compared.max_error,
            "rms_m": compared.rms,
            "encode_ms": encode_ms,
            "decode_ms": decode_ms,
        },
        "global_pca": asdict(global_pca(motion, groups)),
        "piecewise_pca": asdict(piecewise_pca(motion, groups, segmentation.segments)),
        "readings": readings(codec, motion, groups),
        "longer": [there_and_back(codec, motion, times) for times in (1, 2, 4)],
    }
    return row, segmentation.curves, decoded


def there_and_back(codec: Liu2006, motion: Motion, times: int) -> dict[str, Any]:
    """Milliseconds per frame for `times` copies of the motion, alternately forwards and backwards."""
    copies = [motion.positions[:: -1 if turn % 2 else 1] for turn in range(times)]
    long = Motion(np.concatenate(copies), motion.rate, motion.names, motion.up)
    encode_ms, encoded = timed(lambda: codec.encode(long), len(long))
    decode_ms, _ = timed(lambda: codec.decode(encoded), len(long))
    return {"frames": len(long), "encode_ms": encode_ms, "decode_ms": decode_ms}


def readings(codec: Liu2006, motion: Motion, groups: marker_groups.MarkerGroups) -> list[dict[str, Any]]:
    """Results with other interpretations of points that the paper leaves open."""
    others = len(groups.others)
    rows = []
    for interpretation, changed in (
        ("as decided", codec),
        ("no blend", replace(codec, blend_frames=0)),
        ("h = 10", replace(codec, blend_frames=10)),
        ("splines within tolerance × √markers", replace(codec, spline_tolerance=codec.spline_tolerance / others**0.5)),
        ("PCA within tolerance × √coordinates", replace(
            codec, pca_tolerance=codec.pca_tolerance * 3**0.5, foot_tolerance=codec.foot_tolerance * 3**0.5)),
        ("quantiser five times coarser", replace(codec, fineness=0.25)),
    ):  # fmt: skip
        encoded = changed.encode(motion)
        decoded = changed.decode(encoded)
        counts = statistics(encoded)
        rows.append(
            {
                "reading": interpretation,
                "average_components": counts.average_components,
                "scalar_ratio": counts.scalar_ratio,
                "payload_bytes": encoded.payload_bytes,
                "d_normalised": paper_tables.d_normalised(motion, decoded.positions, groups),
                "d_world": metrics.distortion_percent(motion.positions, decoded.positions),
                "jump_at_cuts_m": jump(motion, decoded, [chunk.start for chunk in encoded.chunks[1:]]),
            }
        )
    return rows


def jump(motion: Motion, decoded: Motion, cuts: Sequence[int]) -> float:
    """Jumps that coding adds: root mean square change of the error at cuts, over points and cuts, metres."""
    if not cuts:
        return 0.0
    error = decoded.positions - motion.positions
    return float(np.sqrt(np.nanmean([((error[cut] - error[cut - 1]) ** 2).sum(axis=-1) for cut in cuts])))


def timed(work: Callable[[], Any], frames: int) -> tuple[float, Any]:
    """Milliseconds of processor time per frame of the fastest run, and the result."""
    times: list[float] = []
    result = None
    for _ in range(REPEATS):
        started = time.process_time()
        result = work()
        times.append(time.process_time() - started)
    return min(times) * 1000 / frames, result


def markdown(results: dict[str, Any]) -> str:
    """Tables 2 and 3, our results beside the printed ones."""
    lines = [
        "# Liu and McMillan 2006: our results beside the printed ones",
        "",
        "Made by `scripts/bench liu2006`; settings, data and machine are in `liu2006.json`.",
        "",
        "| | sequence | ours | printed |",
        "|---|---|---|---|",
    ]
    for row in results["rows"]:
        ours, theirs = row["ours"], row["published"]
        for what, here, there in (
            ("segments", ours["segments"], theirs["segments"]),
            ("components, average over segments and groups", f"{ours['average_components']:.1f}", theirs["components"]),
            ("control points a segment, all groups",
             f"{(ours['control_points'] + ours['normalisation_control_points']) / ours['segments']:.0f}",
             f"{theirs['control_points']} (the paper does not say of which groups)"),
            ("ratio, in scalars", f"{ours['scalar_ratio']:.1f}", theirs["scalar_ratio"]),
            ("d %, normalised coordinates", f"{ours['d_normalised']:.1f}", theirs["d"]),
            ("d %, world coordinates", f"{ours['d_world']:.1f}", ""),
            ("ratio, in bytes against float32", f"{ours['byte_ratio_to_float32']:.1f}", ""),
            ("compression, ms a frame", f"{ours['encode_ms']:.3f}", theirs["encode_ms"]),
            ("decompression, ms a frame", f"{ours['decode_ms']:.3f}", theirs["decode_ms"]),
            *((f"{name}: ratio at d % (normalised; world)",
               f"{row[key]['scalar_ratio']:.1f} at {row[key]['d_normalised']:.1f}; {row[key]['d_world']:.1f}",
               "{:.1f} at {:.1f}".format(*theirs[key]))
              for name, key in (("global PCA", "global_pca"), ("piecewise PCA", "piecewise_pca"))),
        ):  # fmt: skip
            lines.append(f"| {what} | {theirs['sequence']} | {here} | {there} |")
    for row in results["rows"]:
        lines += ["", f"Processor time of sequence {row['published']['sequence']}, forwards and backwards in turn:", ""]
        lines += ["| frames | compression, ms a frame | decompression, ms a frame |", "|---|---|---|"]
        lines += [f"| {r['frames']} | {r['encode_ms']:.3f} | {r['decode_ms']:.3f} |" for r in row["longer"]]
        lines += [
            "",
            f"Other interpretations of the paper, sequence {row['published']['sequence']}:",
            "",
            "| interpretation | components | ratio, scalars | bytes | d %, normalised | d %, world "
            "| jump at cuts, mm |",
            "|---|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {r['reading']} | {r['average_components']:.1f} | {r['scalar_ratio']:.1f} | {r['payload_bytes']} "
            f"| {r['d_normalised']:.2f} | {r['d_world']:.2f} | {1000 * r['jump_at_cuts_m']:.1f} |"
            for r in row["readings"]
        ]
    return "\n".join(lines) + "\n"


def figure_3(path: Path, curves: Sequence[Curve], rate: float) -> None:
    """Figure of the average Mahalanobis distance H against the model's end: a curve for each search, and the cuts."""
    plt = pyplot()
    figure, axes = plt.subplots(figsize=(9, 3.6), layout="constrained")
    for i, curve in enumerate(curves):
        axes.plot(curve.frames, curve.distances, color=f"C{i % 10}", lw=1.2)
        if curve.cut is not None:
            axes.axvline(curve.cut, color="0.35", lw=0.8, ls="--")
            axes.plot(curve.cut, curve.distances[list(curve.frames).index(curve.cut)], "o", color=f"C{i % 10}", ms=4)
            axes.annotate(
                str(curve.cut), (curve.cut, 1.01), xycoords=("data", "axes fraction"), ha="center", fontsize=8
            )
    axes.set(yscale="log", xlabel="end of the model, frame", ylabel="average Mahalanobis distance H")
    remove_frame(axes)
    save_png(figure, path, 130)


def figure_4(path: Path, motion: Motion, decoded: Motion, curves: Sequence[Curve]) -> None:
    """Figure of the root mean square error over the markers, frame by frame."""
    plt = pyplot()
    error = 1000 * metrics.rms_per_frame(motion.positions, decoded.positions)
    figure, axes = plt.subplots(figsize=(9, 3.0), layout="constrained")
    axes.plot(error, lw=0.9, color="#00798c")
    for curve in curves:
        if curve.cut is not None:
            axes.axvline(curve.cut, color="0.35", lw=0.8, ls="--")
    axes.axhline(float(np.sqrt((error**2).mean())), color="#d1495b", lw=1)
    axes.set(xlabel="frame", ylabel="RMS error, mm a marker", xlim=(0, len(error)), ylim=(0, None))
    remove_frame(axes)
    save_png(figure, path, 130)


def write_tables(folder: Path) -> Path:
    """Write liu2006.md from liu2006.json; return its path."""
    formats.replace_whole(folder / "liu2006.md", markdown(read_json(folder / "liu2006.json")).encode())
    return folder / "liu2006.md"


@click.command("liu2006")
@click.option("-o", "--output", default="docs/results", show_default=True, type=click.Path(path_type=Path))
@click.option("--data", default=datasets.SHARED, show_default=True, type=click.Path(path_type=Path), help="Recordings.")
def command(output: Path, data: Path) -> None:
    """Tables and figures of Liu and McMillan (2006), our results beside the printed ones.

    Writes liu2006.json, liu2006.md and liu2006_figure*.png.
    """
    run(data, output)
    click.echo(output / "liu2006.md")
