"""Joint limits of people: which joints have them, in any skeleton, and that people's poses are within them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec.codecs import bodycast
from mocodec.geometry import articulation, human_limits, joint_limits, limb_chains
from mocodec.geometry.articulation import Body
from mocodec.testing import actors, poses, sequences

LIMITED = {f"{side}{name}" for side in ("Left", "Right") for name in ("ForeArm", "Leg")}
FIRST = ("T", "A", "arms hanging", "walking", "seated, arms hanging")


def body_in(name: str) -> tuple[Body, sequences.Performance]:
    """The body of the actor in a pose of `poses.POSES`, and the pose."""
    act = poses.posed(actors.capsules(), *poses.POSES[name])
    motion = act.skeleton()
    assert motion.skeleton is not None
    return articulation.from_skeleton(motion.names, motion.skeleton.parents, motion.positions[0]), act


def excess(body: Body, first: sequences.Performance, act: sequences.Performance) -> dict[str, float]:
    """Radians by which each link is beyond its limits in the pose of `act`; the body is in that of `first`."""
    limits, names = human_limits.of_body(body), act.actor.names
    world = np.stack([act.turns[0, names.index(n)] @ first.turns[0, names.index(n)].T for n in body.names])
    rotations = np.stack([world[link] if p < 0 else world[p].T @ world[link] for link, p in enumerate(body.parents)])
    own = rotations[limits.links]
    allowed, _ = joint_limits.nearest_allowed(limits, own)
    beyond = np.linalg.norm(articulation.log(own @ allowed.transpose(0, 2, 1)), axis=1)
    return {body.names[link]: float(angle) for link, angle in zip(limits.links, beyond, strict=True)}


@pytest.mark.parametrize("name", FIRST)
def test_poses_of_people_are_within_the_limits(name):
    body, first = body_in(name)
    for other in poses.POSES:
        beyond = excess(body, first, body_in(other)[1])
        assert set(beyond) == LIMITED
        assert max(beyond.values()) < 0.07, other


@pytest.mark.parametrize("name", FIRST)
@pytest.mark.parametrize(("joint", "angle"), [("LeftLeg", -0.8), ("RightLeg", -0.8)])
def test_joints_that_bend_the_wrong_way_are_beyond_the_limits(name, joint, angle):
    body, first = body_in(name)
    straight = poses.posed(actors.capsules(), *poses.POSES["T"])
    names = straight.actor.names
    turns = straight.turns.copy()
    below = [names.index(joint)]
    for link, parent in enumerate(straight.actor.parents):
        if parent in below:
            below.append(link)
    turns[:, below] = articulation.exp(np.array([angle, 0, 0])) @ turns[:, below]
    assert excess(body, first, replace(straight, turns=turns))[joint] > 0.3


def test_an_elbow_does_not_bend_backwards():
    body, first = body_in("arms hanging")
    pose = poses.DOWN + 0.1 * poses.OUT, poses.DOWN - poses.FORWARD, *poses.STAND
    beyond = excess(body, first, poses.posed(actors.capsules(), pose))
    assert beyond["LeftForeArm"] > 0.3
    assert beyond["RightForeArm"] > 0.3


def test_names_are_not_needed():
    body, first = body_in("slight crouch")
    unnamed = replace(body, names=tuple(f"joint{link}" for link in range(len(body))))
    expected, found = human_limits.of_body(body), human_limits.of_body(unnamed)
    np.testing.assert_array_equal(found.links, expected.links)
    np.testing.assert_allclose(found.table, expected.table, atol=1e-12)
    smpl = {"LeftUpLeg": "left_hip", "LeftLeg": "left_knee", "LeftArm": "left_shoulder", "LeftForeArm": "left_elbow"}
    smpl |= {name.replace("Left", "Right"): other.replace("left", "right") for name, other in smpl.items()}
    named = replace(body, names=tuple(smpl.get(name, name) for name in body.names))
    np.testing.assert_allclose(human_limits.of_body(named).table, expected.table)
    assert first.actor.name == "capsules"


@pytest.mark.parametrize(("left", "right"), [("lfemur", "rfemur"), ("L_Hip", "R_Hip"), ("left_hip", "right_hip")])
def test_sides_are_told_by_names(left, right):
    body, _ = body_in("T")
    pair = {"LeftUpLeg": left, "RightUpLeg": right}
    named = replace(body, names=tuple(pair.get(name, name) for name in body.names))
    np.testing.assert_allclose(human_limits.of_body(named).table, human_limits.of_body(body).table)


def test_other_bodies_have_no_limits():
    places = np.array([[0.0, 0, 0], [0, 1, 0], [0, 2, 0]])
    chain = articulation.from_skeleton(("a", "b", "c"), (-1, 0, 1), places)
    assert not len(human_limits.of_body(chain).links)
    body, _ = body_in("T")
    legless = [link for link, name in enumerate(body.names) if "Leg" not in name and "Foot" not in name]
    parents = tuple(legless.index(body.parents[link]) if body.parents[link] >= 0 else -1 for link in legless)
    torso = Body(
        tuple(body.names[link] for link in legless), parents, body.origins[legless], body.tips[legless],
        body.radii[legless],
    )  # fmt: skip
    assert not len(human_limits.of_body(torso).links)


def test_a_collarbone_does_not_begin_an_arm():
    body, _ = body_in("seated, arms hanging")
    assert {body.names[chain[0]] for chain in limb_chains.chains(body)} == {
        f"{side}{name}" for side in ("Left", "Right") for name in ("Arm", "UpLeg")
    }


def test_a_tracker_without_limits_of_its_skeleton_has_those_of_people():
    act = sequences.jumping_jacks(actors.capsules(), 2)
    clouds = sequences.record(act, 1500, seed=2)
    assert clouds.colours is not None
    body, tracker = bodycast.start_tracking(clouds.positions[0], clouds.colours[0], act.skeleton()[:1], "y", 2500)
    assert {body.names[link] for link in tracker.limits.links} == LIMITED
