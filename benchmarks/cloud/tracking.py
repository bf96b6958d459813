"""Tracking errors and speed of bodycast: eight motions, by points, noise, views and frames a second.

A result has joint errors in centimetres, the number of lost frames (worst joint off by more than 10 cm) and their
longest run, and frames per second of processor time from raw points to a pose. A second measurement turns a limb away
and counts the frames until it is tracked again. Times use the compiled kernels if they are built; the speed of NumPy
alone is also measured.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocodec import native
from mocodec.codecs import bodycast
from mocodec.geometry import articulation
from mocodec.pointcloud import PointClouds
from mocodec.testing import sequences
from mocodec.testing.actors import Actor
from mocodec.testing.sequences import Performance

from .. import datasets, markdown
from ..machine import machine_description
from ..results import write_json
from . import makehuman, retarget

STARTS = {
    "jumping jacks": 0.0, "01_01": 4.0, "02_05": 4.0, "03_03": 4.0, "49_20": 1.0, "118_30": 1.0, "131_04": 2.0,
    "salsa_09": 2.0,
}  # fmt: skip
"""Motions, and the start of each, seconds."""
LOST_M = 0.10
"""A frame is lost if a joint is off by more than this."""
RATE = 15.0
TRACKED_POINTS = 2500
"""Largest number of points of a frame that the tracker uses."""


def perform(actor: Actor, data: Path, name: str, frames: int, rate: float) -> Performance | None:
    """A motion of STARTS on the actor; None if its recording does not exist."""
    if name == "jumping jacks":
        return sequences.jumping_jacks(actor, frames, rate)
    return retarget.perform_clip(actor, data, name, rate, STARTS[name], frames)


CONDITIONS: dict[str, dict[str, Any]] = {
    "10,000 points": {}, "2,500 points": {"keep": 0.25}, "2,500 points, 0.5 cm noise": {"keep": 0.25, "noise_m": 0.005},
    "10,000 points, 0.5 cm noise": {"noise_m": 0.005}, "10,000 points, 1 cm noise": {"noise_m": 0.01},
    "10,000 points, 2 cm noise": {"noise_m": 0.02}, "500 points": {"keep": 0.05}, "100 points": {"keep": 0.01},
    "3 views": {"views": 3}, "1 view": {"views": 1}, "no colours": {"coloured": False}, "30 frames/s": {"rate": 30.0},
    "7.5 frames/s": {"rate": 7.5},
}  # fmt: skip
"""Kinds of recording, as differences from 10,000 points without noise at 15 frames/s."""
FOR_ALL_MOTIONS = tuple(CONDITIONS)[:3]
"""Conditions measured on all motions."""
FAST = ("02_04", "02_05", "02_06", "02_07", "02_10", "49_18", "49_20", "131_03", "131_04", "16_02", "118_14")
"""Jumps, punches, a sword, acrobatics and dance; `run_fast` samples them at FAST_RATE."""
FAST_RATE, FAST_KEEP = 7.5, 0.25
FAULT_MOTIONS = ("jumping jacks", "131_04")
"""Motions measured with faults of cameras."""
IN_ALL_CONDITIONS = ("01_01", "131_04")
"""Motions measured under all conditions."""
POINTS = 10_000
FOUR = sequences.Rig(cameras=4)
FAULTS: dict[str, dict[str, Any]] = {
    "whole surface, no faults": {}, "ten cameras": {"rig": sequences.Rig()}, "four cameras": {"rig": FOUR},
    "four, flying pixels 8 %": {"rig": replace(FOUR, flying=0.08)},
    "four, exposure of half a frame": {"rig": replace(FOUR, blur=0.5)},
    "four, no depth at the head": {"rig": replace(FOUR, dark=("Head",))},
    "four, no depth at a forearm": {"rig": replace(FOUR, dark=("LeftForeArm",))},
    "four, from one side": {"rig": replace(FOUR, span=180.0)},
}  # fmt: skip
"""Faults of real cameras, as options of `sequences.record`."""
TURN_AWAY_RAD = 1.8
"""Rotation of both long bones of a limb before its recovery is measured."""


def record_and_track(
    act: Performance, *, coloured: bool = True, frames: int | None = None, **condition: Any
) -> dict[str, Any]:
    """Record a motion with these options of `sequences.record` and track it."""
    clouds = sequences.record(act, POINTS, seed=1, **condition)[:frames]
    return track(act, clouds if coloured else replace(clouds, colours=None))


def track(act: Performance, clouds: PointClouds) -> dict[str, Any]:
    """Errors and speed of the tracker on a recording of this motion, with the true first pose and skeleton."""
    colours = clouds.colours if clouds.colours is not None else [None] * len(clouds)
    body, tracker = bodycast.start_tracking(clouds.positions[0], colours[0], act.skeleton()[:1], "y", TRACKED_POINTS)
    started = time.process_time()
    poses = [tracker.fit(clouds.positions[f], colours[f], f).pose for f in range(1, len(clouds))]
    seconds = time.process_time() - started
    error = np.array([act.joint_errors(body, pose, frame) for frame, pose in enumerate(poses, start=1)])
    lost = error.max(axis=1) > LOST_M
    runs = np.diff(np.flatnonzero(np.concatenate([[True], ~lost, [True]]))) - 1
    return {
        "mean_cm": round(float(error.mean()) * 100, 3), "max_cm": round(float(error.max()) * 100, 2),
        "lost_frames": int(lost.sum()), "longest_loss": int(runs.max()), "fps": round(len(poses) / seconds, 1),
    }  # fmt: skip


def recovery(act: Performance, at: tuple[int, ...] = (10, 25, 40), most: int = 20) -> list[int]:
    """Frames until no joint is off by more than 10 cm, after a limb was turned away; most + 1 if it takes longer.

    One value for each start frame of `at` and each limb.
    """
    clouds = sequences.record(act, POINTS, seed=1)
    assert clouds.colours is not None
    body, tracker = bodycast.start_tracking(
        clouds.positions[0], clouds.colours[0], act.skeleton()[:1], "y", TRACKED_POINTS
    )
    recovery_frames, frame = list[int](), 0
    for start in at:
        while frame + 1 < min(start, len(clouds)):
            frame += 1
            tracker.fit(clouds.positions[frame], clouds.colours[frame], frame)
        true, rng = (tracker.pose, tracker.previous_pose), np.random.default_rng(start)
        for limb in tracker.limbs:
            axes = rng.normal(size=(2, 3))
            turned = true[0].rotations.copy()
            away = articulation.exp(TURN_AWAY_RAD * axes / np.linalg.norm(axes, axis=1, keepdims=True))
            turned[limb.links[:2]] = away @ turned[limb.links[:2]]
            tracker.pose = tracker.previous_pose = articulation.Pose(turned, true[0].root)
            recovery_frames.append(most + 1)
            for f in range(start, min(start + most, len(clouds))):
                pose = tracker.fit(clouds.positions[f], clouds.colours[f], f).pose
                if act.joint_errors(body, pose, f).max() < LOST_M:
                    recovery_frames[-1] = f - start + 1
                    break
            tracker.pose, tracker.previous_pose = true
    return recovery_frames


def run(
    data: Path = datasets.SHARED, frames: int = 60, conditions: dict[str, dict[str, Any]] = CONDITIONS
) -> dict[str, Any]:
    """Errors and speed of all motions, recovery of limbs, and the speed of NumPy alone."""
    actor = makehuman.find()
    results: dict[str, Any] = {
        "command": "scripts/bench tracking", "machine": machine_description(), "actor": actor.name,
        "frames": frames, "rate": RATE, "compiled": native.available(), "motions": {}, "recovery_frames": {},
    }  # fmt: skip
    for name in STARTS:
        act = perform(actor, data, name, frames, RATE)
        if act is None:
            continue
        by_condition = dict[str, Any]()
        for condition, options in conditions.items():
            if condition not in FOR_ALL_MOTIONS and name not in IN_ALL_CONDITIONS:
                continue
            recording = dict(options)
            rate = recording.pop("rate", RATE)
            resampled = act if rate == RATE else perform(actor, data, name, frames, rate)
            assert resampled is not None
            by_condition[condition] = record_and_track(resampled, **recording)
        with native.without():
            by_condition["2,500 points, NumPy alone"] = record_and_track(act, keep=0.25, frames=16)
        results["motions"][name] = by_condition
        results["recovery_frames"][name] = recovery(act)
    return results


def run_fast(data: Path = datasets.SHARED, frames: int = 200) -> dict[str, Any]:
    """Errors of the tracker on fast motion at FAST_RATE, for two recordings of every clip."""
    actor = makehuman.find()
    results: dict[str, Any] = {
        "command": "scripts/bench tracking --fast", "machine": machine_description(), "actor": actor.name,
        "rate": FAST_RATE, "points": round(POINTS * FAST_KEEP), "motions": {},
    }  # fmt: skip
    for name in FAST:
        act = retarget.perform_clip(actor, data, name, FAST_RATE, STARTS.get(name, 0.0), frames)
        if act is None:
            continue
        results["motions"][name] = [
            {"noise_m": noise, "seed": seed, "frames": len(act) - 1}
            | track(act, sequences.record(act, POINTS, keep=FAST_KEEP, noise_m=noise, seed=seed))
            for noise in (0.0, 0.005)
            for seed in (1, 2)
        ]
    return results


def fast_page(results: dict[str, Any]) -> str:
    """The table of `run_fast`."""
    head = ["clip", "frames", "lost", "longest run", "lost, 0.5 cm noise", "longest run"]
    rows, total = list[list[str]](), [0] * 5
    for name, runs in results["motions"].items():
        clean, noisy = ([run for run in runs if (run["noise_m"] > 0) == is_noisy] for is_noisy in (False, True))
        counts = [sum(run["frames"] for run in clean)]
        for part in (clean, noisy):
            counts += [sum(run["lost_frames"] for run in part), max(run["longest_loss"] for run in part)]
        rows.append([name, *map(str, counts)])
        total = [(max if i in (2, 4) else int.__add__)(total[i], counts[i]) for i in range(5)]
    rows.append(["all", *map(str, total)])
    note = (
        f"*Fast motion at {results['rate']:g} frames/s, {results['points']:,} points a frame, true first pose "
        f"({results['actor']}), two recordings of each clip. Lost: a joint is off by more than {LOST_M * 100:g} cm. "
        f"Made by `{results['command']}`.*"
    )
    return f"{note}\n\n{markdown.table(head, rows)}\n"


def run_faults(
    data: Path = datasets.SHARED, frames: int = 60, names: tuple[str, ...] = FAULT_MOTIONS
) -> dict[str, Any]:
    """Errors of the tracker on recordings with the faults of real cameras."""
    actor = makehuman.find()
    results: dict[str, Any] = {
        "command": f"scripts/bench tracking --faults --frames {frames}", "machine": machine_description(),
        "actor": actor.name, "frames": frames, "rate": RATE, "motions": {},
    }  # fmt: skip
    for name in names:
        act = perform(actor, data, name, frames, RATE)
        if act is not None:
            results["motions"][name] = {fault: record_and_track(act, **options) for fault, options in FAULTS.items()}
    return results


def faults_page(results: dict[str, Any]) -> str:
    """The table of `run_faults`."""
    head = ["recording", *(f"{name}: mean / max cm, frames lost" for name in results["motions"])]
    rows = [
        [fault, *(f"{m['mean_cm']:.2f} / {m['max_cm']:.1f}, {m['lost_frames']}" for m in measured)]
        for fault in FAULTS
        if (measured := [motion[fault] for motion in results["motions"].values()])
    ]
    note = (
        f"*Joint errors of bodycast's tracker, true first pose, {results['frames']} frames at {results['rate']:g} "
        f"frames/s, up to {POINTS:,} points a frame ({results['actor']}). Lost: a joint is off by more than "
        f"{LOST_M * 100:g} cm. Made by `{results['command']}`.*"
    )
    return f"{note}\n\n{markdown.table(head, rows)}\n"


@click.command("tracking")
@click.option("-o", "--output", default="docs/results", show_default=True, type=click.Path(path_type=Path))
@click.option("--data", default=datasets.SHARED, show_default=True, type=click.Path(path_type=Path), help="Recordings.")
@click.option("--frames", default=60, show_default=True, type=click.IntRange(2), help="Frames of every clip.")
@click.option("--faults", is_flag=True, help="Measure faults of real cameras instead.")
@click.option("--fast", is_flag=True, help="Measure fast motion at 7.5 frames/s instead.")
def command(output: Path, data: Path, frames: int, faults: bool, fast: bool) -> None:
    """Track a body through eight motions by points, noise, views and frame rate; recover lost limbs.

    Writes bodycast_tracking.json; with --faults or --fast bodycast_faults.json or bodycast_fast.json,
    and a table beside it.
    """
    output.mkdir(parents=True, exist_ok=True)
    if faults or fast:
        name, results = ("faults", run_faults(data, frames)) if faults else ("fast", run_fast(data))
        write_json(output / f"bodycast_{name}.json", results)
        table = faults_page(results) if faults else fast_page(results)
        (output / f"bodycast_{name}.md").write_text(table)
        click.echo(output / f"bodycast_{name}.md")
        return
    write_json(output / "bodycast_tracking.json", run(data, frames))
    click.echo(output / "bodycast_tracking.json")
