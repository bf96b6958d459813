"""The model is chosen by what a few chunks cost with each."""

from __future__ import annotations

import numpy as np
import pytest

from mocodec.codecs.tempo import Tempo, compiled_chunks, model_choice
from mocodec.codecs.tempo.models import Recording, marker_fitting, skeleton_matching
from mocodec.codecs.tempo.preparation import chunk_bounds
from mocodec.motion import Motion
from mocodec.testing import synthetic

from .motions import header, named_points


def test_a_chunk_that_was_priced_is_not_analysed_again() -> None:
    motion = named_points(1500)
    chunks = [motion.positions[a:b] for a, b in chunk_bounds(len(motion), motion.rate, 4.0)]
    choice = model_choice.choose(Recording(chunks, motion, Tempo().first_step(motion)), "points-prior")
    auto = model_choice.choose(Recording(chunks, motion, Tempo().first_step(motion)))
    assert len(auto.spectra) >= 1 or auto.header == choice.header
    for number, spectrum in auto.spectra.items():
        np.testing.assert_array_equal(spectrum, compiled_chunks.analyse(auto.model, chunks[number]))


def test_known_points_in_any_order_and_spelling_use_the_prior() -> None:
    motion = named_points()
    shuffled = np.random.default_rng(1).permutation(motion.points)
    names = tuple(f"S:{motion.names[i].upper()}" for i in shuffled)
    other = Motion(motion.positions[:, shuffled], motion.rate, names, motion.up)
    sizes = [Tempo(model="transform").encode_chunks(m).payload_bytes for m in (motion, other)]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.02)
    assert header(Tempo(model="transform").encode_chunks(other)).model == "points-prior"


def test_a_stream_that_has_not_begun_takes_directions_if_it_has_a_skeleton() -> None:
    motion = named_points(10)
    assert model_choice.choose(Recording([], motion, -200)).header.model == "points-prior"
    assert model_choice.choose(Recording([], Motion(motion.positions, 120.0), -200)).header.model is None


def test_markers_are_placed_on_bones_only_where_a_stored_basis_takes_much(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[int] = []

    def fit(positions: list[np.ndarray], *_: object) -> None:
        tried.append(sum(map(len, positions)))

    monkeypatch.setattr(marker_fitting, "fit", fit)
    for frames, sigma in ((60, 1e-5), (3000, 1e-3)):
        motion = synthetic.markers(frames=frames, seed=1)
        noise = np.random.default_rng(1).normal(0, sigma, motion.positions.shape)
        chunks = [c + noise[: len(c)] for c in np.array_split(motion.positions, -(-frames // 480))]
        model_choice.choose(Recording(chunks, motion, Tempo(max_error=0.001).first_step(motion)))
    assert tried == [60]


@pytest.mark.parametrize(("share", "matched"), [(model_choice.STILL_SHARE, False), (1.0, True)])
def test_still_points_are_not_matched_with_the_skeleton_of_the_prior(
    share: float, matched: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    random, calls = np.random.default_rng(5), list[int]()
    positions = random.normal(0, 0.4, (1, 80, 3)) + random.normal(0, 2e-4, (90, 80, 3))
    motion = Motion(positions, 100.0, [f"M{i}" for i in range(80)])
    monkeypatch.setattr(model_choice, "STILL_SHARE", share)
    monkeypatch.setattr(skeleton_matching, "match", lambda *_: calls.append(1))
    Tempo(max_error=0.005).encode_chunks(motion)
    assert bool(calls) == matched
