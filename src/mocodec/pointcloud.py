"""PointClouds: frames of unordered, coloured points of people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import BadInput
from .motion import Floats, frame_range

Colours = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class PointClouds:
    """Frames of points, a different number in each.

    positions: one (n, 3) float64 array a frame, metres. colours: one (n, 3) uint8 array a frame, or none at all.
    normals: one (n, 3) array a frame, or none. rate: frames a second. up: the vertical axis. source, extras: as in
    Motion.
    Raises BadInput where the arrays do not fit each other.
    """

    positions: Sequence[Floats]
    rate: float
    colours: Sequence[Colours] | None = None
    normals: Sequence[Floats] | None = None
    up: str = "y"
    source: Mapping[str, Any] = field(default_factory=dict)
    extras: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate > 0):
            raise BadInput(f"the frame rate must be positive, not {self.rate}")
        for what, arrays in (("positions", self.positions), ("colours", self.colours), ("normals", self.normals)):
            if arrays is None:
                continue
            if len(arrays) != len(self.positions):
                raise BadInput(f"{len(self.positions)} frames of positions but {len(arrays)} of {what}")
            for frame, (values, points) in enumerate(zip(arrays, self.positions, strict=True)):
                if values.shape != (len(points), 3):
                    raise BadInput(f"{what} of frame {frame} must be ({len(points)}, 3), not {values.shape}")

    def __len__(self) -> int:
        """The number of frames."""
        return len(self.positions)

    @property
    def raw_bytes(self) -> int:
        """Size as float32 positions and, where there are any, 8-bit colours: what ratios are taken against."""
        return sum(map(len, self.positions)) * (12 + 3 * (self.colours is not None))

    def __getitem__(self, frames: slice) -> PointClouds:
        start, stop = frame_range(frames, len(self))
        return replace(
            self,
            positions=self.positions[start:stop],
            colours=None if self.colours is None else self.colours[start:stop],
            normals=None if self.normals is None else self.normals[start:stop],
        )
