"""ICP, segmentation and normals: the compiled module finds what NumPy finds, up to the rounding of floats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec import native
from mocodec.geometry import articulated_icp, articulation, capsules, icp, normals, skinning
from mocodec.testing import actors, sequences

pytestmark = pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")


def shell(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of an ellipsoid, their normals and colours."""
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return n * [0.2, 0.5, 0.3], n, rng.integers(0, 256, (count, 3))


@pytest.mark.parametrize("count", [40, 700])
@pytest.mark.parametrize("grouped", [False, True])
def test_icp_of_several_parts(count, grouped):
    rng = np.random.default_rng(count)
    p, n, c = shell(count, rng)
    q = p + rng.normal(0, 0.01, p.shape) + [0.03, 0.0, -0.02]
    sizes = [count // 2, count // 4, count - count // 2 - count // 4]
    pivots = np.array([[0.0, 0.5, 0.0], [np.nan] * 3, [np.nan] * 3])
    groups = np.repeat(np.arange(3), sizes)

    def found() -> tuple[np.ndarray, np.ndarray, list[list[float]]]:
        if grouped:
            return icp.icp_many(p, groups, sizes, icp.ClusteredTree.of_groups(q, groups, 3), pivots, iterations=20)
        label = icp.labels(n, icp.colour_cluster(c), len(p))
        return icp.icp_many(p, label, sizes, icp.ClusteredTree.build(q, n, c, label), pivots, iterations=20)

    r, t, errors = found()
    with native.without():
        expected_r, expected_t, expected_errors = found()
    np.testing.assert_allclose(r, expected_r, atol=1e-11)
    np.testing.assert_allclose(t, expected_t, atol=1e-11)
    assert [len(e) for e in errors] == [len(e) for e in expected_errors]
    np.testing.assert_allclose(np.concatenate(errors), np.concatenate(expected_errors), atol=1e-14)


@pytest.mark.parametrize("count", [3, 12, 900])
def test_normals(count):
    rng = np.random.default_rng(count)
    among = shell(count, rng)[0] + rng.normal(0, 0.01, (count, 3))
    ours = normals.estimate(among[::2], among)
    with native.without():
        theirs = normals.estimate(among[::2], among)
    np.testing.assert_allclose(np.abs(np.sum(ours * theirs, axis=1)), 1, atol=1e-9)


@pytest.mark.parametrize("far", [2.0, 1e5, 1e120])
def test_normals_among_outliers(far):
    """The farther an outlier, the more of the other points share a cell: at last a tree is searched."""
    rng = np.random.default_rng(0)
    among = np.concatenate(
        [shell(600, rng)[0] + rng.normal(0, 0.01, (600, 3)), [[far, 0, 0]], np.tile([0.1, 0, 0], (20, 1))]
    )
    ours = normals.estimate(among[:600], among)
    with native.without():
        theirs = normals.estimate(among[:600], among)
    np.testing.assert_allclose(np.abs(np.sum(ours * theirs, axis=1)), 1, atol=1e-9)


def test_distances_from_capsules():
    rng = np.random.default_rng(0)
    points, ends, radii = (
        rng.normal(size=(37, 3)) + 5,
        rng.normal(size=(4, 6, 2, 3)) + 5,
        rng.uniform(0.1, 0.4, (4, 6, 2)),
    )
    ends[0, 0, 1] = ends[0, 0, 0]  # of no length
    ours = capsules.surface_distances(points, ends, radii)
    with native.without():
        theirs = capsules.surface_distances(points, ends, radii)
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


@pytest.mark.parametrize("with_normals", [False, True])
def test_segmentation(with_normals):
    performance = sequences.jumping_jacks(actors.capsules(), 2)
    actor, rng = performance.actor, np.random.default_rng(0)
    body = articulation.from_skeleton(actor.names, actor.parents, performance.joints[0], one_trunk=True, shortest=0.1)
    a, b = articulation.transforms(body, articulation.Pose.canonical(len(body)))
    points = rng.uniform(performance.joints[0].min(axis=0) - 0.1, performance.joints[0].max(axis=0) + 0.1, (2000, 3))
    directions = shell(2000, rng)[1] if with_normals else None
    ours = articulated_icp.segment(body, a, b, points, directions)
    with native.without():
        np.testing.assert_array_equal(ours, articulated_icp.segment(body, a, b, points, directions))


def test_sides_and_moments():
    performance = sequences.jumping_jacks(actors.capsules(), 2)
    actor, rng = performance.actor, np.random.default_rng(2)
    body = articulation.from_skeleton(actor.names, actor.parents, performance.joints[0], one_trunk=True, shortest=0.1)
    a, b = articulation.transforms(body, articulation.Pose.canonical(len(body)))
    points = rng.uniform(performance.joints[0].min(axis=0) - 0.1, performance.joints[0].max(axis=0) + 0.1, (900, 3))
    links = rng.integers(0, len(body) - 1, len(points))  # the last link has no points

    def found() -> tuple[np.ndarray, np.ndarray]:
        normal = articulated_icp.outward_normals(body, a, b, points)
        return normal, articulated_icp.third_moments(points, links, len(body))

    ours = found()
    with native.without():
        theirs = found()
    np.testing.assert_allclose(np.sum(ours[0] * theirs[0], axis=1), 1, atol=1e-9)
    np.testing.assert_allclose(ours[1], theirs[1], atol=1e-14)


def test_tracking():
    performance = sequences.jumping_jacks(actors.capsules(), 6)
    clouds = replace(sequences.record(performance, 1500, seed=1), normals=None)
    assert clouds.colours is not None
    actor, colours = performance.actor, clouds.colours
    body = articulation.from_skeleton(actor.names, actor.parents, performance.joints[0], one_trunk=True, shortest=0.1)

    def poses() -> list[articulation.Pose]:
        own, model = articulated_icp.make_model(body, clouds.positions[0], colours[0])
        tracker = articulated_icp.ArticpTracker(own, model)
        return [tracker.fit(clouds.positions[k], colours[k]) for k in range(1, len(clouds))]

    ours = poses()
    with native.without():
        theirs = poses()
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one.rotations, other.rotations, atol=1e-7)
        np.testing.assert_allclose(one.root, other.root, atol=1e-7)


def test_points_that_are_not_finite_are_refused():
    kernel = native.kernel("ClusteredPoints")
    assert kernel is not None
    with pytest.raises(ValueError, match="not finite"):
        kernel(np.array([[0.0, np.nan, 0.0]]), np.zeros(1, np.uint8))


@pytest.fixture(scope="module")
def figure() -> tuple[articulation.Body, np.ndarray, np.ndarray]:
    """A body, points on its surface and their normals."""
    performance = sequences.jumping_jacks(actors.capsules(), 1)
    clouds = sequences.record(performance, 1500, normals=True)
    assert clouds.normals is not None
    actor = performance.actor
    body = articulation.from_skeleton(actor.names, actor.parents, performance.joints[0])
    return body, clouds.positions[0], clouds.normals[0]


def test_compiled_nearest_surfaces_are_the_same(figure):
    body, points, outward = figure
    links = articulated_icp.nearest_surface(body, points, outward)
    shapes = articulated_icp.surface_shapes(body, points, links)
    shaped = articulated_icp.nearest_surface(body, points, outward, shapes)
    assert len(np.unique(links)) > 10
    with native.without():
        np.testing.assert_array_equal(links, articulated_icp.nearest_surface(body, points, outward))
        np.testing.assert_array_equal(shaped, articulated_icp.nearest_surface(body, points, outward, shapes))


def test_compiled_inverse_skinning_agrees_with_numpy(figure):
    body, points, outward = figure
    skin = skinning.skin(body, points, articulated_icp.nearest_surface(body, points, outward))
    turns = np.random.default_rng(0).normal(0, 0.2, (len(body), 3))
    a, b = articulation.transforms(body, articulation.Pose(articulation.exp(turns), np.array([1.0, 2, 3])))
    rows = np.arange(0, len(points), 3)
    unposed = skin.unposed(a, b, rows, skin.posed(a, b, rows))
    np.testing.assert_allclose(unposed, points[rows], atol=1e-9)
    with native.without():
        np.testing.assert_allclose(unposed, skin.unposed(a, b, rows, skin.posed(a, b, rows)), atol=1e-9)


def test_compiled_means_of_neighbourhoods_agree_with_numpy(figure):
    body, points, outward = figure
    values = np.random.default_rng(0).normal(size=(len(points), 5))
    means = skinning.averaged(body, points, outward, values)
    assert means.std() < 0.8 * values.std()
    with native.without():
        np.testing.assert_allclose(means, skinning.averaged(body, points, outward, values), atol=1e-12)
