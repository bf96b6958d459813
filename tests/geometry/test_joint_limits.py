"""Joint limits: which links of a body have them, the nearest allowed rotation, and the penalty towards it."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs import bodycast
from mocodec.geometry import articulated_icp, articulation, body_tracking, joint_limits, limb_chains, rigid, skinning
from mocodec.geometry.body_matching import FramePoints, Matcher, Step
from mocodec.geometry.gauss_newton import PosePrior
from mocodec.geometry.joint_limits import LinkLimits
from mocodec.motion import Limits, Motion, Skeleton
from mocodec.testing import actors, sequences

FREE = [-np.inf, np.inf]
FRAME, FIRST_ROTATION = (rigid.to_matrix(q / np.linalg.norm(q)) for q in np.random.default_rng(3).normal(size=(2, 4)))
"""The axis frame of a joint, and the world rotation of its body in the first pose."""


def limits_of(ranges, order: str = "xyz", frame=FRAME, first_rotation=FIRST_ROTATION) -> LinkLimits:
    """Limits, degrees, of the second of two links."""
    axes = articulation.quaternions(np.stack([np.eye(3), frame]))
    limits = Limits(("xyz", order), axes, np.stack([np.tile(FREE, (3, 1)), np.radians(np.array(ranges, float))]))
    places = np.array([[0.0, 0, 0], [0, 1, 0]])
    skeleton = Skeleton(("hip", "knee"), (-1, 0), places, limits)
    rotations = articulation.quaternions(np.stack([first_rotation, np.eye(3)]))
    motion = Motion(places[None], 30.0, skeleton.names, "y", skeleton, rotations[None])
    body = articulation.Body(skeleton.names, (-1, 0), places, places + places[1], np.full(2, 0.1), (0, 1))
    return joint_limits.of_links(body, motion)


def distance(limits: LinkLimits, rotations) -> np.ndarray:
    """(…, k): radians from the nearest allowed rotation."""
    allowed, _ = joint_limits.nearest_allowed(limits, rotations)
    return np.linalg.norm(articulation.log(rotations @ np.swapaxes(allowed, -1, -2)), axis=-1)


@pytest.mark.parametrize("order", ["xyz", "yzx", "zxy", "zyx", "yxz", "xzy"])
def test_ranges_hold_in_the_axis_frame_for_every_rotation_order(order):
    low, high = np.array([[-30, 40], [-20, 50], [-60, 10]]).T
    limits = limits_of(np.stack([low, high], axis=1), order)
    tolerance, rng = np.degrees(joint_limits.TOLERANCE_RAD), np.random.default_rng(1)
    seen = set[bool]()
    for _ in range(40):
        angles = rng.uniform(low - 2 * tolerance, high + 2 * tolerance)
        turn = FRAME @ rigid.to_matrix(rigid.from_euler(order, np.radians(angles))) @ FRAME.T
        is_inside = bool(((angles >= low - tolerance) & (angles <= high + tolerance)).all())
        assert (
            joint_limits.nearest_allowed(limits, (FIRST_ROTATION @ turn @ FIRST_ROTATION.T)[None])[1].item()
            != is_inside
        )
        seen.add(is_inside)
    assert len(seen) == 2


def test_nearest_allowed_is_nearer_than_other_allowed_rotations():
    limits = limits_of([[-20, 100], [-50, 80], [-10, 30]])
    rng = np.random.default_rng(2)
    random_rotations = articulation.exp(rng.normal(size=(60, 1, 3)))
    allowed, outside = joint_limits.nearest_allowed(limits, random_rotations)
    assert outside.any()
    assert not outside.all()
    assert np.array_equal(allowed[~outside], random_rotations[~outside])
    assert distance(limits, allowed).max() < 1e-6
    angles = limits.centre + rng.uniform(-1, 1, size=(4000, 3)) * limits.half_width
    some = rigid.to_matrix(rigid.from_euler("xyz", angles))
    some = limits.before.transpose(0, 2, 1) @ some @ limits.after.transpose(0, 2, 1)
    likeness = np.einsum("nij,mij->nm", random_rotations[:, 0], some)
    found = np.einsum("nij,nij->n", random_rotations[:, 0], allowed[:, 0])
    assert (found > likeness.max(axis=1) - 1e-3).all()


def test_nearest_allowed_is_continuous_near_gimbal_lock():
    limits = limits_of([[-10, 10], [-100, 100], [-170, 170]], frame=np.eye(3), first_rotation=np.eye(3))
    for middle in np.radians(
        [89.9, 90.0, 90.1]
    ):  # the first angle is far beyond its range, but the last one compensates for it
        turn = rigid.to_matrix(rigid.from_euler("xyz", np.array([2.0, middle, -1.9])))
        assert distance(limits, turn[None]).max() < 0.01


def test_whole_turns_and_open_ranges_are_free():
    assert not len(limits_of([FREE, FREE, FREE]).links)
    limits = limits_of([[-np.inf, 20], [-180, 180], [-5, 5]], frame=np.eye(3), first_rotation=np.eye(3))
    assert np.isinf(limits.half_width[0, :2]).all()
    angles = np.stack([np.linspace(-7, 7, 9), np.linspace(-4, 4, 9), np.zeros(9)], axis=1)
    turns = rigid.to_matrix(rigid.from_euler("xyz", angles))
    assert not joint_limits.nearest_allowed(limits, turns[:, None])[1].any()


def test_a_range_is_widened_to_contain_the_first_pose():
    for range_x in ([20, 60], [-60, -20], [170, 260]):
        limits = limits_of([range_x, [-5, 5], [0, 0]], frame=np.eye(3), first_rotation=np.eye(3))
        still = np.eye(3)[None]
        assert not joint_limits.nearest_allowed(limits, still)[1].any()
        here = articulation.exp(np.radians([[np.mean(range_x), 0, 0]]))
        assert not joint_limits.nearest_allowed(limits, here)[1].any()


@pytest.mark.parametrize(("merged", "expected"), [((), ("thigh", "shin")), (("toe",), ("thigh", "shin", "foot"))])
def test_links_of_several_joints_have_no_limits(merged, expected):
    """Bones as in an ASF: a link that begins where a bone ends moves as the bone that begins there."""
    names = ("root", "hip", "thigh", "shin", "foot", "toe", "back", "arm", "arm2", "neck")
    parents = (-1, 0, 1, 2, 3, 4, 0, 6, 7, 6)
    ranges = np.tile([-0.5, 0.5], (10, 3, 1))
    ranges[[1, *(names.index(name) for name in merged)]] = 0.0  # these are fixed
    limits = Limits(("zyx",) * 10, np.tile([1.0, 0, 0, 0], (10, 1)), ranges)
    skeleton = Skeleton(names, parents, np.zeros((10, 3)), limits)
    rest = np.tile([1.0, 0, 0, 0], (1, 10, 1))
    motion = Motion(np.zeros((1, 10, 3)), 30.0, names, "y", skeleton, rest, {"format": "amc"})
    joints = (0, 1, 2, 3, 6, 7)  # what begins in the foot's end is merged into the shin's, the arm's into one
    body = articulation.Body(
        tuple(names[j] for j in joints), (-1, 0, 1, 2, 0, 4), np.zeros((6, 3)), np.ones((6, 3)), np.ones(6), joints
    )
    found = joint_limits.of_links(body, motion)
    moves_as = {"hip": "thigh", "thigh": "shin", "shin": "foot", "arm": "arm2"}
    assert tuple(moves_as[body.names[link]] for link in found.links) == expected
    ordinary = joint_limits.of_links(body, replace(motion, source={}))  # joints that rotate the bones below them
    assert "shin" not in {body.names[link] for link in ordinary.links}
    assert "thigh" in {body.names[link] for link in ordinary.links}


def test_skeletons_without_limits_give_none(scene):
    _, body, _, _, motion, _ = scene
    assert not len(joint_limits.of_links(body, replace(motion, skeleton=replace(motion.skeleton, limits=None))).links)
    assert not len(joint_limits.of_links(body, replace(motion, rotations=None)).links)


@pytest.fixture(scope="module")
def scene():
    """Points of a body whose knees and elbows bend about one axis, by half a radian at most."""
    performance = sequences.jumping_jacks(actors.capsules(), 4)
    clouds = sequences.record(performance, 1500, seed=2)
    motion = performance.skeleton()
    skeleton = motion.skeleton
    assert skeleton is not None
    ranges = np.tile(FREE, (len(skeleton), 3, 1))
    for name in ("LeftForeArm", "RightForeArm", "LeftLeg", "RightLeg"):
        ranges[skeleton.names.index(name)] = [[0, 0.5], [0, 0], [0, 0]]
    for joint, name in enumerate(skeleton.names):
        if any(part in name for part in ("Hand", "Foot", "Toe")):
            ranges[joint] = 0.0  # fixed, so that they can be merged with joints that move
    axes = np.tile([1.0, 0, 0, 0], (len(skeleton), 1))
    skeleton = replace(skeleton, limits=Limits(("xyz",) * len(skeleton), axes, ranges))
    motion = replace(motion[:1], skeleton=skeleton)
    body = articulation.from_skeleton(skeleton.names, skeleton.parents, motion.positions[0])
    limits = joint_limits.of_links(body, motion)
    body, model = articulated_icp.make_model(body, clouds.positions[0], None, by_surface=True)
    return clouds, body, model, skinning.skin(body, model.points, model.links), motion, limits


def matcher_of(scene) -> tuple[Matcher, FramePoints]:
    clouds, body, model, skin, _, _ = scene
    some = np.random.default_rng(0).permutation(len(skin.points))[:300]
    return Matcher(body, skin, model.normals, None, some, 0.1, 0.01), FramePoints.build(clouds.positions[2], None, None)


def bent(scene, by: float = 1.2) -> articulation.Pose:
    """A pose with all joints rotated at random."""
    turns = np.random.default_rng(1).normal(scale=by, size=(len(scene[1]), 3))
    return articulation.Pose(articulation.exp(turns), np.array([0.02, 0.01, -0.03]))


def prior_of(scene, turn: float, beyond: float) -> PosePrior:
    links = len(scene[1])
    still = articulation.Pose.canonical(links).rotations
    return PosePrior(np.full(links, turn), np.zeros(links), still, 0.0, scene[5], beyond)


def test_the_penalty_has_the_gradient_of_the_squared_distance(scene):
    with native.without():
        matcher, _ = matcher_of(scene)
    body, limits, pose = scene[1], scene[5], bent(scene)
    prior, size = prior_of(scene, 0.0, 100.0), 3 + 3 * len(body)
    a, _ = articulation.transforms(body, pose)
    h, g = np.zeros((size, size)), np.zeros(size)
    matcher.equations.add_priors(h, g, pose, pose, a, prior, np.zeros((len(limits.links), 3)))

    def cost(turns) -> float:
        above = np.stack([np.eye(3) if p < 0 else a[p] for p in body.parents])
        turned = articulation.exp(np.einsum("lji,lj->li", above, turns)) @ pose.rotations
        return 50.0 * float((distance(limits, turned[limits.links]) ** 2).sum())

    expected = np.zeros((len(body), 3))
    for link in range(len(body)):
        for axis in range(3):
            step = np.zeros((len(body), 3))
            step[link, axis] = 1e-4
            expected[link, axis] = (cost(step) - cost(-step)) / 2e-4
    assert np.abs(expected[limits.links]).max() > 10
    np.testing.assert_allclose(-g[3:].reshape(-1, 3), expected, atol=0.05)
    own = h[3:, 3:].reshape(len(body), 3, len(body), 3)
    for link in range(len(body)):  # about one axis only, and none for a link without limits
        strengths = np.linalg.eigvalsh(own[link, :, link])
        np.testing.assert_allclose(strengths, [0, 0, 100.0 if link in limits.links else 0], atol=1e-9)


@pytest.mark.parametrize("numpy_alone", [True, False])
def test_a_joint_beyond_its_limits_returns(scene, numpy_alone):
    with native.without() if numpy_alone else nullcontext():
        matcher, _ = matcher_of(scene)
        nothing = FramePoints.build(np.zeros((0, 3)), None, None)
        start, limits = bent(scene, 0.5), scene[5]
        assert distance(limits, start.rotations[limits.links]).max() > 0.4
        for steps in (4, 5):  # and remains within them
            pose = matcher.solve(
                nothing, start, [Step(0.05, 1, 0)] * steps, prior_of(scene, 1.0, 1e3)._replace(root_strength=1.0)
            )
            assert distance(limits, pose.rotations[limits.links]).max() < 0.05
    others = np.setdiff1d(np.arange(len(scene[1])), limits.links)
    np.testing.assert_allclose(pose.rotations[others], start.rotations[others], atol=1e-9)


def test_limits_do_not_affect_poses_within_them(scene):
    matcher, data = matcher_of(scene)
    limits = scene[5]
    wide = replace(limits, half_width=np.maximum(limits.half_width, 3.0))
    prior = prior_of(scene, 1.0, 100.0)
    start = articulation.Pose.canonical(len(scene[1]))
    steps = [Step(width, 1500, 300) for width in (0.1, 0.05, 0.02)]
    expected = matcher.solve(data, start, steps, prior._replace(limits=joint_limits.NO_LIMITS))
    found = matcher.solve(data, start, steps, prior._replace(limits=wide))
    assert np.array_equal(found.rotations, expected.rotations)
    assert np.array_equal(found.root, expected.root)
    narrow = replace(limits, half_width=np.full_like(limits.half_width, 1e-3))
    pulled = matcher.solve(data, start, steps, prior._replace(limits=narrow))
    assert not np.array_equal(pulled.rotations, expected.rotations)


@pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or left aside")
def test_compiled_limits_equal_numpy(scene):
    fast, data = matcher_of(scene)
    with native.without():
        numpy_matcher, numpy_data = matcher_of(scene)
    prior = prior_of(scene, 1.0, 1e4)
    steps = [Step(0.2, 400, 100), Step(0.1, 1000, 300), Step(0.05, 1500, 200)]
    for by in (0.3, 1.2, 2.5):
        start = bent(scene, by)
        for number in range(1, 4):
            found = fast.solve(data, start, steps[:number], prior)
            with native.without():
                expected = numpy_matcher.solve(numpy_data, start, steps[:number], prior)
            np.testing.assert_allclose(found.rotations, expected.rotations, atol=1e-7)
    beyond = prior._replace(limits=replace(prior.limits, links=prior.limits.links + 1000))
    with pytest.raises(ValueError, match="beyond the body"):
        fast.solve(data, bent(scene), steps, beyond)


def test_hypotheses_are_clamped_to_limits(scene):
    _, body, model, skin, _, limits = scene
    tracker = body_tracking.BodyTracker(body, skin, model.normals, limits=limits)
    limb = next(limb for limb in tracker.limbs if body.names[limb.links[0]] == "LeftArm")
    draws = bent(scene, 1.5).rotations[limb.links][None].repeat(2, axis=0)
    fore = body.names.index("LeftForeArm")
    within = limb_chains.clamp_to_limits(tracker.limits, limb, draws.copy())
    changed = np.array(limb.links) == fore
    assert not np.array_equal(within[:, changed], draws[:, changed])
    assert np.array_equal(within[:, ~changed], draws[:, ~changed])
    assert distance(limits.subset(np.array([fore])), within[:, changed]).max() < 1e-6


def test_a_tracker_takes_the_limits_of_its_skeleton(scene):
    clouds, _, _, _, motion, _ = scene
    body, tracker = bodycast.start_tracking(clouds.positions[0], clouds.colours[0], motion, "y", 2500)
    assert {body.names[link] for link in tracker.limits.links} >= {"LeftForeArm", "RightLeg"}
    assert tracker.prior.limits is tracker.limits
