"""One chunk while it is encoded.

    positions ─► coefficients ─► integers in some step, corrections ─► Draft ─pack─► payload

`chunk_decoding` is the inverse.

A payload is a byte of flags · [gaps] · [step of corrections or of the grid] · coefficients with corrections, or the
grid's numbers. Three engines make it:

transform   coefficients of the model: few bytes where motion is smooth against the error
lattice     every sample predicted from its neighbours in time and space, under a hard bound: noise and fine bounds
direct      every sample on a grid, predicted in time: for numbers too large for the others
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np

from ... import native, parallel
from ...entropy import varint
from ...errors import CannotEncode, Corrupt
from ...stages import frozen, lattice
from ...stages.lattice import GivenUp
from ...typing import Booleans, Floats, Integers
from .. import rescue
from . import compiled_chunks, trial
from .coding import coefficients, corrections, direct, quantise
from .coding.contexts import OCTAVE
from .models.model import Model
from .preparation import Prepared
from .trial import Trial

Result = TypeVar("Result")

TRANSFORM, DIRECT, LATTICE = 0, 1, 2
STEPPED, GAPPED = 4, 8
GRID_OCTAVE = 256
"""Steps of the direct engine and of corrections, and half steps of the lattice, are 2^(n / 256) metres."""
LARGEST_GRID_STEP = 200 * GRID_OCTAVE
BATCH = 64
"""Chunks coded side by side: enough to be fast, few enough to need little memory."""
LONGEST_SECONDS, ALWAYS_FRAMES = 16, 32
"""No encoder writes chunks that are longer than both: at most 10 s or 16 frames are asked for, rounding adds half."""
REFILLS = 3
"""Rounds of refilling gaps with decoded positions."""
BOUND_SLOPE = 0.1
"""Rate–distortion λ under a bound: smaller than elsewhere, since zeroing coefficients causes error peaks."""
FIRST_OFFSET = 44
"""Under a bound, the first step tried is this many 1/32 octaves above it."""
DIRECT_WORTH_TRYING = 1.2
"""The direct engine is tried where its estimate is below this many times the transform's bytes."""
ESTIMATED_POINTS, CLEARLY = 6, 2.0
"""It is estimated by one point in this many first, and is not looked at where that exceeds the limit so clearly."""


@dataclass(frozen=True, eq=False)
class Payload:
    """engine; numbers: the engine's bytes; step: of corrections or of the grid, None if unused; gaps: `stages.gaps`."""

    engine: int
    numbers: bytes
    step: int | None = None
    gaps: bytes = b""

    def pack(self) -> bytes:
        flags = self.engine | STEPPED * (self.step is not None) | GAPPED * bool(self.gaps)
        out = bytes([flags])
        if self.gaps:
            out += varint.write([len(self.gaps)]) + self.gaps
        if self.step is not None:
            out += varint.write([varint.signed(self.step)])
        return out + self.numbers

    @classmethod
    def unpack(cls, payload: bytes) -> Payload:
        """Raises Corrupt."""
        if not payload or payload[0] & ~(DIRECT | LATTICE | STEPPED | GAPPED) or payload[0] & 3 == DIRECT | LATTICE:
            raise Corrupt("tempo: a chunk of an unknown kind")
        at, step, missing = 1, None, b""
        if payload[0] & GAPPED:
            (length,), at = varint.read(payload, 1, at)
            if at + length > len(payload):
                raise Corrupt("tempo: a chunk that ends within its gaps")
            missing, at = payload[at : at + length], at + length
        if payload[0] & STEPPED:
            (folded,), at = varint.read(payload, 1, at)
            step = varint.unsigned(folded)
            if abs(step) > LARGEST_GRID_STEP:
                raise Corrupt("tempo: a chunk whose step is out of range")
        return cls(payload[0] & (DIRECT | LATTICE), payload[at:], step, missing)


def grid_step(size: float) -> int:
    """The number of the largest grid step that is at most this size, metres."""
    n = int(np.floor(np.log2(size) * GRID_OCTAVE))
    while grid_size(n) > size:
        n -= 1
    return n


def grid_size(step: int) -> float:
    return 2.0 ** (step / GRID_OCTAVE)


class Draft(NamedTuple):
    """A chunk in one step, before it becomes bytes.

    numbers: of the transform, None for the direct engine. grid: the step of corrections or of the direct engine.
    error: sum of the distances, metres, and bits: an estimate, where they were measured.
    """

    numbers: coefficients.ChunkNumbers | None = None
    grid: int | None = None
    error: float = 0.0
    bits: float = 0.0

    @property
    def direct_grid(self) -> int:
        """The grid step of the direct engine: that of the draft, or one as fine as the step of its coefficients."""
        if self.numbers is None or self.grid is not None:
            return self.grid or 0
        return self.numbers.step * GRID_OCTAVE // OCTAVE


class OnLattice(NamedTuple):
    """A chunk by the lattice engine: its payload, and the positions (frames, points, 3), metres, that it decodes to."""

    payload: bytes
    positions: Floats

    @property
    def bytes(self) -> int:
        return len(self.payload)


class ChunkEncoder:
    """A chunk while it is encoded: its samples and, computed once, their coefficients."""

    def __init__(
        self,
        model: Model,
        positions: Floats,
        smooth: Floats | None = None,
        apart: frozen.Split | None = None,
        spikes: Booleans | None = None,
        spectrum: Floats | None = None,
    ) -> None:
        """positions (frames, points, 3), y up, filled where samples are set apart; smooth: without spikes.

        spikes (frames, points): mask. spectrum: coefficients of `smooth`, if they are known.
        """
        none = np.zeros(positions.shape[:2], bool)
        self.apart = frozen.Split(positions, none, none, none) if apart is None else apart
        self.model = model
        self.positions = _in_order(positions)
        self.smooth = self.positions if smooth is None or smooth is positions else _in_order(smooth)
        self.gap_mask = self.apart.apart
        self.spikes = none if spikes is None else spikes
        self.gaps = self.apart.pack()
        self.failure: Exception | None = None
        self.spectrum = spectrum
        if model.rows and spectrum is None:
            self.attempt(self._analyse)

    @classmethod
    def of(cls, model: Model, source: Prepared, frames: slice, spectrum: Floats | None = None) -> ChunkEncoder:
        """The encoder of some frames of a recording."""
        positions, smooth = source.positions[frames], source.smooth[frames]
        return cls(model, positions, smooth, source.apart[frames], source.spikes[frames], spectrum)

    @property
    def frames(self) -> int:
        return len(self.positions)

    def _analyse(self) -> None:
        self.spectrum = compiled_chunks.analyse(self.model, self.smooth)
        if not np.isfinite(self.spectrum).all():
            raise CannotEncode("coefficients that are too large for float64")

    def attempt(self, work: Callable[[], Result]) -> Result | None:
        """The result of `work` with the model; None after a failure, which makes the chunk coded directly."""
        try:
            with np.errstate(all="ignore"):
                return work()
        except MemoryError:
            raise
        except Exception as error:
            if not rescue.may_rescue(error):
                raise
            self.failure = error
            self.spectrum = None
            return None

    def refill_gaps(self, step: int) -> None:
        """Replaces what fills gaps by the decoder's output in about this step: gap samples carry no error."""
        self.attempt(lambda: self._refill_gaps(step))

    def _refill_gaps(self, step: int) -> None:
        for _ in range(REFILLS if self.gap_mask.any() and self.spectrum is not None else 0):
            assert self.spectrum is not None
            found = trial.of_step(
                self.model, self.spectrum, self.smooth, self.gap_mask, step, quantise.SLOPE, keeps=True
            )
            decoded = found.decoded
            assert decoded is not None
            refilled = np.where(self.gap_mask[..., None], decoded, self.smooth)
            self.spectrum = compiled_chunks.analyse(self.model, refilled)

    def trial(self, step: int, slope: float = quantise.SLOPE) -> Trial:
        """The chunk without its spikes in one step (log₂ in 1/32 octave). Raises what made its analysis fail."""
        if self.spectrum is None and self.failure is not None:
            raise self.failure
        assert self.spectrum is not None
        return trial.of_step(self.model, self.spectrum, self.smooth, self.gap_mask, step, slope)

    def errors(self, decoded: Floats) -> Floats:
        """Distances (frames, points) of decoded positions times the points' weights, 0 where samples are set apart."""
        return trial.errors(self.model, self.positions, decoded, self.gap_mask)

    @property
    def samples(self) -> int:
        """Number of samples that are not missing."""
        return int((~self.apart.missing).sum())

    def keeps(self, decoded: Floats, bound: float) -> bool:
        """Whether decoded positions (frames, points, 3) have the gaps, and all samples within the bound (metres)."""
        same_gaps = bool((np.isnan(decoded[..., 0]) == self.apart.missing).all())
        if not (same_gaps and self.errors(decoded).max(initial=0.0) <= bound):
            return False
        frozen_ = self.apart.frozen
        off = np.sqrt(((self.apart.positions[frozen_] - decoded[frozen_]) ** 2).sum(axis=1))
        if self.model.weights is not None:
            off *= self.model.weights[np.nonzero(frozen_)[1]]
        return bool((off <= bound).all())

    def within_bound(self, bound: float, offset: int, most_bits: float = np.inf) -> Draft:
        """The chunk in a step this far above the bound (metres), log₂ in 1/32 octave, with corrections that should
        bring every sample within it. A direct draft where the transform fails or takes `most_bits` without them."""
        found = None
        if self.spectrum is not None:
            found = self.attempt(lambda: self._transform_within(bound, offset, most_bits))
        return found or Draft(grid=grid_step(direct.cell(bound)))

    def _transform_within(self, bound: float, offset: int, most_bits: float) -> Draft | None:
        assert self.spectrum is not None
        grid, step = grid_step(direct.cell(bound)), round(np.log2(bound) * OCTAVE) + offset
        within = bound * (1 - 1e-9)
        found = trial.within_bound(
            self.model,
            self.spectrum,
            self.positions,
            self.gap_mask,
            step,
            BOUND_SLOPE,
            within,
            grid_size(grid),
            most_bits,
        )
        if found is None:
            return None
        numbers = self._numbers(found.quantised, step, found.moved)
        return Draft(numbers, grid if found.moved.size else None, bits=found.quantised.bits)

    def smaller_of_engines(self, payload: bytes, bound: float) -> bytes:
        """The transform's payload, or the direct engine's where that is smaller."""
        if self.spectrum is None:
            return payload
        worth, cell, weighted = len(payload) * DIRECT_WORTH_TRYING, direct.cell(bound), self._weighted()
        if direct.estimate(weighted, cell, ESTIMATED_POINTS) >= CLEARLY * worth:
            return payload
        if direct.estimate(weighted, cell) >= worth:
            return payload
        return min(self.directly(grid_step(cell)), payload, key=len)

    def on_lattice(
        self, bound: float, neighbours: lattice.Neighbours, stride: int, most_bytes: float = np.inf
    ) -> OnLattice | GivenUp | None:
        """By the lattice engine within the bound (metres), unless it would clearly take more than `most_bytes`; None
        where samples are too large for it."""
        step = grid_step(lattice.half_step(bound))
        samples = self._weighted() / grid_size(step)
        without = self._weighted(self.smooth) / grid_size(step) if self.spikes.any() else samples
        spiked = None if without is samples else samples
        found = lattice.encode_up_to(most_bytes, without, self.gap_mask, neighbours, stride, spiked)
        if found is None or isinstance(found, GivenUp):
            return found
        positions = in_metres(self.model, found[1], grid_size(step))
        return OnLattice(Payload(LATTICE, found[0], step, self.gaps).pack(), frozen.restore(positions, self.gaps))

    def estimate_on_lattice(self, bound: float, stride: int) -> float:
        """About the bytes by the lattice engine within the bound (metres)."""
        samples = self._weighted(self.smooth) / grid_size(grid_step(lattice.half_step(bound)))
        return lattice.estimate(samples, stride) * float(1 - self.gap_mask.mean())

    def draft(self, step: int, slope: float = quantise.SLOPE) -> Draft:
        """The chunk in one step, without a bound."""
        drafted = None
        if self.spectrum is not None:
            drafted = self.attempt(lambda: self._transform_draft(step, slope))
        if drafted is None:
            grid = step * GRID_OCTAVE // OCTAVE
            values = direct.quantise(self.positions, grid_size(grid))
            error = float(self.errors(np.asarray(values * grid_size(grid), np.float64)).sum())
            bits = 8 * direct.estimate(self.positions, grid_size(grid)) if self.positions.size else 0.0
            return Draft(grid=grid, error=error, bits=bits)
        return drafted

    def _transform_draft(self, step: int, slope: float) -> Draft:
        assert self.spectrum is not None
        has_spikes = bool(self.spikes.any())
        found = trial.of_step(self.model, self.spectrum, self.positions, self.gap_mask, step, slope, keeps=has_spikes)
        if found.decoded is None:
            return Draft(self._numbers(found.quantised, step, None), None, found.distance, found.quantised.bits)
        moved, grid = self._restore_spikes(found.decoded, step)
        distance = float(self.errors(found.decoded).sum())
        return Draft(self._numbers(found.quantised, step, moved), grid, distance, found.quantised.bits)

    def directly(self, grid: int) -> bytes:
        """The payload of the direct engine in this grid step."""
        values = direct.quantise(self._weighted(), grid_size(grid)).reshape(self.frames, -1)
        return Payload(DIRECT, direct.pack(values), grid, gaps=self.gaps).pack()

    def _numbers(self, found: quantise.Quantised, step: int, moved: Integers | None) -> coefficients.ChunkNumbers:
        return coefficients.ChunkNumbers(self.frames, found.values, step, found.threshold, moved)

    def _weighted(self, positions: Floats | None = None) -> Floats:
        positions = self.positions if positions is None else positions
        return positions if self.model.weights is None else positions * self.model.weights[:, None]

    def _restore_spikes(self, decoded: Floats, step: int) -> tuple[Integers, int]:
        """Corrections of the spikes, applied to `decoded` in place, and their grid step."""
        grid = step * GRID_OCTAVE // OCTAVE
        error = np.where(self.spikes[..., None], self.positions - decoded, 0.0)
        found = corrections.find(error, grid_size(grid), grid_size(grid))
        corrections.apply(decoded, found, grid_size(grid))
        return corrections.numbers(found), grid


def _in_order(positions: Floats) -> Floats:
    """Positions (frames, points, 3) in the order of memory that is fastest: NumPy's loops run along the frames."""
    return np.ascontiguousarray(positions) if native.available() else np.asfortranarray(positions)


def encoders(
    model: Model, source: Prepared, bounds: Sequence[tuple[int, int]], spectra: Mapping[int, Floats] | None = None
) -> list[ChunkEncoder]:
    """Encoders of chunks with these bounds, analysed in the threads of `parallel`. spectra: known ones, by number."""
    known = spectra or {}
    for length in {stop - start for start, stop in bounds}:
        compiled_chunks.encodes(model, length)  # what all threads share is made here
    numbered = list(enumerate(bounds))
    return list(parallel.over(lambda b: ChunkEncoder.of(model, source, slice(*b[1]), known.get(b[0])), numbered))


def drafts_of_step(encoders: Sequence[ChunkEncoder], step: int) -> list[Draft]:
    """Drafts of all chunks in one step (log₂, 1/32 octave), in the threads of `parallel`."""
    return list(parallel.over(lambda encoder: encoder.draft(step), encoders))


def pack(encoders: Sequence[ChunkEncoder], drafts: Sequence[Draft]) -> list[bytes]:
    """The payloads of drafts, in the threads of `parallel`."""
    numbers: dict[int, bytes | None] = {}
    drafted = {i: draft.numbers for i, draft in enumerate(drafts) if draft.numbers is not None}
    compiled = [i for i in drafted if compiled_chunks.decodes(encoders[i].model, encoders[i].frames)]
    numbers |= zip(compiled, parallel.over(lambda i: _packed_compiled(encoders[i], drafted[i]), compiled), strict=True)
    rest = [i for i in drafted if i not in numbers]
    for first in range(0, len(rest), BATCH):
        batch = rest[first : first + BATCH]
        numbers |= zip(batch, _pack_numbers([(encoders[i], drafted[i]) for i in batch]), strict=True)
    payloads: list[bytes] = []
    for i, (encoder, draft) in enumerate(zip(encoders, drafts, strict=True)):
        packed = numbers.get(i)
        if packed is not None:
            payloads.append(Payload(TRANSFORM, packed, draft.grid, encoder.gaps).pack())
        else:
            payloads.append(encoder.directly(draft.direct_grid))
    return payloads


def _packed_compiled(encoder: ChunkEncoder, numbers: coefficients.ChunkNumbers) -> bytes | None:
    """The coefficients of a chunk by the compiled module; None where their coding fails."""
    return encoder.attempt(lambda: compiled_chunks.pack(encoder.model, numbers))


def _pack_numbers(batch: Sequence[tuple[ChunkEncoder, coefficients.ChunkNumbers]]) -> list[bytes | None]:
    """The coefficients of these chunks by NumPy; None where their coding fails."""
    first, numbers = batch[0][0], [n for _, n in batch]
    together = first.attempt(lambda: coefficients.pack(first.model, numbers)) if len(batch) > 1 else None
    if together is not None:
        return list(together)
    if len(batch) > 1:
        first.failure = None
    alone = [e.attempt(lambda n=n: coefficients.pack(first.model, [n])) for e, n in batch]
    return [None if one is None else one[0] for one in alone]


def in_metres(model: Model, values: Floats | Integers, size: float) -> Floats:
    """Positions of the numbers (frames, points, 3) of the direct and lattice engines; size: their unit, metres."""
    positions = np.asarray(values * size, np.float64)
    return positions if model.weights is None else positions / model.weights[:, None]
