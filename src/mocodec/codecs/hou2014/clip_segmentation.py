"""Segmentation into clips (section VI-B), the quantisation step of each clip, and grouping of clips into chunks.

equal       L frames each, the last clip shorter
adaptive    cut where the distribution of poses changes (PPCA): a given number of clips, or the cheapest number
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ... import native
from ...stages import dct, quantise, segment
from ...typing import Floats, Integers
from . import stream
from .stream import QuantisedClips

CANDIDATE_LENGTHS = (70, 140, 210, 280, 420, 560, 840, 1120)
"""Lengths L in frames that `best_equal_length` compares."""

INITIAL_CUTS = {"initial": 60, "ahead": 40, "rise": 30.0}
"""Settings of `segment.ppca` for the fine segmentation that adaptive clips are merged from."""

BITS_PER_CLIP = 24.0
"""Estimated bits of a clip in addition to its coefficients."""

COMPONENTS_AT_A_TIME = 8
"""Lengths are compared by the strongest components first."""
LEAD = 0.06
"""Bits that no length catches up with, as a share of the most bits of all weaker components. Measured: up to 0.027."""

TERMS, LARGEST_TERM = 16, 2.0**60
"""Terms of a product, which must not overflow."""

SLOWEST_MASKING_SPEED = 0.1
"""Metres per second. Slower clips are treated as this fast: below it, motion hides no errors."""


def adaptive_lengths(positions: Floats, curves: Floats, step: float, count: int | None, longest: int) -> Integers:
    """Lengths L_i of clips that are cut where the distribution of poses changes (section VI-B 2).

    positions (frames, points, 3); curves (frames, k): the rows of Mᵀ in the basis. count: number of clips at most; None
    for the number with the fewest estimated bits (section VII, future work 5). longest: frames per clip at most.

    PPCA on poses about their centre gives more cuts than needed. Neighbouring clips are then merged one pair at a time,
    always the pair whose merging saves the most bits or costs the fewest.
    """
    poses = (positions - positions.mean(axis=1, keepdims=True)).reshape(len(positions), -1)
    edges = [0, *(s.stop for s in segment.ppca(poses, **INITIAL_CUTS).segments)]

    def cost(start: int, stop: int) -> float:
        return estimate_bits(curves[start:stop], np.array([stop - start]), step)

    costs = [cost(a, b) for a, b in pairwise(edges)]
    merged_costs = [cost(a, b) if b - a <= longest else np.inf for a, b in zip(edges, edges[2:], strict=False)]
    segmentations = [(sum(costs), list(edges))]
    while len(costs) > (count or 1):
        increases = [merged - a - b for merged, (a, b) in zip(merged_costs, pairwise(costs), strict=True)]
        i = int(np.argmin(increases))
        if not np.isfinite(increases[i]):
            break
        costs[i : i + 2] = [merged_costs[i]]
        del edges[i + 1], merged_costs[i]
        for j in (i - 1, i):
            if 0 <= j < len(merged_costs):
                fits = edges[j + 2] - edges[j] <= longest
                merged_costs[j] = cost(edges[j], edges[j + 2]) if fits else np.inf
        segmentations.append((sum(costs), list(edges)))
    chosen = segmentations[-1] if count else min(segmentations)
    return np.diff(chosen[1])


def best_equal_length(curves: Floats, step: float, longest: int) -> int:
    """The clip length L with the fewest estimated bits: section VII, future work 5.

    curves (frames, k): the rows of Mᵀ in the basis, strongest components first. longest: frames per clip at most. A
    length that is far behind after some components is left out.
    """
    frames = len(curves)
    lengths = {-(-frames // max(1, round(frames / length))) for length in CANDIDATE_LENGTHS}
    allowed = sorted(length for length in lengths if length <= longest) or [-(-frames // -(-frames // longest))]
    if len(allowed) == 1:
        return allowed[0]
    curves_in_steps = curves / step
    leads = LEAD * _most_bits_behind(curves_in_steps)
    if (kernel := native.kernel("best_length")) is not None:
        found = kernel(curves_in_steps, np.array(allowed), BITS_PER_CLIP, leads)
        if found is not None:
            return allowed[found]
    bits = {length: BITS_PER_CLIP * -(-frames // length) for length in allowed}
    for start in range(0, curves.shape[1], COMPONENTS_AT_A_TIME):
        some = curves_in_steps[:, start : start + COMPONENTS_AT_A_TIME]
        for length in bits:
            bits[length] += bits_of_spectra(spectra_of_clips(some, stream.equal_lengths(frames, length)), 1.0)
        most = min(bits.values()) + leads[start + some.shape[1] - 1]
        bits = {length: of_length for length, of_length in bits.items() if of_length <= most}
        if len(bits) == 1:
            break
    return min(bits, key=bits.__getitem__)


def _most_bits_behind(curves_in_steps: Floats) -> Floats:
    """The most bits of all components behind each one, (k,): at equal energy a flat spectrum takes the most."""
    frames = len(curves_in_steps)
    energies = np.einsum("fk,fk->k", curves_in_steps, curves_in_steps)
    most = 0.5 * frames * np.log2(1 + energies / frames)
    return np.cumsum(most[::-1])[::-1] - most


def estimate_bits(curves: Floats, lengths: Integers, step: float) -> float:
    """Estimated bits of these clips: Σ ½ log₂(1 + (coefficient / step)²), and BITS_PER_CLIP for each."""
    return BITS_PER_CLIP * len(lengths) + bits_of_spectra(spectra_of_clips(curves, lengths), step)


def spectra_of_clips(curves: Floats, lengths: Integers) -> list[Floats]:
    """The DCT of curves (frames, k) clip by clip, (l, clips · k) of each run of equal lengths."""
    spectra, start = list[Floats](), 0
    for length, run in stream.equal_length_runs(lengths):
        stop = start + length * (run.stop - run.start)
        clips = curves[start:stop].reshape(run.stop - run.start, length, curves.shape[1]).transpose(1, 0, 2)
        spectra.append(dct.forward(clips).reshape(length, clips.shape[1] * clips.shape[2]))
        start = stop
    return spectra


def bits_of_spectra(spectra: Sequence[Floats], step: float) -> float:
    """Estimated bits of the coefficients alone, from `spectra_of_clips`."""
    return sum(0.5 * _sum_of_logs(one / step) for one in spectra)


def _sum_of_logs(values: Floats) -> float:
    """Σ log₂(1 + value²): products of a few terms are faster than their logarithms."""
    terms = np.minimum(values * values, LARGEST_TERM).ravel()
    terms += 1
    whole = len(terms) // TERMS * TERMS
    products = np.multiply.reduce(terms[:whole].reshape(TERMS, -1), axis=0)
    return float(np.log2(products).sum() + np.log2(terms[whole:]).sum())


def speed_rung_offsets(positions: Floats, rate: float, lengths: Integers, masking: float) -> Integers:
    """Rungs to add to the common quantisation step of each clip, (clips,): larger steps where motion is fast.

    The step is proportional to the clip's mean speed to the power `masking`, since fast motion masks errors (section
    VII, future work 2).
    """
    if masking == 0 or len(positions) < 2:
        return np.zeros(len(lengths), np.int64)
    displacement = np.diff(positions, axis=0, prepend=positions[:1])
    frame_speeds = np.sqrt((displacement**2).sum(axis=2)).mean(axis=1) * rate
    starts = np.cumsum(lengths) - lengths
    speeds = np.maximum(np.add.reduceat(frame_speeds, starts) / lengths, SLOWEST_MASKING_SPEED)
    geometric_mean = np.exp(np.average(np.log(speeds), weights=lengths))
    return np.rint(quantise.LADDER * masking * np.log2(speeds / geometric_mean)).astype(np.int64)


def group_into_chunks(clips: QuantisedClips, chunk_frames: int) -> list[QuantisedClips]:
    """Chunks of consecutive clips with about equal numbers of frames.

    A chunk has at most `chunk_frames` frames, unless a single clip is longer.
    """
    stops = np.cumsum(clips.lengths)
    count = max(1, -(-int(stops[-1]) // chunk_frames))
    edges = [0]
    for i in range(len(stops)):
        start = int(stops[edges[-1] - 1]) if edges[-1] else 0
        reaches_share = int(stops[i]) >= len(edges) * int(stops[-1]) / count
        next_overflows = i + 1 < len(stops) and int(stops[i + 1]) - start > chunk_frames
        if reaches_share or next_overflows:
            edges.append(i + 1)
    if edges[-1] != len(stops):
        edges.append(len(stops))
    spectra = clips.spectra
    return [
        stream.join_clips(clips.lengths[a:b], spectra[a:b], clips.transform_index[a:b], clips.rung_offsets[a:b])
        for a, b in pairwise(edges)
    ]
