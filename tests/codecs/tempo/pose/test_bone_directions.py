"""Poses to directions of bones, and back."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.tempo.pose import bone_directions
from mocodec.codecs.tempo.pose.bone_tree import BoneTree

from ..motions import body, smooth


def test_poses_come_back_from_their_coordinates() -> None:
    tree = body()
    given = smooth(300, tree.dimensions, 3)
    poses = bone_directions.inverse(tree, given)
    assert bone_directions.forward(tree, poses) == pytest.approx(given, abs=1e-9)
    assert bone_directions.inverse(tree, bone_directions.forward(tree, poses)) == pytest.approx(poses, abs=1e-12)


def test_a_full_rotation_continues_instead_of_jumping_back() -> None:
    tree = body()
    given = np.zeros((200, tree.dimensions))
    given[:, 0] = np.linspace(0, 1.5 * np.pi, 200)
    given[:, -3] = np.linspace(0, 1.5 * np.pi, 200)
    poses = bone_directions.inverse(tree, given)
    found = bone_directions.forward(tree, poses)
    assert np.abs(np.diff(found, axis=0)).max() < 0.1
    assert bone_directions.inverse(tree, found) == pytest.approx(poses, abs=1e-9)


def test_the_metric_is_the_squared_movement_of_the_points() -> None:
    tree = body()
    given = smooth(20, tree.dimensions, 4)
    small = 1e-5 * np.random.default_rng(5).normal(size=given.shape)
    moved = ((bone_directions.inverse(tree, given + small) - bone_directions.inverse(tree, given)) ** 2).sum()
    metric = sum(s @ bone_directions.metric(tree, g[None]) @ s for s, g in zip(small, given, strict=True))
    assert metric == pytest.approx(moved, rel=1e-3)


def test_points_at_their_parent_have_no_coordinates() -> None:
    vectors = np.array([[0, 0, 0], [0, 0.4, 0], [0, 0, 0], [0, 0.3, 0.0]], float)
    chain = BoneTree((-1, 0, 1, 2), vectors, np.zeros(4, bool), np.array([False, False, False, True]))
    assert chain.dimensions == 4
    given = smooth(50, 4, 7)
    poses = bone_directions.inverse(chain, given)
    assert poses[:, 1] == pytest.approx(poses[:, 2])
    assert bone_directions.forward(chain, poses) == pytest.approx(given, abs=1e-9)


def with_a_relative_hub() -> BoneTree:
    """A chest and its two shoulders relative to the spine, and arms relative to the hub and to each other."""
    vectors = np.array(
        [[0, 0, 0], [0, 0.5, 0], [-0.2, 0.1, 0], [0.2, 0.1, 0.02], [-0.3, 0, 0], [0.3, 0, 0], [0.2, 0, 0.1]], float
    )
    hub, relative = np.array([0, 0, 1, 1, 0, 0, 0], bool), np.array([0, 0, 1, 1, 1, 1, 1], bool)
    return BoneTree((-1, 0, 1, 1, 2, 3, 5), vectors, hub, relative)


@pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")
@pytest.mark.parametrize("frames", [1, 3, 4, 203])
def test_compiled_coordinates_have_the_bits_of_numpy(frames: int) -> None:
    """Bases are fitted to them: of points that hardly move, the last bits decide about components."""
    for tree in (body(), with_a_relative_hub()):
        poses = bone_directions.inverse(tree, 3 * smooth(frames, tree.dimensions, 9))
        with native.without():
            expected = bone_directions.forward(tree, poses)
        np.testing.assert_array_equal(bone_directions.forward(tree, poses), expected)


def test_a_hub_may_be_relative_and_others_relative_to_it() -> None:
    tree = with_a_relative_hub()
    assert tree.dimensions == 2 * 4 + 3
    rest = bone_directions.inverse(tree, np.zeros((1, 11)))[0]
    assert rest[6] - rest[0] == pytest.approx(tree.vectors[[1, 3, 5, 6]].sum(axis=0))
    given = smooth(300, 11, 8)
    poses = bone_directions.inverse(tree, given)
    offsets = poses[:, [2, 3, 4, 5, 6]] - poses[:, [1, 1, 2, 3, 5]]
    assert np.sqrt((offsets**2).sum(axis=2)) == pytest.approx(np.tile(tree.lengths[2:], (300, 1)))
    assert bone_directions.forward(tree, poses) == pytest.approx(given, abs=1e-9)
    spine_only = given * (np.arange(11) < 2)  # all that is relative to the spine rotates with it
    rotated = bone_directions.inverse(tree, spine_only)
    chest = rotated[:, [2, 3, 4, 5, 6]] - rotated[:, [1]]
    assert np.linalg.norm(chest[:, :, None] - chest[:, None], axis=-1) == pytest.approx(
        np.tile(np.linalg.norm(chest[0, :, None] - chest[0, None], axis=-1), (300, 1, 1))
    )
    with native.without():
        np.testing.assert_array_equal(bone_directions.inverse(tree, given), poses)


def test_series_and_sines_agree() -> None:
    tree = body()
    given = smooth(1, tree.dimensions, 9)
    given[0, 0] = 1.0
    large = given.copy()
    large[0, 0] = 1.0 + 2 * np.pi  # the same rotation, if the other number is zero
    given[0, 1] = large[0, 1] = 0.0
    assert bone_directions.inverse(tree, large) == pytest.approx(bone_directions.inverse(tree, given), abs=1e-12)
