"""Success rate and errors of first poses without a skeleton: people × poses × kinds of recording.

Each frame is independent: the actor faces a random direction and one of three axes is up. Errors are distances of 14
joints from the true ones. The fitted body has other proportions, so some centimetres of every error are differences
between the two bodies' joints. A pose counts as found if no joint is off by more than 12 cm. A body found back to front
has its limbs in place with left and right exchanged; it counts as found and is also listed.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocodec import formats
from mocodec.errors import CannotEncode
from mocodec.geometry import body_fit, pose_search
from mocodec.testing import sequences
from mocodec.testing.actors import Actor
from mocodec.testing.poses import JOINTS, POSES, posed
from mocodec.testing.sequences import Performance, Rig

from .. import datasets
from .. import markdown as md
from ..machine import machine_description
from ..results import read_json, write_json
from . import makehuman, retarget

FOUND_M = 0.12
PEOPLE = (
    "makehuman-male", "makehuman-female", "makehuman-male-child", "makehuman-female-child", "makehuman-male-heavy",
    "makehuman-female-thin", "makehuman-female-old-heavy", "capsules",
)  # fmt: skip
LARGE = 1.12
"""Scale of the largest person, relative to the average man."""
RECORDINGS: dict[str, dict[str, Any]] = {
    "clean": {}, "noise of 1 cm": {"noise_m": 0.01}, "5 % of the points": {"keep": 0.05}, "three views": {"views": 3},
    "one view": {"views": 1}, "ten depth cameras": {"rig": Rig()},
}  # fmt: skip
CLIPS = ("01_01", "02_05", "03_03", "16_02", "49_20", "118_30", "131_04", "salsa_09")


@dataclass
class FirstPose:
    """The result of one frame: joint errors in metres and the worst joint, whether left and right are exchanged,
    seconds of processor time; or the reason for no pose.
    """

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
        """Whether no joint is off by more than FOUND_M."""
        return self.max_m <= FOUND_M


def standing(actor: Actor, data: Path, every: float = 3.0, most: int = 4) -> Iterator[tuple[str, Performance]]:
    """Yields label and performance of frames of CMU's clips in which the actor stands (head above hips above feet): one
    every `every` seconds, at most `most` in a clip.
    """
    for clip in CLIPS:
        act = retarget.perform_clip(actor, data, clip, 1 / every)
        if act is None:
            continue
        height = act.joints[:, :, 1]
        head, hips, left, right = (actor.names.index(n) for n in ("Head", "Hips", "LeftFoot", "RightFoot"))
        feet = np.maximum(height[:, left], height[:, right])
        up = (height[:, head] > height[:, hips] + 0.4) & (height[:, hips] > feet + 0.45)
        for frame in np.flatnonzero(up)[:most]:
            yield f"{clip}, {frame * every:g} s", Performance(actor, act.turns[[frame]], act.root[[frame]], 15.0)


def label_seed(person: str, pose: str, seed: int) -> int:
    """A seed for each frame, so that other frames stay the same if poses or people are added."""
    return zlib.crc32(f"{person}, {pose}, {seed}".encode())


def find_pose(act: Performance, person: str, pose: str, recording: str, seed: int) -> FirstPose:
    """Record a one-frame performance, turned and moved at random, and find its pose."""
    seed = label_seed(person, pose, seed)
    rng = np.random.default_rng(seed)
    act = act.moved(rng.normal(0, 1, 3) * [1, 0, 1], float(rng.uniform(0, 2 * np.pi)))
    clouds = sequences.record(act, seed=seed, **RECORDINGS[recording])
    up = "yzx"[seed % 3]
    turn = body_fit.UPRIGHT[up]
    points = clouds.positions[0] @ turn  # turns the up axis from y to this axis
    result = FirstPose(person, pose, recording, len(points))
    started = time.process_time()
    try:
        figure = body_fit.first_pose(points, up)
    except CannotEncode as error:
        result.problem = str(error)
        return result
    result.seconds = time.process_time() - started
    true = dict(zip(act.actor.names, act.joints[0], strict=True))
    fitted = dict(zip(figure.names, figure.positions @ turn.T, strict=True))
    errors = {name: float(np.linalg.norm(fitted[name] - true[name])) for name in JOINTS}
    swapped = {name: float(np.linalg.norm(fitted[name] - true[pose_search.mirrored_name(name)])) for name in JOINTS}
    result.backwards = sum(swapped.values()) < sum(errors.values())
    best = swapped if result.backwards else errors
    result.mean_m, result.max_m = float(np.mean(list(best.values()))), max(best.values())
    result.worst = max(best, key=lambda name: best[name])
    return result


def frames(data: Path, quick: bool) -> Iterator[tuple[Performance, str, str, str]]:
    """Yields performance, person, pose and recording of every frame: every person in every pose, and frames of CMU's
    clips; the kinds of recording alternate.
    """
    names = [name for name in PEOPLE if name == "capsules" or makehuman.available()]
    people = {name: makehuman.find(name) for name in (names[::3] if quick else names)}
    if not quick:
        people["large"] = makehuman.find(names[0]).scaled(LARGE)
    recordings = list(RECORDINGS)
    for i, (person, actor) in enumerate(people.items()):
        for j, (pose, limbs) in enumerate(POSES.items()):
            yield posed(actor, *limbs), person, pose, recordings[(i + j) % len(recordings)]
    first, actor = next(iter(people.items()))
    for frame, (pose, act) in enumerate(standing(actor, data, most=1 if quick else 4)):
        yield act, first, pose, recordings[frame % len(recordings)]


def run(
    data: Path = datasets.SHARED,
    quick: bool = False,
    seed: int = 0,
    jobs: int = 1,
    report: Callable[[FirstPose], None] = lambda _: None,
) -> list[FirstPose]:
    """Results of all frames, measured in `jobs` processes.

    quick: only every third person. seed: for the directions, places and noise of all frames.
    """
    results = list[FirstPose]()
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for result in pool.map(find_pose, *zip(*frames(data, quick), strict=True), repeat(seed)):
            results.append(result)
            report(result)
    return results


def markdown(results: Sequence[FirstPose]) -> str:
    """A page with success rates and errors of all frames, and by pose, person and kind of recording."""
    parts = [
        "# A first pose without a skeleton",
        "Made by `scripts/bench first-poses`. Single frames in random directions, each with one of three axes up; 14 "
        f"joints. Found: no joint is off by more than {FOUND_M * 100:g} cm. The joints of actor and fitted body differ "
        "by some centimetres, which are in every error. Back to front: the limbs are found with left and right "
        "exchanged.",
    ]
    groups: dict[str, Callable[[FirstPose], str]] = {
        "all": lambda _: "all", "pose": lambda f: f.pose if f.pose in POSES else "CMU: " + f.pose.split(",")[0],
        "person": lambda f: f.person, "recording": lambda f: f.recording,
    }  # fmt: skip
    columns = ["frames", "found", "back to front", "mean cm", "median of worst cm", "worst cm", "seconds"]
    for name, key in groups.items():
        by_value = {value: [f for f in results if key(f) == value] for value in dict.fromkeys(map(key, results))}
        parts.append(md.table([name, *columns], [[value, *cells(group)] for value, group in by_value.items()]))
    return "\n\n".join(parts) + "\n"


def cells(results: Sequence[FirstPose]) -> list[str]:
    """Table cells: frames, share found, back to front, mean error, median and maximum of worst joints, mean seconds."""
    good = [f for f in results if not f.problem]
    if not good:
        return [str(len(results)), "0", "–", "–", "–", "–", "–"]
    worst = np.array([f.max_m for f in good]) * 100
    return [
        str(len(results)), f"{sum(f.found for f in results) / len(results):.0%}", str(sum(f.backwards for f in good)),
        f"{np.mean([f.mean_m for f in good]) * 100:.1f}", f"{np.median(worst):.1f}", f"{worst.max():.1f}",
        f"{np.mean([f.seconds for f in good]):.1f}",
    ]  # fmt: skip


def write_tables(folder: Path) -> Path:
    """Write first_poses.md from first_poses.json; return its path."""
    results = [FirstPose(**frame) for frame in read_json(folder / "first_poses.json")["frames"]]
    formats.replace_whole(folder / "first_poses.md", markdown(results).encode())
    return folder / "first_poses.md"


@click.command("first-poses")
@click.option("-o", "--output", default="docs/results", show_default=True, type=click.Path(path_type=Path))
@click.option("--data", default=datasets.SHARED, show_default=True, type=click.Path(path_type=Path), help="Recordings.")
@click.option("--quick", is_flag=True, help="Every third person.")
@click.option("--seed", default=0, show_default=True, help="Seed of the directions, places and noise.")
@click.option("--jobs", default=1, show_default=True, help="Processes.")
def command(output: Path, data: Path, quick: bool, seed: int, jobs: int) -> None:
    """Find first poses without a skeleton, of people of many builds in many poses.

    Writes first_poses.json and first_poses.md.
    """

    def report(result: FirstPose) -> None:
        errors = result.problem or f"{result.mean_m * 100:.1f} / {result.max_m * 100:.1f} cm {result.worst}"
        turned = " back to front" if result.backwards else ""
        click.echo(f"{result.person}, {result.pose}, {result.recording}: {errors}{turned}, {result.seconds:.1f} s")

    results = run(data, quick, seed, jobs, report)
    output.mkdir(parents=True, exist_ok=True)
    content = {"machine": machine_description(), "seed": seed, "frames": [asdict(result) for result in results]}
    write_json(output / "first_poses.json", content)
    click.echo(write_tables(output))
