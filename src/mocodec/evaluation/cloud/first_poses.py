"""How often and how well a first pose is found without a skeleton: people × poses × ways of recording.

    python -m mocodec.evaluation.cloud.first_poses [--quick] [--data FOLDER] [-o docs/results]

Every frame stands alone, turned at random and lying in its file with one of the axes up. The errors of 14 joints count
from where they truly are, to where a body whose proportions are not known puts them: some centimetres are the two
bodies' different joints. A frame is found where no joint is off by more than 12 cm. A body that is found back to front
has its limbs where they are and its sides exchanged: it counts as found, and is counted beside.
Writes first_poses.json and first_poses.md.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ... import formats
from ...errors import CannotEncode
from ...geometry import articulation, body_fit, pose_search
from ...motion import Floats, Motion
from .. import datasets, runner
from . import actors, sequences
from .actors import Actor
from .sequences import Performance, Rig

JOINTS = (
    "Hips", "Neck", "LeftArm", "LeftForeArm", "LeftHand", "RightArm", "RightForeArm", "RightHand", "LeftUpLeg",
    "LeftLeg", "LeftFoot", "RightUpLeg", "RightLeg", "RightFoot",
)  # fmt: skip
FOUND_M = 0.12
PEOPLE = (
    "makehuman-male", "makehuman-female", "makehuman-male-child", "makehuman-female-child", "makehuman-male-heavy",
    "makehuman-female-thin", "makehuman-female-old-heavy", "capsules",
)  # fmt: skip
LARGE = 1.12  # times a man's size
RECORDINGS: dict[str, dict[str, Any]] = {
    "clean": {}, "noise of 1 cm": {"noise_m": 0.01}, "5 % of the points": {"keep": 0.05}, "three views": {"views": 3},
    "one view": {"views": 1}, "ten depth cameras": {"rig": Rig()},
}  # fmt: skip
DOWN, OUT, FORTH, UP = np.array([0, -1.0, 0]), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), np.array([0, 1.0, 0])
# directions of the left upper arm, forearm, thigh and shin; the right ones mirrored, or given beside
Limbs = tuple[Floats, Floats, Floats, Floats]
STAND = (DOWN + 0.08 * OUT, DOWN + 0.06 * OUT)
POSES: dict[str, tuple[Limbs, Limbs | None]] = {
    "arms hanging": ((DOWN + 0.2 * OUT, DOWN + 0.15 * OUT + 0.2 * FORTH, *STAND), None),
    "A": ((DOWN + OUT, DOWN + OUT, *STAND), None),
    "T": ((OUT, OUT, *STAND), None),
    "arms raised": ((UP + 0.5 * OUT, UP + 0.1 * OUT, *STAND), None),
    "arms forward": ((FORTH + 0.1 * OUT, FORTH, *STAND), None),
    "one arm up": ((UP + 0.4 * OUT, UP, *STAND), (DOWN - 0.3 * OUT, DOWN - 0.2 * OUT + 0.3 * FORTH, *STAND)),
    "hands on hips": ((DOWN + 0.9 * OUT - 0.2 * FORTH, 0.45 * DOWN - 0.6 * OUT + 0.35 * FORTH, *STAND), None),
    "waving": ((OUT, UP + 0.2 * OUT, *STAND), (DOWN - 0.25 * OUT, DOWN - 0.15 * OUT, *STAND)),
    "walking": (
        (DOWN + 0.45 * FORTH + 0.15 * OUT, DOWN + 0.9 * FORTH, DOWN - 0.35 * FORTH, DOWN - 0.7 * FORTH),
        (DOWN - 0.4 * FORTH - 0.15 * OUT, DOWN - 0.1 * FORTH, DOWN + 0.5 * FORTH, DOWN + 0.2 * FORTH),
    ),
    "legs apart": ((OUT + 0.3 * UP, OUT + 0.5 * UP, DOWN + 0.5 * OUT, DOWN + 0.5 * OUT), None),
    "slight crouch": (
        (DOWN + 0.5 * FORTH + 0.2 * OUT, FORTH + 0.3 * DOWN, DOWN + 0.9 * FORTH + 0.15 * OUT, DOWN - 0.6 * FORTH),
        None,
    ),
    "arms folded": ((DOWN + 0.2 * OUT + 0.3 * FORTH, 0.1 * UP - OUT + 0.6 * FORTH, *STAND), None),
}
CLIPS = ("01_01", "02_05", "03_03", "16_02", "49_20", "118_30", "131_04", "salsa_09")


@dataclass
class Found:
    """One frame: joint errors in metres, whether sides are exchanged, seconds of processor time; or the problem."""

    person: str
    pose: str
    recording: str
    points: int
    mean_m: float = float("nan")
    max_m: float = float("nan")
    worst: str = ""
    backwards: bool = False
    seconds: float = 0.0
    problem: str = ""

    @property
    def found(self) -> bool:
        return self.max_m <= FOUND_M


def posed(actor: Actor, limbs: Limbs, right: Limbs | None = None) -> Performance:
    """One frame of an actor whose limbs point these ways, facing +z; the trunk is as it was."""
    turns = np.zeros((1, len(actor.names), 3, 3))
    mirror = np.array([-1.0, 1, 1])
    wanted = dict[str, Floats]()
    for side, ways in (("Left", limbs), ("Right", right or tuple(mirror * way for way in limbs))):
        for (joint, _), way in zip(CHAINS, ways, strict=True):
            wanted[side + joint] = way / np.linalg.norm(way)
    ends = dict(CHAINS)
    for joint, (name, parent) in enumerate(zip(actor.names, actor.parents, strict=True)):
        turns[0, joint] = turns[0, parent] if parent >= 0 else np.eye(3)
        if name in wanted:
            side = "Left" if name.startswith("Left") else "Right"
            end = actor.names.index(side + ends[name.removeprefix(side)])
            bone = actor.joints[end] - actor.joints[joint]
            turns[0, joint] = articulation.rotation_between(bone / np.linalg.norm(bone), wanted[name])
        elif name in ("LeftFoot", "RightFoot"):
            turns[0, joint] = np.eye(3)
    return Performance(actor, turns, actor.joints[:1].copy(), 15.0)


CHAINS = (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("UpLeg", "Leg"), ("Leg", "Foot"))


def standing(actor: Actor, data: Path, every: float = 3.0, most: int = 4) -> Iterator[tuple[str, Performance]]:
    """Frames of CMU's clips, every so many seconds, in which the actor stands: head above hips above feet."""
    for clip in CLIPS:
        for path in (data / "cmu/bvh" / f"{clip}.bvh", data / "cmu/asfamc" / clip.split("_")[0] / f"{clip}.amc"):
            if not path.exists():
                continue
            motion = formats.read(path)
            assert isinstance(motion, Motion)
            act = sequences.perform(actor, motion, 1 / every)
            height = act.joints[:, :, 1]
            head, hips, left, right = (actor.names.index(n) for n in ("Head", "Hips", "LeftFoot", "RightFoot"))
            feet = np.maximum(height[:, left], height[:, right])
            up = (height[:, head] > height[:, hips] + 0.4) & (height[:, hips] > feet + 0.45)
            for frame in np.flatnonzero(up)[:most]:
                yield f"{clip}, {frame * every:g} s", Performance(actor, act.turns[[frame]], act.root[[frame]], 15.0)


def look(act: Performance, person: str, pose: str, recording: str, seed: int) -> Found:
    """Record the frame, turned by chance, and find the pose in it."""
    rng = np.random.default_rng(seed)
    act = act.moved(rng.normal(0, 1, 3) * [1, 0, 1], float(rng.uniform(0, 2 * np.pi)))
    clouds = sequences.record(act, seed=seed, **RECORDINGS[recording])
    up = "yzx"[seed % 3]
    turn = body_fit.UPRIGHT[up]
    points = clouds.positions[0] @ turn  # y up ──► as in the file
    result = Found(person, pose, recording, len(points))
    started = time.process_time()
    try:
        figure = body_fit.first_pose(points, up)
    except CannotEncode as error:
        result.problem = str(error)
        return result
    result.seconds = time.process_time() - started
    true = dict(zip(act.actor.names, act.joints[0], strict=True))
    ours = dict(zip(figure.names, figure.positions @ turn.T, strict=True))
    errors = {name: float(np.linalg.norm(ours[name] - true[name])) for name in JOINTS}
    swapped = {name: float(np.linalg.norm(ours[name] - true[pose_search.mirrored_name(name)])) for name in JOINTS}
    result.backwards = sum(swapped.values()) < sum(errors.values())
    best = swapped if result.backwards else errors
    result.mean_m, result.max_m = float(np.mean(list(best.values()))), max(best.values())
    result.worst = max(best, key=lambda name: best[name])
    return result


def run(
    data: Path = datasets.SHARED, quick: bool = False, told: Callable[[Found], None] = lambda _: None
) -> list[Found]:
    """Every person in every pose, and frames of CMU's clips; the ways of recording take turns."""
    names = [name for name in PEOPLE if name == "capsules" or actors.available()]
    people = {name: actors.find(name) for name in (names[::3] if quick else names)}
    if not quick:
        people["large"] = actors.find(names[0]).scaled(LARGE)
    results = list[Found]()
    ways = list(RECORDINGS)
    for i, (person, actor) in enumerate(people.items()):
        for j, (pose, limbs) in enumerate(POSES.items()):
            recording = ways[(i + j) % len(ways)]
            results.append(look(posed(actor, *limbs), person, pose, recording, len(results)))
            told(results[-1])
    for frame, (pose, act) in enumerate(standing(next(iter(people.values())), data, most=1 if quick else 4)):
        results.append(look(act, next(iter(people)), pose, ways[frame % len(ways)], len(results)))
        told(results[-1])
    return results


def markdown(results: list[Found]) -> str:
    """Rates and errors by pose, person and way of recording."""
    lines = [
        "# A first pose without a skeleton", "",
        "Made by `python -m mocodec.evaluation.cloud.first_poses`. Frames that stand alone, turned by chance, each "
        f"with one of three axes up; 14 joints. Found: none of them off by more than {FOUND_M * 100:g} cm. The bodies' "
        "own joints differ by some centimetres, which are in every error. Back to front: limbs found, sides exchanged.",
    ]  # fmt: skip
    groups: dict[str, Callable[[Found], str]] = {
        "all": lambda _: "all", "pose": lambda f: f.pose if f.pose in POSES else "CMU: " + f.pose.split(",")[0],
        "person": lambda f: f.person, "recording": lambda f: f.recording,
    }  # fmt: skip
    for what, key in groups.items():
        lines += [
            "",
            f"| {what} | frames | found | back to front | mean cm | median of worst cm | worst cm | seconds |",
        ]
        lines += ["|---|---|---|---|---|---|---|---|"]
        for value in dict.fromkeys(map(key, results)):
            some = [f for f in results if key(f) == value]
            good = [f for f in some if not f.problem]
            if not good:
                lines.append(f"| {value} | {len(some)} | 0 | – | – | – | – | – |")
                continue
            worst = np.array([f.max_m for f in good]) * 100
            lines.append(
                f"| {value} | {len(some)} | {sum(f.found for f in some) / len(some):.0%} "
                f"| {sum(f.backwards for f in good)} | {np.mean([f.mean_m for f in good]) * 100:.1f} "
                f"| {np.median(worst):.1f} | {worst.max():.1f} | {np.mean([f.seconds for f in good]):.1f} |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=datasets.SHARED, help="folder with cmu/asfamc and cmu/bvh")
    parser.add_argument("--quick", action="store_true", help="three people")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/results"))
    chosen = parser.parse_args()

    def tell(found: Found) -> None:
        word = found.problem or f"{found.mean_m * 100:.1f} / {found.max_m * 100:.1f} cm {found.worst}"
        turned = " back to front" if found.backwards else ""
        print(f"{found.person}, {found.pose}, {found.recording}: {word}{turned}, {found.seconds:.1f} s", flush=True)

    results = run(chosen.data, chosen.quick, tell)
    chosen.output.mkdir(parents=True, exist_ok=True)
    content = {"machine": runner.machine(), "frames": [asdict(found) for found in results]}
    (chosen.output / "first_poses.json").write_text(json.dumps(content, indent=1) + "\n")
    (chosen.output / "first_poses.md").write_text(markdown(results))


if __name__ == "__main__":
    main()
