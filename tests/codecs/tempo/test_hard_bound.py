"""Few trials of a step, a bound that is kept whatever a trial says, and a test that spares hou2014."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec import native
from mocodec.codecs.tempo import Tempo, chunk, fallback, hard_bound, model_choice
from mocodec.codecs.tempo.chunk import DIRECT, Payload
from mocodec.codecs.tempo.coding.coefficients import list_coding
from mocodec.codecs.tempo.models import Recording
from mocodec.codecs.tempo.preparation import prepare
from mocodec.stages import dct

from .motions import error, named_points, smooth


def test_most_chunks_are_tried_once_or_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    tried, within = [0], chunk.ChunkEncoder.within_bound

    def counted(encoder: chunk.ChunkEncoder, bound: float, offset: int, *most_bits: float) -> chunk.Draft:
        tried[0] += 1
        return within(encoder, bound, offset, *most_bits)

    monkeypatch.setattr(chunk.ChunkEncoder, "within_bound", counted)
    motion = named_points(3000)
    encoded = Tempo(max_error=0.01, model="transform", chunk_seconds=2.0).encode_chunks(motion)
    searched = min(hard_bound.SEARCHED, len(encoded.chunks))
    assert tried[0] <= 4 * searched + 2 * (len(encoded.chunks) - searched)
    assert error(motion, Tempo.decode(encoded)).max() <= 0.01


def test_a_block_begins_with_the_step_of_the_block_before(monkeypatch: pytest.MonkeyPatch) -> None:
    offsets, within = list[int](), chunk.ChunkEncoder.within_bound

    def recorded(encoder: chunk.ChunkEncoder, bound: float, offset: int, *most_bits: float) -> chunk.Draft:
        offsets.append(offset)
        return within(encoder, bound, offset, *most_bits)

    monkeypatch.setattr(chunk.ChunkEncoder, "within_bound", recorded)
    motion = named_points(1200)
    source = prepare(motion.positions, motion.up)
    model = model_choice.choose(Recording([source.smooth], motion, -200), "points-prior").model
    earlier = hard_bound.Earlier()
    for first in (0, 600):
        offsets.clear()
        begin = earlier.begin
        bounds = [(start, start + 100) for start in range(first, first + 600, 100)]
        hard_bound.to_bound(chunk.encoders(model, source, bounds), 0.01, earlier=earlier)
        assert offsets[0] == (chunk.FIRST_OFFSET if begin is None else begin[0])
    assert len(offsets) <= 3 + 2 * (len(bounds) - 1)


def test_a_step_whose_coefficients_take_too_many_bits_is_given_up() -> None:
    motion = named_points(300)
    source = prepare(motion.positions, motion.up)
    model = model_choice.choose(Recording([source.smooth], motion, -200), "points-prior").model
    encoder = chunk.ChunkEncoder.of(model, source, slice(None))
    whole = encoder.within_bound(0.01, 40)
    assert whole.numbers is not None
    assert whole.numbers.lists is not None
    coefficients = whole.bits - list_coding(model, whole.numbers.lists)[1]
    for few, most_bits in ((True, coefficients - 1), (False, coefficients + 1)):
        assert (encoder.within_bound(0.01, 40, most_bits).numbers is None) == few
        with native.without():
            assert (encoder.within_bound(0.01, 40, most_bits).numbers is None) == few


def test_a_chunk_beyond_the_bound_is_coded_directly(monkeypatch: pytest.MonkeyPatch) -> None:
    decoded = hard_bound._decoded
    monkeypatch.setattr(hard_bound, "EXACT_TO", 0.0)
    monkeypatch.setattr(hard_bound, "_decoded", lambda *a: [p if p is None else p + 1 for p in decoded(*a)])
    motion = named_points(400)
    encoded = Tempo(max_error=0.01, model="transform").encode_chunks(motion)
    assert {Payload.unpack(c.payload).engine for c in encoded.chunks} == {DIRECT}
    assert error(motion, Tempo.decode(encoded)).max() <= 0.01


def test_hou2014_is_promising_where_a_basis_of_the_recording_needs_fewer_bits() -> None:
    random = np.random.default_rng(3)
    moved = smooth(300, 3, 1) @ random.normal(size=(3, 30))
    positions = moved.reshape(300, 10, 3)
    spread = np.concatenate([np.zeros((300, 1)), dct.forward(moved)], axis=1)
    assert fallback.is_promising(fallback.Sample([positions], [spread], own_basis=False), -320)
    assert not fallback.is_promising(fallback.Sample([positions], [spread[:, :4]], own_basis=False), -320)
