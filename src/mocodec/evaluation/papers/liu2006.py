"""Liu & McMillan's tables 2 and 3 and figures 3 and 4, ours beside the published.

    python -m mocodec.evaluation.papers.liu2006 [--data FOLDER] [-o docs/results]

The paper's four sequences are known by their numbers of frames: every C3D file below the data folder that has one of
these and the paper's 41 markers is run. Writes liu2006.json, liu2006.md, and figures 3 and 4 of each sequence as PNG.
"""

from __future__ import annotations

import argparse
import json
import statistics as stats
import struct
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ... import formats, metrics
from ...codecs.liu2006 import Liu2006, global_pca, marker_groups, paper_tables, piecewise_pca, statistics
from ...codecs.liu2006.codec import read_shared
from ...motion import Motion
from ...stages.segment import Curve
from .. import datasets, runner

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
"""Tables 2 and 3 by the number of frames; rivals as (ratio, d %)."""

REPEATS = 9


def run(data: Path = datasets.SHARED, output: Path | None = None) -> dict[str, Any]:
    """Measure the paper's sequences below `data`; with `output`, write table and figures there."""
    codec = Liu2006()
    rows: list[dict[str, Any]] = []
    drawings: list[tuple[int, Sequence[Curve], Motion, Motion]] = []
    for path, motion in sequences(data):
        row, curves, decoded = measured(codec, motion)
        rows.append({"file": path.name, **row})
        drawings.append((row["published"]["sequence"], curves, motion, decoded))
    results = {
        "paper": "Liu & McMillan 2006, tables 2 and 3",
        "codec": codec.name,
        "settings": {k: v for k, v in asdict(codec).items() if v is not None},
        "machine": runner.machine(),
        "rows": sorted(rows, key=lambda row: row["published"]["sequence"]),
    }
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        (output / "liu2006.json").write_text(json.dumps(results, indent=1) + "\n")
        (output / "liu2006.md").write_text(markdown(results))
        for sequence, curves, motion, decoded in drawings:
            figure_3(output / f"liu2006_figure3_sequence{sequence}.png", curves, motion.rate)
            figure_4(output / f"liu2006_figure4_sequence{sequence}.png", motion, decoded, curves)
    return results


def sequences(data: Path) -> list[tuple[Path, Motion]]:
    """The paper's sequences among the C3D files below a folder."""
    found: list[tuple[Path, Motion]] = []
    for path in sorted(data.rglob("*.c3d")):
        if frames_of(path) in PUBLISHED:
            motion = formats.read(path)
            if isinstance(motion, Motion) and motion.points == MARKERS:
                found.append((path, motion))
    return found


def frames_of(path: Path) -> int:
    """Frames by the header of a C3D file: words 4 and 5 are the first and the last."""
    with open(path, "rb") as file:
        header = file.read(10)
    first, last = struct.unpack("<6xHH", header) if len(header) == 10 else (0, 0)
    return last - first + 1


def measured(codec: Liu2006, motion: Motion) -> tuple[dict[str, Any], Sequence[Curve], Motion]:
    """One row of the tables, the curves of the segmentation, and the decoded motion."""
    encode_ms, encoded = timed(lambda: codec.encode(motion), len(motion))
    decode_ms, decoded = timed(lambda: codec.decode(encoded), len(motion))
    markers = read_shared(encoded)[1]
    counts = statistics(encoded)
    segmentation = codec.segment_motion(motion.positions, markers, motion.up)
    compared = metrics.compare(motion, decoded, encoded.payload_bytes)
    row = {
        "content": datasets.content_hash(motion),
        "frames": len(motion),
        "published": PUBLISHED[len(motion)],
        "ours": {
            **asdict(counts),
            "average_components_of_all_groups_together": stats.fmean(map(sum, counts.components)),
            "d_normalised": paper_tables.d_normalised(motion, decoded.positions, markers),
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
        "global_pca": asdict(global_pca(motion, markers)),
        "piecewise_pca": asdict(piecewise_pca(motion, markers, segmentation.segments)),
        "readings": readings(codec, motion, markers),
        "longer": [longer(codec, motion, times) for times in (1, 2, 4)],
    }
    return row, segmentation.curves, decoded


def longer(codec: Liu2006, motion: Motion, times: int) -> dict[str, Any]:
    """Milliseconds a frame for the motion there and back again, `times` runs of it in all."""
    there_and_back = [motion.positions[:: -1 if turn % 2 else 1] for turn in range(times)]
    long = Motion(np.concatenate(there_and_back), motion.rate, motion.names, motion.up)
    encode_ms, encoded = timed(lambda: codec.encode(long), len(long))
    decode_ms, _ = timed(lambda: codec.decode(encoded), len(long))
    return {"frames": len(long), "encode_ms": encode_ms, "decode_ms": decode_ms}


def readings(codec: Liu2006, motion: Motion, markers: marker_groups.MarkerGroups) -> list[dict[str, Any]]:
    """What the gaps that the paper leaves would give otherwise: each reading's count and errors."""
    from dataclasses import replace

    others = len(markers.others)
    rows = []
    for what, changed in (
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
                "reading": what,
                "average_components": counts.average_components,
                "scalar_ratio": counts.scalar_ratio,
                "payload_bytes": encoded.payload_bytes,
                "d_normalised": paper_tables.d_normalised(motion, decoded.positions, markers),
                "d_world": metrics.distortion_percent(motion.positions, decoded.positions),
                "jump_at_cuts_m": jump(motion, decoded, [chunk.start for chunk in encoded.chunks[1:]]),
            }
        )
    return rows


def jump(motion: Motion, decoded: Motion, cuts: Sequence[int]) -> float:
    """How far points jump at the cuts beyond what they did in truth: root mean square over points and cuts, metres."""
    if not cuts:
        return 0.0
    error = decoded.positions - motion.positions
    return float(np.sqrt(np.nanmean([((error[cut] - error[cut - 1]) ** 2).sum(axis=-1) for cut in cuts])))


def timed(work: Any, frames: int) -> tuple[float, Any]:
    """The least processor time of a few runs, milliseconds a frame, and the result."""
    times: list[float] = []
    result = None
    for _ in range(REPEATS):
        started = time.process_time()
        result = work()
        times.append(time.process_time() - started)
    return min(times) * 1000 / frames, result


def markdown(results: dict[str, Any]) -> str:
    """Tables 2 and 3, ours beside the published."""
    lines = [
        "# Liu & McMillan 2006: ours beside the published",
        "",
        "Made by `python -m mocodec.evaluation.papers.liu2006`; settings, data and machine are in `liu2006.json`.",
        "",
        "| | sequence | ours | published |",
        "|---|---|---|---|",
    ]
    for row in results["rows"]:
        ours, theirs = row["ours"], row["published"]
        for what, here, there in (
            ("segments", ours["segments"], theirs["segments"]),
            ("components, average over segments and groups", f"{ours['average_components']:.1f}", theirs["components"]),
            ("control points a segment, all groups",
             f"{(ours['control_points'] + ours['normalisation_control_points']) / ours['segments']:.0f}",
             f"{theirs['control_points']} (of what, it does not say)"),
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
        lines += ["", f"Processor time of sequence {row['published']['sequence']}, there and back again:", ""]
        lines += ["| frames | compression, ms a frame | decompression, ms a frame |", "|---|---|---|"]
        lines += [f"| {r['frames']} | {r['encode_ms']:.3f} | {r['decode_ms']:.3f} |" for r in row["longer"]]
        lines += [
            "",
            f"Other readings of the paper, sequence {row['published']['sequence']}:",
            "",
            "| reading | components | ratio, scalars | bytes | d %, normalised | d %, world | jump at cuts, mm |",
            "|---|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {r['reading']} | {r['average_components']:.1f} | {r['scalar_ratio']:.1f} | {r['payload_bytes']} "
            f"| {r['d_normalised']:.2f} | {r['d_world']:.2f} | {1000 * r['jump_at_cuts_m']:.1f} |"
            for r in row["readings"]
        ]
    return "\n".join(lines) + "\n"


def figure_3(path: Path, curves: Sequence[Curve], rate: float) -> None:
    """The Mahalanobis distance H as the model grows, one curve for each search, and where they cut."""
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
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130, metadata={"Software": None})
    plt.close(figure)


def figure_4(path: Path, motion: Motion, decoded: Motion, curves: Sequence[Curve]) -> None:
    """Root mean square error over the markers of each frame."""
    plt = pyplot()
    error = 1000 * metrics.rms_per_frame(motion.positions, decoded.positions)
    figure, axes = plt.subplots(figsize=(9, 3.0), layout="constrained")
    axes.plot(error, lw=0.9, color="#00798c")
    for curve in curves:
        if curve.cut is not None:
            axes.axvline(curve.cut, color="0.35", lw=0.8, ls="--")
    axes.axhline(float(np.sqrt((error**2).mean())), color="#d1495b", lw=1)
    axes.set(xlabel="frame", ylabel="RMS error, mm a marker", xlim=(0, len(error)), ylim=(0, None))
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130, metadata={"Software": None})
    plt.close(figure)


def pyplot() -> Any:
    """Matplotlib without a window. Raises MissingExtra where it is not installed."""
    from ...errors import MissingExtra

    try:
        import matplotlib
    except ImportError:
        raise MissingExtra("drawing figures", "plot") from None
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=datasets.SHARED, help="a folder with CMU's C3D files")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/results"))
    arguments = parser.parse_args()
    results = run(arguments.data, arguments.output)
    print(markdown(results))


if __name__ == "__main__":
    main()
