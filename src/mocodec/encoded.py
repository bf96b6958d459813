# pyright: strict
"""Encoded: the only thing that codecs and the container exchange.

shared bytes   what every chunk needs to decode (a basis, the name of a prior)
chunks         runs of frames; each decodes from the shared bytes, itself and `margin` neighbours on each side
about          a motion (or point clouds) without frames: rate, names, axes, skeleton, source, extras
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

from .motion import Motion, extras_between, source_from, with_valid_positions
from .pointcloud import PointClouds
from .selection import frame_range
from .typing import Floats, Integers

TARGETS = ("max_error", "mean_error", "ratio", "size", "psnr")
"""Settings that are promises: errors in metres, ratio to float32 positions, bytes of the file, dB of colours."""

Recording = Motion | PointClouds
"""The two kinds of data that codecs code."""

RecordingT = TypeVar("RecordingT", bound=Recording)

MAX_CHUNK_SAMPLES = 1 << 22
"""Samples (frames × points) of a chunk, at most, so that decoding two frames needs bounded time and memory."""
CLOUD_SAMPLES = 1 << 8
"""As how many samples a frame of point clouds counts."""


def most_chunk_frames(points: int) -> int:
    """The most frames that a chunk of this many points may have."""
    return MAX_CHUNK_SAMPLES // max(points, 1)


@dataclass(frozen=True)
class Chunk:
    """A run of frames [start, start + frames) and the bytes that they decode from."""

    start: int
    frames: int
    payload: bytes

    @property
    def stop(self) -> int:
        """The frame after the last."""
        return self.start + self.frames


def batches(chunks: Sequence[Chunk], points: int, most: int) -> Iterator[Sequence[Chunk]]:
    """Chunks to decode side by side: at most `most`, with MAX_CHUNK_SAMPLES if each is as long as the longest."""
    first, longest = 0, 0
    for i, chunk in enumerate(chunks):
        longest = max(longest, chunk.frames)
        if i > first and (i - first == most or (i - first + 1) * longest * points > MAX_CHUNK_SAMPLES):
            yield chunks[first:i]
            first, longest = i, chunk.frames
    if first < len(chunks):
        yield chunks[first:]


@dataclass(frozen=True, eq=False)
class Encoded(Generic[RecordingT]):
    """The output of `Codec.encode` and the input of `Codec.decode`.

    codec: its name on disk. about: everything that the codec does not code, with no frames in it. shared: blobs that
    all chunks need. chunks: in order, without holes; from a file, a chunk loads its payload on first use. margin: how
    many neighbouring chunks on each side a chunk needs to decode. settings: the codec's settings that differ from its
    defaults, JSON values, never needed to decode; those named in TARGETS are promises.
    """

    codec: str
    about: RecordingT
    chunks: Sequence[Chunk]
    shared: tuple[bytes, ...] = ()
    margin: int = 0
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def frames(self) -> int:
        """The number of frames."""
        return self.chunks[-1].stop if len(self.chunks) else 0

    @property
    def payload_bytes(self) -> int:
        """Shared bytes and payloads together: the codec's own size, without container and extras."""
        return sum(map(len, self.shared)) + sum(len(chunk.payload) for chunk in self.chunks)

    @property
    def promise(self) -> dict[str, float]:
        """The promises of the file: the settings that are named in TARGETS."""
        chosen = {name: self.settings.get(name) for name in TARGETS}
        return {name: value for name, value in chosen.items() if type(value) in (int, float) and value}

    def range(self, frames: slice | None) -> tuple[int, int]:
        """(start, stop) of a slice of this recording's frames."""
        return frame_range(frames, self.frames)

    def covering(self, start: int, stop: int) -> Sequence[Chunk]:
        """The chunks that frames [start, stop) need, margins included; no other payload is read."""
        if stop <= start:
            return ()
        first, last = self._numbers(start, stop)
        return self.chunks[max(0, first - self.margin) : last + self.margin]

    def _numbers(self, start: int, stop: int) -> tuple[int, int]:
        """Numbers of the first chunk with frames of [start, stop), and of the one behind the last."""
        starts: Integers | None = getattr(self.chunks, "starts", None)  # those of a file are an array
        if starts is not None:
            first, last = starts.searchsorted((start, stop - 1), side="right").tolist()
            return first - 1, last
        first = bisect_right(self.chunks, start, key=lambda chunk: chunk.stop)
        return first, bisect_left(self.chunks, stop, key=lambda chunk: chunk.start)


def about(motion: Motion, has_rotations: bool = False) -> Motion:
    """The motion without its frames: the `about` of its Encoded. has_rotations: whether the codec codes rotations; the
    result then has rotations, of no frames.
    """
    rotations = motion.rotations if has_rotations else None
    return replace(motion, positions=motion.positions[:0], rotations=None if rotations is None else rotations[:0])


def restore(
    encoded: Encoded[Motion],
    positions: Floats,
    start: int = 0,
    rotations: Floats | None = None,
    are_valid: bool = False,
) -> Motion:
    """The motion of decoded positions (frames, points, 3) and rotations (frames, joints, 4), whose first frame is
    `start` of the encoded motion. are_valid: whether all positions are known to be finite, or gaps."""
    like = encoded.about
    complete = start == 0 and len(positions) == encoded.frames
    extras = like.extras if complete else extras_between(like.extras, start, start + len(positions), like.rate)
    source = source_from(like.source, start)
    if are_valid and rotations is None and like.rotations is None:
        return with_valid_positions(like, positions, extras=extras, source=source)
    return replace(like, positions=positions, rotations=rotations, extras=extras, source=source)
