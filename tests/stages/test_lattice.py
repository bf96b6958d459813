"""The lattice engine keeps its bound, and gives the same bytes with and without the compiled module."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.errors import Corrupt
from mocodec.stages import lattice
from mocodec.stages.lattice import Neighbours
from mocodec.testing import synthetic
from mocodec.typing import Booleans, Floats

needs_module = pytest.mark.skipif(not native.available(), reason="the compiled module is not built")

RADIUS = 1.25**0.5
"""Of the ball about a sample that its lattice point lies in, half steps."""


def samples(frames: int, points: int, bound: float = 0.001, seed: int = 1) -> tuple[Floats, Booleans, Neighbours]:
    positions = synthetic.markers(frames=max(frames, 4), seed=seed).positions[:frames, :points]
    rng = np.random.default_rng(seed)
    missing = np.zeros(positions.shape[:2], bool)
    if frames > 30:
        missing[5:20, 0] = missing[12:, -1] = missing[:7, points // 2] = True
        missing |= rng.random(missing.shape) < 0.05
    return positions / lattice.half_step(bound), missing, lattice.neighbours(positions)


@pytest.mark.parametrize(("frames", "points"), [(1, 1), (1, 5), (2, 2), (3, 1), (40, 6), (65, 3)])
@pytest.mark.parametrize("stride", [0, 2, 4])
def test_samples_come_back_within_the_bound(frames: int, points: int, stride: int) -> None:
    wanted, missing, known = samples(frames, points)
    found = lattice.encode(wanted, missing, known, stride)
    assert found is not None
    distance = np.sqrt(((found[1] - wanted) ** 2).sum(axis=2))[~missing]
    assert distance.max(initial=0.0) <= RADIUS
    np.testing.assert_array_equal(lattice.decode(found[0], missing, known), found[1])
    with native.without():
        pure = lattice.encode(wanted, missing, known, stride)
        assert pure is not None
        assert pure[0] == found[0]
        np.testing.assert_array_equal(pure[1], found[1])
        np.testing.assert_array_equal(lattice.decode(found[0], missing, known), found[1])


@pytest.mark.parametrize("kind", ["jump", "noise", "still", "huge", "coincident"])
def test_whatever_the_motion(kind: str) -> None:
    wanted, missing, known = samples(48, 5, seed=3)
    rng = np.random.default_rng(4)
    wanted = wanted.copy()
    if kind == "jump":
        wanted[20:, 2] += 1e5
        wanted[33, 1] -= 4e6
    elif kind == "noise":
        wanted = rng.normal(size=wanted.shape) * 300
    elif kind == "still":
        wanted[:] = wanted[0]
    elif kind == "huge":
        wanted *= 1e5
    else:
        wanted[:, 3] = wanted[:, 1]
    found = lattice.encode(wanted, missing, known, 2)
    with native.without():
        pure = lattice.encode(wanted, missing, known, 2)
    assert found is not None
    assert pure is not None
    assert pure[0] == found[0]
    assert np.sqrt(((found[1] - wanted) ** 2).sum(axis=2))[~missing].max() <= RADIUS * (1 + 1e-6)


def test_spikes_are_stored_apart() -> None:
    wanted, missing, known = samples(40, 4)
    missing[:] = False
    spiked = wanted.copy()
    spiked[7, 2] += (900.5, -3.2, 44.0)
    spiked[31, 0] -= 2000.0
    found, plain = lattice.encode(wanted, missing, known, 2, spiked), lattice.encode(wanted, missing, known, 2)
    assert found is not None
    assert plain is not None
    assert len(found[0]) < len(plain[0]) + 30
    assert np.sqrt(((found[1] - spiked) ** 2).sum(axis=2)).max() <= RADIUS
    np.testing.assert_array_equal(lattice.decode(found[0], missing, known), found[1])


def test_samples_beyond_the_range_are_left_to_others() -> None:
    wanted, missing, known = samples(40, 4)
    assert lattice.encode(wanted * 1e9, missing, known, 2) is None
    with native.without():
        assert lattice.encode(wanted * 1e9, missing, known, 2) is None


def test_neighbours_come_before_and_back_from_their_bytes() -> None:
    for points in (1, 2, 3, 4, 41):
        known = lattice.neighbours(synthetic.markers(frames=60, seed=5).positions[:, :points])
        again = Neighbours.unpack(known.pack(), points)
        np.testing.assert_array_equal(again.table, known.table)
        placed: set[int] = set()
        for point in known.sequence.tolist():
            assert placed >= {n for n in known.table[point].tolist() if n >= 0}
            placed.add(point)
        assert len(placed) == points


def test_many_points_that_are_far_apart_are_all_placed() -> None:
    rng = np.random.default_rng(2)
    places = np.concatenate([rng.normal(size=(90, 3)), 100 + rng.normal(size=(90, 3))])
    known = lattice.neighbours(places + 0.01 * rng.normal(size=(5, 180, 3)))
    assert sorted(known.sequence.tolist()) == list(range(180))


def test_neighbours_in_a_circle_or_out_of_range_are_refused() -> None:
    circle = Neighbours(np.array([[1, -1, -1], [0, -1, -1]], np.int32))
    with pytest.raises(Corrupt, match="circle"):
        Neighbours.unpack(circle.pack(), 2)
    beyond = Neighbours(np.array([[5, -1, -1], [-1, -1, -1]], np.int32))
    with pytest.raises(Corrupt, match="out of range"):
        Neighbours.unpack(beyond.pack(), 2)


def test_damage_is_refused_or_harmless() -> None:
    wanted, missing, known = samples(33, 4)
    found = lattice.encode(wanted, missing, known, 2)
    assert found is not None
    rng = np.random.default_rng(6)
    for data in (b"", b"\x07", found[0][: len(found[0]) // 3], found[0] + bytes(range(1, 20))):
        with pytest.raises(Corrupt):
            lattice.decode(data, missing, known)
    for _ in range(30):
        broken = bytearray(found[0])
        broken[rng.integers(len(broken))] ^= 1 << rng.integers(8)
        for compiled in (True, False):
            try:
                if compiled:
                    lattice.decode(bytes(broken), missing, known)
                else:
                    with native.without():
                        lattice.decode(bytes(broken), missing, known)
            except Corrupt:
                continue


@needs_module
@pytest.mark.parametrize(("frames", "points", "apart"), [(1, 2, 0.0), (3, 5, 0.0), (150, 41, 0.0), (40, 150, 1000.0)])
def test_compiled_neighbours_are_those_of_numpy(frames: int, points: int, apart: float) -> None:
    rng = np.random.default_rng(points)
    positions = np.cumsum(rng.normal(size=(frames, points, 3)), axis=0)
    positions[:, points // 2 :] += apart
    near = lattice._candidates(positions)
    found, pairs = lattice.neighbours(positions), lattice._pairs(positions, near)
    with native.without():
        np.testing.assert_array_equal(found.table, lattice.neighbours(positions).table)
        for ours, theirs in zip(pairs, lattice._pairs(positions, near), strict=True):
            assert ours.tobytes() == theirs.tobytes()


def test_clouds_of_points_far_from_each_other_have_an_order() -> None:
    rng = np.random.default_rng(0)
    positions = np.cumsum(rng.normal(size=(20, 300, 3)), axis=0)
    positions[:, 130:] *= 1e-3  # the more rigid part is where the tree begins
    positions[:, 130:] += 1000.0
    assert sorted(lattice.neighbours(positions).sequence) == list(range(300))


@needs_module
@pytest.mark.parametrize("bound", [0.001, 0.003, 0.005])
@pytest.mark.parametrize("stride", [2, 3, 4])
def test_the_estimate_for_joints_is_near_the_bytes(bound: float, stride: int) -> None:
    positions = synthetic.joints(frames=480, seed=3).positions
    samples = positions / lattice.half_step(bound)
    missing = np.zeros(samples.shape[:2], bool)
    found = lattice.encode(samples, missing, lattice.neighbours(positions), stride)
    assert found is not None
    assert 0.5 < lattice.estimate(samples, stride) / len(found[0]) < 1.3


@pytest.mark.parametrize("frames", [1, 2, 7])
def test_few_frames_have_an_estimate(frames: int) -> None:
    wanted, _, _ = samples(frames, 3)
    assert all(0 <= lattice.estimate(wanted, stride) < 1e4 for stride in lattice.STRIDES)


@needs_module
def test_shorter_strides_suit_samples_of_many_bits() -> None:
    positions = synthetic.markers(frames=240, seed=1).positions
    positions = positions + np.random.default_rng(1).normal(0, 0.002, positions.shape)
    known, missing = lattice.neighbours(positions), np.zeros(positions.shape[:2], bool)
    wanted = positions / lattice.half_step(0.0001)
    stride, size = lattice.best_stride(wanted, missing, known)
    sizes = [len((lattice.encode(wanted, missing, known, each) or (b"", 0))[0]) for each in lattice.STRIDES]
    assert stride < lattice.USUAL_STRIDE
    assert size == min(sizes)


@needs_module
def test_an_encoder_gives_up_where_the_first_points_take_too_many_bytes() -> None:
    positions = synthetic.markers(frames=240, seed=1).positions
    known, missing = lattice.neighbours(positions), np.zeros(positions.shape[:2], bool)
    wanted = positions / lattice.half_step(0.001)
    whole = lattice.encode(wanted, missing, known, 2)
    assert whole is not None
    size = len(whole[0])
    given_up = lattice.encode_up_to(size / 2, wanted, missing, known, 2)
    assert isinstance(given_up, lattice.GivenUp)
    assert 0.5 * size < given_up.bytes < 2 * size
    finished = lattice.encode_up_to(size, wanted, missing, known, 2)
    assert isinstance(finished, tuple)
    assert finished[0] == whole[0]
