"""How closely and how fast bodycast follows a body: eight motions, by points a frame.

    python -m mocodec.evaluation.cloud.tracking [--data FOLDER] [--frames 60] [-o docs/results]

Writes bodycast_tracking.json: joint errors in centimetres, frames whose worst joint is off by more than 10 cm, the
longest run of them, and frames a second of processor time from raw points to a pose.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from ... import formats
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


def measure(act: Performance, points: int, noise_m: float = 0.0) -> dict[str, Any]:
    """One motion, recorded, its first pose and skeleton given."""
    return measured(act, sequences.record(act, points, noise_m=noise_m, seed=1))


def measured(act: Performance, clouds: PointClouds) -> dict[str, Any]:
    """One recording of a motion, its first pose and skeleton given."""
    assert clouds.colours is not None
    first = act.skeleton()[:1]
    body, tracker = bodycast.begin(clouds.positions[0], clouds.colours[0], first, "y", 1000)
    started = time.process_time()
    poses = [tracker.fit(clouds.positions[f], clouds.colours[f], f).pose for f in range(1, len(clouds))]
    seconds = time.process_time() - started
    column = [act.actor.names.index(name) for name in body.names]
    error = np.array(
        [
            np.linalg.norm(articulation.joints_of(body, *articulation.transforms(body, pose)) - true[column], axis=1)
            for pose, true in zip(poses, act.joints[1:], strict=True)
        ]
    )
    lost = error.max(axis=1) > LOST_M
    runs = np.diff(np.flatnonzero(np.concatenate([[True], ~lost, [True]]))) - 1
    return {
        "mean_cm": round(float(error.mean()) * 100, 3), "max_cm": round(float(error.max()) * 100, 2),
        "lost_frames": int(lost.sum()), "longest_loss": int(runs.max()), "fps": round(len(poses) / seconds, 1),
    }  # fmt: skip


def run(data: Path = datasets.SHARED, frames: int = 60, rate: float = 15.0) -> dict[str, Any]:
    """All motions at 10,000 and 2,500 points, and at 2,500 with half a centimetre of noise."""
    actor = actors.find()
    results: dict[str, Any] = {
        "command": "python -m mocodec.evaluation.cloud.tracking", "machine": runner.machine(), "actor": actor.name,
        "frames": frames, "rate": rate, "motions": {},
    }  # fmt: skip
    for name in STARTS:
        act = perform(actor, data, name, frames, rate)
        if act is not None:
            results["motions"][name] = {
                "10,000 points": measure(act, 10_000), "2,500 points": measure(act, 2500),
                "2,500 points, 0.5 cm noise": measure(act, 2500, 0.005),
            }  # fmt: skip
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
