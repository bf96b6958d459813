"""Hard bounds from the cameras' noise upwards: `scripts/bench bounds` → docs/results/bounds.json.

    marker files ──► tempo and SZ3 at the same largest distance ──► payload bytes ─┐
    joints       ──► tempo with all engines, and with the transform alone ─────────┴─► tables of docs/tempo/results.md
    some of both ──► frames encoded per second of processor time ──────────────────┘

Bytes are payloads (shared bytes and chunks), without names and container. SZ3 bounds each coordinate, so its setting is
searched until the largest distance in space equals the bound; its gap mask counts. Every bound is measured after
decoding. Joints use the prior of the package, whose training data contain some of these people.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocodec.codecs.tempo import Tempo
from mocodec.motion import Motion
from mocodec.testing.synthetic import markers
from mocodec.typing import Floats

from . import datasets, results
from .machine import machine_description
from .motion import rivals, runner
from .tempo import geometric, table, write_page

RESULTS = Path("docs/results/bounds.json")
BOUNDS_M = (0.00005, 0.0001, 0.0002, 0.0005, 0.001, 0.003)
FOLDERS = ("cmu/c3d", "field-c3d", "field-trc")
FEWEST_POINTS, FEWEST_FRAMES = 4, 50
JOINTS = (
    "cmu/asfamc/01/01_06.amc", "cmu/asfamc/02/02_05.amc", "cmu/asfamc/03/03_04.amc", "cmu/asfamc/16/16_03.amc",
    "cmu/asfamc/49/49_18.amc", "cmu/asfamc/64/64_03.amc", "cmu/asfamc/118/118_20.amc", "cmu/asfamc/131/131_04.amc",
)  # fmt: skip
JOINT_BOUNDS_M = (0.0001, 0.0005)
SPEED_FILES = ("cmu/c3d/85_12.c3d", "cmu/c3d/85_02.c3d", "field-c3d/Vicon.c3d", "field-c3d/Movement_trial.c3d")
SPEED_BOUNDS_M = (0.0001, 0.001, 0.005, 0.01)
SPEED_RUNS, LONGEST_RUNS_S = 2, 5.0
"""Runs of each measurement, and the time after which no other run starts."""
MANY_POINTS, MANY_FRAMES, NOISE_M = 500, 600, 0.0002


def bare(motion: Motion) -> Motion:
    """The motion without extras and rotations."""
    return replace(motion, extras={}, rotations=None)


def many_points() -> Motion:
    """600 frames of 500 points about the markers of a walking figure, with noise."""
    walk = markers(frames=MANY_FRAMES, seed=1)
    rng = np.random.default_rng(1)
    near = [walk.positions + rng.normal(0, 0.02, (1, walk.points, 3)) for _ in range(-(-MANY_POINTS // walk.points))]
    positions = np.concatenate(near, axis=1)[:, :MANY_POINTS]
    names = tuple(f"point {i}" for i in range(MANY_POINTS))
    return Motion(positions + rng.normal(0, NOISE_M, positions.shape), walk.rate, names, up=walk.up)


def marker_files(root: Path) -> Iterator[tuple[str, Motion]]:
    """Recordings of markers with enough points and frames, by name. Prints skipped ones with the reason."""
    for path in sorted(p for folder in FOLDERS for p in (root / folder).iterdir()):
        motion, problem = datasets.loaded(datasets.labelled(path, root))
        if motion is None or problem:
            click.echo(f"{path.name}: left out: {problem}")
        elif motion.points < FEWEST_POINTS or len(motion) < FEWEST_FRAMES:
            click.echo(f"{path.name}: left out: {len(motion)} frames of {motion.points} points")
        else:
            yield path.name, bare(motion)


def largest_distance(original: Floats, decoded: Floats) -> float:
    """The largest distance of a sample, metres. Raises ValueError if gaps differ."""
    squares = np.zeros(original.shape[:2])
    for axis in range(3):
        squares += (original[..., axis] - decoded[..., axis]) ** 2
    if (np.isnan(squares) != np.isnan(original).any(axis=2)).any():
        raise ValueError("gaps differ")
    return float(np.sqrt(np.nanmax(squares)))


def coded(codec: Tempo, motion: Motion, bound: float) -> dict[str, float]:
    """Payload bytes and the largest error. Raises ValueError if the bound is not kept."""
    encoded = codec.encode(motion)
    error = largest_distance(motion.positions, Tempo.decode(encoded).positions)
    if not error <= bound:
        raise ValueError(f"an error of {error} m under a bound of {bound} m")
    return {"bytes": encoded.payload_bytes, "error_m": error}


def of_markers(name: str, motion: Motion) -> Iterator[dict[str, Any]]:
    """Yields a record of tempo and SZ3 for each bound."""
    sz3 = rivals.Sz3()
    for bound in BOUNDS_M:
        ours = coded(Tempo(max_error=bound), motion, bound)
        theirs = runner.search(
            lambda knob: runner.run_rival(sz3, motion, knob), motion, "max_error", bound, sz3.knob_of(bound / 3)
        )
        if theirs is None or not (error := largest_distance(motion.positions, theirs.positions)) <= bound:
            raise ValueError(f"{name}: no setting of SZ3 keeps {bound} m")
        yield {
            "file": name, "frames": len(motion), "points": motion.points, "raw_bytes": motion.raw_bytes,
            "max_error_m": bound, "tempo": ours, "sz3": {"bytes": theirs.data_bytes, "error_m": error},
        }  # fmt: skip


def of_joints(name: str, motion: Motion) -> Iterator[dict[str, Any]]:
    """Yields a record of all engines and of the transform alone for each bound."""
    for bound in JOINT_BOUNDS_M:
        yield {
            "file": name, "frames": len(motion), "points": motion.points, "raw_bytes": motion.raw_bytes,
            "max_error_m": bound, "tempo": coded(Tempo(max_error=bound), motion, bound),
            "transform": coded(Tempo(max_error=bound, model="transform"), motion, bound),
        }  # fmt: skip


def speeds(root: Path) -> list[dict[str, Any]]:
    """Frames encoded per second of processor time: the fastest of some runs, after a warm-up."""
    recordings = {Path(name).name: bare(datasets.labelled(root / name, root).load()) for name in SPEED_FILES}
    recordings["500 points"] = many_points()
    records: list[dict[str, Any]] = []
    for name, motion in recordings.items():
        for bound in SPEED_BOUNDS_M:
            taken, size = list[float](), 0
            while len(taken) < SPEED_RUNS + (not records) and sum(taken) < LONGEST_RUNS_S:
                started = time.process_time()
                size = Tempo(max_error=bound).encode(motion).payload_bytes
                taken.append(time.process_time() - started)
            records.append({
                "file": name, "frames": len(motion), "points": motion.points, "max_error_m": bound,
                "bytes": size, "encode_fps": len(motion) / min(taken),
            })  # fmt: skip
            click.echo(f"{name} {1000 * bound:g} mm: {records[-1]['encode_fps']:,.0f} frames/s")
    return records


def tables(stored: Mapping[str, Any]) -> str:
    """Three tables: markers against SZ3, joints against the transform alone, speed."""
    lines = ["Ratio of the payload of markers under a hard maximum, and in brackets how many times SZ3's:", ""]
    lines += table(["file", *(f"{1000 * b:g} mm" for b in BOUNDS_M)], marker_rows(stored["markers"]))
    lines += [
        "Ratio of the payload of joints under a hard maximum, and in brackets how many times the transform's:",
        "",
    ]
    head = ["file", *(f"{1000 * b:g} mm" for b in JOINT_BOUNDS_M)]
    lines += table(head, compared_rows(stored["joints"], JOINT_BOUNDS_M, "transform"))
    of_speed: Mapping[str, Any] = stored["speeds"]
    lines += ["Frames encoded per second of processor time (one thread, compiled):", ""]
    head = ["file", "frames × points", *(f"{1000 * b:g} mm" for b in SPEED_BOUNDS_M)]
    rows = [
        [f"{file}, {label}" if len(of_speed) > 1 else file, *cells]
        for label, records in of_speed.items()
        for file, *cells in speed_rows(records)
    ]
    return "\n".join(lines + table(head, sorted(rows, key=lambda row: row[0])))


def marker_rows(records: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """A row for each file, then the geometric mean and the least."""
    rows = compared_rows(records, BOUNDS_M, "sz3")
    times = [[r["sz3"]["bytes"] / r["tempo"]["bytes"] for r in records if r["max_error_m"] == b] for b in BOUNDS_M]
    rows.append(["geometric mean", *(f"**{geometric(t):.2f}**" for t in times)])
    return [*rows, ["least", *(f"{min(t):.2f}" for t in times)]]


def compared_rows(records: Sequence[Mapping[str, Any]], bounds: Sequence[float], rival: str) -> list[list[str]]:
    """Rows of files: the ratio at each bound, and in brackets the factor over the rival's."""
    rows: list[list[str]] = []
    for file in dict.fromkeys(r["file"] for r in records):
        at = {r["max_error_m"]: r for r in records if r["file"] == file}
        cells = [
            (at[b]["raw_bytes"] / at[b]["tempo"]["bytes"], at[b][rival]["bytes"] / at[b]["tempo"]["bytes"])
            for b in bounds
        ]
        rows.append([file, *(f"{ratio:.1f} ({times:.2f})" for ratio, times in cells)])
    return rows


def speed_rows(records: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Rows of files: the size, and the speed at each bound."""
    rows: list[list[str]] = []
    for file in dict.fromkeys(r["file"] for r in records):
        of_file = {r["max_error_m"]: r for r in records if r["file"] == file}
        first = next(iter(of_file.values()))
        cells = (f"{of_file[b]['encode_fps']:,.0f}" for b in SPEED_BOUNDS_M)
        rows.append([file, f"{first['frames']:,} × {first['points']}", *cells])
    return rows


@click.command("bounds")
@click.option("--data", type=click.Path(path_type=Path), default=datasets.SHARED, help="Folder of the recordings.")
@click.option("--only", default="", help="Only files whose name contains this; print instead of storing.")
@click.option("--speed", default="", metavar="LABEL", help="Only speed; store it under this label.")
@click.option("--draw", is_flag=True, help="Only draw the tables again.")
def command(data: Path, only: str, speed: str, draw: bool) -> None:
    """Measure tempo and SZ3 under fine hard maxima; write docs/results/bounds.json and docs/tempo/results.md."""
    stored = results.read_json(RESULTS) or {"markers": [], "joints": [], "speeds": {}}
    if speed:
        stored["speeds"][speed] = results.rounded(speeds(data))
    elif not draw:
        found: dict[str, list[dict[str, Any]]] = {"markers": [], "joints": []}
        for name, motion in marker_files(data):
            if only in name:
                found["markers"] += of_markers(name, motion)
                click.echo("\n".join(" | ".join(row) for row in compared_rows(found["markers"], BOUNDS_M, "sz3")[-1:]))
        for path in JOINTS:
            if only in path:
                found["joints"] += of_joints(Path(path).name, bare(datasets.labelled(data / path, data).load()))
                rows = compared_rows(found["joints"], JOINT_BOUNDS_M, "transform")
                click.echo(" | ".join(rows[-1]))
        if only:
            return
        stored |= results.rounded(found)
    stored["machine"] = machine_description()
    results.write_json(RESULTS, stored)
    if stored["markers"]:
        write_page(tables(stored), "bounds")
