"""The codec: the flow chart of figure 2, and its inverse.

    encode    positions ─gaps─► marker groups ─► segments ─► key frames of the normalisation markers
                       └─ decoded ─► body frame ─► poses ─► a PCA model for each segment and group
    decode    segments ─► normalisation markers ─► body frame ─► poses, blended at transitions ─► positions

A chunk is a segment. The blend at its ends needs the models of its neighbours: the margin is one chunk.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ... import encoded as encodeds
from ... import metrics, native, progress
from ...encoded import Chunk, Encoded, most_chunk_frames
from ...entropy import varint
from ...errors import BadInput, CannotEncode, Corrupt
from ...geometry import body_frame
from ...motion import Motion
from ...stages import bounded, frozen, gaps, lattice, search, segment
from ...typing import Floats, Integers
from .. import base, rescue
from . import marker_groups, segment_model
from .marker_groups import MarkerGroups
from .segment_model import SegmentModel

MEANS_PER_BOUND = (0.5, 10.0, 40.0)
"""With `max_error`, mean errors of the method in parts of the bound; the residual layer corrects the rest. They are
tried in turn, until one takes more bytes than the one before."""

FROZEN_SHARE = 1 / 8
"""Share of the target error that the rounding of a frozen position may take."""

FINENESS = 0.04
FINENESS_WITH_TARGET = 0.25
"""Quantisation step as a fraction of the spline tolerance.

The paper stores floats, and FINENESS adds little to their error. FINENESS_WITH_TARGET needs the fewest bytes at equal
total error.
"""

ATTEMPTS = 10
NEAR_ENOUGH = 0.98
AIM = 0.99
FARTHEST = 25.0
"""The search for a target: most attempts, the measure that ends it, the measure that it aims at, and the largest
logarithm of a scale."""


@dataclass(frozen=True)
class Liu2006:
    """Settings, with the paper's values as defaults. Lengths in metres, durations in frames.

    Tolerances are per marker: a PCA error may be tolerance × √markers (root mean square over frames), a spline error
    tolerance × markers in any frame (L2 norm over the group); docs/papers/liu2006.md gives the reasons. A `mean_error`
    or `ratio` (float32 over payload bytes) scales all tolerances; a `max_error` adds a residual layer.
    """

    name: ClassVar[str] = "liu2006"

    max_error: float | None = None
    mean_error: float | None = None
    ratio: float | None = None

    normalisation_markers: tuple[str, ...] = ()  # origin, left, right; (): chosen by label, else by geometry
    foot_markers: tuple[str, ...] = ()  # (): chosen by label
    initial_frames: int = 200  # K
    variance_kept: float = 0.95  # τ
    ahead_frames: int = 150  # T
    step_frames: int = 10  # Δ
    rise: float = 500.0  # R: least difference of H between valley and peak for a cut
    pca_tolerance: float = 0.030
    foot_tolerance: float = 0.010
    spline_tolerance: float = 0.010
    normalisation_tolerance: float = 0.001
    blend_frames: int = 16  # h
    fineness: float | None = None  # quantisation step / spline tolerance; None: FINENESS, FINENESS_WITH_TARGET

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if (
                isinstance(value, (int, float))
                and not (np.isfinite(value) and value > 0)
                and field.name != "blend_frames"
            ):
                raise BadInput(f"liu2006: {field.name} must be positive and finite, not {value}")
            if isinstance(value, list):
                object.__setattr__(self, field.name, tuple(value))
        if self.mean_error is not None and self.ratio is not None:
            raise BadInput("liu2006: give mean_error or ratio, not both")
        longest = min(self.initial_frames, self.ahead_frames, segment_model.LARGEST_BLEND_MARGIN)
        if not 0 <= self.blend_frames // 2 <= longest:
            raise BadInput(f"liu2006: blend_frames must be between 0 and {2 * longest + 1}, not {self.blend_frames}")

    def encode(self, motion: Motion) -> Encoded[Motion]:
        """Raises CannotEncode for a motion without samples, unknown marker names, or a target that cannot be met."""
        if not base.has_samples(motion):
            return base.encode_gaps(self, motion, base.settings(self))
        error = self.max_error or self.mean_error
        bones, holds = motion.skeleton is not None, self.mean_error is None
        apart = frozen.split(motion.positions, error and FROZEN_SHARE * error, bones, holds)
        base.require_usual_lengths(self, apart.moving)
        positions, _ = gaps.fill(apart.moving)
        moving = dataclasses.replace(motion, positions=apart.moving)
        markers = marker_groups.assign(moving, self.normalisation_markers, self.foot_markers)
        segments = self.segment_motion(positions, markers, motion.up).segments

        def fit(scale: float) -> list[SegmentModel]:
            return self.fit_segments(positions, markers, segments, motion.up, scale)

        known = lattice.neighbours(positions) if self.max_error is not None and lattice.is_fast() else None

        def encoded(models: list[SegmentModel]) -> Encoded[Motion]:
            return self._encode_models(motion, models, markers, apart, known)

        def mean_error(models: list[SegmentModel]) -> float:
            decoded = reconstruct(models, markers, motion.up, 0, len(motion), self.blend_frames)
            return apart.mean_error(decoded)

        if self.ratio is not None:
            allowed = motion.raw_bytes / self.ratio
            return encoded(steer(fit, lambda models: encoded(models).payload_bytes / allowed, grows=False))

        def to_mean(target: float) -> Encoded[Motion]:
            return encoded(steer(fit, lambda models: mean_error(models) / target, grows=True))

        if self.mean_error is not None:
            try:
                result = to_mean(self.mean_error)
            except CannotEncode:
                if self.max_error is not None:
                    raise
                bounded = dataclasses.replace(self, mean_error=None, max_error=self.mean_error)
                return dataclasses.replace(bounded.encode(motion), settings=base.settings(self))
            rescue.require_kept(motion, {"mean_error": self.mean_error}, result, Liu2006.decode)
            return result
        return _smallest_within(self.max_error, to_mean) if self.max_error is not None else encoded(fit(1.0))

    def segment_motion(self, positions: Floats, markers: MarkerGroups, up: str) -> segment.Segmentation:
        """Normalise, and cut where the distribution of poses changes: sections 3.1 and 3.2."""
        rest = np.concatenate([*markers.pca_groups, np.zeros(0, np.int64)])
        longest = most_chunk_frames(markers.points)
        if not len(rest):
            return segment.Segmentation(segment.equal_length(len(positions), longest), [])
        frame = body_frame.from_markers(positions[:, markers.normalisation], up)
        poses = _poses(positions, rest, frame)
        found = segment.ppca(
            poses, self.initial_frames, self.ahead_frames, self.step_frames, self.variance_kept, self.rise
        )
        return segment.Segmentation(segment.no_longer_than(found.segments, longest), found.curves)

    def fit_segments(
        self, positions: Floats, markers: MarkerGroups, segments: Sequence[slice], up: str, scale: float
    ) -> list[SegmentModel]:
        """Key frames and PCA models of every segment, with all tolerances times `scale`: sections 3.3 and 3.4.

        Departure from the paper: poses are normalised by the decoded normalisation markers, not the captured ones, so
        errors of these markers do not turn the body. See docs/papers/liu2006.md.
        """
        captured = positions[:, markers.normalisation]
        fineness = self.fineness or self._default_fineness
        tolerance = scale * self.normalisation_tolerance * captured.shape[1]
        models = [
            SegmentModel(
                one.start,
                one.stop,
                before=0,
                after=0,
                markers=segment_model.fit_normalisation_markers(captured[one], tolerance, fineness),
                groups=(),
            )
            for one in segments
        ]
        if not markers.pca_groups:
            return models
        decoded = np.concatenate([model.normalisation(model.start, model.stop) for model in models])
        frame = body_frame.from_markers(decoded, up)
        group_poses = [_poses(positions, columns, frame) for columns in markers.pca_groups]
        return [self._fit_groups(model, group_poses, markers, scale, fineness) for model in progress.over(models)]

    @property
    def _default_fineness(self) -> float:
        return FINENESS_WITH_TARGET if self.max_error or self.mean_error or self.ratio else FINENESS

    def _fit_groups(
        self, model: SegmentModel, group_poses: list[Floats], markers: MarkerGroups, scale: float, fineness: float
    ) -> SegmentModel:
        """`model` with a PCA model of each group, which reaches half a blend into the neighbouring segments."""
        margin = self.blend_frames // 2
        first, last = max(model.start - margin, 0), min(model.stop + margin, len(group_poses[0]))
        own = slice(model.start - first, model.stop - first)
        fitted = [
            segment_model.fit_poses(
                poses[first:last],
                own,
                pca_tolerance=scale * (self.foot_tolerance if columns is markers.feet else self.pca_tolerance),
                spline_tolerance=scale * self.spline_tolerance * len(columns),
                fineness=fineness,
            )
            for columns, poses in zip(markers.pca_groups, group_poses, strict=True)
        ]
        return dataclasses.replace(model, before=own.start, after=last - model.stop, groups=tuple(fitted))

    def _encode_models(
        self,
        motion: Motion,
        models: list[SegmentModel],
        markers: MarkerGroups,
        apart: frozen.Split,
        known: lattice.Neighbours | None,
    ) -> Encoded[Motion]:
        """A chunk for each segment: its model, its gaps and, with `max_error`, its residual.

        known: neighbours of the points for the residual, None to leave the lattice engine out.
        """
        shared = varint.write([self.blend_frames, *marker_groups.pack(markers)])
        if self.max_error is not None:
            shared += struct.pack("<d", self.max_error)
        chunks: list[Chunk] = []
        for i, model in enumerate(models):
            packed_gaps, residual = apart[model.start : model.stop].pack(), b""
            if self.max_error is not None:
                neighbours = models[max(i - 1, 0) : i + 2]
                prediction = reconstruct(neighbours, markers, motion.up, model.start, model.stop, self.blend_frames)
                original = apart[model.start : model.stop].moving
                residual = _pack_residual(original, prediction, self.max_error, known, packed_gaps)
            payload = segment_model.pack(model, packed_gaps, residual)
            chunks.append(Chunk(model.start, model.stop - model.start, payload))
        return Encoded(
            self.name, encodeds.about(motion), tuple(chunks), (shared,), int(len(chunks) > 1), base.settings(self)
        )

    @staticmethod
    def decode(encoded: Encoded[Motion], frames: slice | None = None) -> Motion:
        """The motion, or a slice of its frames. Raises Corrupt."""
        if not encoded.shared:
            return base.decode_gaps(encoded, frames)
        start, stop = encoded.range(frames)
        blend_frames, markers, max_error = read_shared(encoded)
        models, packed_gaps, residuals = read_segments(encoded.covering(start, stop), markers)
        up = encoded.about.up
        positions = np.empty((stop - start, markers.points, 3))
        for model, packed, residual in progress.over(list(zip(models, packed_gaps, residuals, strict=True))):
            first, last = max(model.start, start), min(model.stop, stop)
            if first >= last:
                continue
            out = positions[first - start : last - start]
            if not residual and not packed:
                reconstruct(models, markers, up, first, last, blend_frames, out)
                continue
            # Gaps and residual unpack only as a whole segment.
            decoded = reconstruct(models, markers, up, model.start, model.stop, blend_frames)
            if residual:
                decoded = bounded.unpack(residual, decoded, max_error, packed)
            out[...] = frozen.restore(decoded, packed)[first - model.start : last - model.start]
        return encodeds.restore(encoded, positions, start)


def _poses(positions: Floats, columns: Integers, frame: body_frame.BodyFrame) -> Floats:
    """Some points (columns,) of positions (frames, points, 3) in the body's frame, (frames, 3 columns)."""
    if (kernel := native.kernel("place_in_body")) is not None:
        return kernel(positions, columns, frame.origin, frame.heading, frame.up)
    return body_frame.to_body(positions[:, columns], frame).reshape(len(positions), -1)


def _place(poses: Floats, columns: Integers, frame: body_frame.BodyFrame, positions: Floats) -> None:
    """The inverse of `_poses`, into positions."""
    if (kernel := native.kernel("place_in_world")) is not None:
        kernel(poses, columns, frame.origin, frame.heading, frame.up, positions)
    else:
        positions[:, columns] = body_frame.to_world(poses.reshape(len(poses), -1, 3), frame)


def _smallest_within(max_error: float, to_mean: Callable[[float], Encoded[Motion]]) -> Encoded[Motion]:
    """The smallest of the encodings at some mean errors below and above the bound, metres. Raises CannotEncode."""
    best = to_mean(MEANS_PER_BOUND[0] * max_error)
    for times in MEANS_PER_BOUND[1:]:
        try:
            coarser = to_mean(times * max_error)
        except CannotEncode:
            break
        if coarser.payload_bytes >= best.payload_bytes:
            break
        best = coarser
    return best


def _pack_residual(
    original: Floats, prediction: Floats, max_error: float, known: lattice.Neighbours | None, packed_gaps: bytes
) -> bytes:
    """The residual layer of a segment, checked by decoding. Raises CannotEncode."""
    residual = bounded.pack(original, prediction, max_error, known)
    errors = metrics.distances(original, bounded.unpack(residual, prediction, max_error, packed_gaps))
    if not np.nanmax(errors, initial=0.0) <= max_error:
        raise CannotEncode(
            f"liu2006 cannot keep max_error={max_error:g} m: coordinates this large have no such precision in float64"
        )
    return residual


def reconstruct(
    models: Sequence[SegmentModel],
    markers: MarkerGroups,
    up: str,
    start: int,
    stop: int,
    blend_frames: int,
    out: Floats | None = None,
) -> Floats:
    """Positions (frames, points, 3) of frames [start, stop), in `out` if it is given: section 3.5.

    models: consecutive segments that cover these frames, and for the blend the segments next to them.
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
        for group, columns in enumerate(markers.pca_groups):
            poses = blended_poses(models, i, group, first, last, blend_frames)
            _place(poses, columns, frame, decoded)
    return positions


def blended_poses(
    models: Sequence[SegmentModel], i: int, group: int, start: int, stop: int, blend_frames: int
) -> Floats:
    """Poses (frames, dimensions) of frames [start, stop) within segment i: y_t = Σ wᵢ b_t,i, section 3.5.

    wᵢ = rᵢ / (h + 1), where rᵢ counts the frames of segment i among t − h/2 to t + h/2. At the ends of the motion this
    window has fewer frames, and wᵢ is rᵢ over their number.
    """
    poses = models[i].poses(group, start, stop)
    half = blend_frames // 2
    frames = np.arange(start, stop)
    window_start = np.maximum(frames - half, models[0].start)
    window_stop = np.minimum(frames + half + 1, models[-1].stop)
    for neighbour in (*models[max(i - 1, 0) : i], *models[i + 1 : i + 2]):
        first = max(start, neighbour.start - neighbour.before)
        last = min(stop, neighbour.stop + neighbour.after)
        if first >= last:
            continue
        overlap = slice(first - start, last - start)
        r = np.minimum(window_stop, neighbour.stop) - np.maximum(window_start, neighbour.start)
        weight = (np.maximum(r, 0) / (window_stop - window_start))[overlap, None]
        poses[overlap] += weight * (neighbour.poses(group, first, last) - models[i].poses(group, first, last))
    return poses


def steer(
    fit: Callable[[float], list[SegmentModel]], measure: Callable[[list[SegmentModel]], float], grows: bool
) -> list[SegmentModel]:
    """Search for the scale of the tolerances at which `measure` of the fitted models is largest, but at most 1.

    grows: the measure grows with the scale; False: it falls. Raises CannotEncode if it exceeds 1 at every scale tried.
    """

    def tried(log_scale: float) -> tuple[float, list[SegmentModel]]:
        fitted = fit(float(np.exp(log_scale)))
        return max(measure(fitted), 1e-6), fitted

    found = search.closest_within(
        progress.attempts(tried),
        0.0,
        rising=grows,
        stride=lambda log: min(abs(np.log(AIM) - log), 3.0) * (1 if grows else 2),
        farthest=FARTHEST,
        aim=AIM,
        near=NEAR_ENOUGH,
        margin=0.05,
        tries=ATTEMPTS,
        whole=False,
    )
    if found is None:
        raise CannotEncode("liu2006 cannot reach the target: ask for a larger error or a lower ratio")
    return found.result


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
