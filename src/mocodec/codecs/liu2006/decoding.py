"""Decoding: the inverse of figure 2.

segments ─► normalisation markers ─► body frame ─► poses, blended at transitions ─► positions
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from ... import encoded as encodeds
from ... import native, progress
from ...encoded import Chunk, Encoded
from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry import body_frame
from ...motion import UP_AXES, Motion
from ...stages import bounded, frozen
from ...typing import Floats, Integers
from .. import base
from . import body_poses, marker_groups, segment_model
from .marker_groups import MarkerGroups
from .segment_model import SegmentModel


def decode(encoded: Encoded[Motion], frames: slice | None = None) -> Motion:
    """The motion, or a slice of its frames. Raises Corrupt."""
    if not encoded.shared:
        return base.decode_gaps(encoded, frames)
    start, stop = encoded.range(frames)
    blend_frames, markers, max_error = read_shared(encoded)
    up = encoded.about.up
    chunks = encoded.covering(start, stop)
    segments = _read_compiled(chunks, markers, up, blend_frames) or _read(chunks, markers, up, blend_frames)
    positions = np.empty((stop - start, markers.points, 3))
    for chunk, packed, residual in progress.over(
        list(zip(chunks, segments.packed_gaps, segments.residuals, strict=True))
    ):
        first, last = max(chunk.start, start), min(chunk.stop, stop)
        if first >= last:
            continue
        out = positions[first - start : last - start]
        if not residual and not packed:
            segments.place(first, last, out)
            continue
        # Gaps and residual unpack only as a whole segment.
        decoded = np.empty((chunk.frames, markers.points, 3))
        segments.place(chunk.start, chunk.stop, decoded)
        if residual:
            decoded = bounded.unpack(residual, decoded, max_error, packed)
        out[...] = frozen.restore(decoded, packed)[first - chunk.start : last - chunk.start]
    return encodeds.restore(encoded, positions, start)


class _Segments(NamedTuple):
    """place(first, last, positions): decodes frames [first, last) into positions (frames, points, 3), without gaps and
    residuals. packed_gaps, residuals: bytes of each chunk."""

    place: Callable[[int, int, Floats], Any]
    packed_gaps: list[bytes]
    residuals: list[bytes]


def _read_compiled(chunks: Sequence[Chunk], markers: MarkerGroups, up: str, blend_frames: int) -> _Segments | None:
    """None without the compiled module, and for bytes that no encoder writes: `_read` then raises the error.

    Raises Corrupt.
    """
    kernel, streams = native.kernel("MotionSegments"), coder.compiled_streams()
    if kernel is None or streams is None:
        return None
    columns = markers.normalisation, markers.pca_groups
    segments = kernel(*streams, coder.unpack, *columns, markers.points, UP_AXES.index(up), blend_frames)
    parts = [segments.read(chunk.payload, chunk.start, chunk.stop) for chunk in chunks]
    if None in parts:
        return None
    return _Segments(segments.place, [packed for packed, _ in parts], [residual for _, residual in parts])


def _read(chunks: Sequence[Chunk], markers: MarkerGroups, up: str, blend_frames: int) -> _Segments:
    """`_read_compiled` without the compiled module. Raises Corrupt."""
    models, packed_gaps, residuals = read_segments(chunks, markers)

    def place(first: int, last: int, out: Floats) -> None:
        reconstruct(models, markers, up, first, last, blend_frames, out)

    return _Segments(place, packed_gaps, residuals)


def reconstruct(
    models: Sequence[SegmentModel],
    markers: MarkerGroups,
    up: str,
    start: int,
    stop: int,
    blend_frames: int,
    out: Floats | None = None,
    by_numpy: bool = False,
) -> Floats:
    """Positions (frames, points, 3) of frames [start, stop), in `out` if it is given: section 3.5.

    models: consecutive segments that cover these frames, and for the blend the segments next to them. by_numpy: the
    products are NumPy's with the compiled module too, so that bytes that follow from the positions are the same.
    """
    positions = np.empty((stop - start, markers.points, 3)) if out is None else out
    for i, model in enumerate(models):
        first, last = max(model.start, start), min(model.stop, stop)
        if first >= last:
            continue
        decoded = positions[first - start : last - start]
        normalisation = model.normalisation(first, last)
        decoded[:, markers.normalisation] = normalisation
        if not markers.pca_groups:
            continue
        frame = body_frame.from_markers(normalisation, up)
        if not by_numpy and _place(model, first, markers, frame, decoded):
            _blend(models, i, first, markers, frame, blend_frames, decoded)
            continue
        for group, columns in enumerate(markers.pca_groups):
            poses = blended_poses(models, i, group, first, last, blend_frames)
            body_poses.to_world(poses, columns, frame, decoded)
    return positions


def blended_poses(
    models: Sequence[SegmentModel], i: int, group: int, start: int, stop: int, blend_frames: int
) -> Floats:
    """Poses (frames, dimensions) of frames [start, stop) within segment i: y_t = Σ wᵢ b_t,i, section 3.5."""
    poses = models[i].poses(group, start, stop)
    changes = [
        (some, weight[:, None] * (neighbour.poses(group, start + some.start, start + some.stop) - poses[some]))
        for neighbour, some, weight in _neighbours(models, i, start, stop, blend_frames)
    ]
    for some, change in changes:
        poses[some] += change
    return poses


def _place(
    model: SegmentModel, start: int, markers: MarkerGroups, frame: body_frame.BodyFrame, positions: Floats
) -> bool:
    """The poses of a segment, without blends, at frames from `start` on, into positions (frames, points, 3); False
    without the compiled module."""
    first = model.start - model.before
    groups = zip(model.groups, markers.pca_groups, strict=True)
    return all(group.place(start - first, columns, frame, positions) for group, columns in groups)


def _blend(
    models: Sequence[SegmentModel],
    i: int,
    start: int,
    markers: MarkerGroups,
    frame: body_frame.BodyFrame,
    blend_frames: int,
    positions: Floats,
) -> None:
    """Blend what `_place` makes of segment i, positions (frames, points, 3), with its neighbours.

    The weights of a frame sum to one, and all its poses are placed alike: positions blend as poses do.
    """
    changes: list[tuple[slice, Floats]] = []
    for neighbour, some, weight in _neighbours(models, i, start, start + len(positions), blend_frames):
        others = positions[some].copy()
        _place(neighbour, start + some.start, markers, frame.of_frames(some), others)
        changes.append((some, weight[:, None, None] * (others - positions[some])))
    for some, change in changes:
        positions[some] += change


def _neighbours(
    models: Sequence[SegmentModel], i: int, start: int, stop: int, blend_frames: int
) -> Iterator[tuple[SegmentModel, slice, Floats]]:
    """The neighbours of segment i that reach into its frames [start, stop), those frames, from `start`, and wᵢ of each.

    wᵢ = rᵢ / (h + 1), where rᵢ counts the frames of segment i among t − h/2 to t + h/2. At the ends of the motion this
    window has fewer frames, and wᵢ is rᵢ over their number.
    """
    half = blend_frames // 2
    for neighbour in (*models[max(i - 1, 0) : i], *models[i + 1 : i + 2]):
        first = max(start, neighbour.start - neighbour.before)
        last = min(stop, neighbour.stop + neighbour.after)
        if first >= last:
            continue
        frames = np.arange(first, last)
        window_start = np.maximum(frames - half, models[0].start)
        window_stop = np.minimum(frames + half + 1, models[-1].stop)
        r = np.minimum(window_stop, neighbour.stop) - np.maximum(window_start, neighbour.start)
        yield neighbour, slice(first - start, last - start), np.maximum(r, 0) / (window_stop - window_start)


def read_shared(encoded: Encoded[Motion]) -> tuple[int, MarkerGroups, float]:
    """The blend's h, the marker groups, and the `max_error` of the file or zero. Raises Corrupt."""
    if len(encoded.shared) != 1:
        raise Corrupt(f"liu2006: the file has {len(encoded.shared)} shared blobs, not 1")
    data = encoded.shared[0]
    (blend_frames,), at = varint.read(data, 1)
    markers, size = marker_groups.unpack(data[at:], encoded.about.points)
    rest = data[at + size :]
    if len(rest) not in (0, 8):
        raise Corrupt(f"liu2006: {len(rest)} bytes follow the marker groups, not 0 or 8")
    max_error = struct.unpack("<d", rest)[0] if rest else 0.0
    if not 0 <= max_error < np.inf:
        raise Corrupt(f"liu2006: max_error must be positive and finite, not {max_error}")
    return blend_frames, markers, max_error


def read_segments(
    chunks: Sequence[Chunk], markers: MarkerGroups
) -> tuple[list[SegmentModel], list[bytes], list[bytes]]:
    """The models, the packed gaps and the residuals of chunks. Raises Corrupt."""
    unpacked = [segment_model.unpack(chunk.payload, chunk.start, chunk.stop, markers) for chunk in chunks]
    return [u[0] for u in unpacked], [u[1] for u in unpacked], [u[2] for u in unpacked]


def key_frames(encoded: Encoded[Motion]) -> Callable[[Chunk], Integers]:
    """A function from a segment's chunk to the frames with a key frame of any marker group, ascending, (n,).

    It raises Corrupt, as does this one.
    """
    _, markers, _ = read_shared(encoded)

    def of_segment(chunk: Chunk) -> Integers:
        (model,), _, _ = read_segments([chunk], markers)
        frames = [model.start + model.markers.keys.by_level]
        frames += [model.start - model.before + group.track.keys.by_level for group in model.groups]
        found: Integers = np.unique(np.concatenate(frames))
        return found[(found >= model.start) & (found < model.stop)]

    return of_segment
