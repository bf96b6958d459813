"""Arrays of bits: round trips, compiled and pure, cut-off streams."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.entropy.adaptive_bits import INPUTS
from mocodec.entropy.bit_arrays import BitCheck, BitDecoder, BitEncoder, CodedPart
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


needs_check = pytest.mark.skipif(not BitCheck.is_available(), reason="the compiled module is not built")


def coded_parts(likely: float) -> tuple[list[CodedPart], bytes]:
    """Parts of random bits, of which few are ones, and all bytes. Each part is coded by a copy of the encoder."""
    rng = np.random.default_rng(2)
    encoder, parts = BitEncoder(keeps_bits=True), list[CodedPart]()
    for size in (0, 1, 3, 500, 3000):
        encoder = encoder.copy()
        encoder.code(rng.integers(0, 1 << 24, (size, INPUTS)), rng.integers(0, 2048, size), rng.random(size) < likely)
        parts.append(encoder.take())
    return parts, encoder.finish()


def is_refused(parts: list[CodedPart], data: bytes) -> bool:
    check = BitCheck()
    try:
        for part in parts:
            check.follow(part)
        check.finish(data)
    except Corrupt:
        return True
    return False


@needs_check
@pytest.mark.parametrize("likely", [0.0, 0.0005, 0.5])
def test_the_check_accepts_what_was_coded_and_refuses_other_bytes(likely):
    parts, data = coded_parts(likely)
    assert sum(len(part.bits) for part in parts) == 3504
    assert data.startswith(b"".join(part.data for part in parts))
    assert not is_refused(parts, data)
    for other in (data + b"12345", data[:-1], data[len(data) // 2 :]) if data else (b"12345",):
        assert is_refused(coded_parts(likely)[0], other)
    for place in range(0, len(data) - 4, 29):
        flipped = bytearray(data)
        flipped[place] ^= 1
        assert is_refused(coded_parts(likely)[0], bytes(flipped))


@needs_check
def test_the_check_finds_a_damaged_byte_while_it_follows():
    parts, _ = coded_parts(0.5)
    check = BitCheck()
    for part in parts[:-1]:
        check.follow(part)
    damaged = bytearray(parts[-1].data)
    damaged[100] ^= 16
    with pytest.raises(Corrupt):
        check.follow(CodedPart(bytes(damaged), parts[-1].bits))
