"""hou2014: the contract of every codec, the published coding, targets, gaps, point weights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mocodec import metrics
from mocodec.codecs.hou2014 import Hou2014
from mocodec.errors import BadInput, CannotEncode
from mocodec.motion import Motion
from mocodec.testing.codec_tests import CodecTests


class TestHou2014(CodecTests):
    codec = staticmethod(lambda **settings: Hou2014(**settings))
    can_bound = True


class TestHou2014AsPublished(CodecTests):
    codec = staticmethod(lambda **settings: Hou2014.as_published(**settings))
    qualities = ({"components": 10}, {"components": 30}, {"components": 60})


def mean_error(motion: Motion, codec: Hou2014) -> float:
    return metrics.mean_distance(motion.positions, Hou2014.decode(codec.encode(motion)).positions)


# ------------------------------------------------------------------------------------------------ the published coding


def test_published_coding_with_all_coefficients_has_only_rounding_error(walk: Motion):
    """Only the quantiser and the 16-bit basis are left: 2^−15 of positions that are metres from the origin."""
    codec = Hou2014.as_published(components=3 * walk.points, frequencies=280, fraction_bits=7)
    assert mean_error(walk, codec) < 0.001
    encoded = codec.encode(walk)
    assert len(encoded.shared[0]) >= 2 * (3 * walk.points) ** 2


def test_compressed_basis_is_smaller_at_about_the_same_error(walk: Motion):
    ours, published = Hou2014(), Hou2014.as_published()
    assert 1.25 * ours.encode(walk).payload_bytes < published.encode(walk).payload_bytes
    assert mean_error(walk, ours) < 1.1 * mean_error(walk, published)


# ------------------------------------------------------------------------------------------------------------- targets


@pytest.mark.parametrize("target", [0.0005, 0.003, 0.01])
def test_mean_error_is_at_most_and_near_the_target(walk: Motion, target: float):
    assert 0.97 * target <= mean_error(walk, Hou2014(mean_error=target)) <= target


@pytest.mark.parametrize("target", [30, 90])
def test_ratio_is_at_least_and_near_the_target(walk: Motion, target: float):
    ratio = walk.raw_bytes / Hou2014(ratio=target).encode(walk).payload_bytes
    assert target <= ratio <= 1.03 * target


def test_unreachable_ratio_raises_cannot_encode(walk: Motion):
    with pytest.raises(CannotEncode):
        Hou2014(ratio=1e9).encode(walk)


@pytest.mark.parametrize(
    "codec",
    [Hou2014(ratio=10, max_error=0.01), Hou2014(mean_error=-1.0), Hou2014(segmentation="none")],
    ids=["two targets", "negative target", "unknown segmentation"],
)
def test_invalid_settings_raise_bad_input(walk: Motion, codec: Hou2014):
    with pytest.raises(BadInput):
        codec.encode(walk)


# ------------------------------------------------------------------------------------------------- gaps, point weights


def test_gaps_and_constant_points_keep_the_bound(walk: Motion):
    positions = walk.positions.copy()
    positions[100:140, 5] = positions[:, 9] = np.nan
    positions[:, 2] = [0.5, -1.0, 2.0]
    motion = replace(walk, positions=positions)
    decoded = Hou2014.decode(Hou2014(max_error=0.003).encode(motion))
    assert np.array_equal(decoded.gaps, motion.gaps)
    assert np.nanmax(metrics.distances(positions, decoded.positions)) <= 0.003


def test_point_weight_lowers_the_error_of_its_point(walk: Motion):
    unweighted = Hou2014(ratio=60)
    weighted = replace(unweighted, point_weights={walk.names[4]: 30.0})
    errors = [
        metrics.distances(walk.positions, Hou2014.decode(codec.encode(walk)).positions)[:, 4].mean()
        for codec in (unweighted, weighted)
    ]
    assert errors[1] < 0.7 * errors[0]


def test_point_weight_of_an_unknown_point_raises_bad_input(walk: Motion):
    with pytest.raises(BadInput):
        Hou2014(point_weights={"unknown": 2.0}).encode(walk)
