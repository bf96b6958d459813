"""lossless: the contract of every codec, and exact round trips."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import mocodec as mc
from mocodec.codecs import lossless
from mocodec.codecs.lossless import Lossless
from mocodec.errors import BadInput, Corrupt
from mocodec.motion import Motion
from mocodec.testing import CodecTests, synthetic


def bits(positions: np.ndarray) -> np.ndarray:
    return positions.astype(np.float32).view(np.int32)


class TestLossless(CodecTests):
    codec = staticmethod(lambda **settings: Lossless(**settings))
    usual_error = 1e-6
    refuses = frozenset({"huge"})


def test_float32_round_trips_bit_for_bit() -> None:
    motion = synthetic.markers(frames=500, seed=3)
    decoded = mc.decode(mc.encode(motion, codec="lossless"))
    assert np.array_equal(bits(decoded.positions), bits(motion.positions))


def test_float32_millimetres_round_trip_in_float64() -> None:
    """The positions of a C3D file: float32 in millimetres, times 0.001."""
    walk = synthetic.markers(frames=200, seed=3)
    motion = replace(
        walk, positions=(walk.positions * 1000).astype(np.float32).astype(float) * 0.001, source={"unit_m": 0.001}
    )
    assert np.array_equal(mc.decode(mc.encode(motion, codec="lossless")).positions, motion.positions)


def test_decimals_of_a_text_file_round_trip_in_float64_and_need_fewer_bytes() -> None:
    walk = synthetic.markers(frames=200, seed=3)
    motion = replace(walk, positions=np.round(walk.positions * 1000, 2) * 0.001, source={"unit_m": 0.001})
    blob = mc.encode(motion, codec="lossless")
    assert np.array_equal(mc.decode(blob).positions, motion.positions)
    assert len(blob) < len(mc.encode(walk, codec="lossless")) * 0.8


def test_ranks_keep_signed_zeros_and_subnormals_and_grow_with_the_value() -> None:
    values = np.array([0.0, -0.0, 1e-45, -1e-45, 1.0, -1.0, 3.4e38, -3.4e38], np.float32)
    assert np.array_equal(bits(lossless.rank_to_float(lossless.float_to_rank(values))), bits(values))
    ranks = lossless.float_to_rank(np.sort(values[2:]))
    assert (np.diff(ranks) > 0).all()


def test_positions_beyond_float32_are_stored_as_float64() -> None:
    motion = Motion(np.full((3, 1, 3), 1e39), 120.0)
    assert np.array_equal(Lossless.decode(Lossless().encode(motion)).positions, motion.positions)


def test_chunks_of_zero_seconds_raise_bad_input() -> None:
    with pytest.raises(BadInput):
        Lossless(chunk_seconds=0).encode(synthetic.markers(frames=3))


def test_damaged_header_or_payload_raises_corrupt() -> None:
    encoded = Lossless().encode(synthetic.markers(frames=30))
    with pytest.raises(Corrupt):
        Lossless.decode(replace(encoded, shared=(b"x",)))
    with pytest.raises(Corrupt):
        Lossless.decode(replace(encoded, chunks=(replace(encoded.chunks[0], payload=b"\xff"),)))


def test_a_predictor_whose_fit_overflows_is_left_out() -> None:
    """Two values, of which one occurs only in the frames that the predictor begins with: its errors are all zero."""
    positions = np.zeros((46, 7, 3))
    positions[1, :, :] = 10.0
    motion = Motion(positions, 30, source={"unit_m": 0.001})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        decoded = Lossless.decode(Lossless().encode(motion))
    np.testing.assert_array_equal(decoded.positions, positions)
