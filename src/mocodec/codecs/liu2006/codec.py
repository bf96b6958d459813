"""The method: figure 2 of the paper, and back.

    encode    positions ─gaps─► roles ─► segments ─► key frames of the normalisation markers
                       └─ decoded ─► body frame ─► poses ─► a model for each segment and group
    decode    segments ─► normalisation markers ─► body frame ─► poses, blended at transitions ─► positions

A chunk is a segment. Near its ends it needs its neighbours' models for the blend: the margin is one chunk.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ... import encoded as encodeds
from ... import metrics, progress
from ...encoded import Chunk, Encoded
from ...entropy import varint
from ...errors import BadInput, CannotEncode, Corrupt
from ...geometry import body_frame
from ...motion import Floats, Motion
from ...stages import bounded, gaps, segment
from .. import base
from . import models, roles
from .models import Segment
from .roles import Roles

MEAN_OF_BOUND = 0.5
"""Under a max_error, the mean error that the method itself is steered to; the residual layer does the rest."""

PLAIN = 0.04
STEERED = 0.25
"""Quantiser steps in tolerances of the splines. The paper stores floats: PLAIN adds little to its error. At an equal
error in all, STEERED takes the fewest bytes."""

ATTEMPTS = 10
NEAR_ENOUGH = 0.98
AIM = float(np.log(0.99))
FARTHEST = 25.0
"""How a target is searched for: how often, when to stop, what to aim at, and the largest logarithm of a scale."""


@dataclass(frozen=True)
class Liu2006:
    """Settings, with the paper's values. Lengths in metres, runs in frames.

    Tolerances are a length for each marker: PCA may leave tolerance × √markers (root mean square over frames), a spline
    may be tolerance × markers off in any frame (L2 norm over its group); docs/papers/liu2006.md says why. `mean_error`
    and `ratio` (float32 over payload bytes) are met by scaling all tolerances; `max_error` by a residual layer on top.
    """

    name: ClassVar[str] = "liu2006"

    max_error: float | None = None
    mean_error: float | None = None
    ratio: float | None = None

    normalisation_markers: tuple[str, ...] = ()  # origin, left, right; by label or geometry where none are named
    foot_markers: tuple[str, ...] = ()  # by label where none are named
    initial_frames: int = 200  # K
    variance_kept: float = 0.95  # τ
    ahead_frames: int = 150  # T
    step_frames: int = 10  # Δ
    rise: float = 500.0  # R
    pca_tolerance: float = 0.030
    foot_tolerance: float = 0.010
    spline_tolerance: float = 0.010
    normalisation_tolerance: float = 0.001
    blend_frames: int = 16  # h
    fineness: float | None = None  # quantiser step, in tolerances of the splines; none: PLAIN, or STEERED to a target

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if (
                isinstance(value, (int, float))
                and not (np.isfinite(value) and value > 0)
                and field.name != "blend_frames"
            ):
                raise BadInput(f"liu2006: {field.name} must be positive, not {value}")
            if isinstance(value, list):
                object.__setattr__(self, field.name, tuple(value))
        if self.mean_error is not None and self.ratio is not None:
            raise BadInput("liu2006: give mean_error or ratio, not both")
        if not 0 <= self.blend_frames // 2 <= min(self.initial_frames, self.ahead_frames, models.MARGIN):
            raise BadInput("liu2006: blend_frames must be within twice initial_frames and twice ahead_frames")

    def encode(self, motion: Motion) -> Encoded[Motion]:
        """Raises CannotEncode for an empty motion, named markers that are missing, or a target that cannot be met."""
        base.require_frames(motion)
        positions, missing = gaps.fill(motion.positions)
        played = roles.of(motion, self.normalisation_markers, self.foot_markers)
        cuts = self.cuts(positions, played, motion.up).segments

        def fit(scale: float) -> list[Segment]:
            return self.fit(positions, played, cuts, motion.up, scale)

        def stored(segments: list[Segment]) -> Encoded[Motion]:
            return self._stored(motion, segments, played, missing)

        def mean_error(segments: list[Segment]) -> float:
            decoded = reconstruct(segments, played, motion.up, 0, len(motion), self.blend_frames)
            return metrics.mean_distance(motion.positions, decoded)

        if self.ratio is not None:
            allowed = motion.raw_bytes / self.ratio
            return stored(steer(fit, lambda segments: stored(segments).payload_bytes / allowed, grows=False))
        target = self.mean_error or (self.max_error and MEAN_OF_BOUND * self.max_error)
        if target is not None:
            return stored(steer(fit, lambda segments: mean_error(segments) / target, grows=True))
        return stored(fit(1.0))

    def cuts(self, positions: Floats, played: Roles, up: str) -> segment.Segmentation:
        """Normalise, and cut where the poses change their distribution: sections 3.1 and 3.2."""
        rest = np.concatenate([*played.groups, np.zeros(0, np.int64)])
        if not len(rest):
            return segment.Segmentation([slice(0, len(positions))], [])
        frame = body_frame.of(positions[:, played.normalisation], up)
        poses = body_frame.into(positions[:, rest], frame).reshape(len(positions), -1)
        return segment.ppca(
            poses, self.initial_frames, self.ahead_frames, self.step_frames, self.variance_kept, self.rise
        )

    def fit(self, positions: Floats, played: Roles, cuts: Sequence[slice], up: str, scale: float) -> list[Segment]:
        """Every segment's key frames and models, with all tolerances times `scale`: sections 3.3 and 3.4.

        The poses are taken in the frame of the normalisation markers as they will be decoded, so that their errors do
        not turn the body: a departure, see docs/papers/liu2006.md.
        """
        markers = positions[:, played.normalisation]
        fineness = self.fineness or (STEERED if self.max_error or self.mean_error or self.ratio else PLAIN)
        tolerance = scale * self.normalisation_tolerance * markers.shape[1]
        tracks = [models.keep_markers(markers[cut], tolerance, fineness) for cut in cuts]
        bare = [Segment(cut.start, cut.stop, 0, 0, track, ()) for cut, track in zip(cuts, tracks, strict=True)]
        decoded = np.concatenate([s.normalisation(s.start, s.stop) for s in bare])
        if not played.groups:
            return bare
        frame = body_frame.of(decoded, up)
        groups = [
            body_frame.into(positions[:, columns], frame).reshape(len(positions), -1) for columns in played.groups
        ]

        def with_models(cut: Segment) -> Segment:
            first, last = (
                max(cut.start - self.blend_frames // 2, 0),
                min(cut.stop + self.blend_frames // 2, len(positions)),
            )
            own = slice(cut.start - first, cut.stop - first)
            fitted = [
                models.fit(
                    poses[first:last],
                    own,
                    pca_tolerance=scale * (self.foot_tolerance if columns is played.feet else self.pca_tolerance),
                    spline_tolerance=scale * self.spline_tolerance * len(columns),
                    fineness=fineness,
                )
                for columns, poses in zip(played.groups, groups, strict=True)
            ]
            return dataclasses.replace(cut, before=own.start, after=last - cut.stop, groups=tuple(fitted))

        return [with_models(cut) for cut in progress.over(bare)]

    def _stored(self, motion: Motion, segments: list[Segment], played: Roles, missing: gaps.Mask) -> Encoded[Motion]:
        """Chunks of the segments, each with its gaps and, for a `max_error`, what keeps the promise."""
        shared = varint.write([self.blend_frames, *roles.pack(played)])
        if self.max_error is not None:
            shared += struct.pack("<d", self.max_error)
        chunks: list[Chunk] = []
        for i, one in enumerate(segments):
            residual = b""
            if self.max_error is not None:
                near = segments[max(i - 1, 0) : i + 2]
                prediction = reconstruct(near, played, motion.up, one.start, one.stop, self.blend_frames)
                original = motion.positions[one.start : one.stop]
                residual = bounded.pack(original, prediction, self.max_error)
                fixed = metrics.distances(original, bounded.unpack(residual, prediction, self.max_error))
                if not np.nanmax(fixed, initial=0.0) <= self.max_error:
                    raise CannotEncode(f"liu2006 cannot hold max_error={self.max_error:g} m at these coordinates")
            payload = models.pack(one, gaps.pack(missing[one.start : one.stop]), residual)
            chunks.append(Chunk(one.start, one.stop - one.start, payload))
        return Encoded(
            self.name, encodeds.about(motion), tuple(chunks), (shared,), int(len(chunks) > 1), base.settings(self)
        )

    @staticmethod
    def decode(encoded: Encoded[Motion], frames: slice | None = None) -> Motion:
        """The motion, or a slice of its frames from the chunks that it needs. Raises Corrupt."""
        start, stop = encoded.range(frames)
        blend_frames, played, max_error = read_shared(encoded)
        segments, gap_bytes, residuals = read_segments(encoded.covering(start, stop), played)
        up = encoded.about.up
        positions = np.empty((stop - start, played.points, 3))
        for one, gap, residual in progress.over(list(zip(segments, gap_bytes, residuals, strict=True))):
            first, last = max(one.start, start), min(one.stop, stop)
            if first >= last:
                continue
            whole = (one.start, one.stop) if residual or gap else (first, last)
            here = reconstruct(segments, played, up, *whole, blend_frames)
            if residual:
                here = bounded.unpack(residual, here, max_error)
            here = gaps.apply(here, gaps.unpack(gap, here.shape[:2]))
            positions[first - start : last - start] = here[first - whole[0] : last - whole[0]]
        return encodeds.restore(encoded, positions, start)


def reconstruct(
    segments: Sequence[Segment], played: Roles, up: str, start: int, stop: int, blend_frames: int
) -> Floats:
    """Positions (frames, points, 3) of frames [start, stop) from the segments there and beside: section 3.5."""
    positions = np.empty((stop - start, played.points, 3))
    for i, one in enumerate(segments):
        first, last = max(one.start, start), min(one.stop, stop)
        if first >= last:
            continue
        here = positions[first - start : last - start]
        markers = one.normalisation(first, last)
        here[:, played.normalisation] = markers
        if not played.groups:
            continue
        frame = body_frame.of(markers, up)
        for group, columns in enumerate(played.groups):
            poses = blended(segments, i, group, first, last, blend_frames)
            here[:, columns] = body_frame.out_of(poses.reshape(len(poses), -1, 3), frame)
    return positions


def blended(segments: Sequence[Segment], i: int, group: int, start: int, stop: int, blend_frames: int) -> Floats:
    """Poses (frames, dimensions) of frames [start, stop) within segment i: y = Σ wᵢ bᵢ over it and its neighbours.

    wᵢ = rᵢ / (h + 1), with rᵢ the frames of segment i among the h + 1 around this one; at the ends of the motion, where
    there are fewer, of those that there are.
    """
    poses = segments[i].poses(group, start, stop)
    half = blend_frames // 2
    around = np.arange(start, stop)
    low, high = np.maximum(around - half, segments[0].start), np.minimum(around + half + 1, segments[-1].stop)
    for neighbour in (*segments[max(i - 1, 0) : i], *segments[i + 1 : i + 2]):
        first = max(start, neighbour.start - neighbour.before)
        last = min(stop, neighbour.stop + neighbour.after)
        if first >= last:
            continue
        inside = slice(first - start, last - start)
        shared = np.minimum(high, neighbour.stop) - np.maximum(low, neighbour.start)
        weight = (np.maximum(shared, 0) / (high - low))[inside, None]
        poses[inside] += weight * (neighbour.poses(group, first, last) - segments[i].poses(group, first, last))
    return poses


def steer(
    fit: Callable[[float], list[Segment]], measure: Callable[[list[Segment]], float], grows: bool
) -> list[Segment]:
    """The fit whose measure is nearest below 1, by the scale of the tolerances that it grows with, or falls with.

    Raises CannotEncode where no scale that was tried comes below.
    """
    best: tuple[float, list[Segment]] | None = None
    inside: tuple[float, float] | None = None  # logarithms of scale and measure, on either side of the aim
    outside: tuple[float, float] | None = None
    scale = 0.0
    for attempt in range(ATTEMPTS):
        with progress.attempt(attempt):
            fitted = fit(float(np.exp(scale)))
        measured = measure(fitted)
        at = (scale, float(np.log(max(measured, 1e-6))))
        if measured <= 1 and (best is None or measured > best[0]):
            best = (measured, fitted)
        if NEAR_ENOUGH <= measured <= 1:
            break
        inside, outside = (at, outside) if at[1] <= AIM else (inside, at)
        if inside and outside:
            share = (AIM - inside[1]) / (outside[1] - inside[1])
            scale = inside[0] + min(max(share, 0.05), 0.95) * (outside[0] - inside[0])
        else:
            step = min(max(AIM - at[1], -3.0), 3.0) * (1 if grows else -2)
            if not -FARTHEST <= scale + step <= FARTHEST:
                break
            scale += step
    if best is None:
        raise CannotEncode("liu2006 does not come down to what was asked: ask for more error or a lower ratio")
    return best[1]


def read_shared(encoded: Encoded[Motion]) -> tuple[int, Roles, float]:
    """The blend's h, the roles, and the max_error that was promised, or zero. Raises Corrupt."""
    if len(encoded.shared) != 1:
        raise Corrupt(f"liu2006 has one shared blob, not {len(encoded.shared)}")
    data = encoded.shared[0]
    (blend_frames,), at = varint.read(data, 1)
    played, used = roles.unpack(data[at:], encoded.about.points)
    rest = data[at + used :]
    if len(rest) not in (0, 8):
        raise Corrupt(f"liu2006: {len(rest)} bytes behind the roles, not 0 or 8")
    max_error = struct.unpack("<d", rest)[0] if rest else 0.0
    if not 0 <= max_error < np.inf:
        raise Corrupt("liu2006: a max_error that is no length")
    return blend_frames, played, max_error


def read_segments(chunks: Sequence[Chunk], played: Roles) -> tuple[list[Segment], list[bytes], list[bytes]]:
    """Segments, gaps and residuals of chunks. Raises Corrupt."""
    read = [models.unpack(chunk.payload, chunk.start, chunk.stop, played) for chunk in chunks]
    return [r[0] for r in read], [r[1] for r in read], [r[2] for r in read]
