"""hou2014: the contract of every codec, the paper's numbers, targets, clips, and transforms learned elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mocodec as mc
from mocodec import metrics
from mocodec.codecs.hou2014 import Hou2014, Hou2014Database, analysis, parameters
from mocodec.errors import BadInput, CannotEncode, Corrupt
from mocodec.motion import Motion
from mocodec.testing import synthetic
from mocodec.testing.codec_tests import CodecTests


class TestHou2014(CodecTests):
    codec = staticmethod(lambda **settings: Hou2014(**settings))
    can_bound = True


class TestHou2014AsPublished(CodecTests):
    codec = staticmethod(lambda **settings: Hou2014.as_published(**settings))
    qualities = ({"components": 10}, {"components": 30}, {"components": 60})


@pytest.fixture(scope="module")
def walk() -> Motion:
    return synthetic.markers(frames=900, seed=7)


def error(motion: Motion, codec: Hou2014) -> float:
    return metrics.mean_distance(motion.positions, Hou2014.decode(codec.encode(motion)).positions)


# ---------------------------------------------------------------------------------------------- the paper's own numbers


@pytest.mark.parametrize(("k", "bits"), [(1, 0), (30, 0), (31, 1), (40, 1), (41, 2), (93, 7)])
def test_equation_13(k: int, bits: int):
    assert parameters.fraction_bits(k) == bits


@pytest.mark.parametrize(("k", "clip", "kept"), [(30, 280, 18), (30, 50, 3), (15, 350, 11), (30, 7, 3), (60, 4, 4)])
def test_equation_12(k: int, clip: int, kept: int):
    assert parameters.frequencies(k, clip) == kept


def test_the_published_coding_is_as_fine_as_its_numbers(walk: Motion):
    """With all components and frequencies only the quantiser and the 16-bit basis are left; 2^−15 of 10 m and more."""
    codec = Hou2014.as_published(components=3 * walk.points, frequencies=280, fraction_bits=7)
    assert error(walk, codec) < 0.001
    encoded = codec.encode(walk)
    assert len(encoded.shared[0]) >= 2 * (3 * walk.points) ** 2


def test_the_compressed_basis_is_smaller_and_as_good(walk: Motion):
    ours, published = Hou2014(), Hou2014.as_published()
    assert 1.25 * ours.encode(walk).payload_bytes < published.encode(walk).payload_bytes
    assert error(walk, ours) < 1.1 * error(walk, published)


# ------------------------------------------------------------------------------------------------------------- targets


@pytest.mark.parametrize("target", [0.0005, 0.003, 0.01])
def test_a_mean_error_is_met_from_below(walk: Motion, target: float):
    assert 0.97 * target <= error(walk, Hou2014(mean_error=target)) <= target


@pytest.mark.parametrize("target", [30, 90])
def test_a_ratio_is_met_from_above(walk: Motion, target: float):
    ratio = walk.raw_bytes / Hou2014(ratio=target).encode(walk).payload_bytes
    assert target <= ratio <= 1.03 * target


def test_targets_that_cannot_be(walk: Motion):
    with pytest.raises(CannotEncode):
        Hou2014(ratio=1e9).encode(walk)
    with pytest.raises(BadInput):
        Hou2014(ratio=10, max_error=0.01).encode(walk)
    with pytest.raises(BadInput):
        Hou2014(mean_error=-1.0).encode(walk)
    with pytest.raises(BadInput):
        Hou2014(segmentation="none").encode(walk)


# --------------------------------------------------------------------------------------------------------------- clips


@pytest.mark.parametrize("frames", [1, 10, 279, 281, 600])
def test_any_number_of_frames_comes_back(walk: Motion, frames: int):
    part = walk[:frames]
    for codec in (Hou2014(), Hou2014(mean_error=0.002)):
        decoded = Hou2014.decode(codec.encode(part))
        assert decoded.positions.shape == part.positions.shape
        assert metrics.mean_distance(part.positions, decoded.positions) < 0.02


def test_chunks_decode_alone(walk: Motion):
    encoded = Hou2014(mean_error=0.001, clip_frames=100, chunk_frames=300).encode(walk)
    assert [chunk.frames for chunk in encoded.chunks] == [300, 300, 300]
    whole = Hou2014.decode(encoded).positions
    lost = replace(encoded, chunks=tuple(replace(c, payload=b"") if c.start == 300 else c for c in encoded.chunks))
    assert np.array_equal(Hou2014.decode(lost, slice(650, 880)).positions, whole[650:880])
    with pytest.raises(Corrupt):
        Hou2014.decode(lost)


def test_adaptive_clips(walk: Motion):
    walks = walk.select(walk.names[:8])
    still = replace(
        walks, positions=np.concatenate([walks.positions[:300], walks.positions[299:300].repeat(300, axis=0)])
    )
    encoded = Hou2014(segmentation="adaptive", mean_error=0.001).encode(still)
    assert metrics.mean_distance(still.positions, Hou2014.decode(encoded).positions) <= 0.001
    assert error(still, Hou2014(segmentation="adaptive", clips=2)) < 0.02


def test_gaps_and_constant_points(walk: Motion):
    positions = walk.positions.copy()
    positions[100:140, 5] = positions[:, 9] = np.nan
    positions[:, 2] = [0.5, -1.0, 2.0]
    motion = replace(walk, positions=positions)
    decoded = Hou2014.decode(Hou2014(max_error=0.003).encode(motion))
    assert np.array_equal(decoded.gaps, motion.gaps)
    assert np.nanmax(metrics.distances(positions, decoded.positions)) <= 0.003


# ------------------------------------------------------------------------------------------------------------- weights


def test_points_of_weight_are_kept_closer(walk: Motion):
    name = walk.names[4]
    plain = Hou2014(ratio=60)
    heavy = replace(plain, point_weights={name: 30.0})
    of_point = [
        metrics.distances(walk.positions, Hou2014.decode(codec.encode(walk)).positions)[:, 4].mean()
        for codec in (plain, heavy)
    ]
    assert of_point[1] < 0.7 * of_point[0]
    with pytest.raises(BadInput):
        Hou2014(point_weights={"nobody": 2.0}).encode(walk)


def test_masking_gives_fast_clips_the_error(walk: Motion):
    slow = walk.positions[:450]
    fast = walk.positions[450::3]
    motion = replace(walk, positions=np.concatenate([slow, fast]))
    codec = Hou2014(clip_frames=150, mean_error=0.004)
    shares = []
    for masking in (0.0, 1.0):
        decoded = Hou2014.decode(replace(codec, masking=masking).encode(motion))
        far = metrics.distances(motion.positions, decoded.positions).mean(axis=1)
        shares.append(far[450:].mean() / far[:450].mean())
    assert shares[1] > 1.2 * shares[0]


# ------------------------------------------------------------------------------------------------------------ database


@pytest.fixture(scope="module")
def people() -> list[Motion]:
    return [synthetic.markers(frames=420, seed=seed) for seed in range(5)]


def test_learned_transforms_are_shared_bytes(people: list[Motion]):
    learned = Hou2014Database(transforms=2, clip_frames=140).fit(people[:4])
    encoded = [learned.codec(one, mean_error=0.003).encode(one) for one in people]
    assert len({one.shared[1:] for one in encoded}) == 1
    own = Hou2014(mean_error=0.003).encode(people[4])
    assert len(encoded[4].shared[0]) + sum(len(c.payload) for c in encoded[4].chunks) < own.payload_bytes
    for one, codec in zip(people, encoded, strict=True):
        assert metrics.mean_distance(one.positions, Hou2014.decode(codec).positions) <= 0.003


def test_a_file_with_learned_transforms_decodes_alone(people: list[Motion]):
    learned = Hou2014Database(transforms=2).fit(people[:3])
    blob = mc.encode(people[4], codec=learned.codec(people[4], max_error=0.005))
    assert metrics.distances(people[4].positions, mc.decode(blob).positions).max() <= 0.005
    assert "transforms" not in mc.open(blob).encoded.settings


def test_annealing_finds_two_kinds_and_converges():
    rng = np.random.default_rng(5)
    kinds = [np.linalg.qr(rng.normal(size=(30, 4)))[0] for _ in range(2)]
    time = np.linspace(0, 1, 280)
    motions = []
    for i in range(24):
        curves = sum(rng.normal(size=(1, 4)) * np.cos(np.pi * f * time)[:, None] for f in range(1, 8))
        motions.append(Motion((curves @ kinds[i % 2].T).reshape(280, 10, 3), 120.0))
    learned = Hou2014Database(transforms=2, components=4, tolerance=1e-6).fit(motions)
    (how,) = learned.how.values()
    assert how.converged
    assert how.iterations <= 30
    assert len(set(how.choice[::2])) == len(set(how.choice[1::2])) == 1
    assert how.choice[0] != how.choice[1]
    assert how.distortions[-1] < 1e-3 * how.distortions[0]


def test_marker_sets_are_kept_apart(people: list[Motion]):
    other = synthetic.joints(frames=300, seed=1)
    learned = Hou2014Database(transforms=1).fit([people[0], other])
    assert set(learned.transforms) == {people[0].names, other.names}
    assert learned.codec(people[1].select(people[1].names[:4])).transforms == ()
    with pytest.raises(BadInput):
        Hou2014Database().fit([])


def test_spectra_on_disk_give_the_same_transforms(people: list[Motion]):
    told: list[tuple[str, int, int]] = []
    here = Hou2014Database(transforms=2).fit(people, lambda *what: told.append(what))
    there = Hou2014Database(transforms=2, memory_bytes=20_000).fit(people)
    assert here.transforms == there.transforms
    assert told[0] == ("reading", 1, 5)


# ------------------------------------------------------------------------------------------------------------ analysis


def test_table_i_and_the_spectra(walk: Motion):
    m = analysis.matrix(walk.positions)
    assert m.shape == (3 * walk.points, len(walk))
    assert np.array_equal(m[walk.points + 2], walk.positions[:, 2, 1])
    assert analysis.variation(m) < 0.05 * analysis.spread(m)
    ramp = np.arange(12.0).reshape(1, 12)
    assert np.isclose(analysis.variation(ramp), 11 / 12)
    assert np.isclose(analysis.spread(ramp), ramp.std())
    whole = analysis.singular_values(m)
    assert whole[0] == 1
    assert all(analysis.singular_values(clip)[20] < whole[20] for clip in analysis.clips(m, 60, 3))
    assert analysis.unfolded(m, 60).shape == (15, 60 * 3 * walk.points)
    row = analysis.coefficients_for(analysis.row_spectrum(m, 0))
    column = analysis.coefficients_for(analysis.column_spectrum(m, 100))
    assert row / m.shape[1] < 0.5 * column / m.shape[0]
