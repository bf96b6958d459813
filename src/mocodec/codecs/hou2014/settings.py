"""Settings of the codec, and where a search for a target begins."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from ...errors import BadInput
from ...motion import Motion
from ...stages import frozen, quantise
from . import parameters

STEP_OF_MEAN, STEP_OF_BOUND = 5.0, 2.6
"""Where a search begins: typical steps as multiples of the mean error and of the bound."""

FIRST_MEAN_ERROR_M = 0.003
"""The mean error that a search for a ratio begins at."""

FROZEN_SHARE = 1 / 8
"""Share of the target error that the rounding of a frozen position may take."""


@dataclass(frozen=True)
class Settings:
    """The fields of `Hou2014`, which documents them."""

    name: ClassVar[str] = "hou2014"

    max_error: float | None = None
    mean_error: float | None = None
    ratio: float | None = None

    components: int | None = None  # k; None: 30, or with a target the number that costs least
    clip_frames: int | None = None  # L; None: 280, or with a target the length that costs least
    frequencies: int | None = None  # l; None: equation (12), or with a target all that have nonzero coefficients
    fraction_bits: int | None = None  # Q; None: equation (13)
    segmentation: str = "equal"  # or "adaptive": cut where the distribution of poses changes
    clips: int | None = None  # most clips of an adaptive segmentation; None: the number that costs least
    unit: float = parameters.UNIT_M  # unit of the quantiser
    compress_basis: bool = True  # store B at adaptive precision; False: 16 bits per entry
    centre: bool = True  # subtract the mean pose before the transform
    economy: float = 0.16  # RDO λ: squared error, in squared steps, that justifies one bit; 0: round to nearest
    masking: float = 0.0  # a clip's step is proportional to its mean speed to this power
    point_weights: Mapping[str, float] = field(default_factory=dict)  # weight of a point's squared error; default 1
    transforms: tuple[bytes, ...] = ()  # learned left transforms from `Hou2014Database`
    chunk_frames: int = 5000  # most frames of a chunk, unless a single clip is longer

    @property
    def has_target(self) -> bool:
        """Whether encoding searches for the quantisation step."""
        return (self.max_error, self.mean_error, self.ratio) != (None, None, None)

    @property
    def first_rung(self) -> int:
        """The step where a search begins; without a target 2^−Q units: section IV-C and equation (13)."""
        if not self.has_target:
            bits = self.fraction_bits
            k = self.components or parameters.COMPONENTS
            return -quantise.LADDER * (parameters.fraction_bits(k) if bits is None else bits)
        if self.max_error is not None:
            return quantise.rung(STEP_OF_BOUND * self.max_error / self.unit)
        return quantise.rung(STEP_OF_MEAN * (self.mean_error or FIRST_MEAN_ERROR_M) / self.unit)

    def check(self, motion: Motion) -> None:
        """Raises BadInput for values that are invalid, alone or for this motion."""
        targets = {name: getattr(self, name) for name in ("max_error", "mean_error", "ratio")}
        given = {name: value for name, value in targets.items() if value is not None}
        if len(given) > 1:
            raise BadInput(f"hou2014 takes one target: give only one of {', '.join(given)}")
        for name, value in (given | {"unit": self.unit}).items():
            if not (math.isfinite(value) and value > 0):
                raise BadInput(f"hou2014: {name} must be positive and finite, not {value}")
        for name in ("components", "clip_frames", "frequencies", "clips", "chunk_frames"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise BadInput(f"hou2014: {name} must be at least 1, not {value}")
        if self.segmentation not in ("equal", "adaptive"):
            raise BadInput(f"hou2014: segmentation must be 'equal' or 'adaptive', not {self.segmentation!r}")
        unknown = [name for name in self.point_weights if name not in motion.names]
        if unknown:
            raise BadInput(f"hou2014: point_weights names points that the motion does not have: {', '.join(unknown)}")
        if any(not 1e-6 <= weight <= 1e6 for weight in self.point_weights.values()):
            raise BadInput("hou2014: point_weights must be between 1e-6 and 1e6")

    def split(self, motion: Motion) -> frozen.Split:
        """The samples that the transform does not code: missing or frozen."""
        error = self.max_error or self.mean_error
        bones, holds = motion.skeleton is not None, self.mean_error is None
        return frozen.split(motion.positions, error and FROZEN_SHARE * error, bones, holds)
