"""A sample says which engine codes a recording."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.tempo import Tempo, engine_choice, model_choice
from mocodec.codecs.tempo.chunk import LATTICE, Payload
from mocodec.motion import Motion
from mocodec.testing import synthetic

from .motions import error, header, named_points, smooth

pytestmark = pytest.mark.skipif(not engine_choice.available(), reason="needs the compiled module")


def noisy(motion: Motion, sigma: float) -> Motion:
    positions = motion.positions + np.random.default_rng(1).normal(0, sigma, motion.positions.shape)
    return Motion(positions, motion.rate, motion.names, motion.up)


def test_no_model_is_fitted_where_the_lattice_codes_all(monkeypatch: pytest.MonkeyPatch) -> None:
    def choose(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(model_choice, "choose", choose)
    motion = noisy(synthetic.markers(frames=600, seed=1), 5e-4)
    encoded = Tempo(max_error=0.0005).encode_chunks(motion)
    assert header(encoded).neighbours is not None
    assert {Payload.unpack(c.payload).engine for c in encoded.chunks} == {LATTICE}
    assert error(motion, Tempo.decode(encoded)).max() <= 0.0005


def test_chunks_are_longer_where_the_lattice_turns_out_smaller_in_each() -> None:
    motion = noisy(named_points(1500), 1e-3)
    encoded = Tempo(max_error=0.0005).encode_chunks(motion)
    assert {Payload.unpack(c.payload).engine for c in encoded.chunks} == {LATTICE}
    assert header(encoded).model is None
    assert max(c.frames for c in encoded.chunks) > 1.2 * 4 * motion.rate


def test_a_smooth_recording_takes_a_model() -> None:
    rng = np.random.default_rng(1)
    moved = smooth(600, 3, 1) @ rng.normal(size=(3, 90))
    motion = Motion(rng.normal(size=(30, 3)) + moved.reshape(600, 30, 3) / 10, 120.0)
    assert header(Tempo(max_error=0.003).encode_chunks(motion)).model is not None
