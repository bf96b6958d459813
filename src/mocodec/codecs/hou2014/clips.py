"""Where a motion is cut into clips (section VI-B), which clips make a chunk, and how coarse each clip may be.

equal       L frames each, the last one shorter
adaptive    where the distribution of poses changes (probabilistic PCA); as many as wanted, or as pay
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...motion import Floats
from ...stages import dct, quantise, segment
from . import stream
from .stream import Clips

Integers = NDArray[np.int64]

CANDIDATES = (70, 140, 210, 280, 420, 560, 840, 1120)
"""Lengths that are tried for equal clips, in frames."""

FINEST = {"initial": 60, "ahead": 40, "rise": 30.0}
"""The segmentation that adaptive clips are put together from: windows in frames, threshold of the rise."""

BITS_PER_CLIP = 24.0
"""What a clip costs beside its coefficients, for comparing segmentations."""


def adaptive(positions: Floats, curves: Floats, step: float, wanted: int | None, longest: int) -> Integers:
    """L_i of clips cut where the distribution of poses changes: so many, or of the fewest bits (section VII).

    Positions (frames, points, 3), curves (frames, k): rows in the basis. Probabilistic PCA on poses about their centre
    finds more cuts than are wanted; neighbours are then joined, those first that gain most or lose least by it, none to
    more than `longest` frames.
    """
    poses = (positions - positions.mean(axis=1, keepdims=True)).reshape(len(positions), -1)
    edges = [0, *(s.stop for s in segment.ppca(poses, **FINEST).segments)]

    def cost(start: int, stop: int) -> float:
        return bits(curves[start:stop], np.array([stop - start]), step)

    costs = [cost(a, b) for a, b in pairwise(edges)]
    joint = [cost(a, b) if b - a <= longest else np.inf for a, b in zip(edges, edges[2:], strict=False)]
    path = [(sum(costs), list(edges))]
    while len(costs) > (wanted or 1):
        gains = [both - one - other for both, (one, other) in zip(joint, pairwise(costs), strict=True)]
        i = int(np.argmin(gains))
        if not np.isfinite(gains[i]):
            break
        costs[i : i + 2] = [joint[i]]
        del edges[i + 1], joint[i]
        for j in (i - 1, i):
            if 0 <= j < len(joint):
                near = edges[j + 2] - edges[j] <= longest
                joint[j] = cost(edges[j], edges[j + 2]) if near else np.inf
        path.append((sum(costs), list(edges)))
    chosen = path[-1] if wanted else min(path)
    return np.diff(chosen[1])


def best_equal_length(curves: Floats, step: float, longest: int) -> int:
    """L of the fewest bits, near enough: section VII's last open end. curves (frames, k): rows in the basis.

    longest: frames that no clip has more of.
    """
    frames = len(curves)
    tried = {-(-frames // max(1, round(frames / length))) for length in CANDIDATES}
    short = sorted(length for length in tried if length <= longest) or [-(-frames // -(-frames // longest))]
    return min(short, key=lambda length: bits(curves, stream.equal_lengths(frames, length), step))


def bits(curves: Floats, lengths: Integers, step: float) -> float:
    """About what the coefficients of these clips cost at a step: half a log of 1 + energy in steps for each."""
    total = BITS_PER_CLIP * len(lengths)
    start = 0
    for length, run in stream.runs(lengths):
        stop = start + length * (run.stop - run.start)
        spectra = dct.forward(curves[start:stop].reshape(run.stop - run.start, length, curves.shape[1]), axis=1) / step
        total += 0.5 * float(np.log2(1 + spectra**2).sum())
        start = stop
    return total


def offsets(positions: Floats, rate: float, lengths: Integers, masking: float) -> Integers:
    """Each clip's step in rungs above the common one: coarser where motion is fast, which hides errors.

    masking: the step goes with the clip's mean speed to this power (section VII, second open end). 0.1 m/s, which is
    hardly seen, stands in for speeds below it.
    """
    if masking == 0 or len(positions) < 2:
        return np.zeros(len(lengths), np.int64)
    moved = np.sqrt((np.diff(positions, axis=0, prepend=positions[:1]) ** 2).sum(axis=2)).mean(axis=1) * rate
    starts = np.cumsum(lengths) - lengths
    speed = np.maximum(np.add.reduceat(moved, starts) / lengths, 0.1)
    usual = np.exp(np.average(np.log(speed), weights=lengths))
    return np.rint(quantise.LADDER * masking * np.log2(speed / usual)).astype(np.int64)


def chunked(clips: Clips, chunk_frames: int) -> list[Clips]:
    """Runs of clips of about equal numbers of frames, none beyond `chunk_frames` unless a single clip is."""
    stops = np.cumsum(clips.lengths)
    wanted = max(1, -(-int(stops[-1]) // chunk_frames))
    edges = [0]
    for i in range(len(stops)):
        start = int(stops[edges[-1] - 1]) if edges[-1] else 0
        reached = int(stops[i]) >= len(edges) * int(stops[-1]) / wanted
        overfull = i + 1 < len(stops) and int(stops[i + 1]) - start > chunk_frames
        if reached or overfull:
            edges.append(i + 1)
    if edges[-1] != len(stops):
        edges.append(len(stops))
    spectra = clips.spectra
    return [
        stream.assembled(clips.lengths[a:b], spectra[a:b], clips.choice[a:b], clips.offsets[a:b])
        for a, b in pairwise(edges)
    ]
