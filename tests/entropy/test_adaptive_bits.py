"""Bits come back from their bytes, and cost about their entropy."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.entropy import adaptive_bits
from mocodec.entropy.adaptive_bits import Decoder, Encoder, Mixer


def coded(bits: list[int], kinds: list[int]) -> bytes:
    encoder, mixer = Encoder(), Mixer()
    for bit, kind in zip(bits, kinds, strict=True):
        mixer.contexts([kind, 0, kind // 2, 1, 2])
        encoder.bit(bit, mixer.mix(0, 0))
        mixer.learn(bit)
    return encoder.finish()


def decoded(data: bytes, kinds: list[int]) -> tuple[list[int], Decoder]:
    decoder, mixer = Decoder(data), Mixer()
    bits = []
    for kind in kinds:
        mixer.contexts([kind, 0, kind // 2, 1, 2])
        bits.append(decoder.bit(mixer.mix(0, 0)))
        mixer.learn(bits[-1])
    return bits, decoder


@pytest.mark.parametrize("count", [0, 1, 2, 7, 500, 3000])
def test_bits_come_back(count: int) -> None:
    rng = np.random.default_rng(count)
    kinds = rng.integers(0, 6, count).tolist()
    bits = (rng.random(count) < np.array([0.02, 0.1, 0.3, 0.5, 0.9, 0.99])[kinds]).astype(int).tolist()
    data = coded(bits, kinds)
    found, decoder = decoded(data, kinds)
    assert found == bits
    assert decoder.at_end
    assert not decoder.exhausted


def test_bits_cost_about_their_entropy() -> None:
    rng = np.random.default_rng(1)
    kinds = rng.integers(0, 4, 6000).tolist()
    p = np.array([0.02, 0.1, 0.3, 0.5])
    bits = (rng.random(6000) < p[kinds]).astype(int).tolist()
    entropy = -(p * np.log2(p) + (1 - p) * np.log2(1 - p)).mean() * 6000 / 8
    assert len(coded(bits, kinds)) < 1.06 * entropy


def test_a_stream_that_is_cut_off_is_noticed() -> None:
    rng = np.random.default_rng(2)
    kinds, bits = [0] * 400, rng.integers(0, 2, 400).tolist()
    data = coded(bits, kinds)
    assert decoded(data[: len(data) // 2], kinds)[1].exhausted
    assert not decoded(data + b"\1\2\3\4\5\6", kinds)[1].at_end


def test_tables_are_the_same_on_every_machine() -> None:
    """No value is so near to a half before rounding that another library's last digit would change it."""
    logits = (np.arange(4096) - 2048) / 256
    probability = (np.arange(4096) + 0.5) / 4096
    unrounded = (
        65536 / (1 + np.exp(-logits)),
        256 * np.log(probability / (1 - probability)),
        -256 * np.log2(probability),
    )
    for values in unrounded:
        assert np.abs(values - np.floor(values) - 0.5).min() > 1e-8
    squash, stretch, rate, cost = adaptive_bits.tables()
    assert (np.diff(squash) >= 0).all()
    assert (np.diff(stretch) >= 0).all()
    assert rate[0] == 40960
    assert cost[-1] == 0
