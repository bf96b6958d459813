"""Tables and figures of Lien and Bajcsy (2006): their results beside our lien2006 and bodycast.

    section 5.1: clips on the actor ──► thinned, noisy points ──► trackers ──► e_t, frame rates (figures 6 to 8)
    section 5.2: clips on the actor ──► ten depth cameras ──► codecs ──► PSNR, ratios (tables 1 and 2, figure 9)

The recordings of the paper are not available; CMU motion on the MakeHuman body replaces them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocodec import formats
from mocodec.codecs.bodycast import Bodycast
from mocodec.codecs.lien2006 import Lien2006
from mocodec.encoded import Encoded
from mocodec.geometry import articulated_icp, articulation, body_tracking, skinning
from mocodec.geometry.articulation import Body, Pose
from mocodec.metrics import point_clouds, splats
from mocodec.pointcloud import PointClouds
from mocodec.testing import sequences
from mocodec.testing.actors import Actor
from mocodec.testing.sequences import Performance
from mocodec.typing import Floats

from .. import datasets
from ..cloud import makehuman, retarget
from ..figures import pyplot
from ..machine import machine_description
from ..results import read_json, write_json

RATE = 15.0
POINTS = 10_000
SYNTHETIC = {"dance": "salsa_09", "crouch & flip": "49_20", "turn": "turning", "tai-chi": "02_05"}
TELE_IMMERSION = {"dancer 1": "salsa_09", "dancer 2": "131_04", "student": "01_01", "tai-chi master": "02_05"}
"""Motions of the paper, and their replacement clips."""

PAPER_FPS = {"dance": 39.1, "crouch & flip": 29.6, "turn": 48.4, "tai-chi": 61.3}
PAPER_FPS_TELE_IMMERSION = {"dancer 1": 11.9, "dancer 2": 11.5, "student": 12.5, "tai-chi master": 12.6}
PAPER_PSNR = {  # table 1: no residuals, 25 %, 100 %
    "dancer 1": (23.87, 25.77, 27.95), "dancer 2": (24.10, 26.18, 28.27), "student": (25.82, 27.96, 29.91),
    "tai-chi master": (26.27, 28.75, 30.83),
}  # fmt: skip
PAPER_RATIO = {  # table 2: no residuals, 25 %, 100 %, Yang et al., H.264
    "dancer 1": (1490.31, 195.62, 66.54, 11.36, 64.04), "dancer 2": (3581.52, 173.52, 55.33, 11.73, 53.78),
    "student": (5839.59, 183.80, 60.29, 10.23, 32.04), "tai-chi master": (5664.55, 183.82, 61.43, 14.41, 49.58),
}  # fmt: skip
LEVELS = (0, 25, 100)
"""Residuals, percent."""
KEPT_SHARES = (1.0, 0.25, 0.05, 0.01)
NOISES_M = (0.0, 0.005, 0.01, 0.02)
STARTS = {"salsa_09": 2.0, "49_20": 1.0, "02_05": 4.0, "131_04": 2.0, "01_01": 4.0}
"""Start of the interesting part of each clip, seconds."""
LONG = 1000
"""Number of frames for ratios with the model."""


def run(
    data: Path = datasets.SHARED,
    output: Path | None = None,
    frames: int = 24,
    report: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Measure everything; with `output`, write JSON, tables and figures there."""
    actor = makehuman.find()
    wanted = sorted({*SYNTHETIC.values(), *TELE_IMMERSION.values()})
    acts = {name: act for name in wanted if (act := perform(actor, data, name, frames)) is not None}
    results: dict[str, Any] = {
        "machine": machine_description(), "actor": actor.name, "frames": frames, "rate": RATE, "points": POINTS,
        "command": "scripts/bench lien2006",
    }  # fmt: skip
    report("figures 6 to 8 and frame rates")
    results["synthetic"] = {
        motion: {"stands_in": name, **track_synthetic(acts[name])} for motion, name in SYNTHETIC.items() if name in acts
    }
    flip = acts.get(SYNTHETIC["crouch & flip"]) or next(iter(acts.values()))
    results["figure_7"] = {f"{keep:.0%}": track_with_both(flip, keep=keep) for keep in KEPT_SHARES}
    results["figure_8"] = {
        f"{noise * 100:g} cm": track_with_both(acts["turning"], keep=0.25, noise_m=noise) for noise in NOISES_M
    }
    results["tele_immersion"] = {}
    for motion, name in TELE_IMMERSION.items():
        if name in acts:
            report(f"tables 1 and 2: {motion}")
            results["tele_immersion"][motion] = {"stands_in": name, **code_and_measure(acts[name], motion, output)}
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        write_json(output / "lien2006.json", results)
        write_tables(output)
        draw(results, output)
    return results


def perform(actor: Actor, data: Path, name: str, frames: int) -> Performance | None:
    """A motion on the actor; None if its recording does not exist."""
    if name == "turning":
        return sequences.turning(actor, frames, RATE)
    return retarget.perform_clip(actor, data, name, RATE, STARTS[name], frames)


def write_tables(folder: Path) -> Path:
    """Write lien2006.md from lien2006.json; return its path."""
    formats.replace_whole(folder / "lien2006.md", markdown(read_json(folder / "lien2006.json")).encode())
    return folder / "lien2006.md"


def track_synthetic(act: Performance) -> dict[str, Any]:
    """Figure 6 and frame rates with 25 % of the points: ARTICP with and without its constraints, bodycast's tracker."""
    clouds = sequences.record(act, POINTS, keep=0.25, seed=1, normals=True)
    settings = articulated_icp.ArticpSettings
    return {
        "with": track_with_articp(act, clouds, settings()),
        "with, true normals": track_with_articp(act, clouds, settings(), normals=True),
        "without global fitting": track_with_articp(act, clouds, settings(global_fitting=False)),
        "without": track_with_articp(act, clouds, settings(global_fitting=False, articulation=False)),
        "bodycast": track_with_bodycast(act, clouds),
    }


def track_with_both(act: Performance, **recording: float) -> dict[str, Any]:
    """ARTICP and bodycast's tracker on a recording with these options of `sequences.record`."""
    clouds = sequences.record(act, POINTS, seed=1, **recording)  # type: ignore[arg-type]
    return {
        "lien2006": track_with_articp(act, clouds, articulated_icp.ArticpSettings()),
        "bodycast": track_with_bodycast(act, clouds),
    }


def track_with_articp(
    act: Performance, clouds: PointClouds, settings: articulated_icp.ArticpSettings, normals: bool = False
) -> dict[str, Any]:
    """ARTICP from the true first pose. normals: use true normals, not estimated ones."""
    actor = act.actor
    body = articulation.from_skeleton(actor.names, actor.parents, act.joints[0], one_trunk=True, shortest=0.1)
    true = lambda frame: normals_of_some_points(clouds, frame) if normals else None  # noqa: E731
    body, model = articulated_icp.make_model(body, *some_points(clouds, 0), true(0))
    tracker = articulated_icp.ArticpTracker(body, model, settings)
    return follow(act, clouds, body, lambda frame: tracker.fit(*some_points(clouds, frame), true(frame)))


def track_with_bodycast(act: Performance, clouds: PointClouds) -> dict[str, Any]:
    """Bodycast's tracker, which fits all joints at once, from the true first pose."""
    actor = act.actor
    body = articulation.from_skeleton(actor.names, actor.parents, act.joints[0])
    body, model = articulated_icp.make_model(body, *some_points(clouds, 0, 3000), by_surface=True)
    skin = skinning.skin(body, model.points, model.links)
    tracker = body_tracking.BodyTracker(body, skin, model.normals, model.colours)
    return follow(act, clouds, body, lambda frame: tracker.fit(*some_points(clouds, frame), frame).pose)


def some_points(clouds: PointClouds, frame: int, most: int = 2500) -> tuple[Floats, Any]:
    """At most `most` random points of a frame and their colours."""
    some = np.random.default_rng(frame).permutation(len(clouds.positions[frame]))[:most]
    return clouds.positions[frame][some], None if clouds.colours is None else clouds.colours[frame][some]


def normals_of_some_points(clouds: PointClouds, frame: int, most: int = 2500) -> Floats:
    """True normals of the points of `some_points`."""
    assert clouds.normals is not None
    return clouds.normals[frame][np.random.default_rng(frame).permutation(len(clouds.positions[frame]))[:most]]


def follow(act: Performance, clouds: PointClouds, body: Body, fit: Callable[[int], Pose]) -> dict[str, Any]:
    """Errors e_t of all frames, mean and largest joint error, and frames per second of processor time."""
    e_t, errors = list[float](), list[Floats]()
    started = time.process_time()
    poses = [fit(frame) for frame in range(1, len(clouds))]
    seconds = time.process_time() - started
    for frame, pose in enumerate(poses, start=1):
        tracked = articulation.joint_positions(body, *articulation.transforms(body, pose))
        true = act.joints[frame][list(body.joints)]
        errors.append(np.linalg.norm(tracked - true, axis=1))
        e_t.append(round(joint_error(tracked, true, clouds.positions[frame]), 5))
    error = np.array(errors)
    return {
        "e_t": e_t, "fps": round(len(poses) / max(seconds, 1e-9), 2), "mean_cm": round(float(error.mean()) * 100, 3),
        "max_cm": round(float(error.max()) * 100, 2), "points": round(float(np.mean([len(p) for p in
        clouds.positions]))),
    }  # fmt: skip


def joint_error(estimated: Floats, true: Floats, points: Floats) -> float:
    """e_t (section 5.1): mean distance of joints (n, 3) over the radius of the smallest ball around the points."""
    return float(np.linalg.norm(estimated - true, axis=1).mean()) / ball_radius(points)


def ball_radius(points: Floats) -> float:
    """Approximate radius of the smallest ball around points (n, 3), by the iteration of Bădoiu and Clarkson."""
    centre = points.mean(axis=0)
    for step in range(1, 60):
        farthest = points[np.argmax(np.sum((points - centre) ** 2, axis=1))]
        centre = centre + (farthest - centre) / (step + 1)
    return float(np.sqrt(np.max(np.sum((points - centre) ** 2, axis=1))))


def code_and_measure(act: Performance, motion: str, output: Path | None) -> dict[str, Any]:
    """Tables 1 and 2 and figure 9 for one motion, recorded by the rig: both codecs at all residuals."""
    clouds = sequences.record(act, POINTS, rig=sequences.Rig(), seed=1)
    second_sample = sequences.record(act, POINTS, rig=sequences.Rig(), seed=2)
    frames = range(1, len(clouds), 3)
    skeleton = act.skeleton()
    result: dict[str, Any] = {
        "raw_bytes_a_frame": clouds.raw_bytes / len(clouds),
        "floor_db": round(float(np.mean([point_clouds.views_psnr(clouds, second_sample, f) for f in frames])), 2),
    }
    pictures = [("data", clouds)]
    for codec in (Lien2006, Bodycast):
        for level in LEVELS:
            started = time.process_time()
            encoded = codec(residual=level, skeleton=skeleton).encode(clouds)
            seconds = time.process_time() - started
            started = time.process_time()
            decoded = codec.decode(encoded)
            decode_seconds = time.process_time() - started
            psnr = [round(point_clouds.views_psnr(clouds, decoded, f), 2) for f in frames]
            result[f"{codec.name} {level}"] = {
                "psnr_db": round(float(np.mean(psnr)), 2), "psnr_by_frame": psnr, **ratios(encoded, clouds),
                "encode_fps": round(len(clouds) / seconds, 2),
                "decode_fps": round(len(clouds) / max(decode_seconds, 1e-9), 2),
            }  # fmt: skip
            if level in (0, 100):
                pictures.append((f"{codec.name} {level}", decoded))
    if output is not None and motion == "tai-chi master":
        side_by_side(pictures, (len(clouds) // 2, len(clouds) - 1), output)
    return result


def ratios(encoded: Encoded[PointClouds], clouds: PointClouds) -> dict[str, float]:
    """Compression ratios against float32 positions and 3-byte colours: without the model, as in the paper, and with the
    model over LONG frames.
    """
    model, moving = sum(map(len, encoded.shared)), sum(len(c.payload) for c in encoded.chunks)
    raw = clouds.raw_bytes / len(clouds)
    a_frame = moving / len(clouds)
    return {
        "model_bytes": model, "bytes_a_frame": round(a_frame, 1), "ratio_without_model": round(raw / a_frame, 1),
        "ratio_with_model": round(LONG * raw / (model + LONG * a_frame), 1),
    }  # fmt: skip


def side_by_side(pictures: Sequence[tuple[str, PointClouds]], frames: Sequence[int], output: Path) -> None:
    """A picture for a visual check: rows of frames, columns of codecs, each frame from two sides."""
    plt = pyplot()
    figure, axes = plt.subplots(len(frames), len(pictures), figsize=(3.2 * len(pictures), 3.4 * len(frames)))
    for row, frame in enumerate(frames):
        for column, (name, clouds) in enumerate(pictures):
            views = splats.views(clouds, frame, like=pictures[0][1])
            panel = axes[row, column]
            panel.imshow(np.concatenate([views[1][:, 50:-50], views[5][:, 50:-50]], axis=1))
            panel.set_axis_off()
            if row == 0:
                panel.set_title(name if name == "data" else f"{name} %", fontsize=10)
    figure.tight_layout()
    output.mkdir(parents=True, exist_ok=True)
    figure.savefig(output / "lien2006_side_by_side.png", dpi=110)
    plt.close(figure)


def markdown(results: dict[str, Any]) -> str:
    """The tables, our results beside those of the paper."""
    lines = [
        "# Lien and Bajcsy 2006: our results beside theirs", "",
        f"Made by `scripts/bench lien2006` on {results['frames']} frames of each motion at {RATE:g} frames/s, body "
        f"{results['actor']}, {POINTS:,} points a frame. The recordings of the paper are not available; the column "
        '"replaced by" names the clip that is used. Frames/s count processor time on one core of the machine in '
        "lien2006.json, which had other load.", "",
        "## Motion estimation of synthetic data: frames a second, 2,500 points", "",
        "| motion | replaced by | paper | lien2006 | bodycast | joint error mean / max cm: lien2006 | bodycast |",
        "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for motion, found in results["synthetic"].items():
        a, b = found["with"], found["bodycast"]
        lines.append(
            f"| {motion} | {found['stands_in']} | {PAPER_FPS[motion]} | {a['fps']} | {b['fps']} "
            f"| {a['mean_cm']} / {a['max_cm']} | {b['mean_cm']} / {b['max_cm']} |"
        )
    lines += ["", "## Figure 6: mean e_t with and without constraints", ""]
    lines += ["| motion | without | without global fitting | with | with, true normals | bodycast |"]
    lines += ["|---|---|---|---|---|---|"]
    for motion, found in results["synthetic"].items():
        kinds = ("without", "without global fitting", "with", "with, true normals", "bodycast")
        lines.append(f"| {motion} | " + " | ".join(f"{np.mean(found[k]['e_t']):.4f}" for k in kinds) + " |")
    for key, what in (("figure_7", "share of the points kept"), ("figure_8", "noise on each coordinate")):
        lines += ["", f"## Figure {key[-1]}: mean e_t by {what}", "", "| | lien2006 | bodycast |", "|---|---|---|"]
        for name, found in results[key].items():
            lines.append(f"| {name} | " + " | ".join(f"{np.mean(f['e_t']):.4f}" for f in found.values()) + " |")
    lines += ["", "## Table 1: PSNR over six rendered views, dB (no residuals / 25 % / 100 %)", ""]
    lines += ["The floor is the PSNR of a second recording of the same motion by the same rig.", ""]
    lines += ["| motion | replaced by | paper | floor | lien2006 | bodycast |", "|---|---|---|---|---|---|"]
    for motion, found in results["tele_immersion"].items():
        ours = [" / ".join(f"{found[f'{c} {r}']['psnr_db']:.2f}" for r in LEVELS) for c in ("lien2006", "bodycast")]
        paper = " / ".join(f"{v:.2f}" for v in PAPER_PSNR[motion])
        lines.append(f"| {motion} | {found['stands_in']} | {paper} | {found['floor_db']} | {ours[0]} | {ours[1]} |")
    lines += ["", "## Table 2: compression ratio (no residuals / 25 % / 100 %)", ""]
    lines += [f"Without the model, as in the paper; in brackets with the model, over {LONG:,} frames.", ""]
    lines += ["| motion | paper | Yang et al., H.264 (paper) | lien2006 | bodycast |", "|---|---|---|---|---|"]
    for motion, found in results["tele_immersion"].items():
        p = PAPER_RATIO[motion]
        cells = [" / ".join(_ratio(found[f"{c} {r}"]) for r in LEVELS) for c in ("lien2006", "bodycast")]
        paper = " / ".join(f"{v:.0f}" for v in p[:3])
        lines.append(f"| {motion} | {paper} | {p[3]}, {p[4]} | {cells[0]} | {cells[1]} |")
    lines += ["", "## Tele-immersion data: frames a second, whole encoding / decoding", ""]
    lines += [
        "| motion | paper, tracking | lien2006, 0 % | 100 % | bodycast, 0 % | 100 % |",
        "|---|---|---|---|---|---|",
    ]
    for motion, found in results["tele_immersion"].items():
        kinds = ("lien2006 0", "lien2006 100", "bodycast 0", "bodycast 100")
        cells = [f"{found[k]['encode_fps']} / {found[k]['decode_fps']}" for k in kinds]
        lines.append(f"| {motion} | {PAPER_FPS_TELE_IMMERSION[motion]} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _ratio(found: dict[str, float]) -> str:
    return f"{found['ratio_without_model']:.0f} ({found['ratio_with_model']:.0f})"


def draw(results: dict[str, Any], output: Path) -> None:
    """Figures 6 to 9."""
    flip = results["synthetic"].get("crouch & flip") or next(iter(results["synthetic"].values()))
    kinds = {"without": "no constraints", "with": "lien2006, all constraints", "bodycast": "bodycast"}
    _curves({label: flip[k]["e_t"] for k, label in kinds.items()}, "e_t", output / "lien2006_figure6.png")
    for key in ("figure_7", "figure_8"):
        curves = {f"{codec}, {name}": f[codec]["e_t"] for name, f in results[key].items() for codec in f}
        _curves(curves, "e_t", output / f"lien2006_{key.replace('_', '')}.png")
    if master := results["tele_immersion"].get("tai-chi master"):
        curves = {f"{c}, {r} %": master[f"{c} {r}"]["psnr_by_frame"] for c in ("lien2006", "bodycast") for r in LEVELS}
        _curves(curves, "PSNR of six views, dB", output / "lien2006_figure9.png", every=3)


def _curves(curves: dict[str, list[float]], unit: str, path: Path, every: int = 1) -> None:
    plt = pyplot()
    figure, panel = plt.subplots(figsize=(7, 4))
    for label, values in curves.items():
        style = "--" if label.startswith("bodycast") else "-"
        panel.plot(1 + every * np.arange(len(values)), values, style, label=label)
    panel.set_xlabel("frame")
    panel.set_ylabel(unit)
    panel.legend(fontsize=7, ncols=2)
    panel.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


@click.command("lien2006")
@click.option("-o", "--output", default="docs/results", show_default=True, type=click.Path(path_type=Path))
@click.option("--data", default=datasets.SHARED, show_default=True, type=click.Path(path_type=Path), help="Recordings.")
@click.option("--frames", default=24, show_default=True, type=click.IntRange(2), help="Frames of every motion.")
def command(output: Path, data: Path, frames: int) -> None:
    """Tables and figures of Lien and Bajcsy (2006), our results beside theirs.

    Writes lien2006.json, lien2006.md and lien2006_*.png.
    """
    run(data, output, frames, lambda step: click.echo(step, err=True))
    click.echo(output / "lien2006.md")
