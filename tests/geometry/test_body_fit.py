"""A first pose is found without a skeleton: in any pose, of any size, whichever way it faces."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.errors import BadInput, CannotEncode
from mocodec.geometry import articulation, body_fit, pose_search, stock_body
from mocodec.geometry.capsules import Field, gaps
from mocodec.testing import actors, poses, sequences


def found(act: sequences.Performance, factor: float = 1.0, up: str = "y", **how: float) -> tuple[float, float]:
    """Mean and worst error of the joints that are found in a frame, metres."""
    turn = body_fit.UPRIGHT[up]
    points = sequences.record(act, 4000, seed=3, **how).positions[0] * factor  # type: ignore[arg-type]
    figure = body_fit.first_pose(points @ turn, up)
    truth = dict(zip(act.actor.names, act.joints[0] * factor, strict=True))
    ours = dict(zip(figure.names, figure.places @ turn.T, strict=True))
    off = [float(np.linalg.norm(ours[name] - truth[name])) for name in poses.JOINTS]
    assert figure.error_m < 0.03
    return float(np.mean(off)), max(off)


@pytest.mark.parametrize(
    ("pose", "factor", "heading", "up"),
    [("arms raised", 1.0, 2.5, "z"), ("walking", 1.15, 4.0, "y"), ("slight crouch", 0.7, 1.0, "x")],
)
def test_first_pose_of_an_unknown_person(pose, factor, heading, up):
    act = poses.posed(actors.capsules(), *poses.POSES[pose]).moved((3.0, 0.5, -2.0), heading)
    mean, worst = found(act, factor, up)
    assert mean < 0.06
    assert worst < 0.12


def test_one_of_two_people_is_taken():
    act = poses.posed(actors.capsules(), *poses.POSES["T"])
    one = sequences.record(act, 3000).positions[0]
    other = sequences.record(act.moved((2.5, 0, 0)), 1000).positions[0]
    far = np.array([[400.0, 0, 0], [0, -900.0, 3]])
    group = body_fit.largest_group(np.concatenate([one, other, far]))
    np.testing.assert_array_equal(group, one)


def test_no_person_no_pose():
    rng = np.random.default_rng(0)
    with pytest.raises(CannotEncode, match="not a standing person"):
        body_fit.first_pose(rng.uniform(0, 0.3, (500, 3)))
    body = stock_body.flesh().body
    with pytest.raises(BadInput, match="from the first frame's points"):
        body_fit.require_near(body, rng.uniform(50, 51, (500, 3)))


def test_gaps_are_distances_from_the_nearest_surface():
    ends, radii = np.array([[[[0, 0, 0], [0, 2.0, 0]], [[5, 0, 0], [5, 1.0, 0]]]]), np.array([[[0.5, 0.1], [0.2, 0.2]]])
    points = np.array([[1.0, 0, 0], [0, 1, 0.5], [5, 0.5, 0], [5, 2, 0]])
    np.testing.assert_allclose(gaps(points, ends, radii)[0], [0.5, 0.2, 0.2, 0.8], atol=1e-5)
    assert gaps(points, ends, radii, signed=True)[0, 2] == pytest.approx(-0.2, abs=1e-5)


def test_field_reads_distances_everywhere():
    field = Field(np.array([[0.0, 0, 0], [1, 0, 0]]))
    assert field(np.array([[0.0, 0, 0], [0.5, 0, 0], [0.2, 0, 0]])) == pytest.approx([0, 0.5, 0.2], abs=0.03)
    assert np.isfinite(field(np.array([100.0, 0, 0])))


def test_builds_scale_what_they_name():
    flesh = stock_body.flesh()
    build = np.ones(len(stock_body.BUILD))
    build[list(stock_body.BUILD).index("arms")] = 1.5
    names = list(stock_body.joints())
    places, ordinary = flesh.places(build), flesh.places(np.ones(len(build)))
    hand, elbow = names.index("LeftHand"), names.index("LeftForeArm")
    np.testing.assert_allclose(places[hand] - places[elbow], 1.5 * (ordinary[hand] - ordinary[elbow]))
    np.testing.assert_allclose(places[names.index("LeftFoot")], ordinary[names.index("LeftFoot")])
    np.testing.assert_allclose(flesh.radii(build), flesh.stock_radii)


def test_knees_that_bend_forwards_cost():
    body = stock_body.flesh().body
    turns = np.zeros((2, len(body), 3))
    turns[0, body.names.index("LeftLeg"), 0] = 0.5
    turns[1, body.names.index("LeftLeg"), 0] = -0.5
    cost = pose_search.oddness(body, articulation.exp(turns))
    assert cost[0] == 0
    assert cost[1] > 0
