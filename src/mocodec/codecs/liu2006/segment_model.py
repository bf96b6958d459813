"""The model of one segment, and its bytes. Liu & McMillan 2006, sections 3.3 to 3.5.

normalisation markers ───────────────────► key frames ──► KeyframeTrack
poses of a PCA group ──PCA──► projections ──► key frames ──► PcaModel = mean, basis, KeyframeTrack
KeyframeTrack of the normalisation markers, a PcaModel for each group = SegmentModel ◄──pack, unpack──► bytes
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from ... import native
from ...entropy import coder, varint
from ...errors import Corrupt
from ...geometry import body_frame
from ...stages import basis, quantise, spline
from ...typing import Floats, Integers
from .marker_groups import MarkerGroups

TRIPLE_ROTATION = np.array([[1, 1, 1], [0, -1, 1], [-2, 1, 1]]) / np.sqrt([[3], [2], [6]])
"""Orthonormal transform of the markers (origin, left, right): centroid, left to right, origin to shoulders."""

TRIPLE_OF_COORDINATES = np.kron(TRIPLE_ROTATION, np.eye(3))

LARGEST_BLEND_MARGIN = 1 << 16
DISTANCES_AT_A_TIME = 1 << 20
"""Frames that a segment's models reach into a neighbour at most."""

LARGEST_RUNG = 60 * quantise.LADDER
"""Limit for every rung in a file: 60 octaves of the ladder of steps."""


@dataclass(frozen=True, eq=False)
class KeyframeTrack:
    """Trajectories (frames, k) as values at key frames.

    numbers (keys, k): integers that `spline.differences` makes of the values, in steps of 2^(rung / 64). values (keys,
    k): the decoded values. Both in the order of the key frames' levels.
    """

    keys: spline.Keyframes
    rung: int
    numbers: Integers
    values: Floats

    def at(self, start: int, stop: int) -> Floats:
        """The trajectories at frames [start, stop), counted from the track's first frame: (frames, k)."""
        if self.compiled is not None:
            return self.compiled.at(start, stop)
        return spline.interpolate(*self._by_frame, np.arange(start, stop))

    @cached_property
    def compiled(self) -> Any:
        """The spline of the compiled module, None without."""
        kernel = native.kernel("TrackSpline")
        return None if kernel is None else kernel(self.keys.by_level, self.values)

    @cached_property
    def _by_frame(self) -> tuple[Integers, Floats]:
        """The key frames, ascending, and their values."""
        order = self.keys.order
        return self.keys.by_level[order], self.values[order]


@dataclass(frozen=True, eq=False)
class PcaModel:
    """Poses (frames, dimensions) of one PCA group: mean, principal components, and the track of the projections.

    mean_numbers: the mean as integers. components: the exact basis, from which `pack` makes the bytes. precision,
    basis: the rounding of each component, and the rounded basis that the decoder gets.
    """

    mean_numbers: Integers
    mean: Floats
    components: Floats
    precision: Integers
    basis: Floats
    track: KeyframeTrack

    def at(self, start: int, stop: int) -> Floats:
        """The poses at frames [start, stop), counted from the track's first frame: (frames, dimensions)."""
        poses = self.track.at(start, stop) @ self.basis.T
        poses += self.mean
        return poses

    def place(self, start: int, columns: Integers, frame: body_frame.BodyFrame, positions: Floats) -> bool:
        """Poses from frame `start` of the track on into these columns of positions (frames, points, 3), in one compiled
        call; False without the compiled module."""
        if self.compiled is None:
            return False
        self.compiled.place(start, columns, frame.origin, frame.heading, frame.up, positions)
        return True

    @cached_property
    def compiled(self) -> Any:
        """The poses of the compiled module, None without."""
        kernel = native.kernel("PoseSpline")
        return None if kernel is None else kernel(self.track.keys.by_level, self.track.values, self.basis, self.mean)


@dataclass(frozen=True, eq=False)
class SegmentModel:
    """Frames [start, stop) of the motion.

    before, after: frames that the PCA models reach into the neighbouring segments, for the blend. markers: the
    normalisation markers. groups: a model for each PCA group.
    """

    start: int
    stop: int
    before: int
    after: int
    markers: KeyframeTrack
    groups: tuple[PcaModel, ...]

    def normalisation(self, start: int, stop: int) -> Floats:
        """The normalisation markers (frames, markers, 3) at frames [start, stop) of the motion, within this segment."""
        return _from_trajectories(self.markers.at(start - self.start, stop - self.start))

    def poses(self, group: int, start: int, stop: int) -> Floats:
        """Poses (frames, dimensions) of a PCA group in the body frame, at frames [start, stop) of the motion.

        The frames may extend `before` and `after` frames beyond the segment.
        """
        first = self.start - self.before
        return self.groups[group].at(start - first, stop - first)


# ── fitting ──────────────────────────────────────────────────────────────────────────────────────────────────────────


def fit_normalisation_markers(markers: Floats, tolerance: float, fineness: float) -> KeyframeTrack:
    """Key frames of the normalisation markers (frames, markers, 3), without PCA: section 3.4."""
    trajectories = _to_trajectories(markers)
    keys = spline.keyframes(trajectories, tolerance)
    rung = quantise.rung(tolerance * fineness)
    numbers, values = spline.differences(keys, trajectories[keys.by_level], quantise.step(rung))
    return KeyframeTrack(keys, rung, numbers, values)


class PrincipalComponents(NamedTuple):
    """Principal components of poses: vectors (dimensions, dimensions), strongest first; variances (dimensions,)."""

    vectors: Floats
    variances: Floats


def principal_components(poses: Floats) -> PrincipalComponents:
    """The principal components of poses (frames, dimensions): section 3.3."""
    centred = poses - poses.mean(axis=0)
    return PrincipalComponents(*basis.fit(centred.T @ centred / len(centred)))


def fit_poses(
    poses: Floats,
    own: slice,
    components: PrincipalComponents,
    pca_tolerance: float,
    spline_tolerance: float,
    fineness: float,
) -> PcaModel:
    """PCA and key frames of one group: sections 3.3 and 3.4.

    poses (frames, 3 × markers): those of a segment and its blend margins, metres; `own` selects the segment's frames.
    pca_tolerance: largest error of the discarded components, metres, root mean square over frames and markers.
    spline_tolerance: largest error of the interpolated projections in any frame, metres, L2 norm. fineness: the
    quantisation step as a fraction of spline_tolerance. components: of these poses, or of almost the same.
    """
    mean = poses[own].mean(axis=0)
    vectors, variances = components
    k = components_needed(variances, pca_tolerance, len(mean) // 3)
    vectors, variances = vectors[:, :k], variances[:k]

    keys = spline.keyframes((poses - mean) @ vectors, spline_tolerance)
    rung = quantise.rung(spline_tolerance * fineness)
    model_step = _model_step(rung, keys)
    mean_numbers = quantise.forward(mean, model_step)
    mean = quantise.inverse(mean_numbers, model_step)
    precision = np.maximum.accumulate(basis.precisions(variances, model_step)[::-1])[::-1]
    rounded = basis.rounded(vectors, precision)

    projections = (poses[keys.by_level] - mean) @ rounded
    numbers, values = spline.differences(keys, projections, quantise.step(rung))
    return PcaModel(mean_numbers, mean, vectors, precision, rounded, KeyframeTrack(keys, rung, numbers, values))


def components_needed(variances: Floats, tolerance: float, markers: int) -> int:
    """Smallest number of leading components with √(Σ discarded λ / markers) ≤ tolerance, metres: section 3.3."""
    discarded = np.maximum(variances.sum() - np.append(0.0, np.cumsum(variances)), 0.0)
    discarded[-1] = 0.0
    return int(np.argmax(discarded <= tolerance**2 * markers))


def _model_step(rung: int, keys: spline.Keyframes) -> float:
    """Quantisation step of mean and basis: Δ / √(number of key frames).

    At this step one more bit for the mean or the basis reduces the error as much as one more bit for all projections.
    """
    return quantise.step(rung) / len(keys) ** 0.5


def _to_trajectories(markers: Floats) -> Floats:
    """(frames, markers, 3) → (frames, 3 × markers), transformed by TRIPLE_ROTATION if there are three markers."""
    flat = markers.reshape(len(markers), -1)
    return flat @ TRIPLE_OF_COORDINATES.T if markers.shape[1] == 3 else flat


def _from_trajectories(trajectories: Floats) -> Floats:
    """The inverse of `_to_trajectories`."""
    if trajectories.shape[1] == len(TRIPLE_OF_COORDINATES):
        trajectories = trajectories @ TRIPLE_OF_COORDINATES
    return trajectories.reshape(len(trajectories), -1, 3)


# ── storing ──────────────────────────────────────────────────────────────────────────────────────────────────────────
#
# payload = section lengths · head · splits · key values of the normalisation markers · means ·
#           then for each PCA group: basis, key values · gaps · residual
# head    = before, after, rung of the markers, then for each PCA group: rung, components, first precision, its drops
# splits  = the bits that define the key frames (`spline.splits`): normalisation markers, then each PCA group


def pack(segment: SegmentModel, gaps: bytes = b"", residual: bytes = b"") -> bytes:
    """The payload of a segment's chunk."""
    head = [segment.before, segment.after, varint.signed(segment.markers.rung)]
    tracks = [segment.markers, *(model.track for model in segment.groups)]
    sections = [coder.pack(segment.markers.numbers), coder.pack(_means(segment.groups))]
    for model in segment.groups:
        head += [varint.signed(model.track.rung), len(model.precision), *_precision_drops(model.precision)]
        sections += [basis.pack(model.components, model.precision, _nearest_marker(model.mean_numbers))]
        sections += [coder.pack(model.track.numbers)]
    splits = np.packbits(np.concatenate([spline.splits(track.keys) for track in tracks])).tobytes()
    return join_sections([varint.write(head), splits, *sections, gaps, residual])


def unpack(payload: bytes, start: int, stop: int, markers: MarkerGroups) -> tuple[SegmentModel, bytes, bytes]:
    """The model of frames [start, stop), and the bytes of its gaps and residual. Raises Corrupt."""
    widths = [3 * len(columns) for columns in markers.pca_groups]
    head, splits, marker_values, means, *sections = split_sections(payload, section_count(markers))
    (before, after, rung), at = varint.read(head, 3)
    if before + after > 2 * LARGEST_BLEND_MARGIN:
        raise Corrupt(f"liu2006: a segment reaches {before + after} frames into its neighbours, more than is allowed")
    bits = np.unpackbits(np.frombuffer(splits, np.uint8))
    keys, used = spline.from_splits(bits, stop - start)
    track = _unpack_track(marker_values, keys, _read_rung(rung), 3 * len(markers.normalisation))

    mean_numbers = coder.unpack(means, (sum(widths) // 3, 3)).ravel()
    models: list[PcaModel] = []
    for width, packed_basis, packed_values in zip(widths, sections[:-2:2], sections[1:-2:2], strict=True):
        (rung, k), at = varint.read(head, 2, at)
        drops, at = varint.read(head, min(k, width + 1), at)
        precision = _precision_from_drops(drops)
        keys, key_bits = spline.from_splits(bits[used:], before + stop - start + after)
        used += key_bits
        own_numbers, mean_numbers = mean_numbers[:width], mean_numbers[width:]
        components = basis.unpack(packed_basis, width, precision, _nearest_marker(own_numbers))
        mean = quantise.inverse(own_numbers, _model_step(_read_rung(rung), keys))
        values = _unpack_track(packed_values, keys, _read_rung(rung), k)
        models.append(PcaModel(own_numbers, mean, components, precision, components, values))
    if len(bits) - used >= 8 or bits[used:].any() or at != len(head):
        raise Corrupt("liu2006: a segment with bits behind its key frames, or numbers behind its head")
    return SegmentModel(start, stop, before, after, track, tuple(models)), sections[-2], sections[-1]


def section_count(markers: MarkerGroups) -> int:
    """Number of sections of a payload."""
    return 6 + 2 * len(markers.pca_groups)


def join_sections(sections: Sequence[bytes]) -> bytes:
    """The lengths of all sections but the last, then the sections."""
    return varint.write(map(len, sections[:-1])) + b"".join(sections)


def split_sections(data: bytes, count: int) -> list[bytes]:
    """The inverse of `join_sections`, for `count` sections. Raises Corrupt."""
    lengths, at = varint.read(data, count - 1)
    ends = [at + sum(lengths[:i]) for i in range(count)]
    if ends[-1] > len(data):
        raise Corrupt(f"liu2006: the payload of a segment has {len(data)} bytes, but its sections need {ends[-1]}")
    return [data[a:b] for a, b in zip(ends, [*ends[1:], len(data)], strict=True)]


def _means(groups: Sequence[PcaModel]) -> Integers:
    return np.concatenate([np.zeros(0, np.int64), *(model.mean_numbers for model in groups)]).reshape(-1, 3)


def _nearest_marker(mean_numbers: Integers) -> Integers:
    """Row that predicts each row of a basis: the same coordinate of the nearest earlier marker in the mean pose.

    Markers near each other move alike. −1 for the first marker.
    """
    pose = mean_numbers.reshape(-1, 3)
    if (kernel := native.kernel("nearest_earlier")) is not None:
        return _rows_of_marker(kernel(pose))
    nearest = np.zeros(len(pose), np.int64)
    rows = max(1, DISTANCES_AT_A_TIME // max(len(pose), 1))
    for first in range(0, len(pose), rows):
        some = pose[first : first + rows]
        squared_distances = ((some[:, None] - pose[: first + len(some)]) ** 2).sum(axis=-1)
        squared_distances[np.triu_indices(len(some), first, first + len(some))] = np.iinfo(np.int64).max
        nearest[first : first + rows] = squared_distances.argmin(axis=1)
    return _rows_of_marker(nearest)


def _rows_of_marker(nearest: Integers) -> Integers:
    """The rows of each marker's coordinates in a basis, (3 markers,); −1 for the first marker."""
    predictors = 3 * nearest[:, None] + np.arange(3)
    predictors[0] = -1
    return predictors.ravel()


def _unpack_track(data: bytes, keys: spline.Keyframes, rung: int, k: int) -> KeyframeTrack:
    numbers = coder.unpack(data, (len(keys), k))
    return KeyframeTrack(keys, rung, numbers, spline.values(keys, numbers, quantise.step(rung)))


def _precision_drops(precision: Integers) -> list[int]:
    """The first precision, then how much it drops from each component to the next. Precisions never rise."""
    return [int(p) for p in precision[:1]] + [int(p) for p in -np.diff(precision)]


def _precision_from_drops(drops: list[int]) -> Integers:
    """The inverse of `_precision_drops`. Raises Corrupt."""
    precision = list(accumulate(drops, operator.sub))
    if precision and not (precision[-1] >= 0 and precision[0] <= basis.FINEST):  # they never rise
        raise Corrupt(f"liu2006: a basis has a precision outside 0 to {basis.FINEST}")
    return np.array(precision, np.int64)


def _read_rung(stored: int) -> int:
    """The rung of a stored varint. Raises Corrupt."""
    rung = varint.unsigned(stored)
    if abs(rung) > LARGEST_RUNG:
        raise Corrupt(f"liu2006: the rung {rung} is outside ±{LARGEST_RUNG}")
    return rung
