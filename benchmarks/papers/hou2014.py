"""Measurements of Hou et al. (2014), our results beside the printed ones: `scripts/bench hou2014`.

    recordings ──► analysis (figures 2 to 5), settings (7, 8, 11, 12), curves with rivals (9), speed, databases
               ──► hou2014.json ──► hou2014.md (Tables I to IV, claims), hou2014_figure*.png

It uses the sequences of the paper if the data folder has them under CMU's names (`subjects/SS/SS_TT.amc`); otherwise
other CMU recordings replace them.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from mocodec import formats, metrics
from mocodec.codecs import baselines
from mocodec.codecs.hou2014 import Hou2014, analysis
from mocodec.codecs.hou2014.database import Hou2014Database
from mocodec.errors import MocodecError
from mocodec.motion import Motion
from mocodec.stages import gaps

from .. import datasets
from ..machine import machine_description
from ..results import read_json, write_json
from .hou2014_claims import claims
from .hou2014_figures import draw
from .hou2014_tables import TARGETS_M, CurvePoint, markdown

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
"""Subjects of the databases of Table II, and of two databases that replace them if their files are missing."""

ASF_UNIT_M = 0.0254 / 0.45

COMPONENTS = (15, 20, 30, 40, 55, 65)
FEW_COMPONENTS = (10, 20, 30, 45)
LENGTHS = (140, 210, 280, 350, 420)
RIVAL_STEPS_M = (0.002, 0.006, 0.015, 0.035, 0.08)
DATABASE_FRAMES = 80_000
"""Most frames of a database; larger databases use only every second, third … file."""


def run(data: Path = datasets.SHARED, output: Path | None = None) -> dict[str, Any]:
    """Measure on the CMU recordings in `data`; with `output`, write JSON, tables and figures there."""
    recordings = Recordings(data)
    report = _reporter()
    results: dict[str, Any] = {
        "paper": "Hou, Chau, Magnenat-Thalmann & He 2014",
        "machine": machine_description(),
        "missing": [n for n in (*ANALYSED, *SECTION_VI, *COMPARED) if recordings.path(n) is None],
        "analysis": [],
        "sequences": [],
    }
    for name in (*ANALYSED, *STAND_INS[:2]):
        motion = recordings.motion(name)
        if motion is not None:
            report(f"analysis of {name}")
            results["analysis"].append({"sequence": name, **analyse(motion)})
    names = [n for n in (*COMPARED, *SECTION_VI, *STAND_INS) if recordings.path(n) is not None]
    for name in names:
        motion = recordings.motion(name)
        if motion is None:
            continue
        report(f"curves of {name}")
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
            report(f"settings on {name}")
            results["closely"].append({"sequence": name, **settings_measured(motion)})
    results["databases"] = [
        measured
        for name, subjects in DATABASES.items()
        if (measured := database(name, recordings, subjects, report)) is not None
    ]
    results["claims"] = claims(results)
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        write_json(output / "hou2014.json", results)
        write_tables(output)
        draw(results, output)
    return results


def write_tables(folder: Path) -> Path:
    """Write hou2014.md from hou2014.json; return its path."""
    formats.replace_whole(folder / "hou2014.md", markdown(read_json(folder / "hou2014.json")).encode())
    return folder / "hou2014.md"


class Recordings:
    """The recordings in a folder, by CMU's names such as 85_12. Each is read once."""

    def __init__(self, folder: Path) -> None:
        self.paths: dict[str, Path] = {}
        for suffix in ("*.c3d", "*.amc"):  # .amc last, so that it replaces .c3d: the paper codes joints
            for path in sorted(folder.rglob(suffix)):
                self.paths[path.stem] = path
        self._read: dict[str, Motion | None] = {}

    def path(self, name: str) -> Path | None:
        """The file of a recording, or None."""
        return self.paths.get(name)

    def of_subjects(self, subjects: Sequence[int]) -> list[str] | None:
        """Names of all joint files of these subjects; None if a subject has no file."""
        found = [[n for n, p in self.paths.items() if p.suffix == ".amc" and _subject(n) == s] for s in subjects]
        return [name for names in found for name in names] if all(found) else None

    def motion(self, name: str) -> Motion | None:
        """The motion with filled gaps (the paper has none); None if the file is missing or unreadable."""
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


def encode_and_measure(codec: Hou2014, motion: Motion, **more: float) -> CurvePoint:
    """One run: ratio of float32 positions to payload bytes, mean and largest error in centimetres."""
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


def curves(motion: Motion) -> dict[str, list[CurvePoint]]:
    """Curves of ratio and error (figure 9), by coder: ours and the rivals."""
    found = {
        "ours, steered": [encode_and_measure(Hou2014(mean_error=t), motion, target_m=t) for t in TARGETS_M],
        "ours, k as in the paper": [encode_and_measure(Hou2014(components=k), motion, k=k) for k in COMPONENTS],
        "as published": [encode_and_measure(Hou2014.as_published(components=k), motion, k=k) for k in COMPONENTS],
        "as published, steered": [
            encode_and_measure(Hou2014.as_published(mean_error=t, clip_frames=280), motion, target_m=t)
            for t in TARGETS_M[::2]
        ],
        "hard bound": [encode_and_measure(Hou2014(max_error=t), motion, target_m=t) for t in (0.003, 0.01)],
    }
    for rival in baselines.BASELINES:
        found[rival.name] = [rival_point(rival, motion, step) for step in RIVAL_STEPS_M]
    return found


def parts(motion: Motion) -> dict[str, list[CurvePoint]]:
    """Ablation: runs at two mean errors with the whole codec, and without each of its parts."""
    without: dict[str, dict[str, Any]] = {
        "all": {},
        "adaptive clips": {"segmentation": "adaptive"},
        "L = 280": {"clip_frames": 280},
        "rounding to nearest": {"economy": 0.0},
        "mean pose left in": {"centre": False},
        "basis of 16 bits an entry": {"compress_basis": False},
    }
    return {
        name: [encode_and_measure(Hou2014(mean_error=t, **settings), motion, target_m=t) for t in (0.003, 0.01)]
        for name, settings in without.items()
    }


def rival_point(rival: baselines.Baseline, motion: Motion, step: float) -> CurvePoint:
    """One run of a rival at a quantisation step in metres."""
    data = rival.encode(motion.positions, step)
    decoded = rival.decode(data, motion.positions.shape)
    return {
        "step_m": step,
        "ratio": motion.raw_bytes / len(data),
        "bytes": len(data),
        "mean_cm": 100 * metrics.mean_distance(motion.positions, decoded),
    }


def speed(motion: Motion) -> dict[str, float]:
    """Frames per second of processor time, at the default settings and as published; medians of three runs."""
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


def settings_measured(motion: Motion) -> dict[str, Any]:
    """Effect of r (figure 7), Q (8), L (9), frame rate (11) and adaptive clips (12) on the codec as published."""
    half = Motion(motion.positions[::2], motion.rate / 2, motion.names, motion.up, motion.skeleton)
    published = Hou2014.as_published
    return {
        "r": {
            f"L = {length}, r = {r}": [
                encode_and_measure(
                    published(components=k, clip_frames=length, frequencies=max(1, round(r * k))), motion, k=k
                )
                for k in FEW_COMPONENTS
            ]
            for length in (100, 200, 300)
            for r in (0.2, 0.4, 0.6, 0.8)
        },
        "Q": {
            f"Q = {bits}": [
                encode_and_measure(published(components=k, fraction_bits=bits), motion, k=k) for k in COMPONENTS
            ]
            for bits in range(5)
        },
        "L": {
            f"L = {length}": [
                encode_and_measure(published(components=k, clip_frames=length), motion, k=k) for k in FEW_COMPONENTS
            ]
            for length in LENGTHS
        },
        "60 Hz": {
            f"L = {length // 2}": [
                encode_and_measure(published(components=k, clip_frames=length // 2), half, k=k) for k in FEW_COMPONENTS
            ]
            for length in LENGTHS
        },
        "adaptive": {
            f"{clips} clips": [
                encode_and_measure(published(components=k, segmentation="adaptive", clips=clips), motion, k=k)
                for k in FEW_COMPONENTS
            ]
            for clips in (2, 4, 8, 16)
        },
        "steered at 120 and 60 Hz": {
            "120": [encode_and_measure(Hou2014(mean_error=t), motion, target_m=t) for t in TARGETS_M[2::2]],
            "60": [encode_and_measure(Hou2014(mean_error=t), half, target_m=t) for t in TARGETS_M[2::2]],
            "adaptive": [
                encode_and_measure(Hou2014(mean_error=t, segmentation="adaptive"), motion, target_m=t)
                for t in TARGETS_M[2::2]
            ],
        },
    }


def analyse(motion: Motion) -> dict[str, Any]:
    """Section III: values of Table I, in metres and in ASF units, and data of figures 2 to 5."""
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
    name: str, recordings: Recordings, subjects: Sequence[int], report: Callable[[str], None]
) -> dict[str, Any] | None:
    """Ratios and errors of a database with K transforms, each stored once. None if a subject's files are missing."""
    files = recordings.of_subjects(subjects)
    if files is None:
        return None
    every = max(1, math.ceil(sum(_frames_guess(recordings.paths[f]) for f in files) / DATABASE_FRAMES))
    report(f"{name}: reading {len(files[::every])} of {len(files)} files")
    motions = [m for f in files[::every] if (m := recordings.motion(f)) is not None]
    frames, raw = sum(map(len, motions)), sum(m.raw_bytes for m in motions)
    rows: list[dict[str, Any]] = []
    for count in (1, 2, 3, 4):
        for k in (10, 20, 30):
            report(f"{name}: K = {count}, k = {k}")
            started = time.perf_counter()
            learned = Hou2014Database(transforms=count, components=k, stored=k).fit(motions, _progress(report))
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
    """Frames of an .amc file, estimated from its size: about 1,400 bytes each."""
    return path.stat().st_size // 1400


def _reporter() -> Callable[[str], None]:
    """A function that shows the current step on one line of a terminal, and does nothing without a terminal."""
    if not sys.stderr.isatty():
        return lambda step: None
    return lambda step: print(f"\r\033[K{step}", end="", file=sys.stderr, flush=True)


def _progress(report: Callable[[str], None]) -> Callable[[str, int, int], None]:
    """The progress callback of Hou2014Database.fit, as a bar."""

    def show(step: str, done: int, total: int) -> None:
        filled = 24 * done // max(1, total)
        report(f"{step} [{'━' * filled}{' ' * (24 - filled)}] {done}/{total}")

    return show


@click.command("hou2014")
@click.option("-o", "--output", default="docs/results", show_default=True, type=click.Path(path_type=Path))
@click.option("--data", default=datasets.SHARED, show_default=True, type=click.Path(path_type=Path), help="Recordings.")
def command(output: Path, data: Path) -> None:
    """Tables and figures of Hou et al. (2014), our results beside the printed ones.

    Writes hou2014.json, hou2014.md and hou2014_*.png.
    """
    run(data, output)
    click.echo(output / "hou2014.md")
