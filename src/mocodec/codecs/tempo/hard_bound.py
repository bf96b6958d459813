"""Payloads of chunks within a hard bound: the step of each chunk, and its engine.

    some chunks ─search─► offsets of their steps, bits ──┐
    every other chunk ─near the one searched before it───┴─► drafts ─pack─► transform ──┐
    chunks that take the transform many bits ────────────────────────────► lattice ─────┴─► the smaller

Where the compiled module codes a chunk, and the lattice engine is not tried for it, the chunk is drafted, packed,
compared with the direct engine and checked in one piece of work.

A coarser step leaves more samples beyond the bound, which take corrections. Where the transform needs few bits the best
step is coarse: offset = `BEST_OFFSET` + `BEST_SLOPE` · log₂ of the bits of a coordinate, fitted to joints and markers
under bounds from 0.5 to 20 mm. What a search finds beside this holds for its neighbours too, so most chunks are coded
once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ... import parallel, progress
from ...encoded import Chunk
from ...stages import lattice
from ...stages.lattice import GivenUp
from ...typing import Floats
from . import chunk, chunk_decoding, compiled_chunks
from .chunk import BATCH, FIRST_OFFSET, TRANSFORM, ChunkEncoder, Draft, OnLattice, Payload, grid_step
from .coding import direct
from .engine_choice import FEWEST_FRAMES, LEAST_SAVING, EngineTrials, LatticePlan, Outcomes

SEARCHED = 4
"""At most this many chunks are searched, whatever the length of the recording; one where an earlier block shows where
to begin."""
BEST_OFFSET, BEST_SLOPE = 31.2, -8.6
"""Offsets are log₂ of the step in bounds, 1/32 octave."""
STRIDE, NEAR = 8, 5
"""A search ends with an offset STRIDE to either side. An offset within NEAR of the predicted one is not changed."""
TOGETHER = 4
"""Number of chunks that the lattice engine tries before the next ones learn from them, in any number of threads."""
LEAST_OFFSET, MOST_OFFSET = -32, 128
EXACT_TO = 1e6
"""Distance from the origin, in bounds, up to which rounding moves no decoded sample beyond the bound: the trial of a
step has measured what the compiled module decodes."""


@dataclass(frozen=True)
class Searched:
    """A chunk, its draft, the offset of its step, and how far this is from the predicted one."""

    encoder: ChunkEncoder
    draft: Draft
    offset: int
    beside: float


@dataclass
class Earlier:
    """What earlier blocks of a recording show for the next one.

    begin: where a search begins, the last one's offset and how far it was from the predicted one; side: where it ends,
    with an offset to this side. lattice: outcomes of trials of the lattice engine.
    """

    begin: tuple[int, float] | None = None
    side: int = STRIDE
    lattice: Outcomes = field(default_factory=Outcomes)


@dataclass(frozen=True)
class Packed:
    """A chunk's draft by the transform, and the payload of the smaller of the transform and the direct engine.

    is_measured: whether the payload is known to be within the bound.
    """

    draft: Draft
    payload: bytes
    is_measured: bool


def to_bound(
    encoders: Sequence[ChunkEncoder],
    bound: float,
    plan: LatticePlan | None = None,
    model_bytes: int = 0,
    earlier: Earlier | None = None,
) -> list[bytes]:
    """Payloads that decode to within the bound (metres) at every sample.

    plan: how the lattice engine is used, None to leave it out. model_bytes: what the transform needs beside the chunks;
    each chunk that it codes is charged with its share. earlier: of the same recording, updated with these chunks. A
    payload that exceeds the bound after all is replaced by the direct engine's, which never does.
    """
    has_transform = encoders[0].model.rows > 0
    searched = _searched(encoders, bound, earlier) if has_transform else []
    every = -(-len(encoders) // max(1, len(searched)))
    on_lattice = None if plan is None else _LatticeTrials(plan, bound, model_bytes, encoders, earlier)
    payloads: list[bytes] = []
    for first in range(0, len(encoders), BATCH):
        batch = encoders[first : first + BATCH]

        def drafted(number: int) -> Draft | Packed:
            before, encoder = searched[number // every], encoders[number]
            draft = before.draft if encoder is before.encoder else _near(encoder, bound, before)
            alone = plan is None or _takes_few_bits(encoder, draft, plan)
            if draft.numbers is None or not alone or not compiled_chunks.decodes(encoder.model, encoder.frames):
                return draft
            return _packed(encoder, draft, chunk.pack([encoder], [draft])[0], bound)

        found: list[Draft | Packed | None] = [None] * len(batch)
        numbers = range(first, first + len(batch)) if has_transform else ()
        for number, one in enumerate(parallel.over(drafted, numbers)):
            found[number] = one
            progress.report((first + number) / len(encoders))
        payloads += _smallest(batch, found, bound, on_lattice)
        progress.report((first + len(batch)) / len(encoders))
    return payloads


def _packed(encoder: ChunkEncoder, draft: Draft, payload: bytes, bound: float) -> Packed:
    """payload: of the transform."""
    smaller = encoder.smaller_of_engines(payload, bound)
    return Packed(draft, smaller, _is_measured(encoder, smaller, bound))


def _takes_few_bits(encoder: ChunkEncoder, draft: Draft, plan: LatticePlan) -> bool:
    """Whether the lattice engine is not tried for a chunk, whatever other chunks show."""
    return draft.bits < plan.least_bits * encoder.positions.size


def _predicted(encoder: ChunkEncoder, bits: float) -> float:
    """The best offset of a chunk that takes about `bits` bits."""
    of_coordinate = max(bits, 1.0) / encoder.positions.size
    return float(np.clip(BEST_OFFSET + BEST_SLOPE * np.log2(of_coordinate), LEAST_OFFSET, MOST_OFFSET))


def _searched(encoders: Sequence[ChunkEncoder], bound: float, earlier: Earlier | None) -> list[Searched]:
    """Chunks that others follow: of equally many consecutive chunks one each."""
    if earlier is None or earlier.begin is None:
        every = -(-len(encoders) // SEARCHED)
        found = list(parallel.over(lambda e: _search(e, bound), encoders[::every]))
    else:
        longest = max(encoders, key=lambda e: e.frames)
        found = [_search(longest, bound, earlier.begin, (earlier.side,))]
        earlier.side = -earlier.side
    if earlier is not None and found[-1].draft.numbers is not None:
        earlier.begin = found[-1].offset, found[-1].beside
    return found


def _search(
    encoder: ChunkEncoder,
    bound: float,
    begin: tuple[int, float] = (FIRST_OFFSET, 0.0),
    sides: tuple[int, ...] = (STRIDE, -STRIDE),
) -> Searched:
    """The cheapest of the first offset, the one that its bits predict, and one to a side. begin: the first offset, and
    what is added to the predicted one."""
    first, beside = begin
    tried = {first: encoder.within_bound(bound, first)}

    def cheaper(at: int, other: int) -> int:
        if other not in tried:
            tried[other] = encoder.within_bound(bound, other, tried[at].bits)
        return other if tried[other].numbers is not None and tried[other].bits < tried[at].bits else at

    at = first
    if tried[at].numbers is not None:
        near = at = cheaper(at, round(_predicted(encoder, tried[at].bits) + beside))
        for side in sides:
            at = cheaper(near, near + side) if at == near else at
    return Searched(encoder, tried[at], at, at - _predicted(encoder, tried[at].bits))


def _near(encoder: ChunkEncoder, bound: float, before: Searched) -> Draft:
    """At the offset of the chunk searched before, or, if this chunk's bits predict another, the cheaper of both."""
    draft = encoder.within_bound(bound, before.offset)
    offset = round(_predicted(encoder, draft.bits) + before.beside)
    if draft.numbers is None or abs(offset - before.offset) <= NEAR:
        return draft
    other = encoder.within_bound(bound, offset, draft.bits)
    return other if other.numbers is not None and other.bits < draft.bits else draft


class _LatticeTrials:
    """The lattice engine, for the chunks that it may make smaller."""

    def __init__(
        self,
        plan: LatticePlan,
        bound: float,
        model_bytes: int,
        encoders: Sequence[ChunkEncoder],
        earlier: Earlier | None,
    ) -> None:
        self._plan, self._bound, self._model_bytes, self._chunks = plan, bound, model_bytes, len(encoders)
        self._trials = EngineTrials()
        self._outcomes = None if earlier is None else earlier.lattice
        self._estimates: dict[ChunkEncoder, float] = {}  # over the transform's bytes
        self._typical = encoders[len(encoders) // 2]
        self._number = 0

    @cached_property
    def share(self) -> float:
        """Bytes that a chunk of the transform is charged with: the stream has the model, or the neighbours."""
        return max(0, self._model_bytes - len(self._plan.neighbours.pack())) / self._chunks

    def coded(self, encoders: Sequence[ChunkEncoder], drafts: Sequence[Draft | None]) -> list[OnLattice | None]:
        """The next chunks, None where one is not tried or not possible, in the threads of `parallel`. drafts: by the
        transform. What they show is learned for the chunks after them; without any, progress is reported."""
        first = self._number
        tried = [i for i, draft in enumerate(drafts) if self._tries(encoders[i], draft)]
        found: list[OnLattice | None] = [None] * len(encoders)
        stride, of_typical = self._best if tried else (0, None)
        transform_bytes = {i: self._transform_bytes(drafts[i]) for i in tried}

        def on_lattice(i: int) -> OnLattice | GivenUp | None:
            known = of_typical if encoders[i] is self._typical else None
            return known or self._of_stride(encoders[i], stride, transform_bytes[i])

        for i, one in zip(tried, parallel.over(on_lattice, tried), strict=True):
            found[i] = one if isinstance(one, OnLattice) else None
            if drafts[i] is None:
                progress.report((first + i + 1) / self._chunks)
            if one is not None and transform_bytes[i] < np.inf:
                self._learn(encoders[i], transform_bytes[i], one.bytes)
        return found

    def _transform_bytes(self, draft: Draft | None) -> float:
        """Bytes of a chunk, with its share of the model; infinite where the transform does not code it."""
        return np.inf if draft is None or draft.numbers is None else draft.bits / 8 + self.share

    def _learn(self, encoder: ChunkEncoder, transform_bytes: float, lattice_bytes: int) -> None:
        self._trials.learn(transform_bytes, lattice_bytes)
        if self._outcomes is not None and encoder.frames >= FEWEST_FRAMES:
            self._outcomes.learn(self._estimates.pop(encoder), lattice_bytes / max(1.0, transform_bytes))

    def _tries(self, encoder: ChunkEncoder, draft: Draft | None) -> bool:
        """Whether the next chunk is tried."""
        number, self._number = self._number, self._number + 1
        if draft is None or draft.numbers is None:
            return True
        if _takes_few_bits(encoder, draft, self._plan) or not self._trials.tries_lattice(number):
            return False
        estimate = encoder.estimate_on_lattice(self._bound, self._plan.stride)
        transform_bytes = self._transform_bytes(draft)
        if estimate > self._plan.unlikely * transform_bytes:
            return False
        if self._outcomes is None or encoder.frames < FEWEST_FRAMES:
            return True
        self._estimates[encoder] = estimate / max(1.0, transform_bytes)
        return not self._outcomes.rule_out(self._estimates[encoder])

    def _of_stride(self, encoder: ChunkEncoder, stride: int, most_bytes: float = np.inf) -> OnLattice | GivenUp | None:
        return encoder.on_lattice(self._bound, self._plan.neighbours, stride, most_bytes)

    @cached_property
    def _best(self) -> tuple[int, OnLattice | None]:
        """The stride for all chunks, and the middle chunk in it if it was coded to find the stride.

        It is the sample's stride, or a longer one where the chunk is smaller: longer strides have more weights to
        learn, which pays in a whole chunk.
        """
        stride = self._plan.stride
        best = self._of_stride(self._typical, stride) if stride < lattice.USUAL_STRIDE else None
        while isinstance(best, OnLattice) and stride < lattice.USUAL_STRIDE:
            longer = self._of_stride(self._typical, stride + 1, best.bytes)
            if longer is None or longer.bytes >= best.bytes:
                break
            best, stride = longer, stride + 1
        return stride, best if isinstance(best, OnLattice) else None


def _on_lattice(
    batch: Sequence[ChunkEncoder], drafts: Sequence[Draft | None], trials: _LatticeTrials | None
) -> Iterator[OnLattice | None]:
    """What the lattice engine makes of each chunk, None where it is not tried or not possible."""
    if trials is None:
        yield from [None] * len(batch)
        return
    together = TOGETHER if any(draft is not None for draft in drafts) else len(batch)
    for first in range(0, len(batch), together):
        some = slice(first, first + together)
        yield from trials.coded(batch[some], drafts[some])


def _smallest(
    batch: Sequence[ChunkEncoder],
    found: Sequence[Draft | Packed | None],
    bound: float,
    trials: _LatticeTrials | None,
) -> list[bytes]:
    """Payloads of the smaller engine, checked. found: by the transform, None without one."""
    drafts = [one.draft if isinstance(one, Packed) else one for one in found]
    on_lattice: dict[int, OnLattice] = {}
    for i, one in enumerate(_on_lattice(batch, drafts, trials)):
        if one is not None:
            on_lattice[i] = one
        elif drafts[i] is None:
            drafts[i] = batch[i].within_bound(bound, FIRST_OFFSET)
    by_transform = {i: one for i, one in enumerate(found) if isinstance(one, Packed)}
    rest = {i: draft for i, draft in enumerate(drafts) if draft is not None and i not in by_transform}
    payloads = dict(zip(rest, chunk.pack([batch[i] for i in rest], list(rest.values())), strict=True))
    for i in list(payloads):
        if i in on_lattice and trials is not None:
            worth = len(on_lattice[i].payload) <= (1 - LEAST_SAVING) * (len(payloads[i]) + trials.share)
            (payloads if worth else on_lattice).pop(i)
    packed = parallel.over(lambda i: _packed(batch[i], rest[i], payloads[i], bound), payloads)
    by_transform |= dict(zip(payloads, packed, strict=True))
    return _checked(batch, by_transform, on_lattice, bound)


def _checked(
    batch: Sequence[ChunkEncoder], by_transform: dict[int, Packed], on_lattice: dict[int, OnLattice], bound: float
) -> list[bytes]:
    """Payloads of a batch, by number: those given, or the direct engine's where one exceeds the bound (metres).

    The lattice engine's encoder has decoded what it codes, and so has the compiled trial of a step.
    """
    payloads = {i: found.payload for i, found in (by_transform | on_lattice).items()}
    unsure = [i for i, found in by_transform.items() if not found.is_measured]
    decoded = dict(zip(unsure, _decoded([batch[i] for i in unsure], [payloads[i] for i in unsure]), strict=True))
    decoded |= {i: found.positions for i, found in on_lattice.items()}
    for i, positions in decoded.items():
        if positions is None or not batch[i].keeps(positions, bound):
            payloads[i] = batch[i].directly(grid_step(direct.cell(bound)))
    return [payloads[i] for i in range(len(batch))]


def _is_measured(encoder: ChunkEncoder, payload: bytes, bound: float) -> bool:
    """Whether the trial of a step says that the payload is within the bound: rounding does not matter to it."""
    compiled = Payload.unpack(payload).engine == TRANSFORM and compiled_chunks.decodes(encoder.model, encoder.frames)
    positions = encoder.positions
    return compiled and not encoder.gap_mask.any() and bool(max(positions.max(), -positions.min()) <= EXACT_TO * bound)


def _decoded(batch: Sequence[ChunkEncoder], payloads: Sequence[bytes]) -> list[Floats | None]:
    """Positions of a batch of chunks; None where decoding fails."""
    if not batch:
        return []
    listed = [Chunk(0, e.frames, b) for e, b in zip(batch, payloads, strict=True)]
    model = batch[0].model
    together = batch[0].attempt(lambda: chunk_decoding.decode(model, listed)) if len(batch) > 1 else None
    if together is not None:
        return list(together)
    if len(batch) > 1:
        batch[0].failure = None
    alone = [e.attempt(lambda c=c: chunk_decoding.decode(model, [c])) for e, c in zip(batch, listed, strict=True)]
    return [None if one is None else one[0] for one in alone]
