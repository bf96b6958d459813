"""Tempo keeps the contract of every codec, and its own targets."""

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

from mocodec import container
from mocodec.codecs.tempo import Tempo
from mocodec.errors import BadInput, CannotEncode, Corrupt, MocodecError, UnknownCodec
from mocodec.motion import Motion
from mocodec.testing import CodecTests, strategies, synthetic
from mocodec.testing.codec_tests import FEW, ROUNDING

from .motions import error, header, named_skeleton, through


class TestTempo(CodecTests):
    codec = staticmethod(lambda **settings: Tempo(**settings))
    can_bound = True
    quick: ClassVar[Mapping[str, Any]] = {"max_error": 0.02}


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


def test_a_bound_too_fine_to_count_is_refused_or_kept() -> None:
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
        {"model": "points"},
        {"model": "hou2014", "weights": {"LTOE": 2.0}},
    ],
)
def test_contradictory_settings_are_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        Tempo(**settings)


@pytest.mark.parametrize(
    "model", ["points-prior", "points-stored", "directions-prior", "directions-stored", "direct", "hou2014"]
)
@pytest.mark.parametrize("target", [{"max_error": 0.004}, {"mean_error": 0.003}, {"ratio": 30.0}])
def test_every_model_can_be_asked_for(model: str, target: dict[str, float]) -> None:
    motion = named_skeleton(300)
    encoded = Tempo(model=model, **target).encode(motion)
    found = header(encoded)
    assert (found.model or ("hou2014" if found.fallback is not None else "direct")) == model
    off = error(motion, Tempo.decode(encoded))
    if "max_error" in target:
        assert off.max() <= target["max_error"]
    elif "mean_error" in target:
        assert 0.95 * target["mean_error"] <= off.mean() <= target["mean_error"]
    else:
        assert encoded.payload_bytes <= motion.raw_bytes / 30
    assert encoded.settings["model"] == model


def test_a_model_that_does_not_fit_is_refused() -> None:
    free = Motion(np.cumsum(np.random.default_rng(2).normal(0, 0.002, (300, 12, 3)), axis=0), 100.0)
    with pytest.raises(CannotEncode, match="directions-stored"):
        Tempo(model="directions-stored").encode(free)


def test_chunks_begin_where_a_motion_leaps() -> None:
    motion = synthetic.markers(frames=480, seed=5)
    leaping = motion.positions.copy()
    leaping[200:, 7:15] += (0.5, 0.3, -0.4)
    codec = Tempo(model="transform")
    encoded = codec.encode(replace(motion, positions=leaping))
    assert 200 in [c.start for c in encoded.chunks]
    assert encoded.payload_bytes < 1.7 * codec.encode(motion).payload_bytes


@pytest.mark.parametrize("settings", [{"max_error": 0.005}, {"mean_error": 0.002}])
def test_spikes_cost_little_and_are_restored(settings: dict[str, float]) -> None:
    motion = synthetic.markers(frames=480, seed=5)
    spiked = motion.positions.copy()
    spiked[100, 3] += 0.7
    spiked[300, 20] -= 0.6
    decoded, size = through(replace(motion, positions=spiked), **settings)
    assert np.sqrt(((decoded.positions - spiked) ** 2).sum(axis=2))[[100, 300], [3, 20]].max() < 0.02
    assert size < through(motion, **settings)[1] + 60


@pytest.mark.parametrize("frame", [0, 1, 119, 120, 121, 239])
def test_a_spike_anywhere_in_a_chunk_keeps_the_bound(frame: int) -> None:
    motion = synthetic.markers(frames=240, seed=5)
    spiked = motion.positions.copy()
    spiked[frame, 3] += 0.7
    decoded, _ = through(replace(motion, positions=spiked), max_error=0.005, chunk_seconds=1.0)
    assert np.sqrt(((decoded.positions - spiked) ** 2).sum(axis=2)).max() <= 0.005


def test_points_that_stand_still_cost_next_to_nothing() -> None:
    motion = synthetic.markers(frames=480, seed=5)
    still = np.repeat(np.random.default_rng(0).normal(size=(1, 20, 3)), len(motion), axis=0)
    more = Motion(np.concatenate([motion.positions, still], axis=1), motion.rate, (), motion.up)
    alone = through(replace(motion, names=()), max_error=0.005)[1]
    assert through(more, max_error=0.005)[1] < 1.35 * alone


def test_the_same_integers_whatever_the_threads(tmp_path: Path) -> None:
    path = tmp_path / "walk.mocz"
    path.write_bytes(container.pack(Tempo(model="transform").encode_chunks(synthetic.markers(frames=300, seed=2))))
    code = (
        "import sys, hashlib, mocodec; from mocodec.codecs.tempo.chunk import Payload;"
        "from mocodec.codecs.tempo.coding import coefficients, corrections;"
        "from mocodec.codecs.tempo.header import StreamHeader;"
        "e = mocodec.open(sys.argv[1]).encoded; m = StreamHeader.unpack(e.shared, e.about.points).read_model(e.about);"
        "p = [Payload.unpack(c.payload).numbers for c in e.chunks];"
        "v = coefficients.unpack(m, [c.frames for c in e.chunks], p, corrections.FIELDS);"
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
    for other in ((), (b"",), (shared[:3],), (b"\x40" + shared[1:],), (b"\x14" + shared[1:],)):
        with pytest.raises((Corrupt, UnknownCodec)):
            Tempo.decode(replace(encoded, shared=other))


@pytest.mark.parametrize("target", [{"size": 5_000}, {"max_error": 0.01}, {"mean_error": 0.01}])
def test_slow_frame_rates_have_chunks_of_several_frames(target: dict[str, float]) -> None:
    steps = np.random.default_rng(0).normal(size=(200, 5, 3))
    slow = Motion(0.01 * steps.cumsum(axis=0), 0.001)
    encoded = Tempo(**target).encode(slow)  # type: ignore[arg-type]
    assert len(encoded.chunks) <= 20
    np.testing.assert_allclose(Tempo.decode(encoded, slice(50, 60)).positions, Tempo.decode(encoded).positions[50:60])
