"""First poses without a skeleton: any pose, size and heading."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.errors import BadInput, CannotEncode
from mocodec.geometry import articulation, body_fit, pose_search, stock_body
from mocodec.geometry.capsules import DistanceField, surface_distances
from mocodec.testing import actors, poses, sequences


def joint_errors(act: sequences.Performance, factor: float = 1.0, up: str = "y", **how: float) -> tuple[float, float]:
    """Mean and largest error of the joints of a first pose, metres."""
    turn = body_fit.UPRIGHT[up]
    points = sequences.record(act, 4000, seed=3, **how).positions[0] * factor  # type: ignore[arg-type]
    figure = body_fit.first_pose(points @ turn, up)
    truth = dict(zip(act.actor.names, act.joints[0] * factor, strict=True))
    ours = dict(zip(figure.names, figure.positions @ turn.T, strict=True))
    off = [float(np.linalg.norm(ours[name] - truth[name])) for name in poses.JOINTS]
    assert figure.error_m < 0.03
    return float(np.mean(off)), max(off)


@pytest.mark.parametrize(
    ("pose", "factor", "heading", "up"),
    [
        ("arms raised", 1.0, 2.5, "z"),
        ("walking", 1.15, 4.0, "y"),
        ("slight crouch", 0.7, 1.0, "x"),
        ("seated, arms hanging", 1.0, 0.5, "y"),
        ("turned", 1.1, 5.0, "z"),
    ],
)
def test_first_pose_of_an_unknown_person(pose, factor, heading, up):
    act = poses.posed(actors.capsules(), *poses.POSES[pose]).moved((3.0, 0.5, -2.0), heading)
    mean, worst = joint_errors(act, factor, up)
    assert mean < 0.06
    assert worst < 0.12


def test_largest_group_is_one_of_two_people():
    act = poses.posed(actors.capsules(), *poses.POSES["T"])
    one = sequences.record(act, 3000).positions[0]
    other = sequences.record(act.moved((2.5, 0, 0)), 1000).positions[0]
    far = np.array([[400.0, 0, 0], [0, -900.0, 3]])
    group = body_fit.largest_group(np.concatenate([one, other, far]))
    np.testing.assert_array_equal(group, one)


def test_points_without_a_person_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(CannotEncode, match="not a standing person"):
        body_fit.first_pose(rng.uniform(0, 0.3, (500, 3)))
    body = stock_body.capsule_model().body
    with pytest.raises(BadInput, match="from the first frame's points"):
        body_fit.require_near(body, rng.uniform(50, 51, (500, 3)))


def test_surface_distances():
    ends, radii = np.array([[[[0, 0, 0], [0, 2.0, 0]], [[5, 0, 0], [5, 1.0, 0]]]]), np.array([[[0.5, 0.1], [0.2, 0.2]]])
    points = np.array([[1.0, 0, 0], [0, 1, 0.5], [5, 0.5, 0], [5, 2, 0]])
    np.testing.assert_allclose(surface_distances(points, ends, radii)[0], [0.5, 0.2, 0.2, 0.8], atol=1e-5)
    assert surface_distances(points, ends, radii, signed=True)[0, 2] == pytest.approx(-0.2, abs=1e-5)


def test_distance_field():
    field = DistanceField(np.array([[0.0, 0, 0], [1, 0, 0]]))
    assert field(np.array([[0.0, 0, 0], [0.5, 0, 0], [0.2, 0, 0]])) == pytest.approx([0, 0.5, 0.2], abs=0.03)
    assert np.isfinite(field(np.array([100.0, 0, 0])))


def test_proportions_scale_their_joints():
    model = stock_body.capsule_model()
    build = np.ones(len(stock_body.PROPORTIONS))
    build[list(stock_body.PROPORTIONS).index("arms")] = 1.5
    names = list(stock_body.joints())
    places, ordinary = model.joint_positions(build), model.joint_positions(np.ones(len(build)))
    hand, elbow = names.index("LeftHand"), names.index("LeftForeArm")
    np.testing.assert_allclose(places[hand] - places[elbow], 1.5 * (ordinary[hand] - ordinary[elbow]))
    np.testing.assert_allclose(places[names.index("LeftFoot")], ordinary[names.index("LeftFoot")])
    np.testing.assert_allclose(model.radii(build), model.stock_radii)


def test_knees_that_bend_the_wrong_way_cost():
    body = stock_body.capsule_model().body
    turns = np.zeros((2, len(body), 3))
    turns[0, body.names.index("LeftLeg"), 0] = 0.5
    turns[1, body.names.index("LeftLeg"), 0] = -0.5
    cost = pose_search.hinge_penalty(body, articulation.exp(turns))
    assert cost[0] == 0
    assert cost[1] > 0


@pytest.fixture(scope="module")
def walker() -> pose_search.PoseSearch:
    """The search for a walking person."""
    act = poses.posed(actors.capsules(), *poses.POSES["walking"]).moved((3.0, 0.5, -2.0), 1.0)
    return pose_search.PoseSearch(sequences.record(act, 2000, seed=3).positions[0])


@pytest.mark.skipif(not native.available(), reason="the compiled module is not built")
@pytest.mark.parametrize(("points", "stride"), [(None, 1), (70, 3)])
def test_compiled_costs_of_poses_agree_with_numpy(walker, points, stride):
    random = walker._random_poses(60)
    compiled = walker._scored(random, points, stride).cost
    with native.without():
        np.testing.assert_allclose(compiled, walker._scored(random, points, stride).cost, rtol=1e-5)


@pytest.mark.skipif(not native.available(), reason="the compiled module is not built")
def test_compiled_choice_of_limbs_agrees_with_numpy(walker):
    random = walker._random_poses(12)
    for limb in walker.limbs:
        turns = walker._limb_turns(random, limb, 20, 0.6)
        best, cost = walker._best_limbs(random, limb, turns)
        with native.without():
            numpy_best, numpy_cost = walker._best_limbs(random, limb, turns)
        np.testing.assert_array_equal(best, numpy_best)
        np.testing.assert_allclose(cost, numpy_cost, rtol=1e-5)


@pytest.mark.skipif(not native.available(), reason="the compiled module is not built")
@pytest.mark.parametrize("views", [{}, {"views": 1}])
def test_compiled_fit_agrees_with_numpy(views):
    """After convergence: single steps differ where two capsules that meet in a joint are equally near."""
    act = poses.posed(actors.capsules(), *poses.POSES["walking"]).moved((3.0, 0.5, -2.0), 1.0)
    points = sequences.record(act, 2000, seed=3, **views).positions[0]
    search = pose_search.PoseSearch(points)
    fitter = body_fit.StockBodyFitter(points, search)
    assert (search.field.hidden is None) == (not views)
    start = body_fit.estimate_of(search.best(1, draws=1500), 0)
    compiled = fitter.refine(start, body_fit.WIDTHS)
    with native.without():
        by_numpy = fitter.refine(start, body_fit.WIDTHS)
    np.testing.assert_allclose(compiled.rotations, by_numpy.rotations, atol=1e-3)
    np.testing.assert_allclose(compiled.root, by_numpy.root, atol=1e-4)
    np.testing.assert_allclose(compiled.build, by_numpy.build, atol=1e-3)
    assert compiled.cost == pytest.approx(by_numpy.cost, rel=1e-3)
