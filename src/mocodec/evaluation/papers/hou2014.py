"""Hou et al.'s figures and tables, ours beside the published.

    python -m mocodec.evaluation.papers.hou2014 [--data FOLDER] [-o docs/results]

Draws figures 2 to 5 (analysis), 7 and 8 (r and Q), 9 (ratio against distortion: rivals, lengths of clips), 11 (60 Hz),
12 (adaptive clips) and the databases; writes hou2014.json, from which all are drawn, and hou2014.md with Tables I to
IV. The paper's sequences are taken where a folder has them as CMU names them (`subjects/SS/SS_TT.amc`); others of CMU
stand in for them.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ... import formats, metrics
from ...codecs import baselines
from ...codecs.hou2014 import Hou2014, analysis
from ...codecs.hou2014.database import Hou2014Database
from ...errors import MocodecError
from ...motion import Motion
from ...stages import gaps
from .. import datasets, runner
from .liu2006 import pyplot

Point = dict[str, float]
"""ratio and mean error in centimetres, and what else is known of one run."""

ANALYSED = ("14_14", "15_12", "83_36", "86_06")
SECTION_VI = ("86_02", "86_12", "41_07", "56_07", "69_08", "86_05")
COMPARED = ("15_04", "17_08", "17_10", "85_12")
STAND_INS = ("03_04", "01_01", "02_05", "118_20", "131_04")
DATABASES = {
    "database_1": (31, 40, 86),
    "database_2": (105, 106, 111, 113),
    "database_3": (6, 15, 16, 17, 35, 94, 135),
    "database_4": (1, 2, 5, 6, 9, 12),
    "subjects 1, 2, 3": (1, 2, 3),
    "subjects here": (1, 2, 3, 10, 16, 49, 64, 118, 131),
}
"""Subjects of the databases of Table II; the last two stand in where those are not there."""

TABLE_I = {"14_14": (0.0516, 2.895), "15_12": (0.0305, 1.683), "83_36": (0.0363, 10.217), "86_06": (0.0483, 8.2831)}
"""v̄ and σ̄ as printed, in the unit of the raw ASF files as it seems."""

TABLE_III = {
    "15_04": (17.2, 27.6), "17_08": (7.19, 9.65), "17_10": (3.24, 4.18), "85_12": (4.90, 6.83), "41_07": (7.88, 10.9),
    "56_07": (9.61, 13.5), "69_08": (5.98, 7.92), "86_05": (8.64, 12.1),
    "database_1": (0.23, 34.6), "database_2": (0.21, 31.4),
}  # fmt: skip
"""Encoding and decoding frames a second, in tens of thousands."""

TABLE_IV = {
    "15_04": ((45.7, 0.12), (114.1, 0.29)), "17_08": ((35.0, 0.15), (93.8, 0.37)),
    "17_10": ((14.2, 0.22), (63.2, 1.07)), "85_12": ((16.1, 0.12), (59.3, 0.84)),
}  # fmt: skip
"""Ratio and mean error in centimetres."""

ASF_UNIT_M = 0.0254 / 0.45

TARGETS_M = (0.001, 0.002, 0.003, 0.006, 0.01)
COMPONENTS = (15, 20, 30, 40, 55, 65)
FEW_COMPONENTS = (10, 20, 30, 45)
LENGTHS = (140, 210, 280, 350, 420)
RIVAL_STEPS_M = (0.002, 0.006, 0.015, 0.035, 0.08)
DATABASE_FRAMES = 80_000
"""Frames of a database that are measured at most, whole files: each third file and so on where there are more."""


def run(data: Path = datasets.SHARED, output: Path | None = None) -> dict[str, Any]:
    """Measure on the CMU recordings below `data`; with `output`, write the JSON, the tables and the figures there."""
    recordings = Recordings(data)
    tell = _teller()
    results: dict[str, Any] = {
        "paper": "Hou, Chau, Magnenat-Thalmann & He 2014",
        "machine": runner.machine(),
        "missing": [n for n in (*ANALYSED, *SECTION_VI, *COMPARED) if recordings.path(n) is None],
        "analysis": [],
        "sequences": [],
    }
    for name in (*ANALYSED, *STAND_INS[:2]):
        motion = recordings.motion(name)
        if motion is not None:
            tell(f"analysis of {name}")
            results["analysis"].append({"sequence": name, **analysed(motion)})
    names = [n for n in (*COMPARED, *SECTION_VI, *STAND_INS) if recordings.path(n) is not None]
    for name in names:
        motion = recordings.motion(name)
        if motion is None:
            continue
        tell(f"curves of {name}")
        results["sequences"].append(
            {
                "sequence": name,
                "frames": len(motion),
                "points": motion.points,
                "rate": motion.rate,
                "content": datasets.content_hash(motion),
                "curves": curves(motion),
                "parts": parts(motion),
                "speed": speed(motion),
            }
        )
    closely = [n for n in ("86_02", "56_07", "86_05", "03_04", "01_01") if n in names][:2]
    results["closely"] = []
    for name in closely:
        motion = recordings.motion(name)
        if motion is not None:
            tell(f"settings on {name}")
            results["closely"].append({"sequence": name, **closely_measured(motion)})
    results["databases"] = [
        measured
        for name, subjects in DATABASES.items()
        if (measured := database(name, recordings, subjects, tell)) is not None
    ]
    results["claims"] = claims(results)
    if output is not None:
        write(results, output)
    return results


def write(results: dict[str, Any], output: Path) -> None:
    """The JSON, the tables and the figures."""
    output.mkdir(parents=True, exist_ok=True)
    (output / "hou2014.json").write_text(json.dumps(results, indent=1) + "\n")
    (output / "hou2014.md").write_text(markdown(results))
    draw(results, output)


class Recordings:
    """The recordings below a folder by CMU's names, such as 85_12; each read once."""

    def __init__(self, folder: Path) -> None:
        self.paths: dict[str, Path] = {}
        for suffix in ("*.c3d", "*.amc"):  # .amc last: joints are the paper's form
            for path in sorted(folder.rglob(suffix)):
                self.paths[path.stem] = path
        self._read: dict[str, Motion | None] = {}

    def path(self, name: str) -> Path | None:
        return self.paths.get(name)

    def of_subjects(self, subjects: Sequence[int]) -> list[str] | None:
        """Names of all joint files of these subjects; none where one subject has no file."""
        found = [[n for n, p in self.paths.items() if p.suffix == ".amc" and _subject(n) == s] for s in subjects]
        return [name for names in found for name in names] if all(found) else None

    def motion(self, name: str) -> Motion | None:
        """Gaps filled: the paper has none. None where the file cannot be read."""
        if name not in self._read:
            path = self.paths.get(name)
            motion = None
            if path is not None:
                try:
                    motion = formats.read(path)
                except MocodecError:
                    motion = None
            if isinstance(motion, Motion):
                filled, _ = gaps.fill(motion.positions)
                motion = Motion(filled, motion.rate, motion.names, motion.up, motion.skeleton)
            self._read[name] = motion if isinstance(motion, Motion) else None
        return self._read[name]


def _subject(name: str) -> int:
    head = name.split("_")[0]
    return int(head) if head.isdigit() else -1


# ------------------------------------------------------------------------------------------------------- measurements


def measured(codec: Hou2014, motion: Motion, **more: float) -> Point:
    """One run: ratio against float32 over payload bytes, mean and largest error in centimetres."""
    encoded = codec.encode(motion)
    decoded = codec.decode(encoded)
    error = metrics.distances(motion.positions, decoded.positions)
    return {
        **more,
        "ratio": motion.raw_bytes / encoded.payload_bytes,
        "bytes": encoded.payload_bytes,
        "mean_cm": 100 * float(error.mean()),
        "max_cm": 100 * float(error.max()),
    }


def curves(motion: Motion) -> dict[str, list[Point]]:
    """Ratio against distortion: figure 9's, and the rivals'."""
    found = {
        "ours, steered": [measured(Hou2014(mean_error=t), motion, target_m=t) for t in TARGETS_M],
        "ours, k as in the paper": [measured(Hou2014(components=k), motion, k=k) for k in COMPONENTS],
        "as published": [measured(Hou2014.as_published(components=k), motion, k=k) for k in COMPONENTS],
        "as published, steered": [
            measured(Hou2014.as_published(mean_error=t, clip_frames=280), motion, target_m=t) for t in TARGETS_M[::2]
        ],
        "hard bound": [measured(Hou2014(max_error=t), motion, target_m=t) for t in (0.003, 0.01)],
    }
    for rival in baselines.BASELINES:
        found[rival.name] = [rival_point(rival, motion, step) for step in RIVAL_STEPS_M]
    return found


def parts(motion: Motion) -> dict[str, list[Point]]:
    """What each part of our coding is worth: steered to two mean errors with all of them, and without each."""
    without: dict[str, dict[str, Any]] = {
        "all": {},
        "adaptive clips": {"segmentation": "adaptive"},
        "L = 280": {"clip_frames": 280},
        "rounding to nearest": {"economy": 0.0},
        "mean pose left in": {"centre": False},
        "basis of 16 bits an entry": {"compress_basis": False},
    }
    return {
        name: [measured(Hou2014(mean_error=t, **settings), motion, target_m=t) for t in (0.003, 0.01)]
        for name, settings in without.items()
    }


def rival_point(rival: baselines.Baseline, motion: Motion, step: float) -> Point:
    data = rival.encode(motion.positions, step)
    decoded = rival.decode(data, motion.positions.shape)
    return {
        "step_m": step,
        "ratio": motion.raw_bytes / len(data),
        "bytes": len(data),
        "mean_cm": 100 * metrics.mean_distance(motion.positions, decoded),
    }


def speed(motion: Motion) -> dict[str, float]:
    """Frames a second of processor time at the default settings, and as published; medians of three."""
    found: dict[str, float] = {}
    for name, codec in (("default", Hou2014()), ("as published", Hou2014.as_published())):
        encoded = codec.encode(motion)
        found[f"{name}, encode"] = len(motion) / _seconds(lambda c=codec: c.encode(motion))
        found[f"{name}, decode"] = len(motion) / _seconds(lambda e=encoded: Hou2014.decode(e))
    return found


def _seconds(work: Callable[[], Any]) -> float:
    times: list[float] = []
    for _ in range(3):
        started = time.process_time()
        work()
        times.append(max(time.process_time() - started, 1e-6))
    return statistics.median(times)


def closely_measured(motion: Motion) -> dict[str, Any]:
    """The impact of r (figure 7), Q (8), L (9), the rate (11) and adaptive clips (12), with the paper's coding."""
    half = Motion(motion.positions[::2], motion.rate / 2, motion.names, motion.up, motion.skeleton)
    published = Hou2014.as_published
    return {
        "r": {
            f"L = {length}, r = {r}": [
                measured(published(components=k, clip_frames=length, frequencies=max(1, round(r * k))), motion, k=k)
                for k in FEW_COMPONENTS
            ]
            for length in (100, 200, 300)
            for r in (0.2, 0.4, 0.6, 0.8)
        },
        "Q": {
            f"Q = {bits}": [measured(published(components=k, fraction_bits=bits), motion, k=k) for k in COMPONENTS]
            for bits in range(5)
        },
        "L": {
            f"L = {length}": [
                measured(published(components=k, clip_frames=length), motion, k=k) for k in FEW_COMPONENTS
            ]
            for length in LENGTHS
        },
        "60 Hz": {
            f"L = {length // 2}": [
                measured(published(components=k, clip_frames=length // 2), half, k=k) for k in FEW_COMPONENTS
            ]
            for length in LENGTHS
        },
        "adaptive": {
            f"{clips} clips": [
                measured(published(components=k, segmentation="adaptive", clips=clips), motion, k=k)
                for k in FEW_COMPONENTS
            ]
            for clips in (2, 4, 8, 16)
        },
        "steered at 120 and 60 Hz": {
            "120": [measured(Hou2014(mean_error=t), motion, target_m=t) for t in TARGETS_M[2::2]],
            "60": [measured(Hou2014(mean_error=t), half, target_m=t) for t in TARGETS_M[2::2]],
            "adaptive": [
                measured(Hou2014(mean_error=t, segmentation="adaptive"), motion, target_m=t) for t in TARGETS_M[2::2]
            ],
        },
    }


def analysed(motion: Motion) -> dict[str, Any]:
    """Section III: Table I in metres and in ASF units, and what figures 2 to 5 draw."""
    m = analysis.matrix(motion.positions)
    v, s = analysis.mean_variation(m), analysis.total_deviation(m)
    row, frame = int(m.std(axis=1).argmax()), m.shape[1] // 2
    kept = 60
    return {
        "frames": len(motion),
        "rows": len(m),
        "v_m": v,
        "sigma_m": s,
        "v_asf": v / ASF_UNIT_M,
        "sigma_asf": s / ASF_UNIT_M,
        "singular_values": analysis.singular_values(m)[:kept].tolist(),
        "of_clips": [analysis.singular_values(c)[:kept].tolist() for c in analysis.random_clips(m, 300, 3)],
        "of_unfolded": analysis.singular_values(analysis.unfold(m, 60))[:kept].tolist(),
        "column_spectrum": analysis.column_spectrum(m, frame).tolist(),
        "row_spectrum": analysis.row_spectrum(m[:, :300], row)[:93].tolist(),
        "coefficients_of_column": analysis.coefficients_for_energy(analysis.column_spectrum(m, frame)),
        "coefficients_of_row": analysis.coefficients_for_energy(analysis.row_spectrum(m[:, :300], row)),
    }


def database(
    name: str, recordings: Recordings, subjects: Sequence[int], tell: Callable[[str], None]
) -> dict[str, Any] | None:
    """Ratio against distortion for K transforms, each stored once. None where a subject is not there."""
    files = recordings.of_subjects(subjects)
    if files is None:
        return None
    every = max(1, math.ceil(sum(_frames_guess(recordings.paths[f]) for f in files) / DATABASE_FRAMES))
    tell(f"{name}: reading {len(files[::every])} of {len(files)} files")
    motions = [m for f in files[::every] if (m := recordings.motion(f)) is not None]
    frames, raw = sum(map(len, motions)), sum(m.raw_bytes for m in motions)
    rows: list[dict[str, Any]] = []
    for count in (1, 2, 3, 4):
        for k in (10, 20, 30):
            tell(f"{name}: K = {count}, k = {k}")
            started = time.perf_counter()
            learned = Hou2014Database(transforms=count, components=k, stored=k).fit(motions, _progress(tell))
            seconds = time.perf_counter() - started
            size = sum(len(blob) for blobs in learned.transforms.values() for blob in blobs)
            far = 0.0
            for motion in motions:
                encoded = learned.codec(motion, components=k).encode(motion)
                size += encoded.payload_bytes - sum(map(len, encoded.shared[1:]))
                far += metrics.mean_distance(motion.positions, Hou2014.decode(encoded).positions) * len(motion)
            annealing = max(learned.annealings.values(), key=lambda one: one.iterations)
            rows.append(
                {
                    "K": count, "k": k, "ratio": raw / size, "mean_cm": 100 * far / frames,
                    "iterations": annealing.iterations, "converged": annealing.converged, "fit_seconds": seconds,
                }
            )  # fmt: skip
    return {"database": name, "files": len(motions), "of_files": len(files), "frames": frames, "rows": rows}


def _frames_guess(path: Path) -> int:
    """Frames of an .amc by its size: about 1,400 bytes each."""
    return path.stat().st_size // 1400


# -------------------------------------------------------------------------------------------------------------- tables


def at(points: Sequence[Point], mean_cm: float) -> float | None:
    """The ratio at a mean error, between the two nearest points in logarithms; none outside the curve."""
    known = sorted((p["mean_cm"], p["ratio"]) for p in points)
    errors, ratios = np.log([e for e, _ in known]), np.log([r for _, r in known])
    if not errors[0] - 0.03 <= math.log(mean_cm) <= errors[-1] + 0.03:
        return None
    return float(np.exp(np.interp(math.log(mean_cm), errors, ratios)))


def error_at(points: Sequence[Point], ratio: float) -> float | None:
    """The mean error in centimetres at a ratio; none outside the curve."""
    known = sorted((p["ratio"], p["mean_cm"]) for p in points)
    ratios = np.log([r for r, _ in known])
    if not ratios[0] <= math.log(ratio) <= ratios[-1]:
        return None
    return float(np.exp(np.interp(math.log(ratio), ratios, np.log([e for _, e in known]))))


def claims(results: dict[str, Any]) -> list[dict[str, Any]]:
    """The paper's claims as they come out here."""
    found: list[dict[str, Any]] = []
    for one in results["sequences"]:
        if one["points"] <= 31 and one["rate"] > 100:
            for name in ("as published, steered", "as published", "ours, steered"):
                error = error_at(one["curves"][name], 100)
                least = min(one["curves"][name], key=lambda point: point["ratio"])
                finer = error is None and least["ratio"] > 100  # the curve begins beyond 100
                value = f"below {least['mean_cm']:.2f} cm" if finer else None if error is None else f"{error:.2f} cm"
                found.append(
                    {
                        "claim": "mean error below 1 cm at a ratio of 100 (joints, 120 Hz)",
                        "on": f"{one['sequence']}, {name}",
                        "value": value,
                        "holds": least["mean_cm"] < 1 if finer else None if error is None else error < 1,
                    }
                )
        for rival in ("clip-wise SVD", "2-D DCT", "2-D DWT"):
            gains = [
                ours / theirs
                for t in TARGETS_M
                if (ours := at(one["curves"]["ours, steered"], 100 * t))
                and (theirs := at(one["curves"][rival], 100 * t))
            ]
            if gains:
                found.append(
                    {
                        "claim": f"better than {rival} at every equal error",
                        "on": one["sequence"],
                        "value": f"{min(gains):.2f} to {max(gains):.2f} times",
                        "holds": min(gains) > 1,
                    }
                )
        compressed = at(one["curves"]["ours, steered"], 1.0)
        plain = at(one["curves"]["as published, steered"], 1.0)
        if compressed and plain:
            found.append(
                {
                    "claim": "compressed basis at least 1.25 times better at 1 cm",
                    "on": one["sequence"],
                    "value": f"{compressed / plain:.2f} times",
                    "holds": compressed / plain >= 1.25,
                }
            )
    for one in results["closely"]:
        equal = [p for points in one["L"].values() for p in points]
        best = max(one["adaptive"].values(), key=lambda points: max(p["ratio"] for p in points))
        high = max(p["ratio"] for p in best)
        near = [error_at(points, 0.9 * high) for points in one["L"].values()]
        near = [e for e in near if e is not None]
        mine = [e for points in one["adaptive"].values() if (e := error_at(points, 0.9 * high)) is not None]
        if near and mine and equal:
            found.append(
                {
                    "claim": f"adaptive clips better than equal ones at a high ratio ({0.9 * high:.0f})",
                    "on": one["sequence"],
                    "value": f"{min(mine):.2f} against {min(near):.2f} cm",
                    "holds": min(mine) < min(near),
                }
            )
        steered = one["steered at 120 and 60 Hz"]
        shares = [b["ratio"] / a["ratio"] for a, b in zip(steered["120"], steered["60"], strict=True)]
        found.append(
            {
                "claim": "about half the ratio at 60 Hz",
                "on": one["sequence"],
                "value": ", ".join(f"{s:.2f}" for s in shares),
                "holds": all(0.4 <= s <= 0.7 for s in shares),
            }
        )
    for one in results["databases"]:
        single = [r for r in one["rows"] if r["K"] == 1]
        gains: list[float] = []
        for row in one["rows"]:
            ratio = at(single, row["mean_cm"])
            if row["K"] > 1 and ratio:
                gains.append(row["ratio"] / ratio)
        if gains:
            found.append(
                {
                    "claim": "K > 1 better than K = 1 on a mixed database",
                    "on": f"{one['database']} ({one['files']} files)",
                    "value": f"up to {max(gains):.2f} times the ratio at equal error",
                    "holds": max(gains) > 1,
                }
            )
        slowest = max(one["rows"], key=lambda row: row["iterations"])
        found.append(
            {
                "claim": "annealing converges within 30 iterations at 1e-6",
                "on": one["database"],
                "value": f"{slowest['iterations']} iterations, {max(r['fit_seconds'] for r in one['rows']):.1f} s",
                "holds": slowest["converged"] and slowest["iterations"] <= 30,
            }
        )
    return found


def markdown(results: dict[str, Any]) -> str:
    """Tables I to IV and the claims, ours beside the published."""
    lines = [
        "# Hou et al. 2014: ours beside the published",
        "",
        "Made by `python -m mocodec.evaluation.papers.hou2014`; data and machine are in `hou2014.json`. Ratios are",
        "float32 positions over payload bytes, basis and all side information included; errors are means in cm.",
        "",
        f"Not among the data: {', '.join(results['missing']) or 'nothing'}; rows of these are left out.",
        "",
        "## Table I: v̄ and σ̄ in ASF units",
        "",
        "| sequence | v̄ | σ̄, the sum of the text | σ̄, a mean over rows | printed v̄ | printed σ̄ |",
        "|---|---|---|---|---|---|",
    ]
    for one in results["analysis"]:
        printed = TABLE_I.get(one["sequence"], ("", ""))
        lines.append(
            f"| {one['sequence']} | {one['v_asf']:.4f} | {one['sigma_asf']:.1f} | {one['sigma_asf'] / one['rows']:.3f} "
            f"| {printed[0]} | {printed[1]} |"
        )
    lines += [
        "",
        "## Ratio at a mean error (Tables II and IV)",
        "",
        "| sequence | frames | points | codec | 0.1 cm | 0.3 cm | 1.0 cm |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in results["sequences"]:
        for name, points in one["curves"].items():
            if name == "hard bound":
                continue
            cells = [f"{r:.1f}" if (r := at(points, e)) else "" for e in (0.1, 0.3, 1.0)]
            lines.append(f"| {one['sequence']} | {one['frames']} | {one['points']} | {name} | {' | '.join(cells)} |")
    lines += ["", "## What each part is worth: ratio at a mean error of 0.3 and 1.0 cm", ""]
    if results["sequences"]:
        names = list(results["sequences"][0]["parts"])
        lines += [f"| sequence | {' | '.join(names)} |", "|" + "---|" * (len(names) + 1)]
        for one in results["sequences"]:
            cells = ["; ".join(f"{p['ratio']:.1f}" for p in one["parts"][name]) for name in names]
            lines.append(f"| {one['sequence']} | {' | '.join(cells)} |")
    lines += ["", "## Table IV: at the published ratio, and under a hard bound", ""]
    lines += [
        "| sequence | published: ratio at cm | ours, steered, at that ratio | ratio at max 0.3 cm | at max 1.0 cm |"
    ]
    lines += ["|---|---|---|---|---|"]
    for one in results["sequences"]:
        hard = " | ".join(f"{p['ratio']:.1f}" for p in one["curves"]["hard bound"])
        rows = [("", "")]
        for ratio, error in TABLE_IV.get(one["sequence"], ()):
            ours = error_at(one["curves"]["ours, steered"], ratio)
            rows.append((f"{ratio} at {error}", "" if ours is None else f"{ours:.2f} cm"))
        lines += [f"| {one['sequence']} | {published} | {ours} | {hard} |" for published, ours in rows[len(rows) > 1 :]]
    lines += ["", "## Table III: frames a second of processor time", ""]
    lines += [
        "| sequence | encode | decode | encode, as published | decode, as published | printed encode | printed decode |"
    ]
    lines += ["|---|---|---|---|---|---|---|"]
    for one in results["sequences"]:
        rates = " | ".join(f"{v:,.0f}" for v in one["speed"].values())
        printed = " | ".join(f"{1e4 * v:,.0f}" for v in TABLE_III.get(one["sequence"], ())) or " | "
        lines.append(f"| {one['sequence']} | {rates} | {printed} |")
    lines += [
        "",
        "## Databases",
        "",
        "| database | files | frames | K | k | ratio | cm | iterations | seconds to fit |",
    ]
    lines += ["|---|---|---|---|---|---|---|---|---|"]
    for one in results["databases"]:
        for row in one["rows"]:
            lines.append(
                f"| {one['database']} | {one['files']} of {one['of_files']} | {one['frames']} | {row['K']} "
                f"| {row['k']} | {row['ratio']:.1f} | {row['mean_cm']:.2f} "
                f"| {row['iterations']} | {row['fit_seconds']:.1f} |"
            )
    lines += ["", "## The paper's claims", "", "| claim | on | here | holds |", "|---|---|---|---|"]
    words = {True: "yes", False: "no", None: "not measured"}
    lines += [f"| {c['claim']} | {c['on']} | {c['value'] or ''} | {words[c['holds']]} |" for c in results["claims"]]
    return "\n".join(lines) + "\n"


# ------------------------------------------------------------------------------------------------------------- figures


def draw(results: dict[str, Any], output: Path) -> None:
    """Every figure, from the results alone."""
    plt = pyplot()
    if results["analysis"]:
        draw_analysis(plt, results["analysis"], output)
    for number, key, title in (
        ("7", "r", "r = l / k"),
        ("8", "Q", "bits of the fractional part"),
        ("9", "L", "length of clips, 120 Hz"),
        ("11", "60 Hz", "length of clips, 60 Hz"),
        ("12", "adaptive", "number of adaptive clips"),
    ):
        draw_closely(plt, results["closely"], key, title, output / f"hou2014_figure{number}.png")
    draw_rivals(plt, results["sequences"], output / "hou2014_figure9_rivals.png")
    draw_databases(plt, results["databases"], output / "hou2014_databases.png")


def draw_analysis(plt: Any, analysed_: Sequence[dict[str, Any]], output: Path) -> None:
    """Figures 2 to 5."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.4), layout="constrained")
    for i, one in enumerate(analysed_):
        axes[0].plot(one["singular_values"], color=f"C{i}", label=one["sequence"])
        axes[2].plot(one["of_unfolded"], color=f"C{i}", label=one["sequence"])
    axes[1].plot(analysed_[0]["singular_values"], color="0.2", label=f"{analysed_[0]['sequence']}, whole")
    for clip in analysed_[0]["of_clips"]:
        axes[1].plot(clip, color="#00798c", lw=0.9)
    axes[1].plot([], color="#00798c", lw=0.9, label="clips of 300 frames")
    for one, title in zip(axes, ("sequences (2a)", "clips and the whole (2b)", "clips as rows (3a)"), strict=True):
        one.set(title=title, xlabel="index", ylabel="singular value over the largest", yscale="log", ylim=(1e-5, 1.2))
        one.legend(frameon=False, fontsize=8)
    save(plt, figure, axes, output / "hou2014_figures2_3.png")
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    axes[0].stem(np.abs(analysed_[0]["column_spectrum"]), markerfmt=" ", basefmt=" ")
    axes[1].stem(np.abs(analysed_[0]["row_spectrum"]), markerfmt=" ", basefmt=" ")
    for one, title in zip(axes, ("a column of M (figure 4)", "a row of M (figure 5)"), strict=True):
        one.set(title=f"DCT of {title}", xlabel="frequency", ylabel="size, m", yscale="log", ylim=(1e-4, None))
    save(plt, figure, axes, output / "hou2014_figures4_5.png")


def draw_closely(plt: Any, sequences: Sequence[dict[str, Any]], key: str, title: str, path: Path) -> None:
    """Curves by one setting, a panel for each sequence."""
    if not sequences:
        return
    figure, axes = plt.subplots(
        1, len(sequences), figsize=(5.2 * len(sequences), 3.8), squeeze=False, layout="constrained"
    )
    for panel, one in zip(axes[0], sequences, strict=True):
        groups = list(dict.fromkeys(label.split(",")[0] for label in one[key]))  # a colour each; r as the kind of line
        colours = plt.get_cmap("viridis")(np.linspace(0, 0.88, len(groups)))
        drawn = dict.fromkeys(groups, 0)
        for label, points in one[key].items():
            group = label.split(",")[0]
            line = (":", "-.", "--", "-")[drawn[group]] if "," in label else "-"
            draw_points(panel, points, label, color=colours[groups.index(group)], ls=line)
            drawn[group] += 1
        panel.set_title(f"{one['sequence']}: {title}", fontsize=10)
        finish(panel)
    save(plt, figure, axes[0], path)


def draw_rivals(plt: Any, sequences: Sequence[dict[str, Any]], path: Path) -> None:
    """Figure 9's axes with ours, ours as published, and the transforms of equations (1) and (2)."""
    if not sequences:
        return
    columns = min(3, len(sequences))
    rows = math.ceil(len(sequences) / columns)
    figure, axes = plt.subplots(rows, columns, figsize=(4.6 * columns, 3.6 * rows), squeeze=False, layout="constrained")
    styles = {
        "ours, steered": {"color": "#00798c", "lw": 2.2},
        "ours, k as in the paper": {"color": "#00798c", "ls": "--"},
        "as published": {"color": "#d1495b", "ls": "--"},
        "as published, steered": {"color": "#d1495b"},
    }
    for panel, one in zip(axes.flat, sequences, strict=False):
        for i, (label, points) in enumerate(one["curves"].items()):
            if label != "hard bound":
                style = styles.get(label, {"color": f"C{i}", "lw": 0.9})
                draw_points(panel, points, label, **style)
        for i, (ratio, error) in enumerate(TABLE_IV.get(one["sequence"], ())):
            panel.plot(ratio, error, "o", mfc="none", color="0.2", label="printed in Table IV" if i == 0 else None)
        panel.set_title(f"{one['sequence']}, {one['points']} points", fontsize=10)
        finish(panel, legend=False)
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False)
    for spare in axes.flat[len(sequences) :]:
        spare.axis("off")
    save(plt, figure, axes.flat[: len(sequences)], path)


def draw_databases(plt: Any, databases: Sequence[dict[str, Any]], path: Path) -> None:
    if not databases:
        return
    figure, axes = plt.subplots(
        1, len(databases), figsize=(5 * len(databases), 3.8), squeeze=False, layout="constrained"
    )
    for panel, one in zip(axes[0], databases, strict=True):
        for count in sorted({row["K"] for row in one["rows"]}):
            draw_points(panel, [row for row in one["rows"] if row["K"] == count], f"K = {count}")
        panel.set_title(f"{one['database']}: {one['files']} files, {one['frames']:,} frames", fontsize=10)
        finish(panel)
    save(plt, figure, axes[0], path)


def draw_points(panel: Any, points: Sequence[Point], label: str, **style: Any) -> None:
    known = sorted(points, key=lambda point: point["ratio"])
    panel.plot([p["ratio"] for p in known], [p["mean_cm"] for p in known], marker=".", label=label, **style)


def finish(panel: Any, legend: bool = True) -> None:
    from .. import report

    panel.set(xscale="log", yscale="log", xlabel="compression ratio", ylabel="mean error, cm")
    report.plain_logarithmic(panel)
    if legend:
        panel.legend(frameon=False, fontsize=7, loc="upper left")


def save(plt: Any, figure: Any, axes: Any, path: Path) -> None:
    for panel in axes:
        panel.grid(alpha=0.25)
        panel.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=120, metadata={"Software": None})
    plt.close(figure)


def _teller() -> Callable[[str], None]:
    """Says what is being done on a terminal's standard error, over one line; nothing otherwise."""
    if not sys.stderr.isatty():
        return lambda what: None
    return lambda what: print(f"\r\033[K{what}", end="", file=sys.stderr, flush=True)


def _progress(tell: Callable[[str], None]) -> Callable[[str, int, int], None]:
    def told(what: str, done: int, of: int) -> None:
        full = 24 * done // max(1, of)
        tell(f"{what} [{'━' * full}{' ' * (24 - full)}] {done}/{of}")

    return told


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=datasets.SHARED, help="a folder with CMU's AMC or C3D files")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/results"))
    arguments = parser.parse_args()
    results = run(arguments.data, arguments.output)
    print(markdown(results))


if __name__ == "__main__":
    main()
