"""The table of rotations in docs/tempo/results.md: `scripts/bench rotations`.

    AMC and BVH recordings ──► tempo with rotations ──► joints, shell points, degrees, by independent kinematics
                           ──► tempo with positions alone, at the same mean error of joints
    both ──► docs/results/tempo_rotations.json ──► docs/tempo/results.md

Bytes are whole .mocz files with names, skeleton and joint limits; ratios are against float32 positions. All codings use
the prior of the package, whose training data contain some of these people. The measurement shares no code with the
codec: it converts rotations to matrices and computes positions from them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocodec import api
from mocodec.codecs.tempo import Tempo
from mocodec.geometry import kinematics
from mocodec.motion import Motion
from mocodec.typing import Floats

from . import datasets
from . import markdown as md
from .machine import machine_description
from .results import read_json, rounded, write_json

RESULTS = Path("docs/results/tempo_rotations.json")
PAGE = Path("docs/tempo/results.md")
BEGIN, END = "<!-- rotations -->", "<!-- end of rotations -->"
EQUAL_MEANS = (0.001, 0.003)
"""Mean errors of joints and shell points for the comparison with positions alone, metres."""
MEANS, BOUNDS = (0.0009, 0.003), (0.001, 0.003, 0.0038, 0.01, 0.013)
EXERCISE = ("cmu/asfamc/03/03_04.amc", "cmu/asfamc/01/01_06.amc", "cmu/asfamc/02/02_10.amc", "cmu/asfamc/49/49_20.amc")
EXERCISE_FRAMES = 4500
SPREAD = 6
"""Every SPREAD-th trial of each subject is measured."""
SHELL_M = 0.03


@dataclass(frozen=True)
class Measurement:
    """One recording at one target. Errors in metres and degrees, processor times in seconds."""

    file: str
    kind: str
    frames: int
    joints: int
    target: str
    target_m: float
    bytes: int
    ratio: float
    positions_alone_bytes: int | None
    mean_error: float
    max_error: float
    joint_mean_error: float
    joint_max_error: float
    max_degrees: float
    encode_s: float
    decode_s: float


def matrices(q: Floats) -> Floats:
    """Rotation matrices (…, 3, 3) of quaternions (…, 4)."""
    w, v = q[..., :1, None], q[..., 1:]
    outer = v[..., :, None] * v[..., None, :]
    skew = np.zeros((*v.shape[:-1], 3, 3))
    skew[..., 0, 1], skew[..., 0, 2], skew[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    skew -= np.swapaxes(skew, -1, -2)
    square = (v * v).sum(axis=-1)[..., None, None]
    return (w * w - square) * np.eye(3) + 2 * outer + 2 * w * skew


def posed(motion: Motion) -> tuple[Floats, Floats]:
    """Points (frames, joints, 4, 3): the motion's joints, and shell points; and world matrices."""
    assert motion.skeleton is not None
    assert motion.rotations is not None
    local = matrices(motion.rotations)
    world = np.empty_like(local)
    for joint, parent in enumerate(motion.skeleton.parents):
        world[:, joint] = local[:, joint] if parent < 0 else world[:, parent] @ local[:, joint]
    shell = motion.positions[:, :, None] + SHELL_M * np.swapaxes(world, -1, -2)
    return np.concatenate([motion.positions[:, :, None], shell], axis=2), world


def measured(motion: Motion, decoded: Motion) -> dict[str, float]:
    """Errors of joints, of joints and shell points together, and of angles."""
    (points, world), (points_2, world_2) = posed(motion), posed(decoded)
    errors = np.sqrt(((points - points_2) ** 2).sum(axis=-1))
    trace = np.einsum("fjab,fjab->fj", world, world_2)
    sine = np.sqrt(((world - world_2) ** 2).sum(axis=(2, 3)) / 8)
    angle = np.where(trace > 2, 2 * np.arcsin(np.minimum(sine, 1)), np.arccos(np.clip((trace - 1) / 2, -1, 1)))
    return {
        "mean_error": float(errors.mean()),
        "max_error": float(errors.max()),
        "joint_mean_error": float(errors[:, :, 0].mean()),
        "joint_max_error": float(errors[:, :, 0].max()),
        "max_degrees": float(np.degrees(angle.max())),
    }


def measurement(label: str, kind: str, motion: Motion, target: str, value: float, compare: bool) -> Measurement:
    """Encode, decode and measure. compare: also measure positions alone at the same mean error of joints."""
    codec = Tempo(**{target: value})  # pyright: ignore[reportArgumentType]
    start = time.process_time()
    blob = api.encode(motion, codec)
    encoded = time.process_time()
    decoded = api.decode(blob, Motion)
    stop = time.process_time()
    errors = measured(motion, decoded)
    alone = None
    if compare:
        positions = replace(motion, rotations=None)
        alone = len(api.encode(positions, Tempo(mean_error=errors["joint_mean_error"])))
    return Measurement(
        label, kind, len(motion), motion.points, target, value, len(blob), motion.raw_bytes / len(blob), alone,
        encode_s=encoded - start, decode_s=stop - encoded, **errors,
    )  # fmt: skip


def cases(data: Path) -> Iterator[tuple[str, str, Callable[[], Motion], str, float, bool]]:
    """Yields label, kind, motion, target, value, and whether to compare with positions alone."""

    def load(path: Path, frames: int | None = None) -> Callable[[], Motion]:
        return lambda: api.read(path, Motion)[slice(0, frames)]

    for subject in sorted((data / "cmu" / "asfamc").iterdir()):
        for path in sorted(subject.glob("*.amc"))[::SPREAD]:
            for value in EQUAL_MEANS:
                yield path.stem, "amc", load(path), "mean_error", value, True
    for path in sorted((data / "cmu" / "bvh").glob("*.bvh")):
        for value in EQUAL_MEANS:
            yield path.stem, "bvh", load(path), "mean_error", value, True
    for name in EXERCISE:
        path = data / name
        for value in MEANS:
            yield path.stem, "exercise", load(path, EXERCISE_FRAMES), "mean_error", value, False
        for value in BOUNDS:
            yield path.stem, "exercise", load(path, EXERCISE_FRAMES), "max_error", value, False


def kinematics_ms() -> float:
    """Milliseconds of forward kinematics for 5,000 frames of 31 joints; best of five runs."""
    motion = api.read(datasets.SHARED / EXERCISE[0], Motion)
    assert motion.skeleton is not None
    assert motion.rotations is not None
    rotations = np.tile(motion.rotations, (2, 1, 1))[:5000]
    root = np.zeros((5000, 3))
    times: list[float] = []
    for _ in range(5):
        start = time.process_time()
        kinematics.forward(motion.skeleton, rotations, root, own_frame=True)
        times.append(1000 * (time.process_time() - start))
    return min(times)


def geometric(values: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(values))))


def tables(content: dict[str, Any]) -> str:
    """The tables, in Markdown."""
    rows = [Measurement(**row) for row in content["measurements"]]
    parts: list[str] = ["Bytes with rotations as a share of positions alone, at the same mean error of the joints:", ""]
    lines: list[list[str]] = []
    for kind in ("amc", "bvh"):
        for value in EQUAL_MEANS:
            some = [r for r in rows if r.kind == kind and r.target_m == value and r.positions_alone_bytes]
            if some:
                shares = [r.bytes / (r.positions_alone_bytes or 1) for r in some]
                worst = int(np.argmax(shares))
                name = f"{shares[worst]:.2f} ({some[worst].file}, {some[worst].frames} frames)"
                lines.append([kind, f"{100 * value:g} cm", str(len(some)), f"{geometric(shares):.3f}", name])
    parts += [md.table(["recordings", "mean of joints and shell", "number", "geometric mean", "worst"], lines), ""]
    parts += [
        f"Sequences of at most {EXERCISE_FRAMES:,} frames at 120 Hz, 31 joints; errors of joints and points 3 cm off:",
        "",
    ]
    lines = []
    for target, values in (("mean_error", MEANS), ("max_error", BOUNDS)):
        for value in values:
            some = [r for r in rows if r.kind == "exercise" and r.target == target and r.target_m == value]
            if some:
                lines.append([
                    f"{target.split('_')[0]} {100 * value:g} cm", " / ".join(f"{r.ratio:.0f}" for r in some),
                    f"{geometric([r.ratio for r in some]):.0f}", " / ".join(f"{100 * r.max_error:.2f}" for r in some),
                    " / ".join(f"{r.max_degrees:.1f}" for r in some),
                ])  # fmt: skip
    names = " / ".join(Path(name).stem for name in EXERCISE)
    parts += [
        md.table(["target", f"ratio: {names}", "geometric mean", "largest error, cm", "largest angle, °"], lines),
        "",
    ]
    long = [r for r in rows if r.kind == "exercise" and r.frames > 2000]
    encode = {t: geometric([r.frames / r.encode_s for r in long if r.target == t]) for t in ("mean_error", "max_error")}
    decode = geometric([r.frames / r.decode_s for r in long])
    parts.append(
        f"Encoding takes {encode['mean_error']:,.0f} frames a second to a mean and {encode['max_error']:,.0f} under a "
        f"bound, decoding {decode:,.0f} (processor time, one thread, compiled); forward kinematics of 5,000 frames of "
        f"31 joints {content['kinematics_ms']:.1f} ms."
    )
    return "\n".join(parts)


def write_page(content: dict[str, Any]) -> None:
    """Write the tables to the page."""
    before, rest = PAGE.read_text().split(BEGIN, 1)
    after = rest.split(END, 1)[1]
    PAGE.write_text(f"{before}{BEGIN}\n{tables(content)}\n{END}{after}")


@click.command("rotations")
@click.option("--tables-only", is_flag=True, help="Draw the tables from the stored results.")
def command(tables_only: bool) -> None:
    """Measure rotations beside positions: bytes, errors and speed, on recordings in ../shared/data."""
    if tables_only:
        write_page(read_json(RESULTS))
        return
    measurements: list[dict[str, Any]] = []
    for label, kind, load, target, value, compare in cases(datasets.SHARED):
        found = measurement(label, kind, load(), target, value, compare)
        measurements.append(asdict(found))
        click.echo(
            f"{label} {target} {value:g}: {found.bytes} bytes, {found.ratio:.1f} : 1, max {found.max_error:.4f} m"
        )
    content = rounded(
        {"machine": machine_description(), "kinematics_ms": kinematics_ms(), "measurements": measurements}
    )
    write_json(RESULTS, content)
    write_page(content)
