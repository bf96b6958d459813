# pyright: strict
"""PointClouds: frames of unordered, coloured points of people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any, cast

from .errors import BadInput
from .motion import UP_AXES
from .selection import Frames, counted, frame_steps
from .typing import Bytes, Floats


@dataclass(frozen=True, eq=False, repr=False)
class PointClouds:
    """Frames of points; the number of points differs between frames.

    positions: one (n, 3) float64 array per frame, metres. colours: one (n, 3) uint8 array per frame, or None.
    normals: one (n, 3) array per frame, or None. rate: frames per second. up: the vertical axis, "x", "y" or "z".
    source, extras: as in Motion.

    `clouds[10:20]`, `clouds[3]` and `clouds[::2]` are point clouds of these frames, as of a Motion.

    Raises BadInput for arrays whose shapes do not match.
    """

    positions: Sequence[Floats]
    rate: float
    colours: Sequence[Bytes] | None = None
    normals: Sequence[Floats] | None = None
    up: str = "y"
    source: Mapping[str, Any] = field(default_factory=dict[str, Any])
    extras: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate > 0):
            raise BadInput(f"the frame rate must be positive, not {self.rate}")
        if self.up not in UP_AXES:
            raise BadInput(f"up must be one of {', '.join(UP_AXES)}, not {self.up!r}")
        for what, arrays in (("positions", self.positions), ("colours", self.colours), ("normals", self.normals)):
            if arrays is None:
                continue
            if len(arrays) != len(self.positions):
                raise BadInput(f"{len(self.positions)} frames of positions but {len(arrays)} of {what}")
            for frame, (values, points) in enumerate(zip(arrays, self.positions, strict=True)):
                shape = cast("tuple[int, ...] | None", getattr(values, "shape", None))  # of a list: none
                if shape is None:
                    raise BadInput(f"{what} of frame {frame} must be an array (n, 3), not a {type(values).__name__}")
                if what == "colours" and values.dtype.kind not in "iu":
                    raise BadInput(
                        f"colours of frame {frame} must be numbers from 0 to 255 (uint8), not {values.dtype}"
                    )
                if shape != (len(points), 3):
                    raise BadInput(f"{what} of frame {frame} must be ({len(points)}, 3), not {values.shape}")

    def __len__(self) -> int:
        """The number of frames."""
        return len(self.positions)

    def __repr__(self) -> str:
        counts = [len(points) for points in self.positions]
        least, most = min(counts, default=0), max(counts, default=0)
        points = counted(most, "point") if least == most else f"{least:,} to {most:,} points"
        facts = [f"{counted(len(self), 'frame')} of {points} at {self.rate:g} Hz", f"{self.seconds:.4g} s"]
        facts += [f"{self.up} up"]
        facts += [name for name in ("colours", "normals") if getattr(self, name) is not None]
        return f"<PointClouds: {', '.join(facts)}>"

    def _repr_html_(self) -> str:
        """The point clouds as a page that plays them, for notebooks (`viewer.for_notebook`)."""
        return cast(str, import_module(f"{__package__}.viewer").for_notebook(self))

    @property
    def seconds(self) -> float:
        """Duration: frames / rate."""
        return len(self) / self.rate

    @property
    def raw_bytes(self) -> int:
        """Size as float32 positions and 8-bit colours, the reference of every compression ratio."""
        return sum(map(len, self.positions)) * (12 + 3 * (self.colours is not None))

    def __getitem__(self, key: Frames) -> PointClouds:
        """A frame or a slice of frames; with a step the rate falls. Raises BadInput, FrameOutOfRange."""
        start, stop, step = frame_steps(key, len(self))
        frames = slice(start, stop, step)
        return replace(
            self,
            positions=self.positions[frames],
            rate=self.rate / step,
            colours=None if self.colours is None else self.colours[frames],
            normals=None if self.normals is None else self.normals[frames],
        )
