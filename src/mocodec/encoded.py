"""Encoded: all that codecs and the container hand each other.

shared bytes   what every chunk needs (a basis, a prior's name); equal bytes in many files are stored once
chunks         each a run of frames that decodes from the shared bytes, itself and `margin` neighbours on each side
about          a motion (or point clouds) of no frames: rate, names, axes, skeleton, source, extras
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

from .motion import Floats, Motion, extras_between, frame_range, source_from
from .pointcloud import PointClouds

TARGETS = ("max_error", "mean_error", "ratio", "size")
"""Settings that promise something: errors in metres, ratio to float32 positions, bytes of the file."""

About = TypeVar("About", Motion, PointClouds)


@dataclass(frozen=True)
class Chunk:
    """A run of frames [start, start + frames) and the bytes that they decode from."""

    start: int
    frames: int
    payload: bytes

    @property
    def stop(self) -> int:
        return self.start + self.frames


@dataclass(frozen=True, eq=False)
class Encoded(Generic[About]):
    """What a codec makes and takes back.

    codec: its name on disk. about: all that the codec does not code, with no frames in it. shared: blobs that all
    chunks need. chunks: in order, without holes; a reader's sequence loads a payload when it is asked for. margin: how
    many neighbouring chunks on each side a chunk needs to decode. settings: the codec's settings that differ from its
    defaults, JSON values, never needed to decode; `max_error` among them is a promise.
    """

    codec: str
    about: About
    chunks: Sequence[Chunk]
    shared: tuple[bytes, ...] = ()
    margin: int = 0
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def frames(self) -> int:
        return self.chunks[-1].stop if len(self.chunks) else 0

    @property
    def payload_bytes(self) -> int:
        """Shared bytes and payloads together: the codec's own size, without container and extras."""
        return sum(map(len, self.shared)) + sum(len(chunk.payload) for chunk in self.chunks)

    @property
    def promise(self) -> dict[str, float]:
        """What was promised when it was encoded: those of TARGETS among the settings."""
        chosen = {name: self.settings.get(name) for name in TARGETS}
        return {name: value for name, value in chosen.items() if type(value) in (int, float) and value}

    def range(self, frames: slice | None) -> tuple[int, int]:
        """(start, stop) of a slice of this recording's frames."""
        return frame_range(frames, self.frames)

    def covering(self, start: int, stop: int) -> Sequence[Chunk]:
        """The chunks that frames [start, stop) need, margins included; payloads of no others are read."""
        first = bisect_right(self.chunks, start, key=lambda chunk: chunk.stop)
        last = bisect_left(self.chunks, stop, key=lambda chunk: chunk.start)
        return self.chunks[max(0, first - self.margin) : last + self.margin] if stop > start else ()


def about(motion: Motion) -> Motion:
    """The motion without its frames and rotations: what goes beside the codec's bytes."""
    return replace(motion, positions=motion.positions[:0], rotations=None)


def restore(encoded: Encoded[Motion], positions: Floats, start: int = 0) -> Motion:
    """The motion again: decoded positions of the frames from `start` on, with names, extras and the rest beside."""
    like = encoded.about
    whole = start == 0 and len(positions) == encoded.frames
    extras = like.extras if whole else extras_between(like.extras, start, start + len(positions), like.rate)
    return replace(like, positions=positions, extras=extras, source=source_from(like.source, start))
