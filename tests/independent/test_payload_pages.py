"""docs/payloads/ holds all that a decoder needs: one written from these pages decodes what mocodec writes."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec.codecs.hou2014 import Hou2014Database
from mocodec.entropy import coder
from mocodec.stages import bounded, frozen, lattice
from mocodec.testing import edge_cases, synthetic

from . import payloads
from .integers import integers

GOLDEN = Path(__file__).parent.parent / "golden"
FILES = [f for f in sorted(GOLDEN.glob("*.mocz")) if f.name.startswith(("hou2014", "liu2006", "lossless"))]


def decode(encoded: Any) -> np.ndarray:
    about = encoded.about
    chunks = [(chunk.frames, chunk.payload) for chunk in encoded.chunks]
    shared = list(encoded.shared)
    if not shared:
        return payloads.gaps_only(chunks, about.points)
    if encoded.codec == "hou2014":
        parents = None if about.skeleton is None else list(about.skeleton.parents)
        return payloads.hou2014(shared, chunks, about.points, parents)
    if encoded.codec == "liu2006":
        return payloads.liu2006(shared, chunks, about.points, about.up)
    return payloads.lossless(shared, chunks, about.points)


def check(source: Path | bytes) -> None:
    with mc.open(source) as f:
        wanted, found = f[:].positions, decode(f.encoded)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_golden_files(path: Path) -> None:
    check(path)


@pytest.mark.parametrize(
    ("codec", "options"),
    [
        ("hou2014", {"max_error": 0.001}),
        ("hou2014", {"mean_error": 0.001}),
        ("hou2014", {"components": 8}),
        ("liu2006", {"max_error": 0.002, "initial_frames": 40, "ahead_frames": 30, "rise": 5.0}),
        ("liu2006", {"mean_error": 0.003}),
        ("lossless", {"chunk_seconds": 0.5}),
    ],
)
def test_frozen_runs(codec: str, options: dict[str, Any]) -> None:
    motion = edge_cases.motion("parked").select(["C7", "LSHO", "RSHO", "LKNE", "LTOE", "RTOE"])
    assert frozen.split(motion.positions).frozen.any()
    check(mc.encode(motion, codec=codec, **options))


@pytest.mark.parametrize(
    ("codec", "options"),
    [
        ("hou2014", {"segmentation": "adaptive", "clips": 3, "masking": 0.5, "components": 8}),
        ("hou2014", {"max_error": 0.001, "point_weights": {"C7": 4.0}, "unit": 0.001}),
        ("hou2014", {"compress_basis": False, "centre": False, "components": 5}),
        ("liu2006", {"max_error": 0.002, "initial_frames": 40, "ahead_frames": 30, "rise": 5.0}),
        ("lossless", {"chunk_seconds": 0.5}),
        ("lossless", {"chunk_seconds": 0.5, "float64": True}),
    ],
)
def test_other_settings(codec: str, options: dict[str, Any]) -> None:
    motion = synthetic.markers(frames=200, seed=3).select(["C7", "LSHO", "RSHO", "LKNE", "LTOE", "RTOE"])
    check(mc.encode(motion, codec=codec, **options))


@pytest.mark.parametrize("codec", ["hou2014", "liu2006", "lossless", "tempo"])
@pytest.mark.parametrize("points", [0, 5])
def test_motions_without_samples(codec: str, points: int) -> None:
    check(mc.encode(mc.Motion(np.full((40, points, 3), np.nan), 100.0), codec=codec))


@pytest.mark.skipif(not lattice.is_fast(), reason="encoders use the lattice engine with the compiled module")
@pytest.mark.parametrize("codec", ["hou2014", "liu2006"])
def test_corrections_by_the_lattice_engine(codec: str, monkeypatch: pytest.MonkeyPatch) -> None:
    motion = edge_cases.motion("parked")[:90].select(["C7", "LSHO", "RSHO", "LKNE", "LTOE", "RTOE"])
    noise = np.random.default_rng(5).normal(0, 0.0005, motion.positions.shape)
    positions = np.where(frozen.split(motion.positions).frozen[..., None], motion.positions, motion.positions + noise)
    positions[30:44, 2] = np.nan
    for limit, share in {"RUNS_UP_TO": 0, "DENSE_FROM": 1, "ENGINE_FROM": 0}.items():
        monkeypatch.setattr(bounded, limit, share)
    settings = {"initial_frames": 40, "ahead_frames": 30} if codec == "liu2006" else {}
    check(mc.encode(mc.Motion(positions, motion.rate, motion.names), codec=codec, max_error=0.0001, **settings))


def test_transforms_of_a_database() -> None:
    motion = synthetic.markers(frames=200, seed=3).select(["C7", "LSHO", "RSHO", "LKNE"])
    database = Hou2014Database(components=4, clip_frames=40, transforms=2)
    check(mc.encode(motion, codec=database.fit([motion]).codec(motion)))


def test_floats_that_lie_on_no_grid() -> None:
    motion = synthetic.markers(frames=60, seed=4).select(["C7", "LSHO"])
    check(mc.encode(mc.Motion(motion.positions.astype(np.float32) / 3, 120.0), codec="lossless"))


SHAPES = [(1, 1), (7, 3), (3, 50), (130, 67), (67, 140), (2500, 4)]
LARGE = 1e13
"""A scale of integers whose bits take the page's decoder seconds, so that they come in the smaller shapes."""


@pytest.mark.parametrize(
    ("scale", "shape"), [*itertools.product([0.5, 60], SHAPES), *itertools.product([LARGE], SHAPES[:3])]
)
def test_coded_integers(shape: tuple[int, int], scale: float) -> None:
    values = np.rint(np.random.default_rng(1).laplace(scale=scale, size=shape)).astype(np.int64)
    np.testing.assert_array_equal(integers(coder.pack(values), *shape), values)


def test_coded_integers_that_are_differences_or_mostly_zero() -> None:
    random = np.random.default_rng(2)
    walk = random.integers(-3, 4, (2100, 4)).cumsum(axis=0)
    sparse = np.zeros((900, 20), np.int64)
    sparse[random.integers(0, 900, 60), random.integers(0, 20, 60)] = 5
    for values in (walk, walk[:100], sparse):
        np.testing.assert_array_equal(integers(coder.pack(values), len(values), values.shape[1]), values)
