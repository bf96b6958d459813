"""Articulated bodies: rotation vectors, poses, and the links of skeletons."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.errors import BadInput
from mocodec.geometry import articulation as art
from mocodec.geometry import rigid

RNG = np.random.default_rng(3)


def test_exp_and_log_are_inverse_up_to_half_a_turn():
    axis = RNG.normal(size=(200, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    vectors = axis * np.concatenate([np.linspace(0, np.pi - 1e-6, 190), np.zeros(10)])[:, None]
    np.testing.assert_allclose(art.log(art.exp(vectors)), vectors, atol=1e-7)
    np.testing.assert_allclose(rigid.to_matrix(art.quaternions(art.exp(vectors))), art.exp(vectors), atol=1e-12)


def test_rotation_between_handles_opposite_directions():
    a = np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]])
    b = np.array([[-1.0, 0, 0], [0, 1, 0], [0, 1, 0]])
    np.testing.assert_allclose(np.einsum("nij,nj->ni", art.rotation_between(a, b), a), b, atol=1e-12)


def human() -> tuple[list[str], list[int], np.ndarray]:
    chain = [
        ("hips", -1, (0, 1, 0)), ("lhip", 0, (0.1, 1, 0)), ("lknee", 1, (0.1, 0.5, 0)), ("lankle", 2, (0.1, 0.1, 0)),
        ("ltoe", 3, (0.1, 0.05, 0.15)), ("ltip", 4, (0.1, 0.05, 0.2)), ("rhip", 0, (-0.1, 1, 0)),
        ("rknee", 6, (-0.1, 0.5, 0)), ("rankle", 7, (-0.1, 0.1, 0)), ("rtoe", 8, (-0.1, 0.05, 0.15)),
        ("rtip", 9, (-0.1, 0.05, 0.2)), ("spine", 0, (0, 1.2, 0)), ("chest", 11, (0, 1.4, 0)), ("neck", 12, (0, 1.5,
        0)), ("head", 13, (0, 1.6, 0)), ("top", 14, (0, 1.75, 0)), ("lcollar", 12, (0.03, 1.42, 0)),
        ("lshoulder", 16, (0.18, 1.42, 0)), ("lelbow", 17, (0.48, 1.42, 0)), ("lwrist", 18, (0.74, 1.42, 0)),
        ("lhand", 19, (0.92, 1.42, 0)), ("rcollar", 12, (-0.03, 1.42, 0)), ("rshoulder", 21, (-0.18, 1.42, 0)),
        ("relbow", 22, (-0.48, 1.42, 0)), ("rwrist", 23, (-0.74, 1.42, 0)), ("rhand", 24, (-0.92, 1.42, 0)),
    ]  # fmt: skip
    return [c[0] for c in chain], [c[1] for c in chain], np.array([c[2] for c in chain], float)


def test_trunk_is_one_link_or_several():
    names, parents, places = human()
    whole = art.from_skeleton(names, parents, places, one_trunk=True)
    assert set(whole.names) == {
        "hips", "lhip", "lknee", "lankle", "rhip", "rknee", "rankle", "neck",
        "lshoulder", "lelbow", "lwrist", "rshoulder", "relbow", "rwrist",
    }  # fmt: skip
    fine = art.from_skeleton(names, parents, places)
    assert {"spine", "chest", "lcollar"} <= set(fine.names)
    assert "ltip" not in fine.names
    foot = whole.names.index("lankle")
    np.testing.assert_allclose(whole.tips[foot], places[names.index("ltip")])
    np.testing.assert_allclose(whole.tips[0], places[names.index("chest")])


def test_raised_arms_do_not_change_the_links():
    names, parents, places = human()
    raised = places.copy()
    for side in "lr":
        arm = [names.index(side + part) for part in ("elbow", "wrist", "hand")]
        raised[arm] = raised[names.index(side + "shoulder")] + np.array([[0, 0.3, 0], [0, 0.56, 0], [0, 0.74, 0]])
    assert art.from_skeleton(names, parents, raised, one_trunk=True).names == (
        art.from_skeleton(names, parents, places, one_trunk=True).names
    )


def test_a_short_bone_of_a_hand_is_merged_with_it():
    names, parents, places = human()
    fingers = places[names.index("lhand")] + np.array([[0.06, 0, 0], [0.16, 0, 0]])
    names, parents = [*names, "lfingers", "lend"], [*parents, names.index("lhand"), len(names)]
    body = art.from_skeleton(names, parents, np.concatenate([places, fingers]), one_trunk=True, shortest=0.05)
    assert "lfingers" not in body.names


def test_pose_keeps_bone_lengths_and_is_recovered_from_world_rotations():
    names, parents, places = human()
    body = art.from_skeleton(names, parents, places)
    vectors = RNG.normal(scale=0.4, size=(len(body), 3))
    pose = art.Pose(art.exp(vectors), np.array([1.0, 2, 3]))
    a, b = art.transforms(body, pose)
    joints = art.joint_positions(body, a, b)
    bones = [i for i, p in enumerate(body.parents) if p >= 0]
    above = [body.parents[i] for i in bones]
    np.testing.assert_allclose(
        np.linalg.norm(joints[bones] - joints[above], axis=1),
        np.linalg.norm(body.origins[bones] - body.origins[above], axis=1),
    )
    again = art.pose_from_world(body, a, joints[0])
    np.testing.assert_allclose(again.rotations, pose.rotations, atol=1e-12)
    np.testing.assert_allclose(again.root, pose.root, atol=1e-12)


def test_too_small_skeletons_are_refused():
    with pytest.raises(BadInput, match="not a body"):
        art.from_skeleton(["a"], [-1], np.zeros((1, 3)))
    with pytest.raises(BadInput, match="not a body"):
        art.from_skeleton(["a", "b"], [-1, 0], np.zeros((2, 3)))
