"""What a model is fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from ....motion import Motion
from ....typing import Floats
from .model import Model


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


class FittedModel(Protocol):
    """A model before it is stored: its bytes, and the Model that a decoder makes of them."""

    def pack(self) -> bytes: ...

    @property
    def prior_id(self) -> bytes: ...

    def model(self, like: Motion) -> Model: ...
