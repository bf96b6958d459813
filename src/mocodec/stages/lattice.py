"""The lattice engine: samples predicted from decoded ones, under a hard bound; residuals on a lattice for a ball.

    positions ─coarse frames first, then the frames between─► prediction from the point's own frames and its neighbours'
        residual ─nearest or cheapest lattice point within the bound─► integers ─adaptive bits─► bytes

A bound is a ball about each sample. Of all lattices in space, the body-centred cubic one covers it by the fewest balls
(Conway and Sloane, Sphere packings, lattices and groups, chapter 2): with rounding of each coordinate a sample costs
0.9 bit more. A residual in half steps has three even or three odd coordinates; every sample of a chunk is within √5 / 2
half steps of a lattice point. The prediction is by recursive least squares, so nothing about it is stored but which
points are neighbours. The transform wins where motion is smooth against the bound or a prior fits; this engine where
markers are noisy and the bound is fine.

`lattice_chunk` and `lattice_points` define the result; the compiled module has the same in
`lattice.h`, the same floats in the same order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..entropy import adaptive_bits, coder, varint
from ..errors import Corrupt
from ..typing import Booleans, Floats, Integers
from . import lattice_chunk
from .lattice_chunk import NEIGHBOURS

STRIDES, USUAL_STRIDE = range(5), 2
"""log₂ of the distances between the first frames that an encoder tries, and the one that it begins with."""
LEAST_BITS_OF_SHORT = 4
"""Where a sample takes more bits, short strides suit it: samples far away in time predict less than the noise hides."""
LARGEST_STRIDE, SPIKED = 6, 128
"""The first byte of a chunk holds the stride, at most LARGEST_STRIDE, and SPIKED if spikes are stored apart."""
SAMPLED_FRAMES = 200
"""Frames that neighbours are chosen by."""
CANDIDATES, MANY_POINTS, CANDIDATES_OF_MANY = 64, 128, 24
"""This many of the nearest points are considered as neighbours of each; fewer of many points, which lie closer."""
DISTANCES_TOGETHER = 1 << 22
"""Number of distances between points that are in memory together."""
LEAST_DISTANCE_M = 0.005
"""Points nearer than this to each other have no direction from one to the other."""

ESTIMATE_OF_BITS, ESTIMATE_OF_SAMPLE = 1.45, 0.045
"""`estimate`: bytes for each byte of the logarithms of its residuals, and for each sample; fitted to joints at 3 and
5 mm."""


def is_fast() -> bool:
    """Whether encoders use the engine: without the compiled module it takes minutes."""
    return native.kernel("tempo_lattice_encode") is not None


def half_step(bound: float) -> float:
    """Half the lattice's step whose every cell lies within the bound of its centre, with room for rounding."""
    return bound * 2 / 5**0.5 * (1 - 1e-9)


@dataclass(frozen=True, eq=False)
class Neighbours:
    """For each point up to three that are coded before it, (points, 3), −1 for none; the first is its partner."""

    table: NDArray[np.int32]

    @cached_property
    def sequence(self) -> NDArray[np.int32]:
        """The points (points,), each after its neighbours. Raises Corrupt where there is no such order."""
        found: list[int] = []
        placed = np.zeros(len(self.table) + 1, bool)
        placed[-1] = True  # index −1: no neighbour
        left = np.arange(len(self.table))
        while len(left):
            ready = placed[self.table[left]].all(axis=1)
            if not ready.any():
                raise Corrupt("lattice: neighbours that form a circle")
            found += left[ready].tolist()
            placed[left[ready]] = True
            left = left[~ready]
        return np.array(found, np.int32)

    def pack(self) -> bytes:
        """Each neighbour as the number of its point less the neighbour's, 0 for none."""
        own = np.arange(len(self.table))[:, None]
        return coder.pack(np.where(self.table < 0, 0, own - self.table).astype(np.int64))

    @classmethod
    def unpack(cls, data: bytes, points: int) -> Neighbours:
        """Raises Corrupt."""
        less = coder.unpack(data, (points, NEIGHBOURS))
        own = np.arange(points)[:, None]
        table = np.where(less == 0, -1, own - less)
        known = table >= 0
        if ((table < 0) & (less != 0)).any() or (table >= points).any() or (known[:, 1:] & ~known[:, :-1]).any():
            raise Corrupt("lattice: neighbours that are out of range")
        found = cls(table.astype(np.int32))
        found.sequence  # noqa: B018 - raises for a circle
        return found


def neighbours(positions: Floats) -> Neighbours:
    """The neighbours of points. positions: (frames, points, 3), metres, without gaps.

    Partners are points at the most constant distance, so that they form a tree; the others move most alike.
    """
    some = np.ascontiguousarray(positions[:: max(1, len(positions) // SAMPLED_FRAMES)])
    points = positions.shape[1]
    if points < 2:
        return Neighbours(np.full((points, NEIGHBOURS), -1, np.int32))
    near = _candidates(some)
    rigidity, likeness = _pairs(some, near)
    order, partner = _tree(near, rigidity, points)
    rank = np.empty(points, np.int64)
    rank[order] = np.arange(points)
    table = np.full((points, NEIGHBOURS), -1, np.int32)
    for p in order[1:]:
        before = np.flatnonzero((rank[near[p]] < rank[p]) & (near[p] != partner[p]))
        others = near[p][before[np.argsort(likeness[p][before], kind="stable")]][: NEIGHBOURS - 1]
        table[p, : 1 + len(others)] = [partner[p], *others]
    return Neighbours(table)


def _candidates(some: Floats) -> Integers:
    """(points, k): the points nearest to each on the whole, itself left out."""
    points = some.shape[1]
    count = min(CANDIDATES if points <= MANY_POINTS else CANDIDATES_OF_MANY, points - 1)
    flat = np.ascontiguousarray(some[:: max(1, len(some) // 8)].swapaxes(0, 1)).reshape(points, -1)
    squares = (flat**2).sum(axis=1)
    near = np.empty((points, count), np.intp)
    rows = max(1, DISTANCES_TOGETHER // points)
    for start in range(0, points, rows):
        block = slice(start, min(points, start + rows))
        distance = squares[block, None] + squares - 2 * flat[block] @ flat.T
        np.fill_diagonal(distance[:, block], np.inf)
        near[block] = np.sort(np.argpartition(distance, count - 1, axis=1)[:, :count], axis=1)
    return near


def _pairs(some: Floats, near: Integers) -> tuple[Floats, Floats]:
    """(points, k) each: standard deviation of the distance to each candidate; root mean square of the difference of
    their steps."""
    if (kernel := native.kernel("lattice_pairs")) is not None:
        return kernel(some, near, LEAST_DISTANCE_M)
    rigidity, likeness = np.empty(near.shape), np.empty(near.shape)
    frames = len(some)
    for p, others in enumerate(near):
        apart = some.take(others, axis=1) - some[:, p : p + 1]
        distance = np.sqrt(_lengths_2(apart))
        mean = distance.sum(axis=0) / frames  # in the order of frames
        spread = np.sqrt(((distance - mean) ** 2).sum(axis=0) / frames)
        rigidity[p] = spread + np.where(mean < LEAST_DISTANCE_M, 1e6, 1e-6 * mean)
        moved = _lengths_2(apart[1:] - apart[:-1])
        likeness[p] = np.sqrt(moved.sum(axis=0) / (frames - 1)) if frames > 1 else mean
    return rigidity, likeness


def _lengths_2(vectors: Floats) -> Floats:
    """Squared lengths of vectors (…, 3)."""
    return (vectors[..., 0] ** 2 + vectors[..., 1] ** 2) + vectors[..., 2] ** 2


def _tree(near: Integers, rigidity: Floats, points: int) -> tuple[Integers, Integers]:
    """Order of the points, and the partner of each: a minimum spanning tree (Prim). Unconnected parts are joined."""
    first = int(rigidity.mean(axis=1).argmin())
    if (kernel := native.kernel("lattice_tree")) is not None:
        return kernel(near, rigidity, first)
    cost, partner = np.full(points, np.inf), np.zeros(points, np.int64)
    done = np.zeros(points, bool)
    edges: list[list[tuple[int, float]]] = [[] for _ in range(points)]
    for p, others in enumerate(near):
        for q, value in zip(others.tolist(), rigidity[p].tolist(), strict=True):
            edges[p].append((q, value))
            edges[q].append((p, value))
    order = [first]
    done[first] = True
    while len(order) < points:
        last = order[-1]
        for q, value in edges[last]:
            if not done[q] and value < cost[q]:
                cost[q], partner[q] = value, last
        following = int(np.where(done, np.inf, cost).argmin())
        if not np.isfinite(cost[following]) or done[following]:
            following = int(np.flatnonzero(~done)[0])
            partner[following] = last
        order.append(following)
        done[following] = True
    return np.array(order), partner


class GivenUp(NamedTuple):
    """About the bytes of a stream that was not finished."""

    bytes: int


def encode(
    samples: Floats, missing: Booleans, known: Neighbours, stride: int, spiked: Floats | None = None
) -> tuple[bytes, Floats] | None:
    """A stream, and the samples that it decodes to, of samples (frames, points, 3) in half steps; missing: gaps.

    stride: log₂ of the distance between the first frames. spiked: the samples with the spikes that were taken out of
    them. None where samples are too large.
    """
    found = encode_up_to(np.inf, samples, missing, known, stride, spiked)
    assert not isinstance(found, GivenUp)
    return found


def encode_up_to(
    most_bytes: float,
    samples: Floats,
    missing: Booleans,
    known: Neighbours,
    stride: int,
    spiked: Floats | None = None,
) -> tuple[bytes, Floats] | GivenUp | None:
    """`encode`, unless the first points show that the stream would clearly be longer than `most_bytes`."""
    wanted = np.ascontiguousarray(samples.swapaxes(0, 1))
    where = np.ascontiguousarray(missing, np.uint8)
    sequence = known.sequence
    if (kernel := native.kernel("tempo_lattice_encode")) is not None:
        found = kernel(wanted, where, sequence, known.table, stride, most_bytes, *adaptive_bits.tables())
    else:
        found = lattice_chunk.encode(wanted, where, sequence, known.table, stride)
    if isinstance(found, int):
        return GivenUp(found)
    if found is None:
        return None
    stream, decoded = found[0], np.ascontiguousarray(found[1].swapaxes(0, 1), np.float64)
    if spiked is None:
        return bytes([stride]) + stream, decoded
    spikes = _pack_spikes(spiked, decoded, samples)
    return bytes([stride | SPIKED]) + varint.write([len(spikes)]) + spikes + stream, decoded


def estimate(samples: Floats, stride: int) -> float:
    """About the bytes of a stream of samples (frames, points, 3) in half steps, from what smooth curves through the
    frames around leave of them.

    Of joints it is hardly ever above the bytes by more than a tenth. It ignores neighbours, which save up to half or
    more of the bytes of points that move alike.
    """
    frames, points = samples.shape[:2]
    bits, counted = 0.0, 0
    for level in range(stride + 1):
        half = 1 << (stride - level)
        if level:  # a frame in the middle of four, 2 half apart
            middle = slice(3 * half, frames - 3 * half, 2 * half)
            count = len(range(frames)[middle])
            if not count:
                continue
            span = 2 * half * (count - 1) + 1
            at = [samples[k * half : k * half + span : 2 * half] for k in (0, 2, 3, 4, 6)]
            off = at[2] - 0.5625 * (at[1] + at[3])
            off += 0.0625 * (at[0] + at[4])
        else:
            off = np.diff(samples[::half], n=2, axis=0)
        np.abs(off, out=off)
        bits += float(np.log2(1.0 + (off[..., 0] + off[..., 1] + off[..., 2])).sum())
        counted += len(off)
    return (ESTIMATE_OF_BITS * bits / 8 + ESTIMATE_OF_SAMPLE * counted * points) * frames / max(1, counted)


def decode(data: bytes, missing: Booleans, known: Neighbours) -> Floats:
    """The samples (frames, points, 3) of `encode`, in half steps. Raises Corrupt."""
    if not data or data[0] & ~SPIKED > LARGEST_STRIDE:
        raise Corrupt("lattice: samples of an unknown kind")
    at, spikes = 1, b""
    if data[0] & SPIKED:
        (length,), at = varint.read(data, 1, at)
        spikes, at = data[at : at + length], at + length
    stride, stream = data[0] & ~SPIKED, data[at:]
    where = np.ascontiguousarray(missing, np.uint8)
    if (kernel := native.kernel("tempo_lattice_decode")) is not None:
        decoded = kernel(stream, where, known.sequence, known.table, stride, *adaptive_bits.tables())
    else:
        decoded = lattice_chunk.decode(stream, where, known.sequence, known.table, stride)
    if decoded is None:
        raise Corrupt("lattice: samples that are cut off or damaged")
    samples = np.ascontiguousarray(decoded.swapaxes(0, 1), np.float64)
    if data[0] & SPIKED:
        _add_spikes(samples, spikes)
    return samples


def _pack_spikes(spiked: Floats, decoded: Floats, samples: Floats) -> bytes:
    """The samples with spikes: the number of each less that of the one before, and its lattice point from `decoded`.

    Adds them to `decoded`.
    """
    numbers = np.flatnonzero((spiked != samples).any(axis=2).ravel())
    flat = decoded.reshape(-1, 3)
    away = spiked.reshape(-1, 3)[numbers] - flat[numbers]
    even, odd = np.rint(away / 2) * 2, np.floor(away / 2) * 2 + 1
    off = [((away - each) ** 2).sum(axis=1) for each in (even, odd)]
    steps = np.where((off[0] <= off[1])[:, None], even, odd)
    flat[numbers] += steps
    listed = np.column_stack([np.diff(numbers, prepend=0), steps]).astype(np.int64)
    return varint.write([len(numbers)]) + coder.pack(listed)


def _add_spikes(samples: Floats, data: bytes) -> None:
    """Raises Corrupt."""
    (count,), at = varint.read(data, 1)
    flat = samples.reshape(-1, 3)
    if not 0 < count <= len(flat):
        raise Corrupt("lattice: more spikes than samples")
    listed = coder.unpack(data[at:], (count, 4))
    numbers = np.cumsum(listed[:, 0])
    if (numbers < 0).any() or (numbers >= len(flat)).any() or (np.abs(listed[:, 1:]) > lattice_chunk.LIMIT).any():
        raise Corrupt("lattice: spikes that are out of range")
    np.add.at(flat, numbers, listed[:, 1:])


def best_stride(samples: Floats, missing: Booleans, known: Neighbours, most_bytes: float = np.inf) -> tuple[int, int]:
    """The stride that makes a chunk smallest, and its bytes, an estimate where they clearly exceed `most_bytes`.

    Longer ones are tried, then shorter ones; shorter ones first where samples take many bits.
    """
    sizes: dict[int, int] = {}

    def size(stride: int) -> int:
        found = encode_up_to(most_bytes, samples, missing, known, stride)
        sizes[stride] = 1 << 40 if found is None else found.bytes if isinstance(found, GivenUp) else len(found[0])
        return sizes[stride]

    best = USUAL_STRIDE
    takes_many = 8 * size(best) > LEAST_BITS_OF_SHORT * samples.shape[0] * samples.shape[1]
    for step in (-1, 1) if takes_many else (1, -1):
        while best + step in STRIDES and best + step not in sizes and size(best + step) < sizes[best]:
            best += step
    return best, sizes[best]
