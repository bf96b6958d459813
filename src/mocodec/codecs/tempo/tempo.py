"""Tempo: mocodec's own codec for named points, small at any error and true to its bound.

    positions ─gaps.fill─► ─body frame─► heading · place · pose ─DCT over the chunk─► ─basis of a prior─► coefficients
    coefficients ─quantise─► whole numbers ─contexts─► rANS ─► bytes
    bytes ─decode─► what is too far off ─corrections─► bytes               a promise is checked by decoding

A chunk (about 4 s) decodes alone: the prior that ships with the package carries the bases and the coder's statistics.
Where this suits a motion badly, a chunk is coded directly on a grid instead; the smaller of the two is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...encoded import Chunk, Encoded, about, restore
from ...errors import BadInput, CannotEncode, Corrupt
from ...motion import Floats, Motion, Skeleton, point_columns
from ...stages import gaps
from ..base import require_frames, settings
from . import (
    attach,
    body,
    chunks,
    coefficients,
    corrections,
    direct,
    held,
    jumps,
    liken,
    mapped,
    matched,
    model,
    own,
    prior,
    skeletal,
    tailored,
)
from .chunks import DIRECT, TRANSFORM, Parts, fine_size, fine_step
from .contexts import OCTAVE

DEFAULT_MAX_ERROR = 0.005
BATCH = 64
"""Chunks decoded side by side: enough to be fast, few enough to be small in memory."""
FIRST_OFFSET = 28
"""The step to try first under a bound: this many 1/32 octaves above it."""
COARSER_MODELS = 8
"""How many coarser models are looked at, two octaves apart, where one takes more than half of a size."""
HELD_BYTES = 8
"""What a chunk's held frames take, at most, where they are held in some order."""
MEAN_WITHIN = 0.02
"""How near to a mean error the result must come."""
BOUND_SLOPE = 0.1
"""λ under a bound: zeros that save bits elsewhere make the errors uneven here."""


@dataclass(frozen=True)
class Tempo:
    """Settings. At most one target; without any, no point of any frame is moved by more than 5 mm.

    max_error, mean_error: metres. ratio: against float32 positions. size: bytes of payload. chunk_seconds: 0.5 to 10.
    weights: points that matter more, by name: with 4, a point is kept within a quarter of `max_error`.
    """

    name: ClassVar[str] = "tempo"

    max_error: float | None = None
    mean_error: float | None = None
    ratio: float | None = None
    size: int | None = None
    chunk_seconds: float = 4.0
    weights: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        targets = {
            t: getattr(self, t) for t in ("max_error", "mean_error", "ratio", "size") if getattr(self, t) is not None
        }
        if len(targets) > 1:
            raise BadInput(f"tempo takes one target, not {' and '.join(targets)}")
        if any(not (np.isfinite(v) and v > 0) for v in targets.values()):
            raise BadInput(f"a target must be positive: {targets}")
        if not 0.5 <= self.chunk_seconds <= 10:
            raise BadInput("chunk_seconds must lie between 0.5 and 10")
        if self.weights and targets.keys() - {"max_error"}:
            raise BadInput("weights go with a hard bound: max_error")
        if self.weights and not all(1 <= w <= 1000 for w in self.weights.values()):
            raise BadInput("weights must lie between 1 and 1000")

    def encode(self, motion: Motion) -> Encoded[Motion]:
        """Raises CannotEncode where the positions are too large to be held to the target."""
        require_frames(motion)
        said = held.said(motion, self.chunk_seconds)
        return self.all_said(motion) if said is None else self.with_held(motion, said)

    def with_held(self, motion: Motion, said: NDArray[np.bool_]) -> Encoded[Motion]:
        """By way of the frames that do not repeat the one before."""
        wanted = self.payload_bytes(motion) - HELD_BYTES * (2 + int(motion.seconds / self.chunk_seconds))
        sized = self.ratio is not None or self.size is not None
        codec = replace(self, ratio=None, size=max(1, wanted)) if sized else self
        encoded = replace(held.encode(motion, said, codec.all_said), settings=self.promised())
        off = self.mean_error and abs(tailored.mean_error(encoded, motion) / self.mean_error - 1) > MEAN_WITHIN
        return (
            self.all_said(motion) if off or (sized and encoded.payload_bytes > self.payload_bytes(motion)) else encoded
        )

    def all_said(self, motion: Motion) -> Encoded[Motion]:
        """As if no frame repeated another."""
        encoded = self.in_chunks(motion)
        if self.weights:
            return encoded
        if self.ratio is not None or self.size is not None:
            return tailored.closer(encoded, motion, self.payload_bytes(motion), self.chunk_seconds)
        target = "max_error" if self.mean_error is None else "mean_error"
        wanted = encoded.settings[target]
        smaller = tailored.smaller(encoded, motion, target, wanted, self.chunk_seconds)
        if smaller is encoded:
            return encoded
        off_mean = target == "mean_error" and abs(tailored.mean_error(smaller, motion) / wanted - 1) > MEAN_WITHIN
        return encoded if off_mean else smaller

    def payload_bytes(self, motion: Motion) -> int:
        """The size that `size` or `ratio` asks for."""
        return self.size or int(motion.raw_bytes / (self.ratio or 1))

    def in_chunks(self, motion: Motion) -> Encoded[Motion]:
        """Each chunk on its own: with the prior's basis, one for all chunks, or directly."""
        filled, mask = gaps.fill(motion.positions)
        positions = body.level(filled, motion.up)
        spikes = jumps.spikes(positions) & ~mask
        smooth = jumps.bridged(positions, spikes)
        bounds = chunk_bounds(len(motion), motion.rate, self.chunk_seconds, jumps.cuts(smooth, motion.rate))
        cut = [smooth[a:b] for a, b in bounds]
        shared, known, spectra = choose_model(cut, motion, self.first_step(motion), self.mean_error)
        if self.ratio is not None or self.size is not None:
            for coarser in range(1, COARSER_MODELS):
                if len(shared) <= self.payload_bytes(motion) / 2:
                    break
                shared, known, spectra = choose_model(cut, motion, self.first_step(motion) + coarser * 2 * OCTAVE)
        if self.weights:
            weighting = weight_bytes(motion.names, self.weights)
            shared, known = bytes([shared[0] | WEIGHTED]) + weighting + shared[1:], weighted(known, weighting)
        pieces = [
            Piece(known, positions[a:b], mask[a:b], spikes[a:b], spectra.get(number))
            for number, (a, b) in enumerate(bounds)
        ]
        for piece in pieces:
            piece.refill(self.first_step(motion))
        if self.mean_error is not None:
            payloads = to_mean(pieces, self.mean_error)
        elif self.ratio is not None or self.size is not None:
            payloads = to_size(pieces, self.payload_bytes(motion) - len(shared))
        else:
            payloads = to_bound(pieces, self.max_error or DEFAULT_MAX_ERROR)
        if all(Parts.unpack(p).engine == DIRECT for p in payloads):
            shared = plain_shared(shared, motion.points)
        return Encoded(
            self.name,
            about(motion),
            [Chunk(a, b - a, p) for (a, b), p in zip(bounds, payloads, strict=True)],
            shared=(shared,),
            settings=self.promised(),
        )

    def promised(self) -> dict[str, Any]:
        """The settings for the file."""
        stored = settings(self)
        if len(stored.keys() & {"mean_error", "ratio", "size"}) == 0:
            stored["max_error"] = self.max_error or DEFAULT_MAX_ERROR
        return stored

    def first_step(self, motion: Motion) -> int:
        """About which step (log₂ in 1/32 octave) the target will need: good enough to round a basis by."""
        if self.mean_error is not None:
            size = 3 * self.mean_error
        elif self.max_error is not None or (self.ratio is None and self.size is None):
            return step_for_bound(self.max_error or DEFAULT_MAX_ERROR)
        else:
            ratio = self.ratio or motion.raw_bytes / (self.size or 1)
            size = 3e-5 * ratio
        return round(np.log2(size) * OCTAVE)

    @staticmethod
    def decode(encoded: Encoded[Motion], frames: slice | None = None) -> Motion:
        if encoded.shared and encoded.shared[0][:1] == bytes([held.KIND]):
            return held.decode(encoded, frames, Tempo.decode_said)
        return Tempo.decode_said(encoded, frames)

    @staticmethod
    def decode_said(encoded: Encoded[Motion], frames: slice | None = None) -> Motion:
        """`decode`, of frames none of which is held."""
        if encoded.shared and encoded.shared[0][:1] == bytes([tailored.KIND]):
            return tailored.decode(encoded, frames)
        start, stop = encoded.range(frames)
        like = encoded.about
        positions = np.empty((stop - start, like.points, 3))
        known = model_of(encoded.shared, like)
        covering = encoded.covering(start, stop)
        for first in range(0, len(covering), BATCH):
            batch = covering[first : first + BATCH]
            for chunk, part in zip(batch, chunks.decode(known, batch), strict=True):
                a, b = max(start, chunk.start), min(stop, chunk.stop)
                here = body.unlevel(part[a - chunk.start : b - chunk.start], like.up)
                for axis in range(3):  # frames are next to each other in `here`, axes in `positions`
                    positions[a - start : b - start, :, axis] = here[..., axis]
        return restore(encoded, positions, start)


def step_for_bound(bound: float) -> int:
    """About which step a hard bound needs, log₂ in 1/32 octave."""
    return round(np.log2(2.2 * bound) * OCTAVE)


PLAIN, KNOWN, OWN, LIMBS, MAPPED, OWN_LIMBS, MATCHED_LIMBS = 0, 1, 2, 4, 5, 7, 16
"""Kinds of model: none (every chunk is coded directly), the prior's, one stored in the file, the prior's of limbs, the
prior's of bones for points that sit on them, limbs stored in the file, and such as the prior knows under other names;
`tailored.KIND` is another. Never change them."""
KINDS = (PLAIN, KNOWN, OWN, LIMBS, MAPPED, OWN_LIMBS, MATCHED_LIMBS)
WEIGHTED = 8
"""Beside the kind: a byte a point follows, its weight."""
OWN_FRAMES = 1200
"""Points that the prior knows, but not as limbs, get a basis of their own only in recordings at least this long."""


class Choice(NamedTuple):
    """A model, its shared bytes, and the spectra of the chunks, by number, that were looked at when it was chosen."""

    shared: bytes
    model: model.Model
    spectra: Mapping[int, Floats] = MappingProxyType({})


def choose_model(cut: list[Floats], like: Motion, step: int, mean_error: float | None = None) -> Choice:
    """The model that makes chunks (frames, points, 3) smallest in about this step.

    like: any motion with the names, rate and skeleton of the chunks. mean_error: metres; the step is then only where
    the search for the one that gives it begins.
    """
    used, names, rate = prior.shipped(), like.names, like.rate
    known = model.of_names(names, used, rate)
    frames = sum(map(len, cut))
    looked_at = range(0, len(cut), max(1, -(-len(cut) // 4)))
    sample = [cut[i] for i in looked_at]
    scale = frames / max(1, sum(map(len, sample)))
    candidates = [] if known is None else [(bytes([KNOWN]) + used.id, known)]
    if known is None and frames >= 2:
        for _ in range(STEP_ROUNDS if mean_error else 0):
            for _, fitted in _with_own(cut, used, names, rate, step, None):
                step = _nearer_step(fitted, sample, step, mean_error or 1.0)
        candidates = [c for finer in OWN_FINER for c in _with_own(cut, used, names, rate, step - finer, None)]
    knowing = prior.of_limbs()
    if knowing is not None and (found := skeletal.candidate(cut, names, rate, step, like.skeleton, knowing)):
        candidates.append((bytes([LIMBS]) + knowing.id + found[0], found[1]))
        if not cut:
            return Choice(*candidates[-1])
    elif known is not None and frames >= OWN_FRAMES:
        candidates += _with_own(cut, used, names, rate, step, known)
    elif knowing is not None and known is None and (own_limbs := _with_own_limbs(cut, like, step, knowing)):
        candidates.append(own_limbs)
    if knowing is not None and known is None and (likened := liken.candidate(cut, like, step, knowing)):
        stored, likened_model = likened
        candidates.append((bytes([MATCHED_LIMBS]) + knowing.id + stored, likened_model))
    bodies = prior.of_bones() if known is None else None
    if bodies is not None and bodies.bones is not None and (sits := attach.fit(cut, bodies, names, rate, step)):
        on_bones = mapped.model(*sits, bodies.bones, bodies, names, rate)
        candidates.append((bytes([MAPPED]) + bodies.id + sits[0].pack(), on_bones))
    if not candidates:
        return Choice(bytes([PLAIN]) + used.id, model.plain(names, used, rate))
    if len(candidates) == 1:
        return Choice(*candidates[0])

    def looked(candidate: tuple[bytes, model.Model]) -> tuple[float, Choice]:
        """What it costs, in bytes."""
        shared, known = candidate
        pieces = [Piece(known, s, np.zeros(s.shape[:2], bool)) for s in sample]
        bits = sum(b + e / coefficients.SLOPE for b, e in (p.weighed(step) for p in pieces))
        spectra = {i: p.spectrum for i, p in zip(looked_at, pieces, strict=True) if p.spectrum is not None}
        return len(shared) + scale * bits / 8, Choice(shared, known, spectra)

    return min(map(looked, candidates), key=lambda found: found[0])[1]


OWN_FINER = (0, 32)
"""A basis of its own is rounded for this step, or for one so much (1/32 octave) finer."""
STEP_ROUNDS = 2
"""How often the step for a mean error is looked for, before a basis is rounded by it."""


def _with_own(
    cut: list[Floats], used: prior.Prior, names: tuple[str, ...], rate: float, step: int, known: model.Model | None
) -> list[tuple[bytes, model.Model]]:
    """The model of the recording's own basis; none where its numbers would be out of range."""
    fitted = own.fit(cut, used, names, rate, step, known)
    try:
        return [(bytes([OWN]) + used.id + fitted, own.unpack(fitted, used, names, rate, known))]
    except Corrupt:
        return []


def _nearer_step(known: model.Model, sample: list[Floats], step: int, mean_error: float) -> int:
    """A step that comes nearer to a mean error (m) with this model."""
    pieces = [Piece(known, s, np.zeros(s.shape[:2], bool)) for s in sample]
    error = sum(float(p.errors(p.transformed(step)[3]).sum()) for p in pieces)
    found = error / max(1, sum(s.shape[0] * s.shape[1] for s in sample))
    octaves = float(np.log2(max(found, mean_error / 8) / mean_error))
    return int(np.clip(step - round(OCTAVE * octaves / 0.85), 1 - coefficients.MAX_STEP, coefficients.MAX_STEP - 1))


def _with_own_limbs(
    cut: list[Floats], like: Motion, step: int, knowing: prior.Prior
) -> tuple[bytes, model.Model] | None:
    """The model of limbs that no prior knows, after its shared bytes; none where the points are no limbs'."""
    if sum(map(len, cut)) < skeletal.FEWEST_FRAMES:
        return None
    centred = np.concatenate([c[:: max(1, len(c) // 256)] for c in cut])
    pose = body.mean_pose(centred - centred.mean(axis=1, keepdims=True))
    found = skeletal.unknown(cut, pose, like.names, like.rate, step, like.skeleton)
    if found is None:
        return None
    stored, points = found
    fitted = own.fit(cut, knowing, like.names, like.rate, step, None, points)
    known = own.unpack(fitted, knowing, like.names, like.rate, None, points)
    return bytes([OWN_LIMBS]) + knowing.id + stored.pack() + fitted, known


def weight_bytes(names: tuple[str, ...], weights: Mapping[str, float]) -> bytes:
    """A byte a point: log₂ of its weight in sixteenths, rounded up. Raises BadInput for an unknown name."""
    point_columns(names, list(weights))
    return bytes(int(np.ceil(16 * np.log2(weights.get(name, 1.0)))) for name in names)


def weighted(known: model.Model, weighting: bytes) -> model.Model:
    return replace(known, weights=2.0 ** (np.frombuffer(weighting, np.uint8) / 16))


def plain_shared(shared: bytes, points: int) -> bytes:
    """Shared bytes for chunks that are all coded directly: what they need of these."""
    flag = shared[0] & WEIGHTED
    return bytes([PLAIN | flag]) + shared[1 : 1 + (points if flag else 0)] + prior.shipped().id


def model_of(shared: tuple[bytes, ...], like: Motion) -> model.Model:
    """The model that a file was coded with. Raises Corrupt, UnknownCodec."""
    if len(shared) != 1 or not shared[0]:
        raise Corrupt("tempo: the shared bytes are not its own")
    tree = like.skeleton
    built = b"" if tree is None else np.array(tree.parents).tobytes() + tree.offsets.tobytes()
    return _model_of(shared[0], like.names, like.rate, _Build(built, tree))


@dataclass(frozen=True)
class _Build:
    """A skeleton that equals another of the same bones: each opening of a file reads its own."""

    bones: bytes
    skeleton: Skeleton | None = field(compare=False)


@lru_cache(maxsize=8)
def _model_of(shared: bytes, names: tuple[str, ...], rate: float, build: _Build) -> model.Model:
    kind, at = shared[0] & ~WEIGHTED, 1
    weighting = b""
    if shared[0] & WEIGHTED:
        weighting, at = shared[at : at + len(names)], at + len(names)
    id_, rest = shared[at : at + prior.ID_BYTES], shared[at + prior.ID_BYTES :]
    if len(id_) < prior.ID_BYTES or kind not in KINDS:
        raise Corrupt("tempo: the shared bytes are not its own")
    used = prior.named(id_)
    if kind == LIMBS:
        found = skeletal.unpack(rest, names, rate, build.skeleton, used)
    elif kind == MATCHED_LIMBS:
        found = matched.unpack(rest, names, rate, build.skeleton, used)
    elif kind == OWN_LIMBS:
        if used.sets[0].limbs is None:
            raise Corrupt("tempo: limbs, of a prior that knows none")
        stored, rest = skeletal.Stored.unpack(rest, len(names))
        found = own.unpack(rest, used, names, rate, None, stored.points(names, build.skeleton))
    elif kind == OWN:
        found = own.unpack(rest, used, names, rate, model.of_names(names, used, rate))
    elif kind == MAPPED:
        found = of_bones(rest, used, names, rate)
    else:
        found = model.of_names(names, used, rate) if kind == KNOWN else model.plain(names, used, rate)
        if found is None or rest:
            raise Corrupt("tempo: the shared bytes do not fit the names of the points")
    return weighted(found, weighting) if weighting else found


def of_bones(data: bytes, used: prior.Prior, names: tuple[str, ...], rate: float) -> model.Model:
    """The model of points on bones that is stored so. Raises Corrupt."""
    if used.bones is None:
        raise Corrupt("tempo: points on bones, of a prior that knows none")
    stored, rest = mapped.Stored.unpack(data, len(names), used.bones)
    if rest:
        raise Corrupt("tempo: the shared bytes do not end where they should")
    return mapped.model(stored, mapped.movements(stored, used.bones), used.bones, used, names, rate)


def chunk_bounds(frames: int, rate: float, seconds: float, cuts: list[int] | None = None) -> list[tuple[int, int]]:
    """Frames between cuts, in equal chunks of about `seconds`."""
    edges = [0]
    for stop in (*(cuts or ()), frames):
        start = edges[-1]
        count = max(1, round((stop - start) / (rate * seconds)))
        edges += [start + (stop - start) * i // count for i in range(1, count + 1)]
    return list(pairwise(edges))


REFILLS = 3
"""How often what fills gaps is made more like what will be decoded there."""


class Piece:
    """One chunk on its way: its samples, and their coefficients once."""

    def __init__(
        self,
        known: model.Model,
        positions: Floats,
        mask: gaps.Mask,
        spikes: gaps.Mask | None = None,
        spectrum: Floats | None = None,
    ) -> None:
        """spectrum: of the positions, where it is known and there are no spikes."""
        self.model = known
        self.positions = np.asfortranarray(positions)  # what works on all frames of a point is quicker so
        self.mask = mask
        self.spikes = mask & ~mask if spikes is None else spikes
        self.gaps = gaps.pack(mask)
        self.spectrum = spectrum
        if known.rows and (spectrum is None or self.spikes.any()):
            self.spectrum = known.analyse(jumps.bridged(self.positions, self.spikes))

    def refill(self, step: int) -> None:
        """Put into gaps what decoding in about this step would put there: nobody asks for more."""
        for _ in range(REFILLS if self.mask.any() and self.spectrum is not None else 0):
            decoded = self.transformed(step)[3]
            smooth = np.where(self.mask[..., None], decoded, jumps.bridged(self.positions, self.spikes))
            self.spectrum = self.model.analyse(smooth)

    def scaled(self) -> Floats:
        """The positions, times their weights."""
        return self.positions if self.model.weights is None else self.positions * self.model.weights[:, None]

    def errors(self, decoded: Floats) -> Floats:
        """Distances (frames, points) of decoded positions, 0 in gaps, times the weights of the points."""
        d = np.where(self.mask, 0.0, np.sqrt(((self.positions - decoded) ** 2).sum(axis=2)))
        return d if self.model.weights is None else d * self.model.weights

    def quantised(self, step: int, slope: float = coefficients.SLOPE) -> tuple[np.ndarray, int, float]:
        """Whole numbers (frequencies, rows), threshold, and about how many bits they take."""
        assert self.spectrum is not None
        scaled = model.without_slopes(self.spectrum, step) / chunks.sizes(self.model, len(self.positions), step)
        return coefficients.quantise(self.model, scaled, step, slope)

    def weighed(self, step: int) -> tuple[float, float]:
        """About how many bits the whole numbers take, and the sum of their squared errors, in squared steps."""
        assert self.spectrum is not None
        scaled = model.without_slopes(self.spectrum, step) / chunks.sizes(self.model, len(self.positions), step)
        values, _, bits = coefficients.quantise(self.model, scaled, step)
        error = (scaled - coefficients.dequantise(values, np.ones(self.model.rows)))[:, model.HEADING + 1 :]
        return bits, float((error**2).sum())

    def transformed(self, step: int, slope: float = coefficients.SLOPE) -> tuple[np.ndarray, int, float, Floats]:
        """Whole numbers (frequencies in the zone, rows), threshold, bits, and the positions that they decode to."""
        values, threshold, cost = self.quantised(step, slope)
        frames = len(self.positions)
        known = coefficients.plan(self.model, frames, step, threshold, 0).frequencies
        sizes = chunks.sizes(self.model, frames, step)
        decoded = self.model.synthesise(coefficients.dequantise(values[:known], sizes), frames)
        return values[:known], threshold, cost, decoded

    def directly(self, step: int) -> bytes:
        values = direct.quantise(self.scaled(), fine_size(step)).reshape(len(self.positions), -1)
        return Parts(DIRECT, direct.pack(values), step, gaps=self.gaps).pack()

    def within(self, bound: float, offset: int, among: Sequence[int]) -> tuple[Draft, int]:
        """The cheapest numbers tried that should decode to within the bound at every sample, and their offset.

        offset: of the step, log₂ of its size in bounds, 1/32 octave. Each of `among` is added to it in turn, until one
        is worse than the first.
        """
        fine = fine_step(direct.cell(bound))
        if self.spectrum is None:
            return Draft(fine=fine), offset
        centre = round(np.log2(bound) * OCTAVE)
        costs: list[float] = []
        drafts: list[Draft] = []
        for more in among:
            if len(costs) > 1 and min(costs[1:]) < costs[0]:
                break
            values, threshold, cost, decoded = self.transformed(centre + offset + more, BOUND_SLOPE)
            moved = corrections.numbers(self.found(decoded, bound))
            costs.append(cost + coefficients.list_bits(self.model, moved))
            numbers = coefficients.Numbers(len(self.positions), values, centre + offset + more, threshold, moved)
            drafts.append(Draft(numbers, fine if moved.size else None))
        best = int(np.argmin(costs))
        return drafts[best], offset + among[best]

    def held(self, payload: bytes, bound: float) -> bytes:
        """A payload of the transform, or the direct engine's where that is smaller."""
        if self.spectrum is None or self.direct_estimate(bound) >= 1.2 * len(payload):
            return payload
        return min(self.directly(fine_step(direct.cell(bound))), payload, key=len)

    def direct_estimate(self, bound: float) -> float:
        """About how many bytes the direct engine will need."""
        return direct.estimate(direct.quantise(self.scaled(), direct.cell(bound)).reshape(len(self.positions), -1))

    def found(self, decoded: Floats, bound: float) -> corrections.Corrections:
        d = self.positions - decoded
        d[self.mask] = 0.0
        if self.model.weights is not None:
            d *= self.model.weights[:, None]
        return corrections.find(d, bound * (1 - 1e-9), fine_size(fine_step(direct.cell(bound))))

    def draft(self, step: int, slope: float = coefficients.SLOPE) -> Draft:
        """The chunk in one step, with no bound to keep."""
        if self.spectrum is None:
            fine = step * chunks.FINE // OCTAVE
            on_grid = np.asarray(direct.quantise(self.positions, fine_size(fine)) * fine_size(fine), np.float64)
            return Draft(fine=fine, error=float(self.errors(on_grid).sum()))
        values, threshold, _, decoded = self.transformed(step, slope)
        moved, fine = self.put_back(decoded, step)
        numbers = coefficients.Numbers(len(self.positions), values, step, threshold, moved)
        return Draft(numbers, fine, float(self.errors(decoded).sum()))

    def put_back(self, decoded: Floats, step: int) -> tuple[np.ndarray | None, int | None]:
        """Corrections for spikes alone, and their step."""
        if not self.spikes.any():
            return None, None
        fine = step * chunks.FINE // OCTAVE
        error = np.where(self.spikes[..., None], self.positions - decoded, 0.0)
        found = corrections.find(error, fine_size(fine), fine_size(fine))
        corrections.apply(decoded, found, fine_size(fine))
        return corrections.numbers(found), fine


class Draft(NamedTuple):
    """A chunk in one step, before it becomes bytes.

    numbers: none of the direct engine's. fine: the step of corrections, or of the direct engine. error: the sum of its
    distances, metres, where it was looked at.
    """

    numbers: coefficients.Numbers | None = None
    fine: int | None = None
    error: float = 0.0


def packed(pieces: Sequence[Piece], drafts: Sequence[Draft]) -> list[bytes]:
    """The payloads of drafts."""
    payloads: list[bytes] = []
    for first in range(0, len(pieces), BATCH):
        batch = list(zip(pieces, drafts, strict=True))[first : first + BATCH]
        numbers = [d.numbers for _, d in batch if d.numbers is not None]
        coded = iter(coefficients.pack(pieces[0].model, numbers) if numbers else [])
        for piece, draft in batch:
            if draft.numbers is not None:
                payloads.append(Parts(TRANSFORM, next(coded), draft.fine, piece.gaps).pack())
            else:
                payloads.append(piece.directly(draft.fine or 0))
    return payloads


def to_bound(pieces: list[Piece], bound: float, offset: int = FIRST_OFFSET) -> list[bytes]:
    """Payloads that decode to within the bound at every sample: all are decoded, and those that do not hold are
    replaced by the direct engine's, which always does."""
    payloads: list[bytes] = []
    for first in range(0, len(pieces), BATCH):
        batch, drafts = pieces[first : first + BATCH], list[Draft]()
        for number, piece in enumerate(batch):
            draft, offset = piece.within(bound, offset, OFFSETS if number % SEARCHED == 0 else (0,))
            drafts.append(draft)
        coded = [p.held(b, bound) for p, b in zip(batch, packed(batch, drafts), strict=True)]
        listed = [Chunk(0, len(p.positions), b) for p, b in zip(batch, coded, strict=True)]
        for i, (piece, decoded) in enumerate(zip(batch, chunks.decode(batch[0].model, listed), strict=True)):
            gone = np.isnan(decoded[..., 0])
            if (gone != piece.mask).any() or not piece.errors(decoded).max() <= bound:
                coded[i] = piece.directly(fine_step(direct.cell(bound)))
        payloads += coded
    return payloads


OFFSETS = (0, -10, 10)
"""Steps tried for a chunk under a bound, in 1/32 octave beside that of the chunk before."""
SEARCHED = 3
"""They are tried for one chunk of so many; those between take the step of the chunk before."""


def to_mean(pieces: list[Piece], target: float) -> list[bytes]:
    """Payloads at the common step whose mean error is nearest to the target.

    The step is looked for among some of the chunks, first by their coefficients alone; all are then coded in it, and
    once more where their mean differs.
    """

    def excess(among: Sequence[Piece], step: int, slope: float = coefficients.SLOPE) -> tuple[float, list[Draft]]:
        """By how much the mean error is too large, 1/32 octave."""
        drafts = [p.draft(step, slope) for p in among]
        error = sum(d.error for d in drafts) / sum(int((~p.mask).sum()) for p in among)
        return OCTAVE * float(np.log2(max(error, 1e-12) / target)), drafts

    def estimate(among: Sequence[Piece], step: int) -> tuple[float, list[Draft]]:
        """About the same."""
        squared = sum(p.weighed(step)[1] for p in among) / sum(p.mask.size for p in among)
        error = MEAN_OF_ROOT * np.sqrt(squared) * model.step_size(step)
        return OCTAVE * float(np.log2(max(error, 1e-12) / target)), []

    def search(
        among: Sequence[Piece],
        step: int,
        excess: Callable[[Sequence[Piece], int], tuple[float, list[Draft]]] = excess,
        near: float = BEST,
    ) -> tuple[dict[int, float], int, list[Draft]]:
        """The excess at every step tried until one is this near, the best of them, and what it gave."""
        tried: dict[int, float] = {}
        best: tuple[int, list[Draft]] = step, []
        for _ in range(12):
            step = int(np.clip(step, 1 - coefficients.MAX_STEP, coefficients.MAX_STEP - 1))
            if step in tried:
                break
            tried[step], drafts = excess(among, step)
            if abs(tried[step]) <= min(map(abs, tried.values())):
                best = step, drafts
            if abs(tried[step]) < near:
                break
            step = _next_step(tried)
        return tried, *best

    some = pieces[:: -(-len(pieces) // SAMPLED)]
    step = round(np.log2(USUAL_STEP * target**1.5) * OCTAVE)
    if pieces[0].spectrum is not None:
        step = search(some, step, estimate, ROUGHLY)[1]
    if len(some) < len(pieces):
        step = search(some, step, near=ROUGHLY)[1]
    tried, step, drafts = search(pieces, step)
    if min(tried.values()) > NEAR:  # finer than the stored bases are exact
        return [p.directly(fine_step(target / CUBE_MEAN)) for p in pieces]
    miss = tried[step]
    for change, share in OTHER_WAYS if abs(miss) < OCTAVE else ():
        if abs(miss) <= NEAR:
            break
        found, other = excess(pieces, step + change, share * coefficients.SLOPE)
        if abs(found) < abs(miss):
            miss, drafts = found, other
    return packed(pieces, drafts)


SAMPLED = 4
"""At most so many chunks are looked at for the step of a mean error, before all are."""
USUAL_STEP = 140
"""The step for people's mean error, both in metres, is about this times its power of 1.5: more coefficients are zero in
coarser steps."""
MEAN_OF_ROOT = 0.81
"""The mean distance against the root of the mean square: 0.92 were all errors alike."""
ROUGHLY = 1.5
"""Near enough to a mean error, 1/32 octave, among some of the chunks."""
BEST = 0.43
"""No other step is nearer to a mean error than one this near, 1/32 octave."""
OTHER_WAYS = tuple((change, share) for share in (0.8, 1.25, 0.6, 1.6, 0.4, 2.0) for change in (0, -1, 1, -2, 2))
NEAR = 0.6
"""Near enough to a mean error, 1/32 octave: 1.3 %. Where no step is, others of error and bits are weighed too."""
CUBE_MEAN = 0.4803
"""The mean distance of the points of a cube from its middle, in sides."""


def _next_step(tried: dict[int, float]) -> int:
    """Where the excess (1/32 octave) ought to vanish, from the steps tried: between two, or along the usual slope."""
    below = [s for s in tried if tried[s] <= 0]
    above = [s for s in tried if tried[s] > 0]
    if below and above:
        a, b = max(below), min(above)
        if b - a <= 1:
            return a
        between = round(a - tried[a] * (b - a) / (tried[b] - tried[a]))
        return min(max(between, a + 1), b - 1)
    last, *before = sorted(tried, reverse=bool(below))
    slope = 0.75 if not before else float(np.clip((tried[last] - tried[before[0]]) / (last - before[0]), 0.4, 1.0))
    change = -tried[last] / slope
    return last + (int(np.ceil(change)) if change >= 0 else int(np.floor(change)))


def to_size(pieces: list[Piece], size: float) -> list[bytes]:
    """Payloads at the smallest common step whose bytes are within the size. Raises CannotEncode."""

    def at(step: int) -> list[bytes]:
        return packed(pieces, [p.draft(step) for p in pieces])

    spectra = [np.abs(p.positions if p.spectrum is None else p.spectrum).max(initial=0.0) for p in pieces]
    finest = int(np.ceil(OCTAVE * np.log2(max(*spectra, 1e-9) / LARGEST_NUMBER)))
    start = max(finest, round(np.log2(0.004) * OCTAVE))
    step = -_largest(lambda s: -s >= finest and sum(map(len, at(-s))) <= size, -start)
    result = at(step)
    if sum(map(len, result)) > size:
        raise CannotEncode(f"even the coarsest step takes more than {size:.0f} bytes")
    return result


LARGEST_NUMBER = 2.0**40
"""A size leaves no room for larger numbers of steps than this, whatever it is."""


def _largest(holds: Callable[[int], bool], start: int) -> int:
    """The largest whole number near `start` for which this holds, if it holds for all below."""
    width, low, high = 16, None, None
    at = start
    while low is None or high is None:
        if abs(at) >= coefficients.MAX_STEP:
            break
        if holds(at):
            low, at = at, at + width
        else:
            high, at = at, at - width
        width *= 2
        if low is not None and high is not None:
            break
        width = min(width, 512)
    low = at if low is None else low
    high = at if high is None else high
    while high - low > 1:
        middle = (low + high) // 2
        if holds(middle):
            low = middle
        else:
            high = middle
    return int(np.clip(low, 1 - coefficients.MAX_STEP, coefficients.MAX_STEP - 1))


__all__ = ["Tempo"]
