"""How closely and how fast bodycast follows a body: eight motions, by points, noise, views and frames a second.

    python -m mocodec.evaluation.cloud.tracking [--data FOLDER] [--frames 60] [-o docs/results]

Writes bodycast_tracking.json: joint errors in centimetres, frames whose worst joint is off by more than 10 cm, the
longest run of them, frames a second of processor time from raw points to a pose, and after how many frames a limb that
was turned away is followed again. The time is that of the compiled kernels where they are built; NumPy's stands beside.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import formats, native
from ...codecs import bodycast
from ...geometry import articulation
from ...motion import Motion
from ...pointcloud import PointClouds
from .. import datasets, runner
from . import actors, sequences
from .sequences import Performance

STARTS = {
    "jumping jacks": 0.0, "01_01": 4.0, "02_05": 4.0, "03_03": 4.0, "49_20": 1.0, "118_30": 1.0, "131_04": 2.0,
    "salsa_09": 2.0,
}  # fmt: skip
"""Motions, and the second at which each begins."""
LOST_M = 0.10
RATE, LOOKED_AT = 15.0, 2500  # frames a second; points of a frame that the tracker looks at, at most


def perform(actor: actors.Actor, data: Path, name: str, frames: int, rate: float) -> Performance | None:
    """A motion on the actor; None where its recording is not there."""
    if name == "jumping jacks":
        return sequences.jumping_jacks(actor, frames, rate)
    for path in (data / "cmu/bvh" / f"{name}.bvh", data / "cmu/asfamc" / name.split("_")[0] / f"{name}.amc"):
        if path.exists():
            motion = formats.read(path)
            assert isinstance(motion, Motion)
            return sequences.perform(actor, motion, rate, STARTS[name], frames)
    return None


CONDITIONS: dict[str, dict[str, Any]] = {
    "10,000 points": {}, "2,500 points": {"keep": 0.25}, "2,500 points, 0.5 cm noise": {"keep": 0.25, "noise_m": 0.005},
    "10,000 points, 0.5 cm noise": {"noise_m": 0.005}, "10,000 points, 1 cm noise": {"noise_m": 0.01},
    "10,000 points, 2 cm noise": {"noise_m": 0.02}, "500 points": {"keep": 0.05}, "100 points": {"keep": 0.01},
    "3 views": {"views": 3}, "1 view": {"views": 1}, "no colours": {"coloured": False}, "30 frames/s": {"rate": 30.0},
    "7.5 frames/s": {"rate": 7.5},
}  # fmt: skip
"""Ways of recording; what is not said is 10,000 points without noise at 15 frames/s."""
MAIN, IN_ALL = tuple(CONDITIONS)[:3], ("01_01", "131_04")  # conditions of all motions, and motions in all conditions
POINTS = 10_000
TURNED = 1.8  # radians by which both long bones of a limb are turned away to see it found again


def measure(act: Performance, *, coloured: bool = True, frames: int | None = None, **how: Any) -> dict[str, Any]:
    """One motion, recorded, its first pose and skeleton given. how: as `sequences.record` takes it."""
    clouds = sequences.record(act, POINTS, seed=1, **how)[:frames]
    return measured(act, clouds if coloured else replace(clouds, colours=None))


def measured(act: Performance, clouds: PointClouds) -> dict[str, Any]:
    """One recording of a motion, its first pose and skeleton given."""
    colours = clouds.colours if clouds.colours is not None else [None] * len(clouds)
    body, tracker = bodycast.begin(clouds.positions[0], colours[0], act.skeleton()[:1], "y", LOOKED_AT)
    started = time.process_time()
    poses = [tracker.fit(clouds.positions[f], colours[f], f).pose for f in range(1, len(clouds))]
    seconds = time.process_time() - started
    error = np.array([joint_errors(act, body, pose, frame) for frame, pose in enumerate(poses, start=1)])
    lost = error.max(axis=1) > LOST_M
    runs = np.diff(np.flatnonzero(np.concatenate([[True], ~lost, [True]]))) - 1
    return {
        "mean_cm": round(float(error.mean()) * 100, 3), "max_cm": round(float(error.max()) * 100, 2),
        "lost_frames": int(lost.sum()), "longest_loss": int(runs.max()), "fps": round(len(poses) / seconds, 1),
    }  # fmt: skip


def recovery(act: Performance, at: tuple[int, ...] = (10, 25, 40), most: int = 20) -> list[int]:
    """How many frames it takes until no joint is off by more than 10 cm, after each limb in turn has been turned away
    at each of some frames; most + 1 where it takes longer.
    """
    clouds = sequences.record(act, POINTS, seed=1)
    assert clouds.colours is not None
    body, tracker = bodycast.begin(clouds.positions[0], clouds.colours[0], act.skeleton()[:1], "y", LOOKED_AT)
    taken, frame = list[int](), 0
    for start in at:
        while frame + 1 < min(start, len(clouds)):
            frame += 1
            tracker.fit(clouds.positions[frame], clouds.colours[frame], frame)
        kept, rng = (tracker.pose, tracker.previous_pose), np.random.default_rng(start)
        for limb in tracker.limbs:
            axes = rng.normal(size=(2, 3))
            turned = kept[0].rotations.copy()
            away = articulation.exp(TURNED * axes / np.linalg.norm(axes, axis=1, keepdims=True))
            turned[limb.links[:2]] = away @ turned[limb.links[:2]]
            tracker.pose = tracker.previous_pose = articulation.Pose(turned, kept[0].root)
            taken.append(most + 1)
            for f in range(start, min(start + most, len(clouds))):
                pose = tracker.fit(clouds.positions[f], clouds.colours[f], f).pose
                if joint_errors(act, body, pose, f).max() < LOST_M:
                    taken[-1] = f - start + 1
                    break
            tracker.pose, tracker.previous_pose = kept
    return taken


def joint_errors(act: Performance, body: articulation.Body, pose: articulation.Pose, frame: int) -> NDArray[np.float64]:
    """(links,): how far the joints of a pose are from the true ones, metres."""
    column = [act.actor.names.index(name) for name in body.names]
    joints = articulation.joint_positions(body, *articulation.transforms(body, pose))
    return np.linalg.norm(joints - act.joints[frame][column], axis=1)


def run(
    data: Path = datasets.SHARED, frames: int = 60, conditions: dict[str, dict[str, Any]] = CONDITIONS
) -> dict[str, Any]:
    """All motions in all conditions, losses on purpose, and the speed in NumPy alone."""
    actor = actors.find()
    results: dict[str, Any] = {
        "command": "python -m mocodec.evaluation.cloud.tracking", "machine": runner.machine(), "actor": actor.name,
        "frames": frames, "rate": RATE, "compiled": native.available(), "motions": {}, "recovery_frames": {},
    }  # fmt: skip
    for name in STARTS:
        act = perform(actor, data, name, frames, RATE)
        if act is None:
            continue
        found = dict[str, Any]()
        for condition, how in conditions.items():
            if condition not in MAIN and name not in IN_ALL:
                continue
            ways = dict(how)
            rate = ways.pop("rate", RATE)
            here = act if rate == RATE else perform(actor, data, name, frames, rate)
            assert here is not None
            found[condition] = measure(here, **ways)
        with native.without():
            found["2,500 points, NumPy alone"] = measure(act, keep=0.25, frames=16)
        results["motions"][name] = found
        results["recovery_frames"][name] = recovery(act)
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=datasets.SHARED, help="folder with cmu/asfamc and cmu/bvh")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/results"))
    chosen = parser.parse_args()
    results = run(chosen.data, chosen.frames)
    chosen.output.mkdir(parents=True, exist_ok=True)
    (chosen.output / "bodycast_tracking.json").write_text(json.dumps(results, indent=1) + "\n")
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
