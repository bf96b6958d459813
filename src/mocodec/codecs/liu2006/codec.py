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
from ... import metrics, progress
from ...encoded import Chunk, Encoded, most_chunk_frames
from ...entropy import varint
from ...errors import BadInput, CannotEncode
from ...geometry import body_frame
from ...motion import Motion
from ...stages import bounded, frozen, gaps, lattice, search, segment
from ...typing import Floats
from .. import base, rescue
from . import body_poses, decoding, marker_groups, segment_model
from .marker_groups import MarkerGroups
from .segment_model import PrincipalComponents, SegmentModel

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
NEAR_ENOUGH = 0.985
AIM = 0.995
CLOSE = 0.01
FARTHEST = 25.0
"""The search for a target: most attempts, the measure that ends it, the measure that it aims at, the distance of two
logarithms of scales, one on either side of the target, that ends it (errors jump where a component is left out), and
the largest change of a logarithm."""

NEAR_BY = 1.25
"""Scales that differ by less than this factor share their principal components."""

USUAL_MEAN_M = 0.028
"""A usual mean error at the paper's tolerances, metres: errors are nearly proportional to their scale."""

Fit = Callable[[float], list[SegmentModel]]
"""The models of all segments at a scale of the tolerances."""
Components = list[list[PrincipalComponents]]
"""The principal components of each segment and PCA group."""


@dataclass(frozen=True)
class Liu2006:
    """Settings of liu2006: segments, PCA and key frames (Liu & McMillan 2006), with the paper's values as defaults.

    Lengths are in metres, durations in frames.

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

        def fitting() -> Fit:
            return self._fitting(positions, markers, segments, motion.up)

        known = lattice.neighbours(positions) if self.max_error is not None and lattice.is_fast() else None

        def encoded(models: list[SegmentModel]) -> Encoded[Motion]:
            return self._encode_models(motion, models, markers, apart, known)

        def mean_error(models: list[SegmentModel]) -> float:
            decoded = decoding.reconstruct(models, markers, motion.up, 0, len(motion), self.blend_frames)
            return apart.mean_error(decoded)

        if self.ratio is not None:
            allowed = motion.raw_bytes / self.ratio
            return encoded(steer(fitting(), lambda models: encoded(models).payload_bytes / allowed, 1.0, grows=False))

        def to_mean(target: float) -> Encoded[Motion]:
            first = target / USUAL_MEAN_M
            return encoded(steer(fitting(), lambda models: mean_error(models) / target, first, grows=True))

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
        if self.max_error is not None:
            return _smallest_within(self.max_error, to_mean)
        return encoded(self.fit_segments(positions, markers, segments, motion.up, 1.0))

    def segment_motion(self, positions: Floats, markers: MarkerGroups, up: str) -> segment.Segmentation:
        """Normalise, and cut where the distribution of poses changes: sections 3.1 and 3.2."""
        rest = np.concatenate([*markers.pca_groups, np.zeros(0, np.int64)])
        longest = most_chunk_frames(markers.points)
        if not len(rest):
            return segment.Segmentation(segment.equal_length(len(positions), longest), [])
        frame = body_frame.from_markers(positions[:, markers.normalisation], up)
        poses = body_poses.to_body(positions, rest, frame)
        found = segment.ppca(
            poses, self.initial_frames, self.ahead_frames, self.step_frames, self.variance_kept, self.rise
        )
        return segment.Segmentation(segment.no_longer_than(found.segments, longest), found.curves)

    def _fitting(self, positions: Floats, markers: MarkerGroups, segments: Sequence[slice], up: str) -> Fit:
        """`fit_segments` at any scale. The principal components are those of the poses at a scale near by, if there was
        one before: poses depend on the scale only by the errors of the normalisation markers."""
        components, scale_of_components = Components(), np.inf

        def fit(scale: float) -> list[SegmentModel]:
            nonlocal components, scale_of_components
            models, poses = self._normalised(positions, markers, segments, up, scale)
            if not 1 / NEAR_BY < scale / scale_of_components < NEAR_BY:
                components = [[segment_model.principal_components(group[one]) for group in poses] for one in segments]
                scale_of_components = scale
            return self._fit_models(models, poses, components, markers, scale)

        return fit

    def fit_segments(
        self, positions: Floats, markers: MarkerGroups, segments: Sequence[slice], up: str, scale: float
    ) -> list[SegmentModel]:
        """Key frames and PCA models of every segment, with all tolerances times `scale`: sections 3.3 and 3.4."""
        return self._fitting(positions, markers, segments, up)(scale)

    def _normalised(
        self, positions: Floats, markers: MarkerGroups, segments: Sequence[slice], up: str, scale: float
    ) -> tuple[list[SegmentModel], list[Floats]]:
        """Models of the normalisation markers alone, and the poses (frames, dimensions) of each PCA group.

        Departure from the paper: poses are normalised by the decoded normalisation markers, not the captured ones, so
        errors of these markers do not turn the body. See docs/papers/liu2006.md.
        """
        captured = positions[:, markers.normalisation]
        tolerance = scale * self.normalisation_tolerance * captured.shape[1]
        models = [
            SegmentModel(
                one.start,
                one.stop,
                before=0,
                after=0,
                markers=segment_model.fit_normalisation_markers(captured[one], tolerance, self._fineness),
                groups=(),
            )
            for one in segments
        ]
        if not markers.pca_groups:
            return models, []
        decoded = np.concatenate([model.normalisation(model.start, model.stop) for model in models])
        frame = body_frame.from_markers(decoded, up)
        return models, [body_poses.to_body(positions, columns, frame) for columns in markers.pca_groups]

    def _fit_models(
        self,
        models: list[SegmentModel],
        poses: list[Floats],
        components: Components,
        markers: MarkerGroups,
        scale: float,
    ) -> list[SegmentModel]:
        """`models` with a PCA model of each group, from `_normalised`. components: of each segment and group."""
        if not poses:
            return models
        return [
            self._fit_groups(model, poses, of_segment, markers, scale)
            for model, of_segment in progress.over(list(zip(models, components, strict=True)))
        ]

    @property
    def _fineness(self) -> float:
        has_target = self.max_error or self.mean_error or self.ratio
        return self.fineness or (FINENESS_WITH_TARGET if has_target else FINENESS)

    def _fit_groups(
        self,
        model: SegmentModel,
        group_poses: list[Floats],
        components: Sequence[PrincipalComponents],
        markers: MarkerGroups,
        scale: float,
    ) -> SegmentModel:
        """`model` with a PCA model of each group, which reaches half a blend into the neighbouring segments."""
        margin = self.blend_frames // 2
        first, last = max(model.start - margin, 0), min(model.stop + margin, len(group_poses[0]))
        own = slice(model.start - first, model.stop - first)
        fitted = [
            segment_model.fit_poses(
                poses[first:last],
                own,
                known,
                pca_tolerance=scale * (self.foot_tolerance if columns is markers.feet else self.pca_tolerance),
                spline_tolerance=scale * self.spline_tolerance * len(columns),
                fineness=self._fineness,
            )
            for columns, poses, known in zip(markers.pca_groups, group_poses, components, strict=True)
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
                prediction = decoding.reconstruct(
                    neighbours, markers, motion.up, model.start, model.stop, self.blend_frames, by_numpy=True
                )
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
        return decoding.decode(encoded, frames)


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


def steer(
    fit: Fit,
    measure: Callable[[list[SegmentModel]], float],
    first: float,
    grows: bool,
) -> list[SegmentModel]:
    """Search for the scale of the tolerances at which `measure` of the fitted models is largest, but at most 1.

    first: the scale to begin with. grows: the measure grows with the scale; False: it falls. Raises CannotEncode if it
    exceeds 1 at every scale tried.
    """

    def tried(log_scale: float) -> tuple[float, list[SegmentModel]]:
        fitted = fit(float(np.exp(log_scale)))
        return max(measure(fitted), 1e-6), fitted

    found = search.closest_within(
        progress.attempts(tried),
        float(np.log(first)),
        rising=grows,
        stride=lambda log: min(abs(np.log(AIM) - log), 3.0) * (1 if grows else 2),
        farthest=FARTHEST,
        aim=AIM,
        near=NEAR_ENOUGH,
        margin=0.05,
        tries=ATTEMPTS,
        whole=False,
        close=CLOSE,
    )
    if found is None:
        raise CannotEncode("liu2006 cannot reach the target: ask for a larger error or a lower ratio")
    return found.result
