"""Signals come back bit for bit, in all forms, compiled and in NumPy."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np
import pytest

from mocodec import native
from mocodec.errors import Corrupt, MocodecError
from mocodec.fields.cursor import Cursor
from mocodec.signals import codec, fitting, forms, residuals
from mocodec.testing.signals import cases, noise, plate, slow

RATE = 1000.0
SIGNALS = cases()


def coded(values: np.ndarray) -> tuple[codec.Head, list[bytes]]:
    result = codec.encode(values, RATE)
    assert result is not None
    return result


@pytest.mark.parametrize("name", SIGNALS)
def test_comes_back_bit_for_bit(name: str) -> None:
    values = SIGNALS[name]
    head, chunks = coded(values)
    cursor = Cursor(codec.pack(head), "test")
    again = codec.unpack(cursor, values.dtype, values.shape)
    cursor.done()
    assert again == head
    decoded = codec.decode(again, chunks.__getitem__).reshape(values.shape)
    assert decoded.dtype == values.dtype
    assert decoded.tobytes() == values.tobytes()
    if values.size > 100:
        assert sum(map(len, chunks)) < values.nbytes


@pytest.mark.parametrize("name", SIGNALS)
def test_numpy_gives_the_same_bits(name: str) -> None:
    if not native.available():
        pytest.skip("the compiled module is not built")
    values = SIGNALS[name]
    head, chunks = coded(values)
    with native.without():
        assert coded(values) == (head, chunks)
        assert codec.decode(head, chunks.__getitem__).reshape(values.shape).tobytes() == values.tobytes()


def test_a_slice_reads_its_chunks_and_channels_only() -> None:
    values = np.rint(slow(30_000, 1000)[:, None] + noise(60_000, 3).reshape(-1, 2)).astype(np.int16)
    head, chunks = coded(values)
    assert len(chunks) > 2
    read: list[int] = []

    def payload(number: int) -> bytes:
        read.append(number)
        return chunks[number]

    start = head.chunk_samples + 10
    part = codec.decode(head, payload, start, start + 200, [1])
    assert read == [1]
    np.testing.assert_array_equal(part[:, 0], values[start : start + 200, 1])
    assert codec.decode(head, payload, 5, 5).shape == (0, 2)


def test_forces_that_follow_from_sensors_take_few_bits() -> None:
    values = plate(4000)
    together = sum(map(len, coded(values)[1]))
    sensors, forces = (sum(map(len, coded(part)[1])) for part in (values[:, :4], values[:, 4:]))
    assert together < sensors + forces / 2


def test_forms_are_found_by_channel() -> None:
    kinds = {name: coded(SIGNALS[name])[0].forms[0].kind for name in ("plate", "filtered", "few values", "counts")}
    assert kinds == {"plate": 2, "filtered": 4, "few values": 5, "counts": 1}


def test_numbers_that_are_too_large_are_left_to_arrays() -> None:
    assert codec.encode(np.array([0, 1, 1 << 60]), RATE) is None
    assert not codec.suits(np.zeros((3, 2), complex))
    assert not codec.suits(np.zeros((0, 2)))


def test_residuals_of_noise_take_few_bits_more_than_its_entropy() -> None:
    values = np.rint(noise(8000, 20)).astype(np.int64)
    share = np.unique(values, return_counts=True)[1] / len(values)
    lane = residuals.encode([values])[0]
    assert 8 * (2 * len(lane.words) + len(lane.raw)) < 1.01 * len(values) * -(share * np.log2(share)).sum()


def outcome(head: codec.Head, payload: bytes) -> bytes | None:
    """The bytes of the first chunk's samples, None where the payload is damaged."""
    try:
        return codec.decode(head, lambda _: payload, 0, head.chunk_samples).tobytes()
    except Corrupt:
        return None


@pytest.mark.parametrize("name", ["plate", "filtered", "few values", "odd floats", "twice each"])
def test_damage_is_corrupt_or_decodes(name: str) -> None:
    """Random damage behind valid checksums: an error, never a crash or a large allocation; NumPy agrees."""
    values = SIGNALS[name]
    head, chunks = coded(values)
    random = np.random.default_rng(5)
    for i in range(120):
        broken = bytearray(chunks[0])
        broken[random.integers(len(broken))] ^= 1 << random.integers(8)
        found = outcome(head, bytes(broken))
        if i < 6:
            with native.without():
                assert outcome(head, bytes(broken)) == found
    for end in range(0, len(chunks[0]), 37):
        with pytest.raises(Corrupt):
            codec.decode(head, lambda _, end=end: chunks[0][:end])


def test_damaged_heads_are_corrupt() -> None:
    values = SIGNALS["few values"]
    data = codec.pack(coded(values)[0])
    random = np.random.default_rng(6)
    for _ in range(200):
        broken = bytearray(data)
        broken[random.integers(len(broken))] ^= 1 << random.integers(8)
        with contextlib.suppress(MocodecError):
            codec.unpack(Cursor(bytes(broken), "test"), values.dtype, values.shape)


def test_circles_and_constants_are_no_references() -> None:
    from mocodec.signals import chunks, prediction
    from mocodec.signals.prediction import Predictor

    lane = residuals.encode([np.zeros(3, np.int64)])[0]

    def record(channel: int) -> bytes:
        predictor = prediction.pack(Predictor(4, 0, (16,), ((channel, (1, 0, 0)),)))
        return bytes([chunks.HAS_PREDICTOR]) + b"\0" + predictor + chunks._pack_lane(lane)

    counts = forms.Form(forms.INTEGERS)
    constant = forms.Form(forms.CONSTANT, item=bytes(2))
    for payload, channel_forms in (
        (record(1) + record(0), [counts, counts]),
        (record(0), [counts]),
        (record(1), [counts, constant]),
    ):
        with pytest.raises(Corrupt, match="refer"):
            chunks.decode(payload, channel_forms, np.dtype(np.int16), 3, [0])


def test_a_coarser_step_is_preferred_to_one_of_another_channel() -> None:
    steps = np.rint(slow(3000, 500) + noise(3000, 20))
    values = np.stack([steps * 2.0**-20, steps[::-1] * 0.75], axis=1).astype(np.float32)
    found = codec.encode(values, 1000.0)
    assert found is not None
    assert [form.step for form in found[0].forms] == [2.0**-20, 0.75]


@pytest.mark.parametrize("samples", [24, 33, 1100, 4000])
def test_predictors_have_the_same_bits_in_numpy(samples: int) -> None:
    if not native.available():
        pytest.skip("the compiled module is not built")
    integers = np.rint(plate(samples).T.astype(np.float64) * 1000).astype(np.int64)
    kept = noise(samples, 1.0) > -1.5
    channels = [fitting.Channel(row, kept | (i == 0), i) for i, row in enumerate(integers)]
    chosen = [choice for choice in fitting.choose(channels) if choice is not None]
    with native.without():
        in_numpy = [choice for choice in fitting.choose(channels) if choice is not None]
    assert [choice.predictor for choice in in_numpy] == [choice.predictor for choice in chosen]
    for choice, other in zip(chosen, in_numpy, strict=True):
        np.testing.assert_array_equal(choice.residuals, other.residuals)
    assert samples < 100 or any(choice.predictor and choice.predictor.references for choice in chosen)


def test_a_channel_that_repeats_another_takes_no_bytes() -> None:
    head, chunks = coded(SIGNALS["copies"])
    assert [(form.kind, form.channel) for form in head.forms[2:]] == [(forms.COPY, 0), (forms.COPY, 1), (forms.COPY, 1)]
    assert sum(map(len, chunks)) == sum(map(len, coded(SIGNALS["copies"][:, :2])[1]))
    part = codec.decode(head, chunks.__getitem__, 5, 9, [4, 2])
    np.testing.assert_array_equal(part, SIGNALS["copies"][5:9, [4, 2]])
    for bad in (2, 4, 9):
        broken = replace(head, forms=(*head.forms[:2], *[forms.Form(forms.COPY, channel=bad)] * 3))
        with pytest.raises(Corrupt, match="copies"):
            codec.unpack(Cursor(codec.pack(broken), "test"), head.dtype, head.shape)


def test_zeros_that_fill_gaps_do_not_disturb_the_prediction() -> None:
    smooth = (5 + slow(400, 0.3)).astype(np.float32)
    filled = smooth.copy()
    filled[:8], filled[-3:] = 0, 0
    sizes = [sum(map(len, coded(values[:, None])[1])) for values in (smooth, filled)]
    assert sizes[1] < sizes[0] + 60
    head, chunks = coded(filled[:, None])
    assert codec.decode(head, chunks.__getitem__).tobytes() == filled.tobytes()
    crossing = (np.rint(slow(4000, 300) + noise(4000, 3)) + 0.0).astype(np.float32)
    assert (crossing == 0).any()
    assert coded(crossing[:, None])[1][0][0] & 1 == 0  # no sample is removed
