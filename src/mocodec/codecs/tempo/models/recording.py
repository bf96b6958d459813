"""What a model is fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from ....motion import Motion
from ....typing import Floats
from ..coding.rows import POSE
from ..pose import heading
from .coordinates import PointCoordinates
from .model import Model
from .stored_basis import Components

POSE_FRAMES = 2000
"""Enough for the mean pose of a recording."""


@dataclass(frozen=True, eq=False)
class Recording:
    """chunks: positions (frames, points, 3), y up, without gaps and spikes; none for a stream that has not begun.

    like: any motion with the names, rate and skeleton. step: log₂ in 1/32 octave of about the quantisation step.
    """

    chunks: Sequence[Floats]
    like: Motion
    step: int

    @cached_property
    def frames(self) -> int:
        return sum(map(len, self.chunks))

    @cached_property
    def mean_pose(self) -> Floats:
        """Mean pose (points, 3), metres, centred, of at most about `POSE_FRAMES` frames, each turned to it."""
        every, starts = max(1, self.frames // POSE_FRAMES), np.cumsum([0, *map(len, self.chunks)])
        some = [chunk[-start % every :: every] for chunk, start in zip(self.chunks, starts[:-1], strict=True)]
        return heading.mean_pose(heading.centred(some))

    @cached_property
    def components(self) -> Components:
        """The components of the positions about the mean pose."""
        return Components.of_positions(self.chunks, PointCoordinates(self.mean_pose), self.like.rate)

    def spectrum(self, model: Model, number: int) -> Floats | None:
        """Coefficients (frames, rows) of a chunk in a model whose basis is that of the components, from their spectra;
        None for other models.

        The model's pose differs from the mean pose by its rounding only, and so the headings are the same.
        """
        pose = model.coordinates.pose
        if model.statistics.completion is None or not isinstance(model.coordinates, PointCoordinates):
            return None
        known = self.components
        out = np.empty((len(self.chunks[number]), model.rows))
        out[:, :POSE] = known.moves[number]
        spectrum = known.spectra[number].copy()
        spectrum[:1] += (self.mean_pose - pose).ravel() * np.sqrt(len(spectrum))
        model.statistics.completion.components(spectrum, out[:, POSE:])
        return out

    def with_step(self, step: int) -> Recording:
        """The recording for another step, which keeps the results that do not depend on the step."""
        other = replace(self, step=step)
        other.__dict__.update({name: value for name, value in self.__dict__.items() if name != "step"})
        return other


class FittedModel(Protocol):
    """A model before it is stored: its bytes, and the Model that a decoder makes of them."""

    def pack(self) -> bytes: ...

    @property
    def prior_id(self) -> bytes: ...

    def model(self, like: Motion) -> Model: ...
