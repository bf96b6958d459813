"""The decoder in TypeScript (web/decoder): its own tests, and the same frames as Python's from files of every kind."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import channels
from mocodec.codecs.bodycast import Bodycast
from mocodec.codecs.lien2006 import Lien2006
from mocodec.codecs.tempo import Tempo
from mocodec.motion import Limits, Motion, Signal
from mocodec.testing import actors, edge_cases, hinged_figures, sequences, signals, skeletal, synthetic
from mocodec.viewer import marks as viewer_marks
from mocodec.viewer.recording import of_file

from .independent import motions

ROOT = Path(__file__).parents[1]
DECODER = ROOT / "web" / "decoder"
PRIORS = ROOT / "src" / "mocodec" / "priors"
TOLERANCE_M = 1e-6
NODE = shutil.which("node")
CLOUDS = [
    path for name in ("bodycast", "lien2006") for path in sorted((ROOT / "tests" / "golden").glob(f"{name}-*.mocz"))
]

pytestmark = [
    pytest.mark.skipif(NODE is None, reason="Node is not installed"),
    pytest.mark.skipif(not (DECODER / "node_modules").is_dir(), reason="needs `npm ci` in web/decoder"),
]

MARKERS = synthetic.markers(frames=150, seed=3)
FEW = MARKERS.select(["C7", "LSHO", "RSHO", "LKNE", "LTOE", "RTOE"])
NAMED = motions.named_joints(150)


def node(*arguments: str | Path) -> None:
    assert NODE is not None
    done = subprocess.run([NODE, *map(str, arguments)], cwd=DECODER, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]


def with_holes(motion: Motion) -> Motion:
    positions = motion.positions.copy()
    positions[len(positions) // 2 :] += (0.4, 0.3, -0.2)
    positions[10, 3] += 0.7
    positions[20:29, 5] = np.nan
    positions[:4, 0] = np.nan
    return replace(motion, positions=positions)


def named(motion: Motion, names: list[str], **changes: Any) -> Motion:
    return replace(motion, names=tuple(names), **changes)


def with_extras() -> Motion:
    """Values, arrays and signals of every kind."""
    rng = np.random.default_rng(5)
    steps = np.cumsum(rng.integers(-3, 4, (400, 2)), axis=0)
    coded = {name: Signal(values, 1000.0, ("a",) * values.shape[1], ("V",) * values.shape[1])
             for name, values in signals.cases().items() if values.ndim == 2}  # fmt: skip
    extras = {
        "numbers": [0, 1, -1, 63, 64, -(2**40), 2**60, 2**70, -(2**70), 0.1, 1e-300, -2.5e10, True, None],
        "text": "line\nline \N{SNOWMAN}",
        "events": [{"time_s": 0.25, "label": "Foot Strike", "context": "Left"}, {"time_s": 1.5}],
        "arrays": {
            "constant": np.full((50, 7), 2.5),
            "steps": steps.astype("<i4"),
            "scaled": (steps * 0.01).astype("<f4"),
            "noise": rng.normal(size=(30, 40)),
            "bytes": rng.integers(0, 2, 4000).astype(bool),
            "words": np.array(["one", "seventeen", "\N{SNOWMAN}"] * 30),
            "waves": np.exp(1j * np.linspace(0, 9, 200)).reshape(50, 4),
        },
        "analog": coded,
    }
    return replace(FEW, extras=extras)


def with_limits() -> Motion:
    """Rotations about the axes of joint limits."""
    motion = hinged_figures.figure(60)
    assert motion.skeleton is not None
    joints = len(motion.skeleton.names)
    ranges = np.radians(np.array([[[-30, 40], [0, 0], [-10, 90.5]]] * joints, float))
    ranges[0] = [-np.inf, np.inf]
    axes = np.tile([np.cos(0.2), np.sin(0.2), 0, 0], (joints, 1))
    return replace(motion, skeleton=replace(motion.skeleton, limits=Limits(("zyx",) * joints, axes, ranges)))


def with_ball(clouds: mc.PointClouds) -> mc.PointClouds:
    """With points that no body explains."""
    ball = np.random.default_rng(2).normal(size=(150, 3))
    ball *= 0.12 / np.linalg.norm(ball, axis=1, keepdims=True)
    assert clouds.colours is not None
    positions = [np.concatenate([p, p.mean(axis=0) + np.array([0.9, 0, 0]) + ball]) for p in clouds.positions]
    colours = [np.concatenate([c, np.full((150, 3), (200, 30, 40), np.uint8)]) for c in clouds.colours]
    return replace(clouds, positions=positions, colours=colours)


HOU: dict[str, Any] = {"codec": "hou2014"}
LIU: dict[str, Any] = {"codec": "liu2006", "initial_frames": 40, "ahead_frames": 30, "rise": 5.0}
RECORDINGS: dict[str, tuple[Motion, dict[str, Any]]] = {
    "points-prior": (motions.named_points(100), {"model": "points-prior"}),
    "markers-on-bones": (MARKERS, {"model": "points-prior", "mean_error": 0.001}),
    "stored-holes": (with_holes(FEW), {"model": "points-stored", "mean_error": 0.002}),
    "joints": (NAMED, {"model": "directions-prior", "max_error": 0.001}),
    "measured": (replace(NAMED, skeleton=None), {"model": "directions-prior", "max_error": 0.003}),
    "matched": (motions.renamed_joints(160, with_skeleton=True), {"model": "directions-prior"}),
    "matched-shuffled": (motions.renamed_joints(160, False, shuffled=True), {"model": "directions-prior"}),
    "tails": (motions.with_tails(90), {"model": "directions-prior"}),
    "tails-stored": (motions.with_tails(90), {"model": "directions-stored"}),
    "tree-stored": (motions.renamed_joints(200, False, shuffled=True), {"model": "directions-stored"}),
    "direct": (replace(FEW, rate=7.3), {"model": "direct", "max_error": 0.0001}),
    "weights": (MARKERS, {"model": "direct", "max_error": 0.008, "weights": dict.fromkeys(MARKERS.names[:6], 5.0)}),
    "fallback": (FEW, {"model": "hou2014"}),
    "repeats": (replace(FEW, positions=np.repeat(FEW.positions, 3, axis=0)), {"chunk_seconds": 0.5}),
    "x-up-frozen": (replace(edge_cases.motion("parked"), up="x"), {"chunk_seconds": 0.5, "mean_error": 0.003}),
    "z-up-spikes": (replace(with_holes(FEW), up="z"), {"chunk_seconds": 0.7, "max_error": 0.0005}),
    "hou-adaptive": (FEW, {**HOU, "segmentation": "adaptive", "clips": 3, "masking": 0.5, "components": 8}),
    "hou-weights": (FEW, {**HOU, "max_error": 0.001, "point_weights": {"C7": 4.0}, "unit": 0.001}),
    "hou-plain": (FEW, {**HOU, "compress_basis": False, "centre": False, "components": 5}),
    "liu-segments": (FEW, {**LIU, "max_error": 0.002}),
    "liu-mean": (with_holes(FEW), {"codec": "liu2006", "mean_error": 0.003}),
    "lossless-float64": (FEW, {"codec": "lossless", "chunk_seconds": 0.5, "float64": True}),
    "lossless-float32": (with_holes(MARKERS), {"codec": "lossless", "chunk_seconds": 0.5}),
    "lossless-skeleton": (NAMED, {"codec": "lossless"}),
    "rotations-own": (hinged_figures.figure(60, own_frame=True), {"max_error": 0.01, "chunk_seconds": 0.5}),
    "rotations-moved": (hinged_figures.with_translations(40), {"max_error": 0.01}),
    "rotations-free": (skeletal.random_motion(40, 9, 2), {"max_error": 0.001}),
    "rotations-limits": (with_limits(), {"mean_error": 0.005}),
    "numbered": (named(FEW, [f"M{i + 3}" for i in range(6)]), {"max_error": 0.01}),
    "prefixed": (named(FEW, [f"Ann:{name}" for name in FEW.names], rate=30000 / 1001), {"max_error": 0.01}),
    "odd-names": (named(FEW, [f"{i} \N{SNOWMAN} left" for i in range(6)]), {"max_error": 0.01}),
    "extras": (with_extras(), {"max_error": 0.01}),
    "one-frame": (replace(FEW, positions=FEW.positions[:1]), {"max_error": 0.01}),
    "all-gaps": (replace(FEW, positions=np.full_like(FEW.positions, np.nan)), {"max_error": 0.01}),
    "still": (replace(FEW, positions=np.zeros_like(FEW.positions)), {"max_error": 0.01}),
}

PERFORMANCE = sequences.jumping_jacks(actors.capsules(), 4)
PERSON = sequences.record(PERFORMANCE, 900, seed=5)
SCATTERED = mc.PointClouds([np.random.default_rng(k).normal(size=(60 * (k != 1), 3)) for k in range(3)], 15.0)
BODY = {"skeleton": PERFORMANCE.skeleton()}
LIEN: dict[str, Any] = {**BODY, "codec": Lien2006}
POINT_CLOUDS: dict[str, tuple[mc.PointClouds, dict[str, Any]]] = {
    "points-bounded": (PERSON, {**BODY, "max_error": 0.004, "psnr": 40}),
    "points-uncoloured": (replace(PERSON, colours=None), {**BODY, "max_error": 0.01}),
    "points-chunks": (PERSON, {**BODY, "max_error": 0.008, "psnr": 30, "chunk_frames": 2}),
    "points-exact": (PERSON, {**BODY, "residual": "exact"}),
    "points-millimetres": (PERSON, {**BODY, "residual": "exact", "precision": 0.001}),
    "surface": (PERSON, BODY),
    "surface-chunks": (PERSON, {**BODY, "chunk_frames": 2, "residual": 8}),
    "surface-and-ball": (with_ball(PERSON), BODY),
    "surface-uncoloured": (replace(PERSON, colours=None), BODY),
    "lien2006": (PERSON, LIEN),
    "lien2006-maps": (PERSON, {**LIEN, "residual": 60, "chunk_frames": 3}),
    "lien2006-uncoloured": (replace(PERSON, colours=None), {**LIEN, "residual": 30}),
    "points-scattered": (SCATTERED, {"max_error": 0.01}),
    "points-scattered-exact": (SCATTERED, {"residual": "exact"}),
}
"""Point clouds of every form."""


def test_frames_and_signals_are_those_of_python(tmp_path: Path) -> None:
    """In one test, since all files are encoded and decoded in one run of Node."""
    for name, (motion, options) in RECORDINGS.items():
        settings = {key: value for key, value in options.items() if key != "codec"}
        codec = options.get("codec") or Tempo(**settings)
        data = mc.encode(motion, codec=codec, **(settings if "codec" in options else {}))
        (tmp_path / f"{name}.mocz").write_bytes(data)
    for name, (clouds, settings) in POINT_CLOUDS.items():
        options = {key: value for key, value in settings.items() if key != "codec"}
        (tmp_path / f"{name}.mocz").write_bytes(mc.encode(clouds, settings.get("codec", Bodycast)(**options)))
    module = tmp_path / "mocodec.mjs"
    node("scripts/build.mjs", module)
    node("scripts/decode.mjs", module, PRIORS, tmp_path, *sorted(tmp_path.glob("*.mocz")), *CLOUDS)
    for name in RECORDINGS:
        compare(tmp_path, name)
    for name in POINT_CLOUDS:
        compare_points(tmp_path, name)
    compare_signals(tmp_path, "extras")
    for path in CLOUDS:
        compare_poses(tmp_path, path)


def compare(folder: Path, name: str) -> None:
    said = json.loads((folder / f"{name}.json").read_text())
    assert "error" not in said, f"{name}: {said['message']}"
    wanted = mc.decode(folder / f"{name}.mocz", Motion)
    info = said["info"]
    assert (info["rate"], info["up"], info["names"]) == (wanted.rate, wanted.up, list(wanted.names)), name
    positions = np.fromfile(folder / f"{name}.positions").reshape(wanted.positions.shape)
    np.testing.assert_allclose(positions, wanted.positions, rtol=0, atol=TOLERANCE_M, err_msg=name)
    if info["codec"] == "lossless":
        assert positions.tobytes() == wanted.positions.tobytes(), name
    if wanted.skeleton is not None:
        assert info["skeleton"]["parents"] == list(wanted.skeleton.parents), name
        assert list(info["skeleton"]["offsets"].values()) == wanted.skeleton.offsets.ravel().tolist(), name
    if wanted.rotations is not None:
        rotations = np.fromfile(folder / f"{name}.rotations").reshape(wanted.rotations.shape)
        alike = np.abs((rotations * wanted.rotations).sum(axis=2))
        np.testing.assert_allclose(alike, 1, rtol=0, atol=1e-12, err_msg=name)
    with mc.open(folder / f"{name}.mocz", Motion) as f:
        marks = viewer_marks.marks(of_file(name, f))
    assert said["marks"] == {mark["label"]: mark["frames"] for mark in marks}, name
    events = wanted.extras.get("events", [])
    assert [event["time"] for event in said["events"]] == [event["time_s"] for event in events], name


def compare_signals(folder: Path, name: str) -> None:
    said = json.loads((folder / f"{name}.json").read_text())
    found = dict(channels.signals(mc.decode(folder / f"{name}.mocz", Motion).extras))
    labels = [signal["path"].split(".")[-1] for signal in said["signals"]]
    assert labels == list(found)
    for i, label in enumerate(labels):
        wanted = np.asarray(found[label].values)
        values = np.fromfile(folder / f"{name}.signal-{i}").reshape(wanted.shape)
        np.testing.assert_array_equal(values, wanted.astype(np.float64), strict=True)


def compare_points(folder: Path, name: str) -> None:
    said = json.loads((folder / f"{name}.json").read_text())
    wanted = mc.decode(folder / f"{name}.mocz", mc.PointClouds)
    assert said.get("points") == [len(points) for points in wanted.positions], name
    positions = np.fromfile(folder / f"{name}.positions").reshape(-1, 3)
    np.testing.assert_allclose(positions, np.concatenate(wanted.positions), rtol=0, atol=1e-9, err_msg=name)
    colours = np.fromfile(folder / f"{name}.colours", np.uint8).reshape(-1, 3)
    np.testing.assert_array_equal(colours, np.concatenate(wanted.colours or [np.zeros((0, 3), np.uint8)]), err_msg=name)


def compare_poses(folder: Path, path: Path) -> None:
    """Origins and tips of links are joints that the codec tracks."""
    bodies = json.loads((folder / f"{path.stem}.json").read_text())["bodies"]
    with mc.open(path) as f:
        encoded: Any = f.encoded
    for i, body in enumerate(bodies):
        wanted = Bodycast.track(encoded, body=i) if encoded.codec == "bodycast" else Lien2006.track(encoded)
        found = np.fromfile(folder / f"{path.stem}.poses-{i}").reshape(len(wanted), len(body["names"]), 2, 3)
        shown = ~np.isnan(found[:, 0, 0, 0])
        assert shown.any(), path.stem
        for link, name in enumerate(body["names"]):
            for end, joint in enumerate((name, f"{name}_end")):
                if joint in wanted.names:
                    tracked = wanted.positions[shown, wanted.names.index(joint)]
                    np.testing.assert_allclose(
                        found[shown, link, end], tracked, rtol=0, atol=TOLERANCE_M, err_msg=path.stem
                    )


def test_its_own_tests_pass() -> None:
    node("node_modules/typescript/bin/tsc")
    node("node_modules/vitest/vitest.mjs", "run")


def test_its_tables_are_those_of_the_package() -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    script = DECODER / "scripts" / "tables.py"
    subprocess.run([sys.executable, script, "--check"], check=True, env=environment)
