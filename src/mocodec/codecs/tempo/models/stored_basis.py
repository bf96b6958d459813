"""A basis learned from the recording itself and stored with it, for positions or bone directions.

    spectra of the recording ─fit─► basis, gain of each component ─pack─► bytes ─unpack─► Statistics

The basis is rounded as finely as each component deserves (`stages.basis`) and completed to all dimensions, so that what
its rounding and the weak components leave can still be coded. The spectrum of a component is that of the prior's
component of the same rank, times one stored gain.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from .... import parallel
from ....errors import Corrupt
from ....fields import Record, array, count, raw, sized
from ....stages import basis
from ....typing import Floats, Integers
from ..coding import contexts
from ..coding.rows import POSE, step_size
from .coordinates import Coordinates
from .model import BANDS, Statistics, coordinate_spectrum
from .predicted_motion import MEAN_BELOW
from .prior import Prior

GAIN_UNIT = 8
"""Gains are stored in 8/32 octave, that is, quarters of an octave."""
MOST_DIMENSIONS = 6144
"""More coordinates (2,048 points) get no stored basis: its matrices would take too much memory."""
WEAKEST = 96
"""A component is stored while its standard deviation exceeds Δ/√frames by 2^(96 / 32) = 8."""
COARSER = 36
"""Entries of the basis are rounded to steps of 2^(36 / 32) · Δ/√(λ frames)."""
FITTED_HZ = (0.3, 2.0)
"""Gains are measured between these frequencies."""
LEAST_REST = 1e-6
"""Share of a sum of squares: a smaller difference between two of them is mostly rounding."""
MOST_MOMENTS = 1 << 22
"""Numbers of matrices that are computed side by side before they are summed."""
GAIN_FREQUENCY = 5
"""Index into `BANDS_MHZ` (1 Hz): shapes are relative to their value there."""

BASIS = Record(
    "tempo: a stored basis",
    count("components", of="gains", least=2, most=lambda known: known["dimensions"] + 1),
    *sized(
        array("gains", ("components",), most=4000, meaning="quarters of an octave, differences; the last: the rest"),
        array(
            "precision",
            (lambda known: known["components"] - 1,),
            most=basis.FINEST,
            meaning="bits of each component, differences",
        ),
    ),
    raw("vectors", meaning="the components (stages.basis)"),
)


@dataclass(frozen=True, eq=False)
class StoredBasis:
    """gains (k + 1,): log₂ of each component's strength against the prior's of the same rank, and of all others'.
    precision (k,): of each component. vectors: the components as bytes of `stages.basis`. unpacked (dimensions, k):
    what these give, if it is known."""

    gains: Integers
    precision: Integers
    vectors: bytes
    unpacked: Floats | None = None

    def pack(self) -> bytes:
        return BASIS.pack(
            {
                "gains": np.diff(self.gains, prepend=0),
                "precision": np.diff(self.precision, prepend=0),
                "vectors": self.vectors,
            }
        )

    @classmethod
    def unpack(cls, data: bytes, dimensions: int) -> StoredBasis:
        """Raises Corrupt."""
        if dimensions > MOST_DIMENSIONS:
            raise Corrupt(f"tempo: a stored basis of {dimensions} dimensions, more than {MOST_DIMENSIONS}")
        values = BASIS.unpack(data, dimensions=dimensions)
        gains, precision = np.cumsum(values["gains"]), np.cumsum(values["precision"])
        if (precision != precision.clip(0, basis.FINEST)).any() or (np.abs(gains) > 4000).any():
            raise Corrupt("tempo: a stored basis that is out of range")
        return cls(gains, precision, values["vectors"])

    def statistics(self, prior: Prior, dimensions: int, similar: Integers | None) -> Statistics:
        """Raises Corrupt. similar: see `fit`."""
        stored = self.unpacked
        if stored is None:
            stored = basis.unpack(self.vectors, dimensions, self.precision, similar)
        completion = basis.Completion.of(stored)
        count = len(self.gains) - 1
        gains = np.concatenate([self.gains[:-1], np.full(dimensions - count, self.gains[-1])]) * GAIN_UNIT
        known = prior.joints.statistics
        shapes = _shapes(known, count + 1)
        spreads = np.concatenate([shapes[:-1], np.repeat(shapes[-1:], dimensions - count, axis=0)]) + gains[:, None]
        return Statistics(
            (completion.rows_after(stored),) * BANDS,
            np.concatenate([known.spreads[:POSE], spreads]),
            np.concatenate([known.means[:POSE], spreads[:, 2] - MEAN_BELOW]),
            completion,
        )


def noise_step(step: int, frames: int) -> int:
    """log₂ of Δ/√frames, 1/32 octave: how exactly a mean over the recording is known, and so worth storing."""
    return step - int(contexts.log2(np.array([frames]))[0]) // 2


class Components(NamedTuple):
    """What a basis is rounded from, the same for every step.

    spectra (frames, dimensions), one a chunk. principal: the components, strongest first, and their variances.
    moves (frames, POSE), one a chunk: coefficients of heading and place, for positions.
    """

    spectra: Sequence[Floats]
    principal: basis.Principal
    moves: Sequence[Floats] = ()

    @classmethod
    def of(cls, spectra: Sequence[Floats], moves: Sequence[Floats] = ()) -> Components:
        return cls(spectra, _principal(spectra, sum(map(len, spectra))), moves)

    @classmethod
    def of_positions(cls, positions: Sequence[Floats], coordinates: Coordinates, rate: float) -> Components:
        """The components of chunks (frames, points, 3), y up."""
        moves = [np.empty((len(p), POSE)) for p in positions]

        def spectrum(number: int) -> Floats:
            return coordinate_spectrum(positions[number], coordinates, rate, moves[number])

        return cls.of(list(parallel.over(spectrum, range(len(positions)))), moves)


def fit(components: Components, prior: Prior, rate: float, step: int, similar: Integers | None = None) -> StoredBasis:
    """For chunks that will be coded with about this step, log₂ in 1/32 octave.

    similar (dimensions,): a coordinate before each that moves alike, −1 for none, which its entries are predicted from.
    """
    spectra, variances = components.spectra, components.principal.variances
    frames = sum(map(len, spectra))
    noise = noise_step(step, frames)
    strength = contexts.OCTAVE / 2 * np.log2(np.maximum(variances, 1e-30))
    count = int(np.clip((strength > noise + WEAKEST).sum(), 1, min(len(strength), frames)))
    vectors = components.principal.vectors(count)
    known, lengths = prior.joints.statistics, [len(s) for s in spectra]
    fitted = np.concatenate([s[_fitted_frequencies(len(s), rate)] for s in spectra])
    gains = _gains(fitted @ vectors, lengths, rate, known, np.arange(count))
    precision = basis.precisions(variances[:count], float(step_size(noise + COARSER)))
    packed, stored = basis.pack_rounded(vectors, precision, similar)
    last = gains[-1:]
    if others := len(vectors) - count:
        rest = np.sqrt(_squares_beside(stored, fitted) / others)
        last = _gains(rest[:, None], lengths, rate, known, np.array([count]))
    return StoredBasis(np.rint(np.append(gains, last) / GAIN_UNIT).astype(np.int64), precision, packed, stored)


def _squares_beside(stored: Floats, spectrum: Floats) -> Floats:
    """Sums of squares (n,) of what orthonormal columns (dimensions, k) leave of rows (n, dimensions) of spectra."""
    inside = spectrum @ stored
    squares = np.einsum("ij,ij->i", spectrum, spectrum)
    rest = squares - np.einsum("ij,ij->i", inside, inside)
    lost = rest < LEAST_REST * squares
    off = spectrum[lost] - inside[lost] @ stored.T
    rest[lost] = np.einsum("ij,ij->i", off, off)
    return rest


def _principal(spectra: Sequence[Floats], frames: int) -> basis.Principal:
    """Components of the recording, strongest first, and the variance of each."""
    if frames < spectra[0].shape[1]:
        found = basis.principal_of_rows(np.concatenate(spectra) / np.sqrt(frames))
        if len(found.variances):
            return found
    vectors, variances = basis.fit(_moments(spectra) / frames)
    return basis.Principal(variances, lambda count: vectors[:, :count])


def _moments(spectra: Sequence[Floats]) -> Floats:
    """Σ sᵀ s of spectra (frames, dimensions), summed in their order."""
    out = np.zeros((spectra[0].shape[1],) * 2)
    together = max(1, MOST_MOMENTS // out.size)
    for first in range(0, len(spectra), together):
        for moments in parallel.over(lambda s: s.T @ s, spectra[first : first + together]):
            out += moments
    return out


def _shapes(known: Statistics, count: int) -> Integers:
    """Spectra (components, frequencies) of the prior's components of the same rank, relative to their value at 1 Hz."""
    spreads = known.spreads[POSE:]
    rank = np.minimum(np.arange(count), len(spreads) - 1)
    return spreads[rank] - spreads[rank][:, GAIN_FREQUENCY : GAIN_FREQUENCY + 1]


def _fitted_frequencies(frames: int, rate: float) -> slice:
    """The frequencies of a chunk that lie between those of FITTED_HZ."""
    hertz = np.arange(frames) * rate / (2 * frames)
    inside = np.flatnonzero((hertz > FITTED_HZ[0]) & (hertz < FITTED_HZ[1]))
    return slice(int(inside[0]), int(inside[-1]) + 1) if len(inside) else slice(0, 0)


@lru_cache(maxsize=32)
def _usual_levels(known: Statistics, frames: int, rate: float) -> Floats:
    """Sums (ranks,) of the prior's spectra over the fitted frequencies of a chunk, relative to their value at 1 Hz."""
    at = (np.arange(frames) * rate / (2 * frames))[_fitted_frequencies(frames, rate)] * 1000
    logs = np.array([np.interp(at, contexts.BANDS_MHZ, shape) for shape in _shapes(known, len(known.spreads) - POSE)])
    return (2.0 ** (logs / contexts.OCTAVE)).sum(axis=1)


def _gains(curves: Floats, lengths: Sequence[int], rate: float, known: Statistics, ranks: Integers) -> Floats:
    """How much stronger components (ranks,) are than the prior's of the same rank, 1/32 octave.

    curves (fitted frequencies of all chunks, ranks): their spectra. lengths: frames of each chunk.
    """
    measured, expected = np.full(len(ranks), 1e-9), np.full(len(ranks), 1e-9)
    fitted = {length: _fitted_frequencies(length, rate) for length in set(lengths)}
    of_length = np.repeat(lengths, [fitted[length].stop - fitted[length].start for length in lengths])
    for length, chunks in Counter(lengths).items():
        levels = _usual_levels(known, length, rate)
        expected += chunks * levels[np.minimum(ranks, len(levels) - 1)]
        measured += np.abs(curves[of_length == length]).sum(axis=0) / np.sqrt(rate / 120)
    return contexts.OCTAVE * np.log2(measured / expected)
