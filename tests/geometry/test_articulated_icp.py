"""ICP and ARTICP: theorem 3.1 and the equations of Lien and Bajcsy 2006, and tracking from a known first pose."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.geometry import articulated_icp, articulation, cylinder_map, icp, normals
from mocodec.testing import actors, sequences

RNG = np.random.default_rng(5)


def blob(count: int = 800) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n = RNG.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return n * [0.2, 0.5, 0.3], n, RNG.integers(0, 256, (count, 3))


def test_rigid_recovers_a_transform_with_and_without_pivot():
    p, _, _ = blob(50)
    r = articulation.exp(np.array([0.3, -0.2, 0.5]))
    found_r, found_t = icp.rigid(p, p @ r.T + [1, 2, 3])
    np.testing.assert_allclose(found_r, r, atol=1e-12)
    np.testing.assert_allclose(found_t, [1, 2, 3], atol=1e-12)
    pivot = np.array([0.1, 0.5, 0.0])
    found_r, found_t = icp.rigid(p, (p - pivot) @ r.T + pivot, pivot)
    np.testing.assert_allclose(found_r @ pivot + found_t, pivot, atol=1e-12)
    np.testing.assert_allclose(found_r, r, atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("jointed", [False, True])
def test_theorem_3_1_the_error_never_rises(seed, jointed):
    rng = np.random.default_rng(seed)
    p, n, c = blob()
    r = articulation.exp(rng.normal(scale=0.4, size=3))
    q = (p @ r.T + rng.normal(scale=0.1, size=3))[rng.permutation(len(p))[:500]] + rng.normal(scale=0.01, size=(500, 3))
    label = icp.labels(n, icp.colour_cluster(c), len(p))
    tree = icp.ClusteredTree.build(q, normals.estimate(q), c[rng.permutation(len(p))[:500]], label)
    pivot = np.array([0.0, 0.5, 0.0]) if jointed else None
    _, _, errors = icp.icp(p, label, tree, pivot=pivot, iterations=40, tolerance=-1)
    assert len(errors) == 40
    assert (np.diff(errors) <= 1e-15).all()
    assert errors[-1] < errors[0]


def test_neighbourhoods_contain_only_similar_normals_and_colours():
    p, n, c = blob()
    label = icp.labels(n, icp.colour_cluster(c), len(p))
    tree = icp.ClusteredTree.build(p, n, c, label)
    row, distance = tree.closest(tree.queries(p, label))
    full = tree.filled[label]
    assert (distance[full] < 1e-9).all()  # every point is in its own neighbourhood
    assert icp.NEAR_NORMALS[icp.normal_cluster(n), icp.normal_cluster(n[row])][full].all()
    assert icp.NEAR_COLOURS[icp.colour_cluster(c), icp.colour_cluster(c[row])][full].all()


def test_normals_of_a_plane_and_a_sphere():
    plane = np.column_stack([RNG.uniform(-1, 1, (300, 2)), np.zeros(300)])
    np.testing.assert_allclose(np.abs(normals.estimate(plane)[:, 2]), 1, atol=1e-6)
    _, n, _ = blob(4000)
    assert np.median(np.abs(np.sum(normals.estimate(n) * n, axis=1))) > 0.99
    assert normals.estimate(np.zeros((2, 3))).shape == (2, 3)


@pytest.mark.parametrize("places", [np.zeros((9, 3)), np.repeat(RNG.uniform(-1, 1, (5, 3)), 12, axis=0)])
def test_normals_of_points_at_one_place_are_unit_vectors(places):
    np.testing.assert_allclose(np.linalg.norm(normals.estimate(places), axis=1), 1)


def test_closeness_is_equation_4():
    body = articulation.Body(("a",), (-1,), np.zeros((1, 3)), np.array([[0, 1.0, 0]]), np.array([0.1]))
    a, b = articulation.transforms(body, articulation.Pose.canonical(1))
    points = np.array([[0.05, 0.5, 0], [0.3, 0.5, 0], [0.3, 0.5, 0]])
    n = np.array([[1.0, 0, 0], [1, 0, 0], [-1, 0, 0]])
    close = articulated_icp.closeness(body, a, b, points, n)[0]
    assert close[0] >= 1
    assert close[1] == pytest.approx(np.exp(-0.2 / 0.1))
    assert close[2] == 0


def test_grid_size_follows_the_paper():
    height, width = cylinder_map.grid_size(1000, 0.15, 0.5)
    assert height * width == pytest.approx(2000, rel=0.03)
    quarter = cylinder_map.grid_size(1000, 0.15, 0.5, 0.25)
    assert quarter[0] * quarter[1] == pytest.approx(500, rel=0.06)


def test_cylinder_map_round_trip():
    cylinder = cylinder_map.cylinder(np.array([1.0, 2, 3]), np.array([1.0, 2.4, 3.3]), 0.0, 0.5)
    along, angle = RNG.uniform(0, 0.5, 5000), RNG.uniform(0, 2 * np.pi, 5000)
    out = np.cos(angle)[:, None] * cylinder.side + np.sin(angle)[:, None] * cylinder.across
    points = cylinder.origin + along[:, None] * cylinder.axis + 0.1 * out
    colours = np.tile([10.0, 20, 30], (5000, 1))
    sampled = cylinder_map.forward(cylinder, points, colours, (20, 24))
    np.testing.assert_allclose(sampled.distance, 0.1)
    back, c = cylinder_map.inverse(cylinder, sampled)
    np.testing.assert_allclose(c, colours[:480])
    height, _, distance = cylinder_map.coordinates(cylinder, back)
    np.testing.assert_allclose(distance, 0.1)
    assert height.min() > 0
    again = cylinder_map.forward(cylinder, back, c, (20, 24))
    np.testing.assert_allclose(again.distance, sampled.distance)
    holes = sampled._replace(distance=np.where(RNG.random((20, 24)) < 0.4, np.nan, sampled.distance))
    np.testing.assert_allclose(cylinder_map.filled(holes).distance, 0.1)


def test_third_moments_distinguish_a_bent_link():
    p, _, _ = blob()
    x = np.concatenate([p - p.mean(axis=0), p + np.array([0, 0.2, 0])])
    straight, bent, none = articulated_icp.third_moments(x, np.repeat([0, 1], len(p)), 3)
    assert np.linalg.norm(straight) < 5e-3
    assert np.linalg.norm(bent) > 2e-2
    np.testing.assert_allclose(bent, np.einsum("ni,nj,nk->ijk", *[x[len(p) :]] * 3) / len(p))
    assert (none == 0).all()


def test_icp_many_equals_icp_of_each_part():
    p, n, c = blob(400)
    tree = icp.ClusteredTree.build(p, n, c, icp.labels(n, icp.colour_cluster(c), 400))
    moved = p @ articulation.exp(np.array([0.05, 0.1, -0.04])).T + 0.01
    label, pivot = icp.labels(n, icp.colour_cluster(c), 400), np.array([0, 0.4, 0.0])
    pivots = np.stack([np.full(3, np.nan), pivot])
    r, t, errors = icp.icp_many(moved, label, [150, 250], tree, pivots)
    for part, rows, joint in ((0, slice(150), None), (1, slice(150, 400), pivot)):
        alone = icp.icp(moved[rows], label[rows], tree, pivot=joint)
        np.testing.assert_allclose(r[part], alone[0], atol=1e-9)
        np.testing.assert_allclose(t[part], alone[1], atol=1e-9)
        assert len(errors[part]) == len(alone[2])


def test_outward_normals_point_out_of_a_body():
    performance = sequences.jumping_jacks(actors.capsules(), 4)
    clouds = sequences.record(performance, 2500, normals=True)
    assert clouds.normals is not None
    found = normals.outward(clouds.positions[3])
    assert np.mean(np.sum(found * clouds.normals[3], axis=1) > 0) > 0.9
    assert np.isfinite(normals.outward(np.zeros((40, 3)))).all()
    assert normals.outward(np.zeros((2, 3))).shape == (2, 3)


def test_tracks_a_body_from_its_first_pose():
    performance = sequences.jumping_jacks(actors.capsules(), 9)
    clouds = sequences.record(performance, 2500, seed=1)
    assert clouds.colours is not None
    actor = performance.actor
    body = articulation.from_skeleton(actor.names, actor.parents, performance.joints[0], one_trunk=True, shortest=0.1)
    body, model = articulated_icp.make_model(body, clouds.positions[0], clouds.colours[0])
    tracker = articulated_icp.ArticpTracker(body, model)
    for frame in range(1, 9):
        pose = tracker.fit(clouds.positions[frame], clouds.colours[frame])
        joints = articulation.joint_positions(body, *articulation.transforms(body, pose))
        error = np.linalg.norm(joints - performance.joints[frame][list(body.joints)], axis=1)
        assert error.mean() < 0.08
    still = tracker.fit(np.zeros((3, 3)), None)
    np.testing.assert_array_equal(still.rotations, pose.rotations)
