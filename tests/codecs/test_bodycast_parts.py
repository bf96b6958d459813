"""What bodycast is made of: octrees and exact points, masks, poses, woven points."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.bodycast import bits, exact, octree, poses, strangers
from mocodec.errors import CannotEncode, Corrupt
from mocodec.geometry import articulation, skinning
from mocodec.geometry.articulation import Body, Pose
from mocodec.testing import corruption


def sphere(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    points *= 0.5 / np.linalg.norm(points, axis=1, keepdims=True)
    return (points + np.array([0.1, -3.0, 40.0])).astype(np.float32).astype(np.float64), rng.integers(
        0, 256, (count, 3), np.uint8
    )


def in_order(cloud) -> np.ndarray:
    """Points and colours in one order, whatever order they came in."""
    points, colours = cloud
    rows = np.concatenate([points.astype(np.float32), np.zeros((len(points), 0)) if colours is None else colours], 1)
    return rows[np.lexsort(rows.T)]


def test_codes_and_cells():
    cells = np.random.default_rng(1).integers(0, 1 << octree.DEEPEST, (500, 3))
    np.testing.assert_array_equal(octree.cells_of(octree.codes(cells)), cells)
    assert octree.codes(np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [3, 0, 0]])).tolist() == [1, 2, 4, 9]


@pytest.mark.parametrize("coloured", [True, False])
def test_every_bit_of_a_float_comes_back(coloured):
    odd = np.array([[0.0, -0.0, 1e-30], [-1e-7, 3.0, 2**-10], [1e-3, -(2**-10), 0.3], [5.0, 5.0, 5.0], [5.0, 5.0, 5.0]])
    frames = [sphere(700), (np.zeros((0, 3)), np.zeros((0, 3), np.uint8)), (odd, np.zeros((5, 3), np.uint8)), sphere(1)]
    frames = [(p.astype(np.float32).astype(np.float64), c if coloured else None) for p, c in frames]
    back = exact.unpack(exact.pack(frames, 0.0, coloured), len(frames), coloured)
    for was, now in zip(frames, back, strict=True):
        np.testing.assert_array_equal(in_order(was), in_order(now))


@pytest.mark.parametrize("step", [0.001, 0.004, 1 / 256, 0.0025])
def test_points_on_a_grid_cost_no_more_than_their_cells(step):
    points, colours = sphere(4000)
    cells = np.unique(np.round(points / step), axis=0)
    gridded = cells * step, colours[: len(cells)]
    packed = exact.pack([gridded], 0.0, True)
    np.testing.assert_array_equal(in_order(exact.unpack(packed, 1, True)[0]), in_order(gridded))
    assert len(exact.pack([(gridded[0], None)], 0.0, False)) < 5.0 * len(cells)


def test_a_stated_precision_is_kept_and_a_surface_is_cheap():
    points, _ = sphere(60_000)
    packed = exact.pack([(points, None)], 0.01, False)
    [(back, _)] = exact.unpack(packed, 1, False)
    assert np.abs(np.sort(back[:, 2]) - np.sort(points[:, 2])).max() <= 0.005 + 1e-9
    cells = len(np.unique(np.round(points / 0.01), axis=0))
    assert 8 * len(packed) / cells < 5.5  # bits a cell, and how many points each holds


def test_what_is_too_far_apart():
    with pytest.raises(CannotEncode, match="apart"):
        exact.pack([(np.array([[1.2345e-4, 0, 0], [5003.7, 0, 0]]), None)], 0.0, False)


def test_damage_to_points_raises_or_decodes():
    frames = [sphere(120), sphere(80, 1)]
    for data, read in (
        (exact.pack(frames, 0.0, True), lambda d: exact.unpack(d, 2, True)),
        (exact.pack(frames, 0.002, True), lambda d: exact.unpack(d, 2, True)),
        (strangers.pack_strangers(frames, True), lambda d: strangers.unpack_strangers(d, 2, True)),
    ):
        assert len(read(data)) == 2
        for bad in (*corruption.prefixes(data, every=29), *corruption.damaged(data, 60, seed=3)):
            try:
                read(bad)
            except Corrupt:
                continue


def test_masks():
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:40, :57]
    for mask in (
        np.hypot(x - 25, y - 20) < 15,
        rng.random((9, 5)) < 0.3,
        np.zeros((3, 4), bool),
        np.ones((1, 1), bool),
    ):
        np.testing.assert_array_equal(bits.unpack_mask(bits.pack_mask(mask), mask.shape), mask)
    assert len(bits.pack_mask(np.hypot(x - 25, y - 20) < 15)) < 60
    with pytest.raises(Corrupt):
        bits.unpack_mask(bits.pack_mask(np.hypot(x - 25, y - 20) < 15)[:-3], (40, 57))


@pytest.fixture
def arm() -> tuple[Body, skinning.Skin]:
    """Three links in a row, with points around them."""
    origins = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.8, 0, 0]])
    tips = np.array([[0.5, 0, 0], [0.8, 0, 0], [0.9, 0, 0]])
    body = Body(("root", "arm", "hand"), (-1, 0, 1), origins, tips, np.full(3, 0.05))
    rng = np.random.default_rng(2)
    points = rng.uniform([0, -0.05, -0.05], [0.9, 0.05, 0.05], (900, 3))
    links = np.searchsorted([0.5, 0.8], points[:, 0])
    return body, skinning.skin(body, points, links)


def swinging(frames: int, noise: float = 0.0) -> poses.Track:
    time = np.arange(frames) / 15
    rng = np.random.default_rng(3)
    turns = np.stack([np.sin(time * k)[:, None] * [0.3 * k, 0.8, 0.2] for k in (1, 2, 3)], axis=1)
    turns[:, 0, 1] += 2.5 * time  # more than a full turn
    turns += noise * rng.normal(size=turns.shape)
    return poses.Track(articulation.exp(turns), np.stack([time, 0 * time, np.cos(time)], axis=1))


@pytest.mark.parametrize("frames", [1, 2, 3, 90])
def test_poses_come_back_within_their_step(arm, frames):
    body, skin = arm
    track, before = swinging(frames), None
    rig = skinning.SkinMatrix.build(skin, len(body))
    truth = rig.posed(*track.transforms(body))
    for step in (0.02, 0.005, 0.001):
        scale = poses.Scale.of(body, skin, step)
        data = poses.pack(body, track, scale)
        back = rig.posed(*poses.unpack(body, data, frames, scale).transforms(body))
        off = float(np.sqrt(((back - truth) ** 2).sum(axis=2).mean()))
        assert off < 2.5 * step
        assert before is None or frames < 3 or off < before
        before = off
    assert frames < 90 or len(data) < 12 * frames


def test_turns_have_no_leaps(arm):
    body, _ = arm
    time = np.arange(200) / 15
    for most in (1.0, 3.0, 9.0):  # radians: far from half a turn, near it, and beyond
        swings = np.stack([most * np.sin(time), 0.3 * np.cos(time), 0 * time], axis=1)
        axes = poses._axes(body)[1]
        parted = poses._parted(poses._joined(swings, axes), axes)
        assert np.abs(np.diff(parted, axis=0)).max() < 0.12 * most + 0.1
        np.testing.assert_allclose(poses._joined(parted, axes), poses._joined(swings, axes), atol=1e-9)


def test_a_scale_survives(arm):
    body, skin = arm
    scale = poses.Scale.of(body, skin, 0.0030072)
    back, at = poses.Scale.unpack(body, b"xx" + scale.pack(), 2)
    assert at == 2 + len(scale.pack())
    np.testing.assert_allclose(back.sizes(), scale.sizes())
    sizes = scale.sizes()[3:].reshape(3, 3)
    assert (sizes[0] < sizes[2]).any()  # what moves more is told more finely


def test_single_poses_for_live_use(arm):
    body, skin = arm
    scale = poses.Scale.of(body, skin, 0.004)
    track, previous = swinging(60), np.zeros(3 + 9, np.int64)
    jumps = list[int]()
    for frame in range(60):
        steps = poses.quantise(body, track[frame], scale, previous)
        back = poses.dequantise(body, steps, scale)
        a, b = articulation.transforms(body, track[frame])
        c, d = articulation.transforms(body, back)
        assert np.linalg.norm(skin.posed(a, b) - skin.posed(c, d), axis=1).mean() < 0.012
        jumps.append(int(np.abs(steps - previous).max()) if frame else 0)
        previous = steps
    assert max(jumps) < 400  # turns go on past half a turn, without a leap


def test_a_rig_is_its_skin(arm):
    body, skin = arm
    track = swinging(4)
    a, b = track.transforms(body)
    rig = skinning.SkinMatrix.build(skin, len(body))
    both = rig.posed(a, b)
    for frame in range(4):
        np.testing.assert_allclose(both[frame], skin.posed(a[frame], b[frame]), atol=1e-12)
    moved = skin.points + 0.01
    np.testing.assert_allclose(
        rig.with_points(moved).posed(a[1], b[1]), skinning.Skin(moved, skin.links, skin.weights).posed(a[1], b[1])
    )
    assert isinstance(track[0], Pose)
