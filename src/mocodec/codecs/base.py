"""What every codec is: a frozen dataclass of settings with `encode`, and a static `decode` that needs only bytes."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, Protocol

import numpy as np

from ..encoded import Encoded
from ..errors import CannotEncode
from ..motion import Motion


class Codec(Protocol):
    """The contract. `name` is written on disk: never change one.

    Settings are the dataclass's fields, with the paper's defaults; those among `max_error`, `mean_error` (metres),
    `ratio` and `size` (bytes) that are fields are the targets this codec can steer to.
    """

    name: ClassVar[str]

    def encode(self, motion: Motion) -> Encoded[Motion]:
        """Raises CannotEncode where the motion cannot be coded as the settings ask."""
        ...

    @staticmethod
    def decode(encoded: Encoded[Motion], frames: slice | None = None) -> Motion:
        """The motion, or a slice of its frames, equal to the slice of the whole. Raises Corrupt."""
        ...


def settings(codec: Any) -> dict[str, Any]:
    """The settings that differ from the defaults, as JSON values: provenance for the file."""
    changed = {}
    for f in dataclasses.fields(codec):
        value = getattr(codec, f.name)
        default = f.default_factory() if f.default_factory is not dataclasses.MISSING else f.default
        if value != default:
            changed[f.name] = list(value) if isinstance(value, tuple) else value
    return changed


def require_frames(motion: Motion) -> None:
    """Raises CannotEncode for a motion without frames, without points, or without a single sample."""
    if len(motion) == 0:
        raise CannotEncode("the motion has no frames")
    if motion.points == 0:
        raise CannotEncode("the motion has no points")
    if np.isnan(motion.positions).all():
        raise CannotEncode("every point is missing in every frame")
