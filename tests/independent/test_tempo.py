"""docs/payloads/tempo.md and tempo-models.md hold all that a decoder of tempo needs."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec.codecs.tempo import Tempo, header
from mocodec.codecs.tempo.models.skeleton_correspondence import rest_metric
from mocodec.codecs.tempo.pose import bone_directions
from mocodec.codecs.tempo.pose.bone_tree import BoneTree
from mocodec.encoded import Encoded
from mocodec.entropy import coder
from mocodec.motion import Motion
from mocodec.testing import edge_cases, synthetic

from . import motions, tempo
from .integers import integers
from .trees import Tree, metric


def check(encoded: Encoded[Any]) -> header.StreamHeader:
    """Both decoders agree. Returns the header."""
    like = encoded.about
    bones = (None, None) if like.skeleton is None else (list(like.skeleton.parents), like.skeleton.offsets)
    chunks = [(c.frames, c.payload) for c in encoded.chunks]
    found = tempo.decode(encoded.shared[0], chunks, tempo.Recording(like.names, like.rate, like.up, *bones))
    np.testing.assert_allclose(found, Tempo.decode(encoded).positions, rtol=0, atol=1e-9)
    return header.StreamHeader.unpack(encoded.shared, like.points)


def with_holes(motion: Motion) -> Motion:
    """With gaps, a spike, and a leap."""
    positions = motion.positions.copy()
    positions[len(positions) // 2 :] += (0.4, 0.3, -0.2)
    positions[10, 3] += 0.7
    positions[20:29, 5] = np.nan
    positions[:4, 0] = np.nan
    return replace(motion, positions=positions)


GOLDEN = sorted((Path(__file__).parents[1] / "golden").glob("tempo-*.mocz"))
PAGE = Path(__file__).parents[2] / "docs" / "payloads" / "tempo.md"
MARKERS = synthetic.markers(frames=120, seed=3)
FEW_MARKERS = MARKERS.select(["C7", "LSHO", "RSHO", "LKNE", "LTOE", "RTOE"])
NAMED = motions.named_joints(150)


@pytest.mark.parametrize("path", GOLDEN, ids=lambda path: path.stem)
def test_golden_files(path: Path) -> None:
    with mc.open(path) as f:
        check(f.encoded)


@pytest.mark.parametrize(
    ("motion", "options"),
    [
        (motions.named_points(100), {"model": "points-prior"}),
        (replace(MARKERS, rate=60.0), {"model": "points-prior"}),
        (MARKERS, {"model": "points-prior", "mean_error": 0.001}),
        (FEW_MARKERS, {"model": "points-stored", "max_error": 0.001}),
        (with_holes(FEW_MARKERS), {"model": "points-stored", "mean_error": 0.002}),
        (NAMED, {"model": "points-prior", "max_error": 0.02}),
        (NAMED, {"model": "points-stored", "max_error": 0.001}),
        (NAMED, {"model": "directions-prior", "max_error": 0.001}),
        (replace(NAMED, skeleton=None), {"model": "directions-prior", "max_error": 0.003}),
        (motions.renamed_joints(160, with_skeleton=True), {"model": "directions-prior"}),
        (motions.renamed_joints(160, with_skeleton=False, shuffled=True), {"model": "directions-prior"}),
        (
            motions.renamed_joints(90, True, ("lhipjoint", "rfingers", "upperneck"), size=0.03),
            {"model": "directions-prior"},
        ),
        (motions.renamed_joints(90, False, ("lhipjoint", "rtoes"), size=0.03), {"model": "directions-prior"}),
        (motions.with_tails(90), {"model": "directions-prior"}),
        (motions.with_tails(90), {"model": "directions-stored"}),
        (replace(motions.with_tails(90), skeleton=None), {"model": "directions-prior"}),
        (motions.renamed_joints(90, with_skeleton=True), {"model": "directions-stored", "max_error": 0.001}),
        (motions.renamed_joints(200, False, shuffled=True), {"model": "directions-stored", "max_error": 0.003}),
        (FEW_MARKERS, {"model": "direct", "max_error": 0.002}),
        (MARKERS, {"model": "direct", "max_error": 0.0001}),
        (FEW_MARKERS, {"model": "hou2014"}),
    ],
)
def test_every_model(motion: Motion, options: dict[str, Any]) -> None:
    found = check(Tempo(**options).encode(motion))
    assert (found.model or ("hou2014" if found.fallback is not None else "direct")) == options["model"]


@pytest.mark.parametrize("model", ["points-prior", "points-stored", "direct"])
def test_weights(model: str) -> None:
    weights = dict.fromkeys(MARKERS.names[:6], 5.0)
    assert check(Tempo(model=model, max_error=0.008, weights=weights).encode(MARKERS)).weights


@pytest.mark.parametrize("model", ["points-stored", "direct", "hou2014"])
def test_repeats(model: str) -> None:
    irregular = np.repeat(np.arange(60), np.random.default_rng(1).integers(1, 5, 60))
    for frames in (np.repeat(np.arange(60), 3), irregular, np.repeat([7], 200)):
        motion = replace(FEW_MARKERS, positions=FEW_MARKERS.positions[frames])
        assert check(Tempo(model=model, chunk_seconds=0.5).encode(motion)).millihertz is not None


@pytest.mark.parametrize("up", ["x", "y", "z"])
@pytest.mark.parametrize("target", [{"max_error": 0.0005}, {"max_error": 0.03}, {"mean_error": 0.003}, {"ratio": 20.0}])
def test_gaps_spikes_leaps_and_every_axis(up: str, target: dict[str, Any]) -> None:
    check(Tempo(chunk_seconds=0.7, **target).encode_chunks(replace(with_holes(FEW_MARKERS), up=up)))


@pytest.mark.parametrize("target", [{}, {"mean_error": 0.003}, {"model": "direct"}, {"model": "hou2014"}])
def test_frozen_runs(target: dict[str, Any]) -> None:
    check(Tempo(chunk_seconds=0.5, **target).encode(replace(edge_cases.motion("parked"), up="x")))


def test_the_example_of_the_page() -> None:
    example = PAGE.read_text(encoding="utf-8").split("## An example")[1]
    blocks = re.findall(r"(?:^    .+\n)+", example, re.MULTILINE)
    shared, chunk, poses, direct_chunk, direct_poses = blocks
    like = tempo.Recording(("A", "B"), 30.0, "y")
    for head, payload, wanted in ((shared, chunk, poses), ("04", direct_chunk, direct_poses)):
        found = tempo.decode(bytes.fromhex(head), [(24, bytes.fromhex(payload))], like)
        frames = np.array(wanted.split(), float).reshape(2, 2, 3)
        np.testing.assert_allclose(found[[0, -1]], frames, rtol=0, atol=1e-9)


def test_chunks_without_coefficients() -> None:
    still = replace(FEW_MARKERS, positions=np.zeros_like(FEW_MARKERS.positions))
    for model in ("points-stored", "direct"):
        check(Tempo(model=model).encode_chunks(still))


def test_trees_with_hubs_and_bones_relative_to_each_other_and_bones_without_length() -> None:
    rng = np.random.default_rng(3)
    parents = [-1, 0, 0, 1, 1, 1, 3, 4, 4, 4, 8, 10]
    hub = np.isin(np.arange(12), [1, 2, 3, 5, 7, 9])
    for relative in (hub, ~hub, rng.random(12) < 0.5, np.ones(12, bool)):
        vectors = rng.normal(size=(12, 3))
        vectors[10] = 0
        own, theirs = Tree(parents, vectors, hub, relative), BoneTree(tuple(parents), vectors, hub, relative)
        coordinates = rng.normal(size=(20, own.dimensions))
        assert own.dimensions == theirs.dimensions
        np.testing.assert_allclose(own.positions(coordinates), bone_directions.inverse(theirs, coordinates), atol=1e-9)
        offsets = rng.normal(size=(12, 3))
        np.testing.assert_allclose(own.resized(offsets).vectors, theirs.with_offsets(offsets).vectors, atol=1e-9)
        np.testing.assert_array_equal(metric(own), rest_metric(theirs))


@pytest.mark.parametrize("shape", [(60, 3), (90, 90), (400, 6), (6, 400)])
def test_coded_integers_with_contexts(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(4)
    contexts = np.rint(10 ** rng.uniform(0, 3, shape[0])).astype(np.int64)
    values = np.rint(rng.laplace(size=shape) * contexts[:, None]).astype(np.int64)
    packed = coder.pack(values, contexts=np.repeat(contexts[:, None], shape[1], axis=1))
    assert len(packed) < len(coder.pack(values))
    np.testing.assert_array_equal(integers(packed, shape[0], shape[1], contexts.tolist()), values)


@pytest.mark.parametrize("rate", [7.3, 24.0, 240.0, 1000.0])
def test_frame_rates(rate: float) -> None:
    check(Tempo(model="points-stored", chunk_seconds=0.5).encode(replace(FEW_MARKERS, rate=rate)))


@pytest.mark.parametrize("frames", [1, 2, 3, 4, 17, 33])
def test_short_recordings(frames: int) -> None:
    for model in ("direct", "points-prior"):
        check(Tempo(model=model).encode(motions.named_points(frames)))
