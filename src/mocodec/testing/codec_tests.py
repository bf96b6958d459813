"""What every codec must pass.

    class TestLiu2006(CodecTests):
        codec = staticmethod(lambda **settings: Liu2006(**settings))
        can_bound = True

Run by pytest; hypothesis finds the odd motions that `odd` does not name.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from .. import api, metrics
from ..encoded import Encoded
from ..errors import CannotEncode, MocodecError
from ..motion import Motion, Signal
from . import corruption, odd, synthetic
from .strategies import motions

SAME = 1e-9
"""Positions of a figure of human size agree to this, in metres: between machines, and a slice with the whole."""

ROUNDING = 1e-12
"""What a bound may be exceeded by, as a share of the largest coordinate: float64 itself."""

OFFSET_ROUNDING = 5e-6 + 1e-12
"""A file holds a skeleton's offsets in steps of 10 µm (docs/format.md): back within half a step, in metres."""

FEW = settings(
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.differing_executors],
)
"""The same examples every time, and no clock: a machine may be slow."""


class CodecTests:
    """Inherit, set `codec`, and say what it can do. See the module's docstring."""

    codec: ClassVar[Callable[..., Any]]
    """Settings by keyword → an instance."""

    can_bound: ClassVar[bool] = False
    """Whether it takes `max_error`."""

    qualities: ClassVar[tuple[Mapping[str, Any], ...]] = ()
    """Settings from coarse to fine, spaced so that the error must fall; with `can_bound` there are some already."""

    usual_error: ClassVar[float] = 0.03
    """Mean error in metres that the default settings keep on a walking figure."""

    refuses: ClassVar[frozenset[str]] = frozenset()
    """Names of `odd.MOTIONS` that it may refuse with CannotEncode; a codec that bounds should need few."""

    quick: ClassVar[Mapping[str, Any]] = {}
    """Settings for the tests that encode often."""

    def figure(self) -> Motion:
        """The motion that most tests use; joint codecs may return `synthetic.joints`."""
        return synthetic.markers(frames=240, seed=2)

    def small(self) -> Motion:
        """A motion for the tests that decode thousands of damaged files."""
        names = ["C7", "LSHO", "RSHO", "LKNE", "LHEE"]
        return synthetic.markers(frames=60, seed=4).select(names)

    def steps(self) -> tuple[Mapping[str, Any], ...]:
        bounds = ({"max_error": 0.05}, {"max_error": 0.01}, {"max_error": 0.002}) if self.can_bound else ()
        return self.qualities or bounds

    # ------------------------------------------------------------------------------------------- what goes in comes out

    def test_round_trip(self) -> None:
        motion = self.figure()
        encoded = type(self).codec().encode(motion)
        decoded = type(self).codec().decode(encoded)
        assert decoded.positions.shape == motion.positions.shape
        assert metrics.mean_distance(motion.positions, decoded.positions) <= self.usual_error
        assert encoded.payload_bytes < motion.raw_bytes

    def test_a_bound_holds(self) -> None:
        if not self.can_bound:
            pytest.skip("this codec promises no bound")
        motion = self.figure()
        for bound in (0.02, 0.001):
            decoded = self.through_bytes(motion, max_error=bound)
            assert metrics.distances(motion.positions, decoded.positions).max() <= bound

    def test_more_quality_is_less_error_and_more_bytes(self) -> None:
        motion = self.figure()
        if not self.steps():
            pytest.skip("this codec has no knob")
        errors, sizes = [], []
        for quality in self.steps():
            encoded = type(self).codec(**quality).encode(motion)
            decoded = type(self).codec().decode(encoded)
            errors.append(metrics.mean_distance(motion.positions, decoded.positions))
            sizes.append(encoded.payload_bytes)
        assert errors == sorted(errors, reverse=True)
        assert len(set(errors)) == len(errors)
        assert sizes == sorted(sizes)

    def test_the_same_bytes_twice(self) -> None:
        motion = self.figure()
        assert self.pack(motion) == self.pack(motion)

    def test_what_is_not_positions_survives(self) -> None:
        plain = self.figure()
        motion = replace(
            plain,
            rate=119.88,
            names=tuple(f"Subject:{name}" for name in plain.names),
            up="y",
            source={"format": "c3d", "units": "mm", "unit_m": 0.001, "first_frame": 17},
            extras={
                "events": [{"label": "Foot Strike", "time_s": 0.25}],
                "analog": Signal(np.arange(960, dtype=np.int16).reshape(480, 2), 239.76, ("Fz1", "Fz2"), ("N", "N")),
                "notes": {"subject": "Ünsal", "trial": [1, 2, None]},
            },
        )
        back = self.through_bytes(motion, **self.quick)
        assert back.rate == motion.rate
        assert back.names == motion.names
        assert back.up == motion.up
        assert dict(back.source) == dict(motion.source)
        assert back.extras["events"] == motion.extras["events"]
        assert back.extras["notes"] == motion.extras["notes"]
        analog, wanted = back.extras["analog"], motion.extras["analog"]
        assert analog.values.dtype == wanted.values.dtype
        assert np.array_equal(analog.values, wanted.values)
        assert (analog.rate, analog.labels, analog.units) == (wanted.rate, wanted.labels, wanted.units)

    def test_a_skeleton_survives(self) -> None:
        motion = replace(synthetic.joints(frames=120, seed=1), rotations=None)
        skeleton = self.through_bytes(motion, **self.quick).skeleton
        assert motion.skeleton is not None
        assert skeleton is not None
        assert skeleton.names == motion.skeleton.names
        assert skeleton.parents == motion.skeleton.parents
        assert np.abs(skeleton.offsets - motion.skeleton.offsets).max() <= OFFSET_ROUNDING

    # -------------------------------------------------------------------------------------------------- odd motions

    @pytest.mark.parametrize("name", odd.MOTIONS)
    def test_odd_motions(self, name: str) -> None:
        self.check_any(odd.motion(name), may_refuse=name in self.refuses)

    @settings(FEW, max_examples=25)
    @given(motion=motions())
    def test_any_motion(self, motion: Motion) -> None:
        self.check_any(motion, may_refuse=bool(self.refuses) or not self.can_bound)

    def test_nothing_to_encode_is_refused(self) -> None:
        motion = self.figure()
        for empty in (motion[:0], motion.select([]), replace(motion, positions=np.full((9, motion.points, 3), np.nan))):
            with pytest.raises(CannotEncode):
                type(self).codec().encode(empty)

    def check_any(self, motion: Motion, may_refuse: bool) -> None:
        """Gaps come back exactly where they were, everything else is finite, and a bound, where there is one, holds."""
        extent = float(np.nanmax(np.abs(motion.positions)))
        bound = max(0.002, extent * 1e-6)
        try:
            decoded = self.through_bytes(motion, **({"max_error": bound} if self.can_bound else {}))
        except CannotEncode:
            if may_refuse:
                return
            raise
        assert decoded.positions.shape == motion.positions.shape
        assert np.array_equal(decoded.gaps, motion.gaps)
        assert np.isfinite(decoded.positions[~decoded.gaps]).all()
        if self.can_bound:
            assert np.nanmax(metrics.distances(motion.positions, decoded.positions)) <= bound + ROUNDING * extent

    # -------------------------------------------------------------------------------------------------- random access

    def test_a_slice_of_the_whole_is_the_slice_alone(self) -> None:
        motion = self.figure()
        positions = motion.positions.copy()
        positions[50:70, 3] = positions[200:, 8] = np.nan
        motion = replace(motion, positions=positions)
        encoded = type(self).codec().encode(motion)
        whole = type(self).codec().decode(encoded)
        frames = len(motion)
        cuts = [(0, 1), (0, 17), (57, 63), (frames - 1, frames), (frames // 3, 2 * frames // 3), (0, frames), (9, 9)]
        boundaries = [chunk.start for chunk in encoded.chunks[1:4]]
        cuts += [(b - 1, b + 1) for b in boundaries] + [(b, b + 5) for b in boundaries]
        for start, stop in cuts:
            part = type(self).codec().decode(encoded, slice(start, stop))
            assert_same(part.positions, whole.positions[start:stop])
        with api.open(self.pack(motion)) as file:
            assert file.shape == motion.positions.shape
            assert_same(file[57:163].positions, whole.positions[57:163])
            some = [motion.names[1], motion.names[0]]
            assert_same(file[57:63, some].positions, whole.positions[57:63, [1, 0]])
            assert_same(np.concatenate([chunk.positions for chunk in file]), whole.positions)

    def test_the_bytes_are_enough(self, tmp_path: Path) -> None:
        motion = self.figure()
        blob = self.pack(motion)
        (tmp_path / "motion.mocz").write_bytes(blob)
        program = (
            "import sys, numpy, mocodec\n"
            "numpy.save(sys.argv[2], mocodec.decode(sys.argv[1]).positions)\n"
            "numpy.save(sys.argv[3], mocodec.open(sys.argv[1])[101:150].positions)\n"
        )
        for threads in ("1", "3"):
            environment = {**os.environ, "OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
            paths = [str(tmp_path / name) for name in ("motion.mocz", "whole.npy", "part.npy")]
            subprocess.run([sys.executable, "-c", program, *paths], check=True, env=environment, cwd=tmp_path)
            here = api.decode(blob).positions
            assert_same(np.load(paths[1]), here)
            assert_same(np.load(paths[2]), here[101:150])

    # -------------------------------------------------------------------------------------------------- damage

    def test_every_prefix_is_detected(self) -> None:
        blob = self.pack(self.small(), **self.quick)
        for cut in corruption.prefixes(blob, every=1 + len(blob) // 3000):
            with pytest.raises(MocodecError):
                api.decode(cut)

    def test_every_flipped_byte_is_detected(self) -> None:
        blob = self.pack(self.small(), **self.quick)
        for at, broken in corruption.flips(blob, every=1 + len(blob) // 3000):
            try:
                api.decode(broken)
            except MocodecError:
                continue
            pytest.fail(f"byte {at} of {len(blob)} flipped, and nobody noticed")

    def test_damage_behind_the_checksums_raises_or_decodes(self) -> None:
        """A stream that was made to be wrong, checksums and all: MocodecError, or a motion of the right size."""
        encoded = type(self).codec(**self.quick).encode(self.small())
        blobs = [*encoded.shared, *(chunk.payload for chunk in encoded.chunks)]
        rounds = 300
        for place, blob in enumerate(blobs[:6]):
            broken = list(blobs)
            for bad in corruption.damaged(blob, rounds // min(len(blobs), 6), seed=place):
                broken[place] = bad
                self.decode_hostile(encoded, broken)

    @settings(FEW, max_examples=40)
    @given(data=st.data())
    def test_any_bytes_raise_or_decode(self, data: st.DataObject) -> None:
        encoded = getattr(self, "_encoded", None) or type(self).codec(**self.quick).encode(self.small())
        self._encoded = encoded
        blobs = [*encoded.shared, *(chunk.payload for chunk in encoded.chunks)]
        place = data.draw(st.integers(0, len(blobs) - 1))
        blobs[place] = data.draw(st.one_of(st.binary(max_size=60), st.just(blobs[place] + b"\0")))
        self.decode_hostile(encoded, blobs)

    def decode_hostile(self, encoded: Encoded[Motion], blobs: list[bytes]) -> None:
        """Decode with these instead of the shared bytes and payloads."""
        shared = tuple(blobs[: len(encoded.shared)])
        payloads = blobs[len(shared) :]
        chunks = tuple(replace(c, payload=p) for c, p in zip(encoded.chunks, payloads, strict=True))
        try:
            decoded = type(self).codec().decode(replace(encoded, shared=shared, chunks=chunks))
        except MocodecError:
            return
        assert decoded.positions.shape == (encoded.frames, encoded.about.points, 3)

    # -------------------------------------------------------------------------------------------------- help

    def pack(self, motion: Motion, **chosen: Any) -> bytes:
        """The bytes of a .mocz."""
        return api.encode(motion, codec=type(self).codec(**chosen))

    def through_bytes(self, motion: Motion, **chosen: Any) -> Motion:
        """Encoded, packed, and decoded from the bytes."""
        return api.decode(self.pack(motion, **chosen))


def assert_same(a: np.ndarray, b: np.ndarray) -> None:
    """Equal shapes and gaps, positions within SAME."""
    assert a.shape == b.shape
    assert np.array_equal(np.isnan(a), np.isnan(b))
    assert np.nanmax(np.abs(a - b), initial=0.0) <= SAME
