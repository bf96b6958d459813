"""Training of tempo's priors on synthetic joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import folds
from mocodec import metrics
from mocodec.codecs.tempo import Tempo, training
from mocodec.codecs.tempo.header import StreamHeader
from mocodec.codecs.tempo.models import prior
from mocodec.codecs.tempo.pose import bone_directions
from mocodec.errors import UnknownCodec
from mocodec.motion import Motion, Skeleton
from mocodec.testing import synthetic
from mocodec.typing import Floats

JOINTS = prior.for_directions().joints
BOUND_M = 0.01
MOTIONS = [synthetic.joints(frames=240, seed=s) for s in range(3)]
NAMES = MOTIONS[0].names


def smooth(frames: int, columns: int, seed: int) -> Floats:
    """Slow waves (frames, columns) about as large as people's rotations, radians."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames)[:, None, None] / 120
    waves = rng.normal(0, 0.15, (columns, 4)) * np.sin(2 * np.pi * rng.uniform(0.1, 2.5, (columns, 4)) * t)
    return np.asarray(waves.sum(axis=2))


def rigid_bones(frames: int, seed: int) -> Motion:
    """A body with the joints of the package's prior and other proportions, and its skeleton."""
    scale = np.random.default_rng(seed).uniform(0.85, 1.15, (len(JOINTS.names), 1))
    tree = JOINTS.tree.with_offsets(JOINTS.tree.vectors * scale)
    positions = bone_directions.inverse(tree, smooth(frames, tree.dimensions, seed))
    return Motion(positions, 120.0, JOINTS.names, "y", Skeleton(JOINTS.names, tree.parents, tree.vectors))


def check_coding(motion: Motion, model: str, learned: prior.Prior) -> None:
    """Checks that the motion uses the learned prior and decodes within the bound."""
    encoded = Tempo(max_error=BOUND_M, model=model).encode_chunks(motion)
    header = StreamHeader.unpack(encoded.shared, motion.points)
    assert header.model == model
    assert header.fitted[: prior.ID_BYTES] == learned.id
    assert metrics.distances(motion.positions, Tempo.decode(encoded).positions).max() <= BOUND_M


def test_trained_points_encode_and_decode() -> None:
    people: Mapping[str, list[Motion]] = {"a": MOTIONS[:2], "b": MOTIONS[2:]}
    data = training.train_points(people)
    assert data == training.train_points(people)
    with prior.installed(points=data) as (points, directions):
        assert prior.for_points() is points
        assert directions is prior.for_directions()
        check_coding(MOTIONS[0], "points-prior", points)
        assert points.bones is not None
        assert points.bones.names == NAMES
        encoded = Tempo(max_error=BOUND_M, model="points-prior").encode_chunks(MOTIONS[0])
    assert prior.for_points() is not points
    with pytest.raises(UnknownCodec):
        Tempo.decode(replace(encoded, about=replace(encoded.about, rate=119.0)))


def test_trained_directions_encode_and_decode() -> None:
    people = {"a": [rigid_bones(240, 1), rigid_bones(240, 2)], "b": [rigid_bones(240, 3)]}
    data = training.train_directions(people)
    assert data == training.train_directions(people)
    with prior.installed(directions=data) as (points, directions):
        assert prior.for_directions() is directions
        assert points is prior.for_points()
        check_coding(rigid_bones(400, 4), "directions-prior", directions)


def test_priors_of_a_fold_are_kept_in_one_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "people", lambda folder, leave_out: {"a": MOTIONS})
    monkeypatch.setattr(training, "train_directions", lambda _: prior.packaged_bytes(prior.DIRECTIONS_FILE))
    path = folds.trained(tmp_path, ("02",))
    assert path == tmp_path / "prior-without-02"
    assert {file.name for file in path.iterdir()} == {prior.POINTS_FILE, prior.DIRECTIONS_FILE}
    monkeypatch.setattr(folds, "train", None)
    assert folds.trained(tmp_path, ("02",)) == path
    with folds.unseen(path):
        assert prior.for_points().joints.names == NAMES
    assert prior.for_points().joints.names != NAMES
