"""Bone trees are found in poses."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.tempo.pose import bone_directions, tree_fitting

from ..motions import body, smooth


def test_a_tree_is_found_in_poses() -> None:
    tree = body()
    poses = bone_directions.inverse(tree, smooth(400, tree.dimensions, 6))
    found = tree_fitting.fit([poses[:200], poses[200:]], tree.parents)
    assert (found.hub == tree.hub).all()
    assert found.lengths == pytest.approx(tree.lengths, abs=1e-9)
    assert bone_directions.inverse(found, bone_directions.forward(found, poses)) == pytest.approx(poses, abs=1e-9)


def test_two_bodies_and_a_loop_are_not_one_tree() -> None:
    assert tree_fitting.topological_order((-1, 0, -1, 2)) is None
    assert tree_fitting.topological_order((2, 0, 1)) is None
    assert tree_fitting.topological_order((-1, 0, 5)) is None
    assert list(np.asarray(tree_fitting.topological_order((1, -1, 0)))) == [1, 0, 2]
