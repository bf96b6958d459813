"""An error inside a codec does not cost the recording: the next way is taken, with a note, and the promise is kept."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mocodec as mc
from mocodec import metrics, native
from mocodec.codecs.lossless import Lossless
from mocodec.codecs.tempo import Tempo, chunk, compiled_chunks, engine_choice, fallback, model_choice, repeats, trial
from mocodec.codecs.tempo.coding import coefficients, direct
from mocodec.errors import BadInput, CannotEncode
from mocodec.motion import Motion
from mocodec.stages import lattice, lattice_chunk
from mocodec.testing import synthetic


@pytest.fixture(autouse=True)
def rescued(monkeypatch: pytest.MonkeyPatch) -> None:
    """As for users: internal errors end in the next way."""
    monkeypatch.setenv("MOCODEC_STRICT", "0")


PACK = (compiled_chunks if native.available() else coefficients, "pack")
WALK = synthetic.markers(frames=200, seed=8).select(["C7", "LSHO", "RSHO", "LKNE", "LTOE", "RTOE"])


def check(motion: Motion, **target: float) -> mc.Motion:
    """The decoded motion, which keeps the promise."""
    decoded = mc.decode(mc.encode(motion, **target), Motion)
    errors = metrics.distances(motion.positions, decoded.positions)
    assert np.array_equal(decoded.gaps, motion.gaps)
    assert np.nanmax(errors) <= target.get("max_error", np.inf)
    assert np.nanmean(errors) <= target.get("mean_error", np.inf)
    return decoded


def break_(monkeypatch: pytest.MonkeyPatch, where: Any, name: str, times: int = 10**9) -> None:
    """Make a function raise an IndexError at its first calls; the lattice engine, which needs no model, is off."""
    monkeypatch.setattr(lattice, "is_fast", lambda: False)
    fail(monkeypatch, where, name, times)


def fail(monkeypatch: pytest.MonkeyPatch, where: Any, name: str, times: int = 10**9) -> None:
    """Make a function raise an IndexError at its first calls."""
    works, left = getattr(where, name), times

    def broken(*args: Any, **options: Any) -> Any:
        nonlocal left
        left -= 1
        if left >= 0:
            raise IndexError("injected")
        return works(*args, **options)

    monkeypatch.setattr(where, name, broken)


@pytest.mark.parametrize("target", [{"max_error": 0.002}, {"mean_error": 0.002}])
@pytest.mark.parametrize(
    ("where", "name"),
    [
        (model_choice, "choose"),
        (compiled_chunks, "analyse"),
        (trial, "of_step"),
        PACK,
        (fallback, "smaller"),
        (repeats, "distinct_frames"),
        (chunk.ChunkEncoder, "_numbers"),
    ],
)
def test_a_broken_part_of_tempo(
    monkeypatch: pytest.MonkeyPatch, where: Any, name: str, target: dict[str, float]
) -> None:
    break_(monkeypatch, where, name)
    decoded = check(WALK, **target)
    assert "IndexError: injected" in decoded.source["notes"][-1]


@pytest.mark.skipif(not lattice.is_fast(), reason="the lattice engine needs the compiled module")
@pytest.mark.parametrize(
    ("where", "name"), [(engine_choice, "plan"), (lattice, "neighbours"), (lattice_chunk, "encode")]
)
@pytest.mark.parametrize("target", [{"max_error": 0.0005}, {"mean_error": 0.0005}])
def test_a_broken_lattice_engine(
    monkeypatch: pytest.MonkeyPatch, where: Any, name: str, target: dict[str, float]
) -> None:
    fail(monkeypatch, where, name)
    check(WALK, **target)


@pytest.mark.parametrize("name", ["choose", "_fitted"])
def test_an_internal_error_is_named_and_strict_runs_raise_it(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    break_(monkeypatch, model_choice, name)
    note = check(WALK, max_error=0.002).source["notes"][-1]
    assert "an internal error of mocodec, IndexError: injected, please report it" in note
    monkeypatch.setenv("MOCODEC_STRICT", "1")
    with pytest.raises(IndexError, match="injected"):
        mc.encode(WALK, max_error=0.002)


def test_one_broken_chunk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lattice, "is_fast", lambda: False)
    plain = mc.encode(WALK, chunk_seconds=0.5, model="points-stored")
    break_(monkeypatch, chunk.ChunkEncoder, "_transform_within", times=1)
    blob = mc.encode(WALK, chunk_seconds=0.5, model="points-stored")
    assert "1 of 3 chunks" in mc.decode(blob, Motion).source["notes"][-1]
    assert len(blob) < 3 * len(plain)


def test_tempo_and_direct_coding_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    break_(monkeypatch, model_choice, "choose")
    break_(monkeypatch, direct, "pack")
    blob = mc.encode(WALK, max_error=0.001)
    with mc.open(blob) as file:
        assert file.encoded.codec == "lossless"
        assert file.encoded.promise == {"max_error": 0.001}
    assert "losslessly" in mc.decode(blob, Motion).source["notes"][-1]


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_interrupts_pass_through(monkeypatch: pytest.MonkeyPatch, error: type[BaseException]) -> None:
    def interrupted(*_: Any, **__: Any) -> Any:
        raise error

    for where, name in ((model_choice, "choose"), (compiled_chunks, "analyse"), PACK):
        with monkeypatch.context() as patch:
            patch.setattr(lattice, "is_fast", lambda: False)
            patch.setattr(where, name, interrupted)
            with pytest.raises(error):
                Tempo().encode(WALK)


def test_what_the_caller_asked_for_is_not_rescued() -> None:
    with pytest.raises(CannotEncode, match="does not fit"):
        Tempo(model="directions-prior").encode(WALK.select(["C7"]))
    with pytest.raises(BadInput):
        Tempo(max_error=0.01, weights={"nobody": 2.0}).encode(WALK)
    with pytest.raises(CannotEncode, match="coarsest"):
        Tempo(size=1).encode(WALK)


def test_other_codecs_are_replaced_with_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    from mocodec.codecs import hou2014, liu2006

    for codec in (hou2014.Hou2014, liu2006.Liu2006):
        break_(monkeypatch, codec, "encode")
        decoded = mc.decode(mc.encode(WALK, codec=codec.name, max_error=0.002), Motion)
        assert metrics.distances(WALK.positions, decoded.positions).max() <= 0.002
        assert codec.name in decoded.source["notes"][-1]


FRAMES = np.linspace(0, 6, 60)[:, None, None]
STRANGE = {
    "10^7 m": 1e7 + np.sin(FRAMES + np.ones((1, 4, 3))),
    "10^12 m": 1e12 * np.sin(FRAMES + np.ones((1, 4, 3))),
    "10^300 m": 1e300 * np.sin(FRAMES + np.ones((1, 4, 3))),
    "the largest floats": np.finfo(np.float64).max * np.sign(np.sin(FRAMES + np.arange(12).reshape(1, 4, 3))),
    "denormals": 5e-324 * np.rint(50 * np.sin(FRAMES + np.ones((1, 4, 3)))),
    "a huge constant": np.full((60, 4, 3), 1e300),
    "one huge sample": np.where(np.arange(60)[:, None, None] == 30, 1e200, np.ones((1, 4, 3))),
    "one point": np.sin(FRAMES + np.ones((1, 1, 3))),
    "one frame": np.ones((1, 3, 3)),
    "5,000 points": np.random.default_rng(1).normal(size=(3, 5000, 3)),
}


@pytest.mark.parametrize("target", [{"max_error": 0.005}, {"mean_error": 0.001}], ids=lambda t: next(iter(t)))
@pytest.mark.parametrize("name", STRANGE)
def test_any_finite_motion_is_coded(name: str, target: dict[str, float]) -> None:
    check(Motion(STRANGE[name], 60.0), **target)


@pytest.mark.parametrize("float64", [False, True])
def test_lossless_keeps_every_bit_of_float64(float64: bool) -> None:
    random = np.random.default_rng(2)
    scale = 10.0 ** (random.integers(-300, 300, (50, 3, 1)) if float64 else np.array(200.0))
    positions = random.normal(size=(50, 3, 3)) * scale
    positions[20:30, 1] = np.nan
    motion = Motion(positions, 100.0)
    encoded = Lossless(0.1, float64).encode(motion)
    assert np.array_equal(Lossless.decode(encoded).positions, positions, equal_nan=True)
    assert np.array_equal(Lossless.decode(encoded, slice(17, 33)).positions, positions[17:33], equal_nan=True)
