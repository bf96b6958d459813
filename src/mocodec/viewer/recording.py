"""A recording that a page shows: one in memory, or an open .mocz of which only the shown frames are decoded."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np

from .. import api, formats
from ..encoded import Recording
from ..errors import Corrupt, Truncated
from ..motion import Motion
from ..pointcloud import PointClouds
from ..typing import Floats


@dataclass(frozen=True, eq=False)
class Shown:
    """A recording and its name. `positions` and `clouds` decode frames; damaged frames of a motion are gaps.

    columns: the order in which points are shown, as numbers of the recording's points; None for its own order.
    bytes, codec, promise, chunks (first frame, bytes): of a compressed file; None and empty for others. file_bytes:
    size of the file that it was read from, if it is one file.
    """

    name: str
    recording: Recording | api.File[Any]
    columns: Sequence[int] | None = None
    bytes: int | None = None
    notes: Sequence[str] = ()
    codec: str | None = None
    promise: Mapping[str, float] = field(default_factory=dict[str, float])
    chunks: Sequence[tuple[int, int]] = ()
    file_bytes: int | None = None

    @cached_property
    def about(self) -> Recording:
        """The recording, or its description without frames; points in the shown order."""
        about = self.recording.encoded.about if isinstance(self.recording, api.File) else self.recording
        if not isinstance(about, Motion) or self.columns is None:
            return cast("Recording", about)
        return replace(about, rotations=None).select([about.names[c] for c in self.columns])

    @property
    def frames(self) -> int:
        """The number of frames."""
        return len(self.recording)

    @cached_property
    def in_memory(self) -> Recording:
        """The whole recording, in its own order of points. Damaged frames are gaps, or have no points."""
        if not isinstance(self.recording, api.File):
            return self.recording
        try:
            return cast("Recording", self.recording[:])
        except (Corrupt, Truncated):
            return self._without_damage()

    def _without_damage(self) -> Recording:
        about = cast("api.File[Any]", self.recording).encoded.about
        if isinstance(about, Motion):
            positions = replace(self, columns=None).positions(0, self.frames)
            return replace(about, positions=positions, rotations=None, extras={})
        frames = [self.frame_or_nothing(frame) for frame in range(self.frames)]
        colours = None if any(f.colours is None for f in frames) else [c for f in frames for c in f.colours or ()]
        return replace(
            about, positions=[p for f in frames for p in f.positions], colours=colours, normals=None, extras={}
        )

    def frame_or_nothing(self, frame: int) -> PointClouds:
        """One frame of point clouds, without points if it is damaged."""
        try:
            return self.clouds(frame, frame + 1)
        except (Corrupt, Truncated):
            return PointClouds([np.zeros((0, 3))], self.about.rate, [np.zeros((0, 3), np.uint8)])

    @property
    def is_truncated(self) -> bool:
        """Whether the file was cut short."""
        return isinstance(self.recording, api.File) and self.recording.is_truncated

    @cached_property
    def damage(self) -> list[tuple[int, int]]:
        """Runs of frames (start, stop) that do not decode."""
        if not isinstance(self.recording, api.File):
            return []
        runs, at = list[tuple[int, int]](), 0
        for start, stop in [*self.recording.whole(), (self.frames, self.frames)]:
            if start > at:
                runs.append((at, start))
            at = stop
        return [(int(start), int(stop)) for start, stop in runs]

    def part(self, a: int, b: int) -> Recording:
        """Frames [a, b). Raises Corrupt or Truncated for damaged ones."""
        return self.recording[a:b]

    def positions(self, a: int, b: int) -> Floats:
        """Positions (b − a, points, 3) of a motion, metres; NaN in gaps and in damaged frames."""
        try:
            return self._ordered(a, b)
        except (Corrupt, Truncated):
            result = np.full((b - a, cast("Motion", self.about).points, 3), np.nan)
        at = a
        for start, stop in [*self.damage, (b, b)]:
            if at < min(start, b):
                with contextlib.suppress(Corrupt, Truncated):
                    result[at - a : min(start, b) - a] = self._ordered(at, min(start, b))
            at = max(at, stop)
        return result

    def _ordered(self, a: int, b: int) -> Floats:
        positions = cast("Motion", self.part(a, b)).positions
        return positions if self.columns is None else positions[:, list(self.columns)]

    def clouds(self, a: int, b: int) -> PointClouds:
        """Frames [a, b) of point clouds. Raises Corrupt or Truncated for damaged ones."""
        return cast("PointClouds", self.part(a, b))


def of_file(name: str, opened: api.File[Any]) -> Shown:
    """An open .mocz."""
    info = opened.info
    chunks = [
        (int(chunk.start), int(size)) for chunk, size in zip(opened.encoded.chunks, opened.chunk_bytes, strict=True)
    ]
    size: int = info["bytes"]
    promise = opened.encoded.promise
    return Shown(name, opened, bytes=size, codec=info["codec"], promise=promise, chunks=chunks, file_bytes=size)


def of_path(path: str, name: str, recording: Recording) -> Shown:
    """A recording that was read from a file."""
    size = Path(path).stat().st_size if Path(path).is_file() else None
    return Shown(name, recording, notes=[str(note) for note in formats.notes(recording)], file_bytes=size)
