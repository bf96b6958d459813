"""What is kept of one segment, and its bytes. Liu & McMillan 2006, sections 3.3 to 3.5.

normalisation markers ──────────────────► key frames ──► Track
poses of a group ──PCA──► trajectories ──► key frames ──► PoseModel = mean, basis, Track
                                                          Segment = Track + a PoseModel for each group
Segment ──pack──► bytes ──unpack──► Segment
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...motion import Floats
from ...stages import basis, quantise, spline
from .roles import Roles

Integers = NDArray[np.int64]

TRIPLE = np.array([[1, 1, 1], [0, -1, 1], [-2, 1, 1]]) / np.sqrt([[3], [2], [6]])
"""Three markers as their middle, left to right, and origin to shoulders: orthonormal, so errors stay what they are."""

MARGIN = 1 << 16
"""No blend reaches farther into a neighbour, in frames."""


@dataclass(frozen=True, eq=False)
class Track:
    """Trajectories (frames, k) as key frames: numbers (keys, k) in steps of 2^(rung / 16), and what they decode to.

    Both are in the order of the key frames' levels.
    """

    keys: spline.Keyframes
    rung: int
    numbers: Integers
    values: Floats

    def at(self, start: int, stop: int) -> Floats:
        """The trajectories at frames [start, stop) of the run."""
        order = np.argsort(frames := self.keys.by_level)
        return spline.interpolate(frames[order], self.values[order], np.arange(start, stop))


@dataclass(frozen=True, eq=False)
class PoseModel:
    """Poses (frames, dimensions) of a group of markers: mean, principal components and the track of the projections.

    components: the basis before it was rounded to `precision`, which is what its bytes are made from.
    """

    mean_numbers: Integers
    mean: Floats
    components: Floats
    precision: Integers
    basis: Floats
    track: Track

    def at(self, start: int, stop: int) -> Floats:
        """The poses at frames [start, stop) of the run."""
        return self.track.at(start, stop) @ self.basis.T + self.mean


@dataclass(frozen=True, eq=False)
class Segment:
    """Frames [start, stop); its groups' models reach `before` and `after` frames into the neighbours, for the blend."""

    start: int
    stop: int
    before: int
    after: int
    markers: Track
    groups: tuple[PoseModel, ...]

    def normalisation(self, start: int, stop: int) -> Floats:
        """The normalisation markers (frames, markers, 3) at frames [start, stop) of the motion, within this segment."""
        return _untriple(self.markers.at(start - self.start, stop - self.start))

    def poses(self, group: int, start: int, stop: int) -> Floats:
        """A group's poses at frames [start, stop) of the motion, in the body's frame, within reach of this segment."""
        first = self.start - self.before
        return self.groups[group].at(start - first, stop - first)


# ── fitting ──────────────────────────────────────────────────────────────────────────────────────────────────────────


def keep_markers(markers: Floats, tolerance: float, fineness: float) -> Track:
    """The normalisation markers (frames, markers, 3) by key frames alone: section 3.4, last paragraph but one."""
    return _track(_triple(markers), tolerance, fineness)


def fit(poses: Floats, own: slice, pca_tolerance: float, spline_tolerance: float, fineness: float) -> PoseModel:
    """A model of the poses (frames, 3 × markers) of a segment and its margins; `own` are the segment's among them.

    pca_tolerance: what the discarded components may leave, metres, root mean square over frames and markers.
    spline_tolerance: how far the splines may be from the projections in any frame, metres, L2 norm. fineness: the
    quantiser's step as a share of that tolerance.
    """
    mean = poses[own].mean(axis=0)
    away = poses[own] - mean
    components, variances = basis.fit(away.T @ away / len(away))
    k = components_needed(variances, pca_tolerance, len(mean) // 3)
    components, variances = components[:, :k], variances[:k]

    keys = spline.keyframes((poses - mean) @ components, spline_tolerance)
    rung = quantise.rung(spline_tolerance * fineness)
    noise = _noise(rung, keys)
    mean_numbers = quantise.forward(mean, noise)
    mean = quantise.inverse(mean_numbers, noise)
    precision = np.maximum.accumulate(basis.precisions(variances, noise)[::-1])[::-1]
    rounded = basis.rounded(components, precision)

    wanted = (poses[keys.by_level] - mean) @ rounded
    numbers, values = spline.differences(keys, wanted, quantise.step(rung))
    return PoseModel(mean_numbers, mean, components, precision, rounded, Track(keys, rung, numbers, values))


def components_needed(variances: Floats, tolerance: float, markers: int) -> int:
    """The fewest leading components whose discarded rest is below the tolerance: √(Σ λ / markers), metres."""
    discarded = np.maximum(variances.sum() - np.append(0.0, np.cumsum(variances)), 0.0)
    discarded[-1] = 0.0
    return int(np.argmax(discarded <= tolerance**2 * markers))


def _track(trajectory: Floats, tolerance: float, fineness: float) -> Track:
    keys = spline.keyframes(trajectory, tolerance)
    rung = quantise.rung(tolerance * fineness)
    numbers, values = spline.differences(keys, trajectory[keys.by_level], quantise.step(rung))
    return Track(keys, rung, numbers, values)


def _noise(rung: int, keys: spline.Keyframes) -> float:
    """Δ/√(number of key frames): where one more bit for mean or basis buys as much as one more for all projections."""
    return quantise.step(rung) / len(keys) ** 0.5


def _triple(markers: Floats) -> Floats:
    turned = np.einsum("ij,fjc->fic", TRIPLE, markers) if markers.shape[1] == 3 else markers
    return turned.reshape(len(markers), -1)


def _untriple(trajectory: Floats) -> Floats:
    turned = trajectory.reshape(len(trajectory), -1, 3)
    return np.einsum("ji,fjc->fic", TRIPLE, turned) if turned.shape[1] == 3 else turned


# ── storing ──────────────────────────────────────────────────────────────────────────────────────────────────────────
#
# payload = lengths · head · splits · key values of the markers · means · then for each group: basis, key values ·
#           gaps · residual
# head    = before, after, rung of the markers, then for each group: rung, components, precision, its falls
# splits  = the bits that say where key frames are: markers, then each group


def pack(segment: Segment, gaps: bytes = b"", residual: bytes = b"") -> bytes:
    """The payload of a segment's chunk."""
    head = [segment.before, segment.after, varint.signed(segment.markers.rung)]
    tracks = [segment.markers, *(model.track for model in segment.groups)]
    sections = [coder.pack(segment.markers.numbers), coder.pack(_means(segment.groups))]
    for model in segment.groups:
        head += [varint.signed(model.track.rung), len(model.precision), *_falls(model.precision)]
        sections += [basis.pack(model.components, model.precision, _beside(model.mean_numbers))]
        sections += [coder.pack(model.track.numbers)]
    splits = np.packbits(np.concatenate([spline.splits(track.keys) for track in tracks])).tobytes()
    return join([varint.write(head), splits, *sections, gaps, residual])


def unpack(payload: bytes, start: int, stop: int, roles: Roles) -> tuple[Segment, bytes, bytes]:
    """A segment of frames [start, stop), and the bytes of its gaps and residual. Raises Corrupt."""
    widths = [3 * len(columns) for columns in roles.groups]
    head, splits, markers, means, *sections = split(payload, sections_of(roles))
    (before, after, rung), at = varint.read(head, 3)
    if before + after > 2 * MARGIN:
        raise Corrupt("liu2006: a segment that reaches farther than any blend")
    bits = np.unpackbits(np.frombuffer(splits, np.uint8))
    keys, used = spline.from_splits(bits, stop - start)
    track = _unpack_track(markers, keys, _rung(rung), 3 * len(roles.normalisation))

    mean_numbers = coder.unpack(means, (sum(widths) // 3, 3)).ravel()
    models: list[PoseModel] = []
    for width, packed_basis, packed_values in zip(widths, sections[:-2:2], sections[1:-2:2], strict=True):
        (rung, k), at = varint.read(head, 2, at)
        falls, at = varint.read(head, min(k, width + 1), at)
        precision = _rise(falls)
        keys, more = spline.from_splits(bits[used:], before + stop - start + after)
        used += more
        own, mean_numbers = mean_numbers[:width], mean_numbers[width:]
        components = basis.unpack(packed_basis, width, precision, _beside(own))
        mean = quantise.inverse(own, _noise(_rung(rung), keys))
        values = _unpack_track(packed_values, keys, _rung(rung), k)
        models.append(PoseModel(own, mean, components, precision, components, values))
    return Segment(start, stop, before, after, track, tuple(models)), sections[-2], sections[-1]


def sections_of(roles: Roles) -> int:
    """How many sections a payload has."""
    return 6 + 2 * len(roles.groups)


def _means(groups: Sequence[PoseModel]) -> Integers:
    return np.concatenate([np.zeros(0, np.int64), *(model.mean_numbers for model in groups)]).reshape(-1, 3)


def _beside(mean_numbers: Integers) -> Integers:
    """For each coordinate the same one of the nearest earlier marker of the mean pose, which will move much alike."""
    pose = mean_numbers.reshape(-1, 3)
    apart = ((pose[:, None] - pose) ** 2).sum(axis=-1)
    apart[np.triu_indices(len(pose))] = np.iinfo(np.int64).max
    beside = 3 * apart.argmin(axis=1)[:, None] + np.arange(3)
    beside[0] = -1
    return beside.ravel()


def _unpack_track(data: bytes, keys: spline.Keyframes, rung: int, k: int) -> Track:
    numbers = coder.unpack(data, (len(keys), k))
    return Track(keys, rung, numbers, spline.values(keys, numbers, quantise.step(rung)))


def _falls(precision: Integers) -> list[int]:
    """Precisions never rise from a component to the next: the first, then how far each falls."""
    return [int(p) for p in precision[:1]] + [int(p) for p in -np.diff(precision)]


def _rise(falls: list[int]) -> Integers:
    precision = np.cumsum([*falls[:1], *(-f for f in falls[1:])], dtype=np.int64)
    if len(precision) and not (precision.min() >= 0 and precision.max() <= basis.FINEST):
        raise Corrupt("liu2006: a precision that no basis has")
    return precision


def _rung(folded: int) -> int:
    rung = varint.unsigned(folded)
    if abs(rung) > 60 * quantise.LADDER:
        raise Corrupt("liu2006: a step outside the ladder")
    return rung


def join(sections: Sequence[bytes]) -> bytes:
    """Sections one behind the other; first the lengths of all but the last."""
    return varint.write(map(len, sections[:-1])) + b"".join(sections)


def split(data: bytes, count: int) -> list[bytes]:
    """The `count` sections of `join`. Raises Corrupt."""
    lengths, at = varint.read(data, count - 1)
    ends = [at + sum(lengths[:i]) for i in range(count)]
    if ends[-1] > len(data):
        raise Corrupt("liu2006: a segment is cut short")
    return [data[a:b] for a, b in zip(ends, [*ends[1:], len(data)], strict=True)]
