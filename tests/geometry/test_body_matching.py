"""Registration of a template: grids, and the compiled kernels against the NumPy code that defines them."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.geometry import articulation, body_tracking, link_grids
from mocodec.geometry.body_matching import FramePoints, Matcher, Step
from mocodec.geometry.gauss_newton import PosePrior

compiled = pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or left aside")


@pytest.fixture(scope="module")
def scene(jumper):
    return jumper(1500)


def matcher_of(scene, coloured: bool) -> tuple[Matcher, FramePoints]:
    clouds, body, model, skin = scene
    shades = model.colours * (0.2 / 255) if coloured else None
    some = np.random.default_rng(0).permutation(len(skin.points))[:300]
    data = FramePoints.build(clouds.positions[2], clouds.colours[2] * (0.2 / 255) if coloured else None, None)
    return Matcher(body, skin, model.normals, shades, some, 0.1, 0.01), data


def prior_of(body: articulation.Body) -> PosePrior:
    hold = np.where(np.arange(len(body)) % 3 == 0, 4.0, 0.0)
    return PosePrior(np.ones(len(body)), hold, articulation.Pose.canonical(len(body)).rotations)


def pose_near_canonical(body: articulation.Body) -> articulation.Pose:
    turns = np.random.default_rng(1).normal(scale=0.1, size=(len(body), 3))
    return articulation.Pose(articulation.exp(turns), np.array([0.02, 0.01, -0.03]))


def both(scene, coloured: bool):
    """Matcher and data, compiled and in NumPy."""
    fast = matcher_of(scene, coloured)
    with native.without():
        numpy_matcher = matcher_of(scene, coloured)
    return fast, numpy_matcher


@compiled
@pytest.mark.parametrize("coloured", [True, False])
def test_compiled_steps_equal_numpy(scene, coloured):
    (fast, data), (numpy_matcher, numpy_data) = both(scene, coloured)
    start, prior = pose_near_canonical(fast.body), prior_of(fast.body)
    steps = [
        Step(0.2, 400, 100),
        Step(0.1, 1000, 300),
        Step(0.1, 5000, 300),
        Step(0.05, 1500, 200),
        Step(0.02, 1500, 300),
    ]
    for number in range(len(steps) + 1):
        found = fast.solve(data, start, steps[:number], prior)
        with native.without():
            expected = numpy_matcher.solve(numpy_data, start, steps[:number], prior)
        np.testing.assert_allclose(found.rotations, expected.rotations, atol=1e-9)
        np.testing.assert_allclose(found.root, expected.root, atol=1e-9)
    with native.without():
        expected = numpy_matcher.assess(numpy_data, start)
    found = fast.assess(data, start)
    assert found.cost == pytest.approx(expected.cost, rel=1e-12)
    for name in ("residuals", "rows", "links", "gaps"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)


@compiled
def test_compiled_limb_steps_equal_numpy(scene):
    (fast, data), (numpy_matcher, numpy_data) = both(scene, False)
    body = fast.body
    limb = np.array([body.names.index(name) for name in ("LeftArm", "LeftForeArm")])
    turn = np.full(len(body), 1e8)
    turn[limb] = 1.0
    allowed = np.isin(np.arange(len(body)), limb)
    rows = np.flatnonzero(np.isin(fast.skin.links[:, 0], limb))[::2]
    prior = prior_of(body)._replace(start_strength=turn, root_strength=1e8)
    steps = [Step(0.1, 1500, 100), Step(0.05, 1500, 100)]
    start = pose_near_canonical(body)
    found = fast.solve(data, start, steps, prior, rows, allowed)
    with native.without():
        expected = numpy_matcher.solve(numpy_data, start, steps, prior, rows, allowed)
    np.testing.assert_allclose(found.rotations, expected.rotations, atol=1e-9)
    moved = np.abs(found.rotations - start.rotations).max(axis=(1, 2))
    assert moved[limb].min() > 1e-3
    assert np.delete(moved, limb).max() < 1e-3


@compiled
def test_compiled_grids_and_queries_equal_numpy(scene):
    (fast, data), (numpy_matcher, numpy_data) = both(scene, True)
    points = fast.skin.points
    grid = fast.grids.nearest != numpy_matcher.grids.nearest
    assert grid.mean() < 1e-3  # cells equally far from two points
    assert (fast.grids.size == numpy_matcher.grids.size).all()
    shades = fast.scaled_colours
    for within in (0.01, 0.3):
        found, expected = data.nearest(points, shades, within), numpy_data.nearest(points, shades, within)
        np.testing.assert_allclose(found[0], expected[0], atol=1e-12)
        assert (found[1] == expected[1]).all()


@compiled
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e20])
@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_the_nearest_point_is_exact_at_every_scale(scale, offset):
    rng = np.random.default_rng(3)
    points = scale * (offset + rng.normal(size=(700, 3)))
    points[300:340] = points[7]  # more points at one place than a leaf has
    queries = scale * (offset + 2 * rng.normal(size=(200, 3)))
    fast = FramePoints.build(points)
    with native.without():
        expected = FramePoints.build(points).nearest(queries, None, np.inf)
    found = fast.nearest(queries, None, np.inf)
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-12)
    np.testing.assert_array_equal(points[found[1]], points[expected[1]])


@compiled
def test_compiled_prediction_equals_numpy(scene):
    _, body, model, skin = scene
    found = []
    for is_compiled in (True, False):
        with native.without() if not is_compiled else pytest.MonkeyPatch.context():
            tracker = body_tracking.BodyTracker(body, skin, model.normals)
            tracker.pose = pose_near_canonical(body)
            found.append(tracker.predict())
    np.testing.assert_allclose(found[0].rotations, found[1].rotations, atol=1e-12)
    np.testing.assert_array_equal(found[0].root, found[1].root)


@compiled
@pytest.mark.parametrize("coloured", [True, False])
def test_neighbours_known_from_earlier_solutions_change_nothing(scene, coloured):
    matcher, data = matcher_of(scene, coloured)
    rest, near = articulation.Pose.canonical(len(matcher.body)), pose_near_canonical(matcher.body)
    prior, steps = prior_of(matcher.body), [Step(width, 1500, 300) for width in (0.2, 0.1, 0.05, 0.03, 0.02)]
    for start in (near, rest, near):
        unknown = data.subset(np.arange(len(data.points)))
        found, expected = matcher.fit(data, start, steps, prior), matcher.fit(unknown, start, steps, prior)
        np.testing.assert_array_equal(found.pose.rotations, expected.pose.rotations)
        np.testing.assert_array_equal(found.gaps, expected.gaps)
        assert found.cost == expected.cost


@compiled
def test_kernels_refuse_arrays_of_wrong_shape(scene):
    fast, data = matcher_of(scene, True)
    pose, prior = pose_near_canonical(fast.body), prior_of(fast.body)
    with pytest.raises(ValueError, match="another body"):
        fast.solve(data, articulation.Pose(pose.rotations[1:], pose.root), [Step(0.1, 10, 10)], prior)
    with pytest.raises(ValueError, match="beyond the template"):
        fast.solve(data, pose, [Step(0.1, 10, 10)], prior, np.array([10**9]))
    with pytest.raises(ValueError, match="shapes differ"):
        native.kernel("KdTree")(np.zeros((4, 2)), np.zeros((0, 3)))  # type: ignore[misc]


def test_grids_find_the_nearest_point_of_a_link(scene):
    matcher, _ = matcher_of(scene, False)
    link = matcher.body.names.index("LeftForeArm")
    own = np.flatnonzero(matcher.skin.shares(len(matcher.body))[:, link] > 0.34)
    places = matcher.skin.points[own] + 0.004
    rows = matcher.grids.look_up(np.full(len(own), link), places)
    away = np.linalg.norm(matcher.skin.points[rows] - places, axis=1)
    assert np.isin(rows, own).all()
    assert away.max() < 0.0075 + link_grids.CELL_M * np.sqrt(3)
