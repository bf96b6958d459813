"""Golden files: files of each codec at some version, and the motion that every later version must decode from them.

    python tests/golden/write.py              write the missing files
    python tests/golden/write.py NAME …       write these files again, if the version in the twin is this package's

Version 1 of the format is frozen: files named in `frozen.json` are never written again, by nobody. A change that one of
them does not survive is a change of the format, and needs a new version.

`NAME.mocz` is the file. `NAME.json` is its readable twin: version, codec, settings, and all positions in metres
and signals; for point clouds, positions to a micrometre and colours. A file of an earlier version is never
overwritten. lien2006-lines, bodycast-jumper-bounded and bodycast-jumper-learned have forms that the codecs no longer
write.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import mocodec
from mocodec import channels
from mocodec.codecs.tempo.models import prior
from mocodec.codecs.tempo.pose import bone_directions
from mocodec.motion import Motion, Signal, Skeleton
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, hinged_figures, sequences, synthetic
from mocodec.testing import signals as signal_cases

HERE = Path(__file__).parent

LABELS = ("V1", "V2", "V3", "V4", "Fz", "My", "EMG", "Sync", "Phase", "Odd")
MARKERS = ["C7", "LSHO", "RSHO", "LFWT", "RFWT", "LKNE", "LHEE", "RTOE"]


def markers() -> Motion:
    """96 frames of eight markers; two markers have gaps."""
    motion = synthetic.markers(frames=96, seed=11).select(MARKERS)
    positions = motion.positions.copy()
    positions[20:31, 5] = positions[90:, 6] = np.nan
    return Motion(positions, motion.rate, motion.names, motion.up, source={"format": "c3d", "unit_m": 0.001})


def spiked_markers() -> Motion:
    """`markers` with two spikes."""
    motion = markers()
    positions = motion.positions.copy()
    positions[40, 2] += (0.6, -0.3, 0.2)
    positions[70, 4] -= 0.5
    return replace(motion, positions=positions)


def noisy_markers() -> Motion:
    """`markers` with the noise of cameras, 0.5 mm."""
    motion = markers()
    noise = np.random.default_rng(16).normal(0, 0.0005, motion.positions.shape)
    return replace(motion, positions=motion.positions + noise)


def joints() -> Motion:
    """80 frames of joints, with their skeleton."""
    motion = synthetic.joints(frames=80, rate=60.0, seed=12)
    return Motion(motion.positions, motion.rate, motion.names, motion.up, motion.skeleton)


def named_skeleton() -> Motion:
    """240 frames of the prior's joints with constant bone lengths, with their skeleton."""
    known = prior.for_directions().joints
    rng = np.random.default_rng(13)
    t = np.arange(240)[:, None, None] / 120
    size = (known.tree.dimensions, 3)
    coordinates = (rng.normal(0, 0.15, size) * np.sin(2 * np.pi * rng.uniform(0.1, 2.0, size) * t)).sum(axis=2)
    positions = bone_directions.inverse(known.tree, coordinates) + np.array([0.0, 1.0, 0.0])
    skeleton = Skeleton(known.names, known.tree.parents, known.tree.vectors)
    return Motion(positions, 120.0, known.names, "y", skeleton)


def unnamed_joints() -> Motion:
    """`named_skeleton` without names and skeleton."""
    motion = named_skeleton()
    return Motion(motion.positions, motion.rate, (), motion.up)


def fewer_unnamed_joints() -> Motion:
    """72 frames of `unnamed_joints`, without fingers, thumbs and toes."""
    motion = unnamed_joints()[:72]
    removed = [i for i, name in enumerate(named_skeleton().names) if name[1:] in ("fingers", "thumb", "toes")]
    return Motion(np.delete(motion.positions, removed, axis=1), motion.rate, (), motion.up)


def full_body_markers() -> Motion:
    """72 frames of full-body markers, too few to fit a basis to them."""
    return synthetic.markers(frames=72, seed=14)


def repeated_frames() -> Motion:
    """96 frames of `named_skeleton`; every second frame repeats the previous one."""
    motion = named_skeleton()[:96]
    return replace(motion, positions=motion.positions[np.arange(96) // 2 * 2])


def figure() -> Motion:
    """48 frames of a figure with hinges, and rotations."""
    return hinged_figures.figure(48)


def own_frame_figure() -> Motion:
    """The same in AMC's convention, with joint limits."""
    return hinged_figures.figure(48, own_frame=True)


def figure_with_translations() -> Motion:
    """48 frames of a figure with joints that slide and stretch."""
    return hinged_figures.with_translations(48)


def with_signals() -> Motion:
    """`markers` with signals: a plate's sensors and forces, EMG, counts, channels of few values, and odd floats."""
    plate = signal_cases.plate(960)
    emg = signal_cases.filtered_counts(960)
    still = np.full((960, 1), 0.25, np.float32)
    few = np.random.default_rng(15).choice(signal_cases.noise(12, 40.0, 16).astype(np.float32), (960, 1))
    odd = np.concatenate([signal_cases.odd_floats(480), signal_cases.noise(480, 1.0)[:, None].astype(np.float32)])
    floats = np.concatenate([plate, emg, still, few, odd], axis=1)
    counts = np.rint(signal_cases.slow(1920, 900)[:, None] + signal_cases.noise(3840, 4).reshape(1920, 2))
    extras = {
        "analog": Signal(floats, 1200.0, LABELS, ("V",) * 4),
        "counts": Signal(counts.astype(np.int16), 2400.0, ("Fx", "Fy")),
    }
    return replace(markers(), extras=extras)


def lab() -> Motion:
    """`markers` with the extras of a motion lab: words of its dictionary, a channel that repeats another, events."""
    motion = with_signals()
    floats = np.array(motion.extras["analog"].values)
    floats[:, 6] = floats[:, 2]
    words = [
        f"{side}{joint}Angles" for side in "LR" for joint in ("Hip", "Knee", "Ankle", "Shoulder", "Elbow", "Wrist")
    ]
    words += [f"Kistler Force Plate 2.0.0.0::Force.F{axis}1 [1,{i}]" for i, axis in enumerate("xyz", 1)]
    extras = {
        "analog": Signal(floats, 1200.0, LABELS, ("V",) * 4),
        "parameters": {"POINT": {"ANGLES": words, "UNITS": "mm"}, "TRIAL": {"CAMERA_RATE": 120.0}},
        "table": np.arange(600, dtype=np.float32).reshape(100, 6) ** 1.5,
        "events": [{"label": "Foot Strike", "context": "Left", "time_s": 0.25}],
    }
    return replace(motion, extras=extras)


def jumper() -> PointClouds:
    """Three frames of a jumping person, 240 points each; the middle frame has only four."""
    clouds = sequences.record(PERFORMANCE, 240, seed=14)
    assert clouds.colours is not None
    few = [slice(4) if frame == 1 else slice(None) for frame in range(3)]
    positions = [points[some] for points, some in zip(clouds.positions, few, strict=True)]
    return PointClouds(positions, 15.0, [c[some] for c, some in zip(clouds.colours, few, strict=True)])


def covered_jumper() -> PointClouds:
    """Four frames of a person whom a curved sheet covers from the second frame on; a ball moves beside."""
    person = sequences.record(PERFORMANCE, 240, seed=14)
    assert person.colours is not None
    positions, colours = [], []
    for k in range(4):
        rng = np.random.default_rng([17, k])
        ball = rng.normal(size=(120, 3))
        ball = 0.1 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [1.0 + 0.03 * k, 0.3, 0.2]
        flat = rng.uniform([-0.4, 0.2], [0.4, 1.6], (300, 2))
        sheet = np.column_stack([flat, 0.25 - 0.5 * flat[:, 0] ** 2])
        cloth = np.column_stack([90 * flat + 80, 60 * flat[:, 1]])
        own, clothes = (person.positions[0], person.colours[0]) if k == 0 else (sheet, cloth)
        positions.append(np.concatenate([own, ball]).astype(np.float32).astype(np.float64))
        red = np.tile([180, 60, 40], (len(ball), 1))
        colours.append(np.concatenate([clothes, red]).astype(np.uint8))
    return PointClouds(positions, 15.0, colours)


PERFORMANCE = sequences.jumping_jacks(actors.capsules(), 3)
SKELETON = {"skeleton": PERFORMANCE.skeleton()}

RECIPES: dict[str, tuple[Callable[[], Motion | PointClouds], str, dict[str, Any]]] = {
    "lossless-markers": (markers, "lossless", {}),
    "liu2006-markers": (markers, "liu2006", {}),
    "liu2006-markers-bounded": (markers, "liu2006", {"max_error": 0.002}),
    "liu2006-markers-fine": (noisy_markers, "liu2006", {"max_error": 0.0002}),
    "hou2014-markers": (markers, "hou2014", {}),
    "hou2014-joints": (joints, "hou2014", {}),
    "hou2014-markers-bounded": (markers, "hou2014", {"max_error": 0.002}),
    "hou2014-markers-fine": (noisy_markers, "hou2014", {"max_error": 0.0002}),
    "tempo-markers": (markers, "tempo", {"max_error": 0.005, "model": "transform"}),
    "tempo-joints": (joints, "tempo", {"max_error": 0.005, "model": "transform"}),
    "tempo-directions": (named_skeleton, "tempo", {"max_error": 0.005, "model": "transform"}),
    "tempo-directions-stored": (unnamed_joints, "tempo", {"max_error": 0.005, "model": "directions-stored"}),
    "tempo-skeleton-matched": (fewer_unnamed_joints, "tempo", {"max_error": 0.005, "model": "transform"}),
    "tempo-points-prior": (named_skeleton, "tempo", {"max_error": 0.005, "model": "points-prior"}),
    "tempo-points-stored": (markers, "tempo", {"max_error": 0.005, "model": "points-stored"}),
    "tempo-markers-on-bones": (full_body_markers, "tempo", {"max_error": 0.01, "model": "transform"}),
    "tempo-direct": (markers, "tempo", {"max_error": 0.005, "model": "direct"}),
    "tempo-lattice": (markers, "tempo", {"max_error": 0.0005, "model": "lattice"}),
    "tempo-lattice-joints": (joints, "tempo", {"max_error": 0.0002, "model": "lattice"}),
    "tempo-lattice-spikes": (
        spiked_markers,
        "tempo",
        {"max_error": 0.001, "weights": {"LHEE": 4.0}, "model": "lattice"},
    ),
    "tempo-fallback": (markers, "tempo", {"max_error": 0.005, "model": "hou2014"}),
    "tempo-weights": (markers, "tempo", {"max_error": 0.005, "weights": {"LHEE": 4.0, "RTOE": 4.0}}),
    "tempo-repeats": (repeated_frames, "tempo", {"max_error": 0.005, "model": "transform"}),
    "rotations-figure": (figure, "tempo", {"mean_error": 0.003}),
    "rotations-own-frame": (own_frame_figure, "tempo", {"max_error": 0.01}),
    "rotations-translations": (figure_with_translations, "tempo", {"max_error": 0.005}),
    "rotations-lossless": (figure, "lossless", {}),
    "signals-exact": (with_signals, "tempo", {"max_error": 0.005}),
    "signals-12bit": (with_signals, "tempo", {"max_error": 0.005, "signal_error": "12bit"}),
    "signals-lab": (lab, "tempo", {"max_error": 0.005}),
    "lien2006-jumper": (jumper, "lien2006", {"residual": 50, **SKELETON}),
    "bodycast-jumper": (jumper, "bodycast", {"residual": 50, **SKELETON}),
    "bodycast-covered": (covered_jumper, "bodycast", {"max_error": 0.003, **SKELETON}),
    "bodycast-exact": (jumper, "bodycast", {"residual": "exact", **SKELETON}),
    "bodycast-exact-steps": (covered_jumper, "bodycast", {"residual": "exact", "precision": 0.002, **SKELETON}),
    "bodycast-jumper-smoothed": (jumper, "bodycast", {"max_error": 0.012, "psnr": 28, **SKELETON}),
    "bodycast-jumper-cubes": (jumper, "bodycast", {"max_error": 0.006, **SKELETON}),
}


def write(name: str, folder: Path = HERE) -> None:
    """Write a golden file and its twin. Raises SystemExit if this would overwrite a frozen file, or one of another
    version.
    """
    if folder == HERE and name in frozen():
        raise SystemExit(f"{name} belongs to the frozen version 1 of the format: keep it, and add a file of a new name")
    twin = folder / f"{name}.json"
    if twin.exists() and (version := json.loads(twin.read_text())["version"]) != mocodec.__version__:
        raise SystemExit(
            f"{name} was written by mocodec {version}, not {mocodec.__version__}: keep it, and add a file of a new name"
        )
    recipe, codec, settings = RECIPES[name]
    blob = mocodec.encode(recipe(), codec=codec, **settings)
    (folder / f"{name}.mocz").write_bytes(blob)
    decoded = mocodec.decode(blob)
    about = {
        "version": mocodec.__version__,
        "codec": codec,
        "settings": {key: value for key, value in settings.items() if key != "skeleton"},
        "recipe": recipe.__name__,
        "bytes": len(blob),
        "sha256": hashlib.sha256(blob).hexdigest(),
        "rate": decoded.rate,
        "up": decoded.up,
    }
    if isinstance(decoded, Motion):
        about["names"] = decoded.names
        digits, frames = 10, {"positions": decoded.positions}
    else:
        digits, frames = 6, {"positions": decoded.positions, "colours": decoded.colours or []}
    text = json.dumps(about, indent=2)[:-2]
    if isinstance(decoded, Motion) and decoded.rotations is not None:
        frames["rotations"] = decoded.rotations
    if isinstance(decoded, Motion) and decoded.extras:
        text += f',\n  "signals": {json.dumps(described_signals(decoded))}'
    for key, values in frames.items():
        lines = [
            json.dumps([None if np.isnan(p[0]) else [round(c, digits) for c in p] for p in f.tolist()]) for f in values
        ]
        text += f',\n  "{key}": [\n    ' + ",\n    ".join(lines) + "\n  ]"
    twin.write_text(text + "\n}\n")


def frozen() -> dict[str, str]:
    """SHA-256 of each file of the frozen version 1, by name."""
    hashes: dict[str, str] = json.loads((HERE / "frozen.json").read_text())
    return hashes


def described_signals(motion: Motion) -> dict[str, Any]:
    """Rate, type, labels and all values of each signal; NaN and infinities as Python writes them."""
    return {
        path: {
            "rate": signal.rate,
            "dtype": np.dtype(signal.dtype).str,
            "labels": list(signal.labels),
            "values": np.asarray(signal.values).tolist(),
        }
        for path, signal in channels.signals(motion.extras)
    }


if __name__ == "__main__":
    for chosen in sys.argv[1:] or [name for name in RECIPES if not (HERE / f"{name}.mocz").exists()]:
        write(chosen)
        print(chosen)
