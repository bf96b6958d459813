"""Arrays of bits: round trips, compiled and pure, cut-off streams."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.entropy.adaptive_bits import INPUTS
from mocodec.entropy.bit_arrays import BitDecoder, BitEncoder
from mocodec.errors import Corrupt


def arrays(count: int = 2000):
    rng = np.random.default_rng(0)
    for size in (0, 1, count):
        contexts = rng.integers(0, 8, (size, INPUTS))
        yield contexts, rng.integers(0, 5, size), rng.random(size) < contexts[:, 0] / 7


def packed() -> bytes:
    encoder = BitEncoder()
    for contexts, sets, bits in arrays():
        encoder.code(contexts, sets, bits)
    return encoder.finish()


def test_round_trip_and_the_same_bytes_without_the_compiled_module():
    data = packed()
    assert len(data) * 8 < 0.85 * 2001
    with native.without():
        assert packed() == data
        decoders = [BitDecoder(data)]
    for decoder in [*decoders, BitDecoder(data)]:
        for contexts, sets, bits in arrays():
            np.testing.assert_array_equal(decoder.code(contexts, sets), bits)
        decoder.finish()


def test_cut_off_and_left_over_bytes_are_corrupt():
    data = packed()
    with pytest.raises(Corrupt):
        BitDecoder(data + b"12345678").finish()
    contexts, sets, _ = list(arrays(4000))[-1]
    with pytest.raises(Corrupt):
        BitDecoder(data[:9]).code(contexts, sets)
    with pytest.raises(ValueError, match="bits"):
        BitEncoder().code(np.zeros((1, INPUTS), int), np.zeros(1, int), None)


def test_what_encoders_and_their_copies_write_decodes():
    rng = np.random.default_rng(1)
    likely = rng.random(60_000) < 0.0002  # many bits in a byte: bytes come long after their bits
    contexts, sets = np.zeros((len(likely), INPUTS), int), np.zeros(len(likely), int)
    encoder = BitEncoder()
    encoder.code(contexts, sets, likely)
    trial = encoder.copy()
    for coder in (encoder, trial):
        random = rng.random(30_000) < 0.5
        coder.code(contexts[:30_000], sets[:30_000], random)
        decoder = BitDecoder(coder.finish())
        np.testing.assert_array_equal(decoder.code(contexts, sets), likely)
        np.testing.assert_array_equal(decoder.code(contexts[:30_000], sets[:30_000]), random)
    assert len(BitEncoder().finish()) == 0
