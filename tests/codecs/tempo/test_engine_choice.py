"""A sample says which engine codes a recording."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mocodec.codecs.tempo import Tempo, chunk, engine_choice, fallback, model_choice
from mocodec.codecs.tempo.chunk import LATTICE, TRANSFORM, Payload
from mocodec.motion import Motion
from mocodec.stages import lattice
from mocodec.testing import synthetic

from .motions import error, header, named_points, smooth

pytestmark = pytest.mark.skipif(not lattice.is_fast(), reason="needs the compiled module")


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


def smooth_motion(frames: int) -> Motion:
    rng = np.random.default_rng(1)
    moved = smooth(frames, 3, 1) @ rng.normal(size=(3, 90))
    return Motion(rng.normal(size=(30, 3)) + moved.reshape(frames, 30, 3) / 10, 120.0)


def test_a_smooth_recording_takes_a_model() -> None:
    assert header(Tempo(max_error=0.003).encode_chunks(smooth_motion(600))).model is not None


def test_hou2014_is_not_tried_where_the_lattice_is_much_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    def smaller(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(fallback, "smaller", smaller)
    motion = noisy(synthetic.markers(frames=600, seed=1), 1e-3)
    assert header(Tempo(max_error=0.0003).encode_without_repeats(motion)).neighbours is not None


@pytest.mark.parametrize(("share", "engine"), [(0.85, LATTICE), (0.98, TRANSFORM)])
def test_the_lattice_has_to_save_some_bytes(share: float, engine: int, monkeypatch: pytest.MonkeyPatch) -> None:
    motion = smooth_motion(480)
    with monkeypatch.context() as without_lattice:
        without_lattice.setattr(lattice, "is_fast", lambda: False)
        size = Tempo(max_error=0.003).encode_chunks(motion).payload_bytes
    found = chunk.ChunkEncoder.on_lattice

    def of_this_size(
        encoder: chunk.ChunkEncoder, bound: float, neighbours: lattice.Neighbours, stride: int, _: float
    ) -> chunk.OnLattice:
        coded = found(encoder, bound, neighbours, stride)
        assert isinstance(coded, chunk.OnLattice)
        return coded._replace(payload=coded.payload[:1].ljust(round(share * size), b" "))

    monkeypatch.setattr(chunk.ChunkEncoder, "on_lattice", of_this_size)
    monkeypatch.setattr(chunk.ChunkEncoder, "keeps", lambda *_: True)
    monkeypatch.setattr(engine_choice.EngineTrials, "tries_lattice", lambda *_: True)
    encoded = Tempo(max_error=0.003).encode_chunks(motion)
    assert Payload.unpack(encoded.chunks[0].payload).engine == engine


def test_a_still_chunk_does_not_decide_for_those_after_it() -> None:
    trials = engine_choice.EngineTrials()
    trials.learn(400, 130)
    assert trials.tries_lattice(1)
    trials.learn(5000, 8000)
    assert not trials.tries_lattice(2)
    assert trials.tries_lattice(engine_choice.TRIED_EVERY)


def test_the_lattice_is_not_tried_where_joints_take_few_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    def neighbours(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(lattice, "neighbours", neighbours)
    motion = named_points(600)
    encoded = Tempo(max_error=0.02).encode_chunks(motion)
    assert error(motion, Tempo.decode(encoded)).max() <= 0.02


@pytest.mark.parametrize(("estimate", "tried"), [(1e9, 0), (0.0, 1)])
def test_an_estimate_rules_the_lattice_out(estimate: float, tried: int, monkeypatch: pytest.MonkeyPatch) -> None:
    coded, found = [], chunk.ChunkEncoder.on_lattice

    def on_lattice(*arguments: Any) -> Any:
        coded.append(arguments)
        return found(*arguments)

    monkeypatch.setattr(lattice, "estimate", lambda *_: estimate)
    monkeypatch.setattr(chunk.ChunkEncoder, "on_lattice", on_lattice)
    motion = noisy(named_points(480), 0.002)
    Tempo(max_error=0.001, model="auto").encode_chunks(motion)
    assert bool(coded) == bool(tried)


def test_joints_without_a_skeleton_take_a_model_where_it_is_smaller() -> None:
    walk = synthetic.joints(frames=600, seed=3)
    joints = Motion(walk.positions, walk.rate, up=walk.up)
    plan = Tempo(max_error=0.002)
    assert plan.encode(joints).payload_bytes <= 1.05 * replace(plan, model="transform").encode(joints).payload_bytes


def test_a_still_beginning_does_not_choose_the_stride() -> None:
    moving = noisy(synthetic.markers(frames=2400, seed=1), 5e-4)
    positions = moving.positions.copy()
    positions[:600] = positions[600] + np.random.default_rng(2).normal(0, 5e-4, positions[:600].shape)
    quiet = Motion(positions, moving.rate, moving.names, moving.up)
    whole = Tempo(max_error=0.0001).encode(quiet)
    after = Tempo(max_error=0.0001).encode(quiet[600:])
    later = sum(len(c.payload) for c in whole.chunks if c.start >= 600)
    frames = sum(c.frames for c in whole.chunks if c.start >= 600)
    assert later / frames <= 1.03 * after.payload_bytes / 1800


def test_trials_in_vain_rule_out_others_with_higher_estimates() -> None:
    outcomes = engine_choice.Outcomes()
    outcomes.learn(0.8, 0.9)
    for _ in range(engine_choice.FEWEST_FAILED):
        assert not outcomes.rule_out(1.0)
        outcomes.learn(0.9, 1.1)
    assert not outcomes.rule_out(0.85)
    assert not outcomes.rule_out(0.7)
    ruled_out = [outcomes.rule_out(1.0) for _ in range(engine_choice.TRIED_EVERY)]
    assert ruled_out == [True] * (engine_choice.TRIED_EVERY - 1) + [False]
    outcomes.learn(1.0, 0.9)
    assert not outcomes.rule_out(0.95)
