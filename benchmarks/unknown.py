"""Points outside tempo's prior, mostly in short clips: `scripts/bench unknown`.

    original recordings: marker sets, other skeletons ─────────────────┐
    joints of people ─► markers on their bones, repeated samples, gaps, ├─► tempo and SZ3 at equal errors ─► docs/tempo
                        other names, rates and proportions ─────────────┘

Cases from joints of a person in the prior's training data use a prior trained without that person. Noise and offsets
have fixed seeds.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import click
import numpy as np

from mocodec import formats
from mocodec.geometry import kinematics, rigid
from mocodec.motion import Motion
from mocodec.typing import Floats

from . import datasets, folds
from .machine import machine_description
from .motion import rivals, runner
from .tempo import BOUNDS, MEANS, Measurement, geometric, measurement, pick, table, write_page

RESULTS = Path("docs/results/tempo_unknown.json")


@dataclass(frozen=True)
class Case:
    """A row of the table: its label, a function that makes the motion, and the person to leave out of the prior."""

    label: str
    make: Callable[[Path], Motion]
    person: str | None = None


def amc(trial: str, start_s: float = 0.0, seconds: float = 10.0) -> Callable[[Path], Motion]:
    """A function that reads some seconds of a trial: joints with rotations."""

    def make(data: Path) -> Motion:
        motion = formats.read(data / "cmu" / "asfamc" / trial.split("_")[0] / f"{trial}.amc")
        assert isinstance(motion, Motion)
        first = round(start_s * motion.rate)
        return motion[first : first + round(seconds * motion.rate)]

    return make


def recorded(path: str, start_s: float = 0.0, seconds: float = 10.0) -> Callable[[Path], Motion]:
    """A function that reads some seconds of a recording, unchanged."""

    def make(data: Path) -> Motion:
        motion = formats.read(data / path)
        assert isinstance(motion, Motion)
        first = round(start_s * motion.rate)
        return motion[first : first + round(seconds * motion.rate)]

    return make


BONES = {
    "root": 5, "lfemur": 3, "rfemur": 3, "ltibia": 3, "rtibia": 3, "lfoot": 3, "rfoot": 3, "thorax": 5, "head": 4,
    "lhumerus": 3, "rhumerus": 3, "lradius": 3, "rradius": 3, "lhand": 2, "rhand": 2, "lclavicle": 1, "rclavicle": 1,
    "upperback": 1,
}  # fmt: skip
"""Number of markers on each bone, of fifty."""


def markers(joints: Motion, count: int, noise_m: float, seed: int, slide_m: float = 0.003) -> Motion:
    """`count` markers on the bones of a skeleton (own_frame), y up, with noise and slow sliding on the skin."""
    random = np.random.default_rng(seed)
    assert joints.skeleton is not None
    assert joints.rotations is not None
    turns = kinematics.world_rotations(joints.skeleton, joints.rotations)
    bones = [name for name, n in BONES.items() for _ in range(n)]
    chosen = [bones[i % len(bones)] for i in random.permutation(max(count, len(bones)))[:count]]
    seconds = np.arange(len(joints)) / joints.rate
    placed = np.empty((len(joints), count, 3))
    for i, bone in enumerate(chosen):
        j = joints.names.index(bone)
        along = joints.skeleton.offsets[j] * random.uniform(-1, 0)
        offset = along + 0.07 * _direction(random)
        waves = random.normal(size=(3, 3)) @ np.sin(np.outer((0.7, 1.7, 3.1), seconds) + random.uniform(0, 6, (3, 1)))
        placed[:, i] = joints.positions[:, j] + rigid.rotate(turns[:, j], offset + slide_m / 2 * waves.T)
    placed += noise_m * random.normal(size=placed.shape)
    names = tuple(f"M{i + 1:03d}" for i in range(count))
    return Motion(placed, joints.rate, names, joints.up)


def _direction(random: np.random.Generator) -> Floats:
    d = random.normal(size=3)
    return np.asarray(d / np.linalg.norm(d))


def bare(motion: Motion, names: Sequence[str] = ()) -> Motion:
    """Only the positions, with these names or without names."""
    return Motion(motion.positions, motion.rate, tuple(names), motion.up)


def hold_samples(motion: Motion, frames: int) -> Motion:
    """Each sample repeated for `frames` frames, like a slow camera in a fast file."""
    return replace(motion, positions=motion.positions[np.arange(len(motion)) // frames * frames])


def slower(motion: Motion, rate: float) -> Motion:
    """Every n-th frame, to about this rate."""
    every = round(motion.rate / rate)
    return Motion(motion.positions[::every], motion.rate / every, motion.names, motion.up)


def with_gaps(motion: Motion, share: float, seed: int) -> Motion:
    """Removes about this share of the samples, in runs of 0.05 to 1.5 seconds."""
    random = np.random.default_rng(seed)
    positions = motion.positions.copy()
    while np.isnan(positions[..., 0]).mean() < share:
        length = round(motion.rate * 0.05 * 30 ** random.random())
        first = int(random.integers(-length + 1, len(motion)))
        positions[max(first, 0) : first + length, random.integers(motion.points)] = np.nan
    return replace(motion, positions=positions)


SMPL = {
    "pelvis": "root", "left_hip": "lhipjoint", "right_hip": "rhipjoint", "spine1": "lowerback", "left_knee": "lfemur",
    "right_knee": "rfemur", "spine2": "upperback", "left_ankle": "ltibia", "right_ankle": "rtibia", "spine3": "thorax",
    "left_foot": "lfoot", "right_foot": "rfoot", "neck": "lowerneck", "left_collar": "lclavicle",
    "right_collar": "rclavicle", "head": "head", "left_shoulder": "lclavicle", "right_shoulder": "rclavicle",
    "left_elbow": "lhumerus", "right_elbow": "rhumerus", "left_wrist": "lradius", "right_wrist": "rradius",
}  # fmt: skip
"""Joints of SMPL, and the CMU joints that replace them."""


def smpl(joints: Motion, named: bool, seed: int) -> Motion:
    """22 joints at 30 Hz, with other proportions than the recording."""
    other = with_other_proportions(joints, seed)
    columns = [joints.names.index(j) for j in SMPL.values()]
    positions = other.positions[:, columns].copy()
    positions[:, [13, 14]] = 0.5 * (positions[:, [13, 14]] + other.positions[:, [joints.names.index("thorax")]])
    return slower(Motion(positions, joints.rate, tuple(SMPL) if named else (), joints.up), 30.0)


def with_other_proportions(joints: Motion, seed: int) -> Motion:
    """The motion's rotations on bones up to a fifth longer or shorter, left and right equal."""
    random = np.random.default_rng(seed)
    assert joints.skeleton is not None
    assert joints.rotations is not None
    of_part = {name.lstrip("lr"): random.uniform(0.82, 1.2) for name in joints.names}
    offsets = joints.skeleton.offsets * np.array([[of_part[n.lstrip("lr")]] for n in joints.names])
    skeleton = replace(joints.skeleton, offsets=offsets)
    root = joints.positions[:, 0] - joints.skeleton.offsets[0]
    positions = kinematics.forward(skeleton, joints.rotations, root * 1.05, own_frame=True)
    return replace(joints, positions=positions, skeleton=skeleton)


def without_names(joints: Motion) -> Motion:
    """Joints without names and with other proportions."""
    return bare(with_other_proportions(joints, 3))


CLIPS = (
    ("118_05", 0.0, 5.0), ("64_03", 0.5, 4.0), ("16_03", 0.0, 3.0), ("02_05", 2.0, 8.0), ("10_01", 0.0, 2.0),
    ("131_04", 1.0, 8.0), ("49_18", 1.0, 10.0),
)  # fmt: skip


def cases() -> list[Case]:
    """All rows of the table."""

    def made(label: str, clip: int, change: Callable[[Motion], Motion]) -> Case:
        trial, start, seconds = CLIPS[clip]
        take = amc(trial, start, seconds)
        return Case(f"{label}, {seconds:g} s of {trial}", lambda data: change(take(data)), trial.split("_")[0])

    found = [
        made("41 markers, 0.2 mm of noise", 0, lambda m: markers(m, 41, 2e-4, 1)),
        made("41 markers, 0.3 mm", 2, lambda m: markers(m, 41, 3e-4, 2)),
        made("53 markers, 0.3 mm", 5, lambda m: markers(m, 53, 3e-4, 3)),
        made("60 markers, 0.5 mm", 1, lambda m: markers(m, 60, 5e-4, 4)),
        made("44 markers, each sample held twice", 3, lambda m: hold_samples(markers(m, 44, 2e-4, 5), 2)),
        made("44 markers at 60 Hz", 6, lambda m: slower(markers(m, 44, 2e-4, 6), 60)),
        made("68 markers, a fifth missing", 3, lambda m: with_gaps(markers(m, 68, 3e-4, 7), 0.2, 8)),
        made("22 joints of SMPL, 30 Hz", 5, lambda m: smpl(m, True, 9)),
        made("22 joints without names, 30 Hz", 0, lambda m: smpl(m, False, 10)),
        made("22 joints without names, 30 Hz", 3, lambda m: smpl(m, False, 11)),
        made("31 joints without names", 2, without_names),
        made("31 joints without names, 60 Hz", 5, lambda m: slower(without_names(m), 60)),
        made("300 markers", 4, lambda m: markers(m, 300, 3e-4, 12)),
        made("1 marker", 0, lambda m: markers(m, 1, 2e-4, 13)),
    ]
    real = [
        ("cmu/c3d/85_02.c3d", 0, 7), ("cmu/c3d/85_12.c3d", 5, 5), ("cmu/c3d/85_12.c3d", 20, 10),
        ("cmu/bvh/131_03.bvh", 0, 9), ("cmu/bvh/salsa_09.bvh", 5, 5),
        ("field-c3d/59993_Frame_Static.c3d", 0, 9), ("field-c3d/BTS.c3d", 0, 9), ("field-c3d/FP_Type1.c3d", 0, 9),
        ("field-c3d/FP_Type3.c3d", 0, 9), ("field-c3d/Movement_trial.c3d", 0, 9), ("field-c3d/Qualisys.c3d", 0, 9),
        ("field-c3d/RoboStatic.c3d", 0, 9), ("field-c3d/Sample_Static.c3d", 0, 9),
        ("field-c3d/Static_trial.c3d", 0, 9), ("field-c3d/Vicon.c3d", 0, 9),
        ("field-c3d/read_NOTworking2.c3d", 0, 30), ("field-trc/Gait.trc", 0, 9), ("field-trc/SprintMotion.trc", 0, 9),
    ]  # fmt: skip
    for path, start, seconds in real:
        name = Path(path).name + (f", {seconds} s from {start}" if start else "")
        found.append(Case(name, recorded(path, start, seconds)))
    return found


def of_case(case: Case, data: Path, priors: Path, known: Sequence[Measurement] = ()) -> Iterator[Measurement]:
    """Measurements of tempo and SZ3 at each error; reuses those of SZ3 in `known`."""
    motion = replace(case.make(data), extras={}, rotations=None, skeleton=None, source={})
    prior = None if case.person is None else folds.trained(priors, (case.person,))
    sz3 = rivals.Sz3()
    with folds.unseen(prior):
        for target, wanted in [("mean_error", e) for e in MEANS] + [("max_error", e) for e in BOUNDS]:
            outcome = runner.run_codec("tempo", motion, **{target: wanted})
            yield measurement(case.label, "unknown", motion, "tempo", target, wanted, outcome)
            reused = [
                f for f in known if (f.file, f.codec, f.target, f.target_m) == (case.label, "sz3", target, wanted)
            ]
            if reused:
                yield reused[0]
                continue

            def run(knob: float) -> runner.Outcome:
                return runner.run_rival(sz3, motion, knob)

            guess = sz3.knob_of(wanted if target == "mean_error" else wanted / 3)
            theirs = runner.search(run, motion, target, wanted, guess)
            if theirs is not None:
                yield measurement(case.label, "unknown", motion, "sz3", target, wanted, theirs)


def markdown(measurements: Sequence[Measurement]) -> str:
    """Table: ratios, and ratios over SZ3's, by case; geometric mean and worst."""
    head = ["points", *(f"mean {100 * e:g} cm" for e in MEANS), *(f"maximum {100 * e:g} cm" for e in BOUNDS)]
    columns = [("mean_error", e) for e in MEANS] + [("max_error", e) for e in BOUNDS]
    cells = [(pick(measurements, "tempo", *c), pick(measurements, "sz3", *c)) for c in columns]
    rows = []
    for file in dict.fromkeys(f.file for f in measurements):
        row = [
            f"{ours[file].ratio:.1f} ({ours[file].ratio / theirs[file].ratio:.2f})" if file in theirs else "–"
            for ours, theirs in cells
        ]
        rows.append([file, *row])
    times = [[o[f].ratio / t[f].ratio for f in o if f in t] for o, t in cells]
    rows.append(["geometric mean", *(f"**{geometric(t):.2f}**" for t in times)])
    rows.append(["worst", *(f"{min(t):.2f}" for t in times)])
    return "\n".join(["Ratio, and in brackets how many times SZ3's at the same error:", "", *table(head, rows)])


@click.command("unknown")
@click.option("--data", default=datasets.SHARED, show_default=True, type=click.Path(path_type=Path), help="Recordings.")
@click.option(
    "--priors", default="build/priors", show_default=True, type=click.Path(path_type=Path), help="Their folder."
)
@click.option("--only", default="", help="Only rows whose label contains this; print the table instead of storing it.")
@click.option("--tables", is_flag=True, help="Only draw the table again.")
def command(data: Path, priors: Path, only: str, tables: bool) -> None:
    """Measure tempo and SZ3 on points outside the prior.

    Writes docs/results/tempo_unknown.json and the table of docs/tempo/results.md.
    """
    known = read_measurements()
    if not tables:
        measurements: list[Measurement] = []
        for case in cases():
            if only in case.label:
                measurements += of_case(case, data, priors, known)
                click.echo(case.label)
        if only:
            click.echo(markdown(measurements))
            return
        stored = {"machine": machine_description(), "figures": [asdict(m) for m in measurements]}
        RESULTS.write_text(json.dumps(stored, indent=0) + "\n")
    write_tables()


def read_measurements() -> list[Measurement]:
    """The stored measurements; empty if there are none."""
    return [Measurement(**m) for m in json.loads(RESULTS.read_text())["figures"]] if RESULTS.is_file() else []


def write_tables() -> None:
    """Write the table of the page from the stored results."""
    write_page(markdown(read_measurements()), "unknown")
