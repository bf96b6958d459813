"""Chunks that the compiled module decodes whole: the positions of the NumPy code, and its errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from mocodec import native, parallel
from mocodec.codecs.tempo import Tempo, chunk_decoding, compiled_chunks
from mocodec.codecs.tempo.chunk import TRANSFORM, Payload, grid_size
from mocodec.codecs.tempo.header import StreamHeader
from mocodec.codecs.tempo.models.model import Model
from mocodec.encoded import Chunk, Encoded
from mocodec.errors import Corrupt
from mocodec.motion import Motion
from mocodec.testing import synthetic

from .motions import named_skeleton

pytestmark = pytest.mark.skipif(not native.available(), reason="mocodec._native is not built, or switched off")


def markers(up: str = "z", gaps: bool = False) -> Motion:
    motion = synthetic.markers(frames=700, seed=4)
    positions = motion.positions.copy()
    if gaps:
        positions[100:140, 3] = np.nan
        positions[300:, 5] = positions[300, 5]
    return replace(motion, positions=positions, up=up)


def encodings() -> Iterator[tuple[str, Motion, Tempo]]:
    joints = replace(synthetic.joints(frames=500, seed=2), rotations=None)
    yield "directions", joints, Tempo(max_error=0.002, model="transform")
    yield "directions, stored", joints, Tempo(mean_error=0.004, model="directions-stored")
    yield "named joints", named_skeleton(frames=400), Tempo(max_error=0.005, model="directions-prior")
    yield "named points", named_skeleton(frames=400), Tempo(max_error=0.005, model="points-prior")
    yield "markers", markers("x"), Tempo(max_error=0.003, model="transform")
    yield "markers, stored", markers("y"), Tempo(max_error=0.001, model="points-stored")
    yield "gaps", markers("z", gaps=True), Tempo(max_error=0.003, model="transform")
    yield "weights", markers(), Tempo(max_error=0.02, model="points-stored", weights={"LTOE": 8.0, "RTOE": 3.0})


@pytest.fixture(scope="module")
def encoded() -> dict[str, Encoded[Motion]]:
    return {name: codec.encode(motion) for name, motion, codec in encodings()}


def model_of(encoded: Encoded[Motion]) -> Model:
    return StreamHeader.unpack(encoded.shared, encoded.about.points).read_model(encoded.about)


def test_positions_are_those_of_numpy(encoded: dict[str, Encoded[Motion]]):
    for name, stream in encoded.items():
        with native.without():
            expected = Tempo.decode(stream).positions
        model, compiled = model_of(stream), 0
        for chunk in stream.chunks:
            payload = Payload.unpack(chunk.payload)
            if payload.engine == TRANSFORM and not payload.gaps:
                out = np.empty((chunk.frames, model.points, 3))
                step = 0.0 if payload.step is None else grid_size(payload.step)
                compiled += compiled_chunks.decode(model, chunk.frames, payload.numbers, step, out)
        assert compiled > 0 or name == "gaps", name
        found = Tempo.decode(stream).positions
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11, err_msg=name)
        for start, stop in ((0, 1), (37, 290), (len(expected) - 3, len(expected))):
            np.testing.assert_array_equal(Tempo.decode(stream, slice(start, stop)).positions, found[start:stop])


@pytest.mark.parametrize("frames", [1, 2, 3, 4, 5, 8, 9, 17, 31, 64, 101, 240, 257, 459, 512, 1023])
def test_coefficients_of_any_number_of_frames_are_those_of_numpy(encoded: dict[str, Encoded[Motion]], frames: int):
    model, positions = model_of(encoded["named joints"]), named_skeleton(frames=frames).positions
    expected = model.analyse(positions)
    found = compiled_chunks.analyse(model, positions)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


def test_numpy_encodes_to_the_same_bytes(encoded: dict[str, Encoded[Motion]]):
    """Trials of a step: quantisation, errors, corrections; and coordinates of bones."""
    for name, motion, codec in encodings():
        with native.without():
            expected = codec.encode(motion)
        assert expected.shared == encoded[name].shared, name
        assert [c.payload for c in expected.chunks] == [c.payload for c in encoded[name].chunks], name


def test_many_points_are_those_of_numpy() -> None:
    """Few components have most of the frequencies: their curves are made before their product with the basis."""
    walk = synthetic.markers(frames=150, seed=6)
    random = np.random.default_rng(6)
    positions = np.tile(walk.positions, (1, 3, 1))[:, :100] + random.normal(0, 0.03, (1, 100, 3))
    positions += random.normal(0, 0.0002, positions.shape)
    motion = Motion(positions, walk.rate, tuple(f"p{i}" for i in range(100)), walk.up)
    stream = Tempo(max_error=0.002, model="points-stored").encode(motion)
    found = Tempo.decode(stream).positions
    with native.without():
        np.testing.assert_allclose(found, Tempo.decode(stream).positions, rtol=0, atol=1e-9)
        assert Tempo(max_error=0.002, model="points-stored").encode(motion).chunks == stream.chunks
    for start, stop in ((0, 1), (37, 90), (147, 150)):
        np.testing.assert_array_equal(Tempo.decode(stream, slice(start, stop)).positions, found[start:stop])


def test_threads_decode_the_same(encoded: dict[str, Encoded[Motion]]):
    stream = encoded["markers, stored"]
    chunks = [Chunk(c.start + turn * stream.frames, c.frames, c.payload) for turn in range(6) for c in stream.chunks]
    longer = replace(stream, chunks=chunks)
    alone = Tempo.decode(longer).positions
    with parallel.threads(3):
        np.testing.assert_array_equal(Tempo.decode(longer).positions, alone)
        np.testing.assert_array_equal(Tempo.decode(longer, slice(91, 3000)).positions, alone[91:3000])
        damaged = [*chunks[:5], Chunk(chunks[5].start, chunks[5].frames, b"\xff"), *chunks[6:]]
        with pytest.raises(Corrupt):
            Tempo.decode(replace(stream, chunks=damaged))


def test_damaged_bytes_are_left_to_numpy(encoded: dict[str, Encoded[Motion]]):
    """What the compiled module takes, NumPy takes too, with the same result; all else is left to it."""
    random, taken, left = np.random.default_rng(5), 0, 0
    for stream in encoded.values():
        model, chunk = model_of(stream), stream.chunks[-1]
        payload = Payload.unpack(chunk.payload)
        if payload.engine != TRANSFORM:
            continue
        numbers = payload.numbers
        damaged = [numbers[:n] for n in random.integers(0, len(numbers), 6)] + [numbers + b"\0", b""]
        for _ in range(8):
            changed = bytearray(numbers)
            changed[int(random.integers(min(len(numbers), 60)))] ^= 1 << int(random.integers(8))
            damaged.append(bytes(changed))
        for data in damaged:
            out = np.zeros((chunk.frames, model.points, 3))
            step = 0.0 if payload.step is None else grid_size(payload.step)
            is_taken = compiled_chunks.decode(model, chunk.frames, data, step, out)
            whole = replace(payload, numbers=data, gaps=b"").pack()
            with native.without(), np.errstate(all="ignore"):
                try:
                    expected = chunk_decoding.decode(model, [Chunk(0, chunk.frames, whole)])[0]
                except Corrupt:
                    assert not is_taken
                    left += 1
                    continue
            assert is_taken
            taken += 1
            scale = max(1.0, float(np.abs(expected).max()))
            assert np.abs(out - expected).max() <= 1e-9 * scale
    assert left > 20


def test_lengths_of_chunks_are_kept_within_a_limit(encoded: dict[str, Encoded[Motion]]):
    model = model_of(encoded["markers, stored"])
    for frames in range(1, 60):
        assert compiled_chunks.decodes(model, frames)
        assert len(model.compiled) <= compiled_chunks.MOST_LENGTHS + 2
    assert not compiled_chunks.decodes(model, 2000)
    assert not compiled_chunks.decodes(Model.without_rows(("a",), 120.0), 10)


def test_any_frames_of_a_chunk_are_those_of_the_whole(encoded: dict[str, Encoded[Motion]]):
    random = np.random.default_rng(5)
    for name, stream in encoded.items():
        whole = Tempo.decode(stream).positions
        for start, length in zip(random.integers(0, len(whole), 40), random.integers(1, 90, 40), strict=True):
            part = Tempo.decode(stream, slice(int(start), int(start + length))).positions
            np.testing.assert_allclose(part, whole[start : start + length], rtol=0, atol=1e-12, err_msg=name)
