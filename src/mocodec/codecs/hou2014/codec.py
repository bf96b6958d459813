"""The codec: which of its ways of encoding is taken, and decoding.

    encode    positions ─gaps─► clips ─► B ─► S_i = Bᵀ M_i D̃ ─quantise─► integers ─► entropy code
                                  ▲ step, k, l: by the paper's rules, or searched for a target
    decode    entropy code ─► integers ─► B S_i D̃ᵀ ─► corrections ─► gaps ─► positions

A chunk is a group of clips. It decodes from the shared bytes and its own payload.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from ...encoded import Encoded
from ...errors import CannotEncode
from ...motion import Motion
from ...stages import frozen, gaps
from ...typing import Floats
from .. import base, rescue
from . import decoding
from .motion_encoder import MotionEncoder
from .settings import Settings

PROMISING_BITS = 1.1
"""A bound is tried in place of a mean error if its coefficients take up to this many times the bits."""


@dataclass(frozen=True)
class Hou2014(Settings):
    """Settings of hou2014: DCT along time and one basis across points (Hou et al. 2014).

    Lengths are in metres. One target or none: `max_error`, `mean_error`, `ratio` (float32 over payload bytes).

    A setting that is None follows the paper's rule; with a target, encoding searches for its best value.
    `as_published` gives the paper's own coding of numbers.
    """

    @classmethod
    def as_published(cls, **settings: Any) -> Hou2014:
        """Section IV-C: 16 bits per entry of B, no mean pose, rounding to nearest."""
        return cls(**{"compress_basis": False, "centre": False, "economy": 0.0, **settings})

    def encode(self, motion: Motion) -> Encoded[Motion]:
        """Raises CannotEncode if the target cannot be met, BadInput for invalid settings."""
        if not base.has_samples(motion):
            self.check(motion)
            return base.encode_gaps(self, motion, base.settings(replace(self, transforms=())))
        apart = self.split(motion)
        moving = apart.moving
        base.require_usual_lengths(self, moving)
        filled = gaps.fill(moving)[0]
        if self.mean_error is None:
            return self.prepared(motion, filled, by_engine=True, apart=apart).to_target()
        return self._encode_to_mean(motion, filled, apart, self.mean_error)

    def _encode_to_mean(self, motion: Motion, filled: Floats, apart: frozen.Split, target: float) -> Encoded[Motion]:
        """At a mean error, or under this error as a bound where that is smaller, or the only way."""
        encoder, encoded, failure = self.prepared(motion, filled, apart=apart), None, None
        bounded = replace(self, mean_error=None, max_error=target)
        by_bound = cache(lambda: bounded.prepared(motion, filled, apart=replace(apart, holds=True)))
        promising = True
        try:
            rung = encoder.rung_for_mean_error(target)
            encoded = encoder.encoded(rung)
            size = encoded.payload_bytes
            promising = encoder.takes_few_bits(bounded.first_rung, rung, PROMISING_BITS)
            promising = promising and by_bound().estimate(limit=size)[0] < size
        except CannotEncode as error:
            failure = error
        if promising:
            try:
                rival = by_bound().to_target()
            except CannotEncode:
                rival = None
            if rival is not None and (encoded is None or rival.payload_bytes < encoded.payload_bytes):
                encoded = replace(rival, settings=base.settings(replace(self, transforms=())))
        if encoded is None:
            assert failure is not None
            raise failure
        rescue.require_kept(motion, {"mean_error": target}, encoded, Hou2014.decode)
        return encoded

    def prepared(
        self,
        motion: Motion,
        smooth: Floats,
        by_engine: bool = False,
        apart: frozen.Split | None = None,
        fitted_hz: float | None = None,
    ) -> MotionEncoder:
        """For encoding by a transform that codes `smooth` in place of the motion's positions. Raises as `encode`.

        smooth (frames, points, 3): the positions with gaps filled. With `max_error`, outliers of single frames may be
        smoothed too, since corrections restore them. by_engine: the lattice engine may code corrections. apart: `split`
        of the motion, if it is known. fitted_hz: see `MotionEncoder`.
        """
        base.require_frames(motion)
        self.check(motion)
        apart = self.split(motion) if apart is None else apart
        return MotionEncoder(self, motion, smooth, apart, by_engine, fitted_hz)

    @staticmethod
    def decode(encoded: Encoded[Motion], frames: slice | None = None) -> Motion:
        """The motion, or a slice of its frames. Raises Corrupt."""
        return decoding.decode(encoded, frames)
