"""What is stored of a correspondence, and what the prior predicts by way of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from mocodec.codecs.tempo.models import ordered, skeleton_correspondence
from mocodec.codecs.tempo.models.coordinates import DirectionCoordinates
from mocodec.codecs.tempo.models.skeleton_correspondence import USUAL_LEVELS, Correspondence
from mocodec.codecs.tempo.pose import bone_directions
from mocodec.codecs.tempo.pose.bone_tree import BoneTree

from ..motions import JOINTS, NAMES, parents_without

LIKE = JOINTS.tree


def merged(gone: Sequence[int]) -> tuple[BoneTree, Correspondence, list[int]]:
    """The prior's tree without some joints; the correspondence; and the prior's joints in the order of the tree."""
    kept = [i for i in range(len(NAMES)) if i not in gone]
    joint = np.array(kept)
    marks = skeleton_correspondence.expected_marks(joint, LIKE)
    none = np.zeros((len(kept), 3), int)
    stored = Correspondence(10, tuple(parents_without(gone)), joint, marks, none, np.array(USUAL_LEVELS))
    rest, columns = skeleton_correspondence.rest_tree(stored, LIKE, None)
    return rest, stored, [kept[c] for c in columns]


def test_what_is_stored_comes_back() -> None:
    _, stored, _ = merged([12, 15])
    rng = np.random.default_rng(4)
    stored = replace(stored, vectors=np.where(stored.stored, rng.integers(-300, 300, stored.vectors.shape), 0))
    found = Correspondence.unpack(stored.pack(LIKE), len(stored.joint), LIKE)
    assert (found.digits, found.parents) == (stored.digits, stored.parents)
    for name in ("joint", "marks", "vectors", "levels"):
        assert (getattr(found, name) == getattr(stored, name)).all()


def test_the_metric_in_fixed_order_is_the_trees() -> None:
    rest, _, _ = merged([])
    known = bone_directions.metric(rest, np.zeros((1, rest.dimensions)))
    assert skeleton_correspondence.rest_metric(rest) == pytest.approx(known, abs=2e-6 * known.max())
    factor = ordered.cholesky(known + 1e-6 * np.eye(len(known)))
    assert factor @ factor.T == pytest.approx(known + 1e-6 * np.eye(len(known)), abs=1e-12)
    assert isinstance(JOINTS.coordinates, DirectionCoordinates)
    bases = JOINTS.statistics.bases
    unscaled = ordered.times_inverse(bases[0], JOINTS.coordinates.metric_root)
    assert unscaled == pytest.approx(JOINTS.coordinates.unscaled(bases)[0], abs=1e-9)


@pytest.mark.parametrize("gone", [[], [15], [12, 15, 20, 27], [1, 6, 20]])
def test_small_rotations_of_the_prior_are_small_rotations_of_the_file(gone: list[int]) -> None:
    rest, stored, kept = merged(gone)
    paths = skeleton_correspondence.bone_paths(np.array(kept), rest.parents, LIKE)
    mapping = skeleton_correspondence.coordinate_map(rest, paths, LIKE)
    angles = np.random.default_rng(5).normal(0, 1e-4, (4, LIKE.dimensions))
    poses = bone_directions.inverse(LIKE, angles)[:, kept]
    poses = poses - poses.mean(axis=1, keepdims=True)
    moving = [b for b in rest.schedule.bones if rest.parents[b] >= 0 and len(paths[b]) > 0]
    assert len(moving) == len(rest.schedule.bones)
    assert bone_directions.forward(rest, poses) == pytest.approx(angles @ mapping, abs=1e-6)
    assert len(stored.joint) == len(kept)
