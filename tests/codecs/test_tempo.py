"""Tempo keeps the contract of every codec, and its own promises."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocodec import container, metrics
from mocodec.codecs.tempo import (
    Decoder,
    Encoder,
    Tempo,
    attach,
    body,
    contexts,
    mapped,
    prior,
    tailored,
    tempo,
    training,
)
from mocodec.codecs.tempo.model import POSE
from mocodec.encoded import Chunk
from mocodec.errors import BadInput, CannotEncode, Corrupt, MocodecError, UnknownCodec
from mocodec.motion import Motion
from mocodec.testing import CodecTests, strategies, synthetic
from mocodec.testing.codec_tests import FEW, ROUNDING


class TestTempo(CodecTests):
    codec = staticmethod(lambda **settings: Tempo(**settings))
    can_bound = True
    quick: ClassVar[Mapping[str, Any]] = {"max_error": 0.02}


def joints(frames: int = 480, seed: int = 1) -> Motion:
    """As many points of a figure as the prior's skeleton has joints, under their names."""
    motion = synthetic.markers(frames=frames, seed=seed)
    names = prior.shipped().sets[0].names
    return Motion(motion.positions[:, : len(names)], motion.rate, names, motion.up)


def error(motion: Motion, decoded: Motion) -> np.ndarray:
    return metrics.distances(motion.positions, decoded.positions)


def through(motion: Motion, **settings: Any) -> tuple[Motion, int]:
    encoded = Tempo(**settings).encode(motion)
    return Tempo.decode(encoded), encoded.payload_bytes


# ------------------------------------------------------------------------------------------------------------- targets


@FEW
@given(motion=strategies.motions(), bound=st.floats(-9, 1).map(lambda x: 10.0**x))
def test_any_motion_keeps_any_bound_or_is_refused(motion: Motion, bound: float) -> None:
    extent = float(np.nanmax(np.abs(motion.positions)))
    try:
        decoded, _ = through(motion, max_error=bound)
    except CannotEncode:
        assert bound < extent * 1e-6
        return
    assert np.nanmax(error(motion, decoded)) <= bound + ROUNDING * extent


@pytest.mark.parametrize("mean", [0.0003, 0.001, 0.01])
def test_a_mean_error_is_met_within_two_per_cent(mean: float) -> None:
    motion = synthetic.markers(frames=600, seed=3)
    decoded, _ = through(motion, mean_error=mean)
    assert np.nanmean(error(motion, decoded)) == pytest.approx(mean, rel=0.02)


@pytest.mark.parametrize(("frames", "seed", "mean"), [(60, 3, 0.005), (72, 2, 0.01), (96, 3, 0.005)])
def test_a_mean_error_is_met_where_it_does_not_always_rise_with_the_step(frames: int, seed: int, mean: float) -> None:
    motion = synthetic.markers(frames=frames, seed=seed)
    encoded = Tempo(mean_error=mean).in_chunks(motion)
    assert encoded.shared[0][0] != tempo.PLAIN
    assert error(motion, Tempo.decode(encoded)).mean() == pytest.approx(mean, rel=0.02)


def test_a_mean_error_finer_than_the_bases_are_exact() -> None:
    motion = synthetic.markers(frames=60, seed=3)
    decoded, _ = through(motion, mean_error=1e-10)
    assert np.nanmean(error(motion, decoded)) <= 1.02e-10


def test_size_and_ratio_are_kept() -> None:
    motion = synthetic.markers(frames=600, seed=3)
    assert 0.9 * 9000 < through(motion, size=9000)[1] <= 9000
    assert through(motion, ratio=60)[1] <= motion.raw_bytes / 60
    with pytest.raises(CannotEncode):
        through(motion, size=5)


def test_a_size_that_leaves_room_for_everything_or_for_hardly_a_basis() -> None:
    still = Motion(np.repeat(synthetic.markers(frames=1, seed=3).positions, 90, axis=0), 120.0)
    assert through(still, size=20_000)[1] <= 20_000
    line = Motion(np.cumsum(np.ones((90, 5, 3)), axis=0), 120.0)
    assert through(line, ratio=2.0)[1] <= line.raw_bytes / 2
    noise = Motion(np.random.default_rng(0).normal(size=(90, 41, 3)), 120.0)
    assert through(noise, ratio=20.0)[1] <= noise.raw_bytes / 20


def test_a_bound_beyond_counting_is_refused_or_kept() -> None:
    motion = synthetic.markers(frames=30, seed=3)
    huge = replace(motion, positions=motion.positions * 1e6)
    try:
        decoded, _ = through(huge, max_error=1e-9)
    except CannotEncode:
        return
    assert error(huge, decoded).max() <= 1e-9 + ROUNDING * 1e7


def test_weighted_points_are_kept_closer() -> None:
    motion = synthetic.markers(frames=240, seed=3)
    decoded, _ = through(motion, max_error=0.01, weights={"LTOE": 8.0})
    worst = error(motion, decoded).max(axis=0)
    assert worst.max() <= 0.01
    assert worst[motion.names.index("LTOE")] <= 0.01 / 8
    with pytest.raises(BadInput):
        through(motion, max_error=0.01, weights={"NOSE": 8.0})


@pytest.mark.parametrize(
    "settings",
    [
        {"max_error": 0.01, "mean_error": 0.01},
        {"max_error": -1.0},
        {"mean_error": float("nan")},
        {"chunk_seconds": 0.1},
        {"mean_error": 0.01, "weights": {"LTOE": 2.0}},
    ],
)
def test_settings_that_make_no_sense(settings: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        Tempo(**settings)


# ---------------------------------------------------------------------------------------------------------- real motion


def test_chunks_begin_where_a_motion_leaps() -> None:
    motion = synthetic.markers(frames=480, seed=5)
    leaping = motion.positions.copy()
    leaping[200:, 7:15] += (0.5, 0.3, -0.4)
    encoded = Tempo().encode(replace(motion, positions=leaping))
    assert 200 in [c.start for c in encoded.chunks]
    assert encoded.payload_bytes < 1.7 * Tempo().encode(motion).payload_bytes


@pytest.mark.parametrize("settings", [{"max_error": 0.005}, {"mean_error": 0.002}])
def test_spikes_cost_little_and_come_back(settings: dict[str, float]) -> None:
    motion = synthetic.markers(frames=480, seed=5)
    spiked = motion.positions.copy()
    spiked[100, 3] += 0.7
    spiked[300, 20] -= 0.6
    decoded, size = through(replace(motion, positions=spiked), **settings)
    assert np.sqrt(((decoded.positions - spiked) ** 2).sum(axis=2))[[100, 300], [3, 20]].max() < 0.02
    assert size < through(motion, **settings)[1] + 60


def test_a_chunk_that_was_looked_at_is_not_analysed_again_in_another_way() -> None:
    motion = joints(1500)
    codec = Tempo()
    cut = [motion.positions[a:b] for a, b in tempo.chunk_bounds(len(motion), motion.rate, 4.0)]
    chosen = tempo.choose_model(cut, motion, codec.first_step(motion))
    assert len(chosen.spectra) >= 1
    for number, spectrum in chosen.spectra.items():
        np.testing.assert_array_equal(spectrum, chosen.model.analyse(cut[number]))


def test_the_decoders_neighbours_weigh_what_the_encoders_do() -> None:
    rng = np.random.default_rng(3)
    magnitudes = contexts.ceiling(rng.geometric(0.02, (40, 23)) - 1)
    encoders = contexts.neighbourhood(contexts.bordered(magnitudes))
    below = np.concatenate([np.zeros((contexts.DEPTH, 23)), magnitudes]).astype(np.float32)
    starts = contexts.groups(40)[0]
    decoders = np.stack([below[k : k + contexts.DEPTH].ravel() for k in starts]) @ contexts.weights(23)
    np.testing.assert_array_equal(decoders, encoders)


def test_points_that_stand_still_cost_next_to_nothing() -> None:
    motion = synthetic.markers(frames=480, seed=5)
    still = np.repeat(np.random.default_rng(0).normal(size=(1, 20, 3)), len(motion), axis=0)
    more = Motion(np.concatenate([motion.positions, still], axis=1), motion.rate, (), motion.up)
    alone = through(replace(motion, names=()), max_error=0.005)[1]
    assert through(more, max_error=0.005)[1] < 1.35 * alone


def test_known_points_in_any_order_and_spelling_use_the_prior() -> None:
    motion = joints()
    shuffled = np.random.default_rng(1).permutation(motion.points)
    names = tuple(f"S:{motion.names[i].upper()}" for i in shuffled)
    other = Motion(motion.positions[:, shuffled], motion.rate, names, motion.up)
    sizes = [Tempo().in_chunks(m).payload_bytes for m in (motion, other)]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.02)
    assert Tempo().in_chunks(other).shared[0][0] == 1


# ------------------------------------------------------------------------------------------ points on the prior's bones


def on_bones(motion: Motion, mean_error: float = 0.01) -> tuple[mapped.Stored, mapped.Movements, prior.Prior]:
    bodies = prior.of_bones()
    assert bodies is not None
    positions = body.level(motion.positions, motion.up)
    found = attach.fit([positions], bodies, motion.names, motion.rate, tempo.step_for_bound(mean_error))
    assert found is not None
    return *found, bodies


def test_a_short_clip_of_unknown_points_sits_on_the_priors_bones() -> None:
    motion = synthetic.markers(frames=240, seed=5)
    encoded = Tempo(mean_error=0.008).in_chunks(motion)
    assert encoded.shared[0][0] == tempo.MAPPED
    with prior.installed(prior.packaged_bytes()):
        assert prior.of_bones() is None
        without = Tempo(mean_error=0.008).in_chunks(motion)
    assert encoded.payload_bytes < 0.9 * without.payload_bytes
    decoded = Tempo.decode(encoded)
    assert np.nanmean(error(motion, decoded)) == pytest.approx(0.008, rel=0.02)


def test_left_and_right_feet_are_told_apart_by_how_they_move() -> None:
    motion = synthetic.markers(frames=360, seed=7)
    stored, _, bodies = on_bones(motion)
    assert bodies.bones is not None
    of_point = {name: bodies.bones.names[w] for name, w in zip(motion.names, stored.where, strict=True)}
    left, right = of_point["LTOE"][0], of_point["RTOE"][0]
    assert {left, right} == {"l", "r"}
    assert of_point["LHEE"][0] == of_point["LSHN"][0] == left
    assert of_point["RHEE"][0] == of_point["RSHN"][0] == right


@pytest.mark.parametrize("points", [4, 5, 41])
def test_points_on_bones_have_orthonormal_bases_and_come_back_from_their_bytes(points: int) -> None:
    motion = synthetic.markers(frames=120, seed=6)
    motion = motion.select(list(motion.names[:points]))
    stored, found, bodies = on_bones(motion)
    assert bodies.bones is not None
    for basis in found.bases:
        assert basis.shape == (3 * points - 3, 3 * points)
        assert np.abs(basis @ basis.T - np.eye(len(basis))).max() < 1e-9
        assert np.abs(basis.reshape(len(basis), -1, 3).mean(axis=1)).max() < 1e-9
    again, rest = mapped.Stored.unpack(stored.pack() + b"more", points, bodies.bones)
    assert rest == b"more"
    for name in ("pose", "where", "offsets", "levels"):
        assert (getattr(again, name) == getattr(stored, name)).all()
    there = mapped.movements(again, bodies.bones)
    assert (
        mapped.spreads_of(there, bodies.bones.usual, again.levels)
        == mapped.spreads_of(found, bodies.bones.usual, stored.levels)
    ).all()
    for size in range(len(stored.pack())):
        with pytest.raises(Corrupt):
            mapped.Stored.unpack(stored.pack()[:size], points, bodies.bones)


def test_points_that_are_no_body_are_not_taken_for_one() -> None:
    motion = synthetic.markers(frames=60, seed=6)
    bodies = prior.of_bones()
    assert bodies is not None
    for positions in (motion.positions * 1e5, motion.positions * 1e-3, motion.positions[:, :3], motion.positions[:0]):
        assert attach.fit([positions], bodies, motion.names[: positions.shape[1]], 120.0, 0) is None


# ------------------------------------------------------------------------------------------------------------ the prior


def test_the_prior_is_orthonormal_small_and_named() -> None:
    shipped = prior.shipped()
    for points in shipped.sets:
        for basis in points.bases:
            assert np.abs(basis @ basis.T - np.eye(len(basis))).max() < 1e-5
        assert len(points.spreads) == len(points.means) == POSE + len(points.bases[0])
    with pytest.raises(UnknownCodec):
        prior.named(b"nope")


def test_a_prior_can_be_trained_and_installed() -> None:
    motions = [joints(frames=300, seed=s) for s in range(3)]
    data = training.train({"someone": motions})
    assert data == training.train({"someone": motions})
    with prior.installed(data) as other:
        encoded = Tempo(max_error=0.01).encode(motions[0])
        assert encoded.shared[0][1:5] == other.id
        assert error(motions[0], Tempo.decode(encoded)).max() <= 0.01
    with pytest.raises(UnknownCodec):
        Tempo.decode(replace(encoded, about=replace(encoded.about, rate=119.0)))


def test_bones_can_be_learned() -> None:
    motions = [synthetic.joints(frames=240, seed=s) for s in range(2)]
    data = training.train_bones({"someone": motions}, prior.shipped())
    with prior.installed(data) as learned:
        assert prior.of_bones() is learned
        assert learned.bones is not None
        assert learned.bones.names == motions[0].names
        assert (np.diff(learned.coder.frequencies - prior._packaged().coder.frequencies) == 0).all()


# ---------------------------------------------------------------------------------------------------------- the stream


@pytest.mark.parametrize("latency", [0.1, 0.5])
def test_a_stream_keeps_its_bound_at_its_latency(latency: float) -> None:
    motion = joints(frames=200)
    positions = motion.positions.copy()
    positions[50:60, 2] = np.nan
    encoder = Encoder(motion[:0], max_error=0.005, latency_seconds=latency)
    chunks: list[Chunk] = []
    for start in range(0, 200, 7):
        chunks += encoder.push(positions[start : start + 7])
        done = chunks[-1].stop if chunks else 0
        assert min(start + 7, 200) - done < latency * motion.rate + 1
    chunks += encoder.finish()
    decoder = Decoder(encoder.shared, motion[:0])
    decoded = np.concatenate([decoder.push(c) for c in chunks])
    assert np.nanmax(metrics.distances(positions, decoded)) <= 0.005
    assert (np.isnan(decoded) == np.isnan(positions)).all()


def test_a_stream_of_unknown_points_learns_from_an_earlier_recording() -> None:
    earlier, motion = (synthetic.markers(frames=360, seed=s) for s in (1, 2))
    sizes = []
    for like in (None, earlier):
        encoder = Encoder(motion[:0], latency_seconds=1.0, like=like)
        sizes.append(sum(len(c.payload) for c in [*encoder.push(motion.positions), *encoder.finish()]))
    assert sizes[1] < 0.8 * sizes[0]


# --------------------------------------------------------------------------------------------------------- the decoder


def test_the_same_numbers_whatever_the_threads(tmp_path: Path) -> None:
    path = tmp_path / "walk.mocz"
    path.write_bytes(container.pack(Tempo().in_chunks(synthetic.markers(frames=300, seed=2))))
    code = (
        "import sys, hashlib, mocodec; from mocodec.codecs.tempo import chunks, coefficients, corrections, tempo;"
        "e = mocodec.open(sys.argv[1]).encoded; m = tempo.model_of(e.shared, e.about);"
        "p = [chunks.Parts.unpack(c.payload) for c in e.chunks];"
        "v = coefficients.unpack(m, [c.frames for c in e.chunks], [q.numbers for q in p], corrections.FIELDS);"
        "print(hashlib.sha256(b''.join(a[0].tobytes() for a in v)).hexdigest())"
    )
    results = {
        subprocess.run(
            [sys.executable, "-c", code, str(path)],
            env={**os.environ, "OPENBLAS_NUM_THREADS": n, "OMP_NUM_THREADS": n},
            capture_output=True,
            check=True,
            text=True,
        ).stdout
        for n in ("1", "4")
    }
    assert len(results) == 1


def test_damaged_shared_bytes_are_noticed() -> None:
    encoded = Tempo().encode(synthetic.markers(frames=120, seed=2))
    shared = encoded.shared[0]
    random = np.random.default_rng(0)
    for at in random.integers(0, len(shared), 60):
        damaged = bytearray(shared)
        damaged[at] ^= 1 << random.integers(8)
        with contextlib.suppress(MocodecError):
            Tempo.decode(replace(encoded, shared=(bytes(damaged),)))
    for other in ((), (b"",), (shared[:3],), (b"\x07" + shared[1:],)):
        with pytest.raises((Corrupt, UnknownCodec)):
            Tempo.decode(replace(encoded, shared=other))


# ------------------------------------------------------------------------------------- a transform made for the motion


@pytest.mark.parametrize("settings", [{"max_error": 0.003}, {"mean_error": 0.002}, {"ratio": 80.0}])
def test_the_motions_own_transform_is_taken_where_it_is_smaller(settings: dict[str, float]) -> None:
    motion = synthetic.markers(frames=480, seed=2)
    plain, best = Tempo(**settings).in_chunks(motion), Tempo(**settings).encode(motion)
    if "max_error" in settings:
        assert best.shared[0][0] == tailored.KIND
    errors = metrics.distances(motion.positions, Tempo.decode(best).positions)
    if "ratio" in settings:
        assert best.payload_bytes <= motion.raw_bytes / settings["ratio"]
        assert errors.mean() <= metrics.mean_distance(motion.positions, Tempo.decode(plain).positions)
    else:
        assert best.payload_bytes <= plain.payload_bytes
    if "max_error" in settings:
        assert errors.max() <= settings["max_error"]
    if "mean_error" in settings:
        assert errors.mean() == pytest.approx(settings["mean_error"], rel=0.02)
    assert dict(best.settings) == dict(plain.settings)


def test_chunks_of_the_motions_own_transform_keep_to_the_length_asked_for() -> None:
    motion = synthetic.markers(frames=1500, seed=2)
    encoded = Tempo(mean_error=0.002, chunk_seconds=1.0).encode(motion)
    assert max(chunk.frames for chunk in encoded.chunks) <= 2.5 * motion.rate + 1
    part = Tempo.decode(encoded, slice(700, 800)).positions
    assert part == pytest.approx(Tempo.decode(encoded).positions[700:800], abs=1e-9)
