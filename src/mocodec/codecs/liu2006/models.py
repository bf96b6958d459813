"""What is kept of one segment, and its bytes. Liu & McMillan 2006, sections 3.3 to 3.5.

normalisation markers ──────────────────► key frames ──► Track
poses of a group ──PCA──► trajectories ──► key frames ──► PoseModel = mean, basis, Track
                                                          Segment = Track + a PoseModel for each group
Segment ──pack──► bytes ──unpack──► Segment
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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

LANES = 8

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
    """Poses (frames, dimensions) of a group of markers: mean, principal components and the track of the projections."""

    mean_numbers: Integers
    mean: Floats
    precision: Integers
    packed_basis: bytes
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
    packed = basis.pack(components, precision)
    components = basis.unpack(packed, len(mean), precision)

    wanted = (poses[keys.by_level] - mean) @ components
    numbers, values = spline.differences(keys, wanted, quantise.step(rung))
    return PoseModel(mean_numbers, mean, precision, packed, components, Track(keys, rung, numbers, values))


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
# payload = lengths · head · splits · numbers · one basis for each group · gaps · residual
# head    = before, after, rung of the markers, then for each group: rung, components, precision, its falls
# splits  = the bits that say where key frames are: markers, then each group
# numbers = key values of the markers, then for each group: mean, key values


def pack(segment: Segment, gaps: bytes = b"", residual: bytes = b"") -> bytes:
    """The payload of a segment's chunk."""
    head = [segment.before, segment.after, varint.signed(segment.markers.rung)]
    for model in segment.groups:
        head += [varint.signed(model.track.rung), len(model.precision), *_falls(model.precision)]
    tracks = [segment.markers, *(model.track for model in segment.groups)]
    splits = np.packbits(np.concatenate([spline.splits(track.keys) for track in tracks])).tobytes()
    numbers = [segment.markers.numbers.ravel()]
    for model in segment.groups:
        numbers += [model.mean_numbers, model.track.numbers.ravel()]
    contexts = _contexts(tracks, [len(model.mean) for model in segment.groups])
    values = np.zeros(contexts.shape, np.int64)
    flat = np.concatenate(numbers)
    values.flat[: len(flat)] = flat
    bases = [model.packed_basis for model in segment.groups]
    return join([varint.write(head), splits, coder.pack(values, contexts), *bases, gaps, residual])


def unpack(payload: bytes, start: int, stop: int, roles: Roles) -> tuple[Segment, bytes, bytes]:
    """A segment of frames [start, stop), and the bytes of its gaps and residual. Raises Corrupt."""
    groups = roles.groups
    packed_head, packed_splits, packed_numbers, *bases, gaps, residual = split(payload, 5 + len(groups))
    (before, after, rung), at = varint.read(packed_head, 3)
    rung = _rung(rung)
    if before + after > 2 * MARGIN:
        raise Corrupt("liu2006: a segment that reaches farther than any blend")
    shapes: list[tuple[int, Integers]] = []
    for columns in groups:
        (group_rung, k), at = varint.read(packed_head, 2, at)
        if k > 3 * len(columns):
            raise Corrupt(f"liu2006: {k} components of {3 * len(columns)} coordinates")
        falls, at = varint.read(packed_head, k, at)
        shapes.append((_rung(group_rung), _rise(falls)))

    bits = np.unpackbits(np.frombuffer(packed_splits, np.uint8))
    keys: list[spline.Keyframes] = []
    for frames in (stop - start, *[before + stop - start + after] * len(groups)):
        found, used = spline.from_splits(bits, frames)
        keys.append(found)
        bits = bits[used:]

    width = 3 * len(roles.normalisation)
    tracks = [Track(keys[0], rung, np.zeros((len(keys[0]), width), np.int64), np.zeros(0))]
    for (rung, precision), found in zip(shapes, keys[1:], strict=True):
        tracks.append(Track(found, rung, np.zeros((len(found), len(precision)), np.int64), np.zeros(0)))
    contexts = _contexts(tracks, [3 * len(group) for group in groups])
    flat = coder.unpack(packed_numbers, contexts.shape, contexts).ravel()

    def take(shape: tuple[int, ...]) -> Integers:
        nonlocal flat
        taken, flat = flat[: (size := int(np.prod(shape)))].reshape(shape), flat[size:]
        return taken

    markers = _restored(tracks[0], take)
    models: list[PoseModel] = []
    for columns, (rung, precision), packed, track in zip(groups, shapes, bases, tracks[1:], strict=True):
        mean_numbers = take((3 * len(columns),))
        mean = quantise.inverse(mean_numbers, _noise(rung, track.keys))
        components = basis.unpack(packed, len(mean), precision)
        models.append(PoseModel(mean_numbers, mean, precision, packed, components, _restored(track, take)))
    return Segment(start, stop, before, after, markers, tuple(models)), gaps, residual


def _restored(track: Track, take: Callable[[tuple[int, ...]], Integers]) -> Track:
    numbers = take(track.numbers.shape)
    return Track(track.keys, track.rung, numbers, spline.values(track.keys, numbers, quantise.step(track.rung)))


def _contexts(tracks: Sequence[Track], means: Sequence[int]) -> Integers:
    """A context for each number, (steps, LANES): which track and how early a level, or a mean."""
    kinds: list[Integers] = []
    for i, track in enumerate(tracks):
        if i:
            kinds.append(np.zeros(means[i - 1], np.int64))
        level = np.repeat(np.arange(len(track.keys.levels)), [len(level) for level in track.keys.levels])
        kind = 1 + 4 * min(i, 2) + np.minimum(level, 3)
        kinds.append(np.repeat(kind, track.numbers.shape[1]))
    flat = np.concatenate(kinds)
    return np.append(flat, np.zeros(-len(flat) % LANES, np.int64)).reshape(-1, LANES)


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
