"""The tests that every codec must pass.

    class TestLiu2006(CodecTests):
        codec = staticmethod(lambda **settings: Liu2006(**settings))
        can_bound = True

pytest runs them; hypothesis adds random motions to the named ones of `edge_cases`.
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
from ..codecs.base import Codec
from ..encoded import Encoded
from ..errors import CannotEncode, MocodecError
from ..motion import Motion, Signal
from ..typing import Floats
from . import corruption, edge_cases, synthetic
from .strategies import motions

SAME = 1e-9
"""Positions of a figure of human size agree to this on all machines, and a slice with the whole; metres."""

ROUNDING = 1e-12
"""How far a bound may be exceeded, relative to the largest coordinate: rounding of float64."""

OFFSET_ROUNDING = 5e-6 + 1e-12
"""Files store a skeleton's offsets in steps of 10 µm (docs/format.md): the error is at most half a step; metres."""

FEW = settings(
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.differing_executors],
)
"""The same examples in every run, and no time limits, because machines may be slow."""


class CodecTests:
    """Subclass it, set `codec`, and declare what the codec can do. See the module's docstring."""

    codec: ClassVar[Callable[..., Codec[Motion]]]
    """Returns an instance with the settings that are given by keyword."""

    can_bound: ClassVar[bool] = False
    """Whether the codec has `max_error`."""

    qualities: ClassVar[tuple[Mapping[str, Any], ...]] = ()
    """Settings from coarse to fine, spaced so that the error must fall; three bounds by default with `can_bound`."""

    usual_error: ClassVar[float] = 0.03
    """Largest mean error of the default settings on a walking figure, metres."""

    refuses: ClassVar[frozenset[str]] = frozenset()
    """Names of `edge_cases.MOTIONS` that may raise CannotEncode; few, for a codec with `can_bound`."""

    quick: ClassVar[Mapping[str, Any]] = {}
    """Fast settings, for the tests that encode often."""

    def figure(self) -> Motion:
        """The motion of most tests; a codec for joints may return `synthetic.joints`."""
        return synthetic.markers(frames=240, seed=2)

    def small(self) -> Motion:
        """A small motion, for the tests that decode thousands of damaged files."""
        names = ["C7", "LSHO", "RSHO", "LKNE", "LHEE"]
        return synthetic.markers(frames=60, seed=4).select(names)

    def settings_by_quality(self) -> tuple[Mapping[str, Any], ...]:
        """Settings from coarse to fine: `qualities`, or three bounds."""
        bounds = ({"max_error": 0.05}, {"max_error": 0.01}, {"max_error": 0.002}) if self.can_bound else ()
        return self.qualities or bounds

    # ------------------------------------------------------------------------------------------- round trip

    def test_round_trip(self) -> None:
        motion = self.figure()
        encoded = type(self).codec().encode(motion)
        decoded = type(self).codec().decode(encoded)
        assert decoded.positions.shape == motion.positions.shape
        assert metrics.mean_distance(motion.positions, decoded.positions) <= self.usual_error
        assert encoded.payload_bytes < motion.raw_bytes

    def test_max_error_is_kept(self) -> None:
        if not self.can_bound:
            pytest.skip("this codec has no max_error")
        motion = self.figure()
        for bound in (0.02, 0.001):
            decoded = self.through_bytes(motion, max_error=bound)
            assert metrics.distances(motion.positions, decoded.positions).max() <= bound

    def test_finer_settings_give_less_error_and_more_bytes(self) -> None:
        motion = self.figure()
        if not self.settings_by_quality():
            pytest.skip("this codec has no settings of quality")
        errors, sizes = [], []
        for quality in self.settings_by_quality():
            encoded = type(self).codec(**quality).encode(motion)
            decoded = type(self).codec().decode(encoded)
            errors.append(metrics.mean_distance(motion.positions, decoded.positions))
            sizes.append(encoded.payload_bytes)
        assert errors == sorted(errors, reverse=True)
        assert len(set(errors)) == len(errors)
        assert sizes == sorted(sizes)

    def test_encoding_is_deterministic(self) -> None:
        motion = self.figure()
        assert self.pack(motion) == self.pack(motion)

    def test_metadata_and_extras_survive(self) -> None:
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

    # -------------------------------------------------------------------------------------------------- edge cases

    @pytest.mark.parametrize("name", edge_cases.MOTIONS)
    def test_edge_cases(self, name: str) -> None:
        self.check_round_trip(edge_cases.motion(name), may_refuse=name in self.refuses)

    @settings(FEW, max_examples=25)
    @given(motion=motions())
    def test_any_motion(self, motion: Motion) -> None:
        self.check_round_trip(motion, may_refuse=bool(self.refuses) or not self.can_bound)

    def test_a_motion_without_frames_is_refused(self) -> None:
        with pytest.raises(CannotEncode, match="no frames"):
            type(self).codec().encode(self.figure()[:0])

    @pytest.mark.parametrize("largest", [1e7, 1e12, 1e20, 1e35, 1e200])
    def test_positions_far_away_are_coded_or_refused(self, largest: float) -> None:
        figure = self.figure()[:20]
        positions = figure.positions / np.nanmax(np.abs(figure.positions)) * largest
        motion = replace(figure, positions=positions)
        try:
            back = self.through_bytes(motion, **self.quick)
        except CannotEncode:
            return
        assert np.array_equal(back.gaps, motion.gaps)
        assert np.isfinite(back.positions[~back.gaps]).all()

    def test_motions_without_samples_keep_what_is_beside_them(self) -> None:
        """Force plates may be recorded alone, and all markers may be hidden."""
        analog = Signal(np.arange(90, dtype=np.int16).reshape(45, 2), 5 * self.figure().rate)
        gaps_only = replace(self.figure()[:9], positions=np.full((9, self.figure().points, 3), np.nan))
        for empty in (self.figure()[:9].select([]), gaps_only):
            motion = replace(empty, extras={"analog": analog})
            with api.open(self.pack(motion), Motion) as file:
                back, part = file[:], file[2:5]
            assert back.positions.shape == motion.positions.shape
            assert part.positions.shape == (3, motion.points, 3)
            assert back.gaps.all()
            assert np.array_equal(back.extras["analog"].values, analog.values)
            assert np.array_equal(part.extras["analog"].values, analog.values[10:25])

    def check_round_trip(self, motion: Motion, may_refuse: bool) -> None:
        """Gaps are the same, all other positions are finite, and a bound is kept if the codec has one."""
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

    def test_a_decoded_slice_equals_the_slice_of_the_whole(self) -> None:
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
        with api.open(self.pack(motion), Motion) as file:
            assert file.shape == motion.positions.shape
            assert_same(file[57:163].positions, whole.positions[57:163])
            some = [motion.names[1], motion.names[0]]
            assert_same(file[57:63, some].positions, whole.positions[57:63, [1, 0]])
            assert_same(np.concatenate([chunk.positions for chunk in file]), whole.positions)

    def test_other_processes_decode_the_same(self, tmp_path: Path) -> None:
        motion = self.figure()
        blob = self.pack(motion)
        (tmp_path / "motion.mocz").write_bytes(blob)
        program = (
            "import sys, numpy, mocodec\n"
            "numpy.save(sys.argv[2], mocodec.decode(sys.argv[1]).positions)\n"
            "numpy.save(sys.argv[3], mocodec.open(sys.argv[1])[101:150].positions)\n"
        )
        threads = "3" if os.environ.get("OPENBLAS_NUM_THREADS") == "1" else "1"  # other than here
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
        paths = [str(tmp_path / name) for name in ("motion.mocz", "whole.npy", "part.npy")]
        subprocess.run([sys.executable, "-c", program, *paths], check=True, env=environment, cwd=tmp_path)
        here = api.decode(blob, Motion).positions
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
            pytest.fail(f"byte {at} of {len(blob)} flipped, was not detected")

    def test_damage_with_valid_checksums_raises_or_decodes(self) -> None:
        """Damaged payloads with correct checksums raise MocodecError, or decode to a motion of the right size."""
        encoded = type(self).codec(**self.quick).encode(self.small())
        blobs = [*encoded.shared, *(chunk.payload for chunk in encoded.chunks)]
        rounds = 300
        for place, blob in enumerate(blobs[:6]):
            broken = list(blobs)
            for bad in corruption.damaged(blob, rounds // min(len(blobs), 6), seed=place):
                broken[place] = bad
                self.check_damaged(encoded, broken)

    @settings(FEW, max_examples=40)
    @given(data=st.data())
    def test_any_bytes_raise_or_decode(self, data: st.DataObject) -> None:
        encoded = getattr(self, "_encoded", None) or type(self).codec(**self.quick).encode(self.small())
        self._encoded = encoded
        blobs = [*encoded.shared, *(chunk.payload for chunk in encoded.chunks)]
        place = data.draw(st.integers(0, len(blobs) - 1))
        blobs[place] = data.draw(st.one_of(st.binary(max_size=60), st.just(blobs[place] + b"\0")))
        self.check_damaged(encoded, blobs)

    def check_damaged(self, encoded: Encoded[Motion], blobs: list[bytes]) -> None:
        """Decode with these blobs instead of the shared bytes and payloads."""
        shared = tuple(blobs[: len(encoded.shared)])
        payloads = blobs[len(shared) :]
        chunks = tuple(replace(c, payload=p) for c, p in zip(encoded.chunks, payloads, strict=True))
        try:
            decoded = type(self).codec().decode(replace(encoded, shared=shared, chunks=chunks))
        except MocodecError:
            return
        assert decoded.positions.shape == (encoded.frames, encoded.about.points, 3)

    # -------------------------------------------------------------------------------------------------- helpers

    def pack(self, motion: Motion, **chosen: Any) -> bytes:
        """Encode to the bytes of a .mocz."""
        return api.encode(motion, codec=type(self).codec(**chosen))

    def through_bytes(self, motion: Motion, **chosen: Any) -> Motion:
        """Encode to the bytes of a .mocz and decode them."""
        return api.decode(self.pack(motion, **chosen), Motion)


def assert_same(a: Floats, b: Floats) -> None:
    """Equal shapes and gaps, positions within SAME."""
    assert a.shape == b.shape
    assert np.array_equal(np.isnan(a), np.isnan(b))
    assert np.nanmax(np.abs(a - b), initial=0.0) <= SAME
