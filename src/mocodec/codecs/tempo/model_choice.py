"""Which model makes a recording smallest.

recording ─fit─► models of each type ─price on a few chunks─► the cheapest, with the coefficients of these chunks
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ... import parallel
from ...errors import CannotEncode, Corrupt
from ...motion import Motion
from ...typing import Floats
from .chunk import ChunkEncoder
from .coding import coefficients, quantise
from .coding.contexts import OCTAVE
from .coding.rows import step_size
from .header import StreamHeader
from .models import MODELS, Recording, directions, points, prior
from .models.model import Model
from .models.stored_basis import MOST_DIMENSIONS

AUTO, TRANSFORM, DIRECT = "auto", "transform", "direct"
KNOWN_NAME_MODELS = ("points-prior", "directions-prior")
"""Where the prior knows the points by name, the other models are not tried."""
PRICED_CHUNKS = 4
CLEARLY = 0.85
"""One chunk decides between two models of known points where the cheaper takes less than this share of the other."""
WORTH_PRIOR = 0.25
"""Markers are placed on the prior's bones only where the stored basis takes at least this share of the bytes."""
STILL_POINTS, STILL_SHARE = 64, 0.5
"""A skeleton of more points than STILL_POINTS is not matched with the prior's where the pose at rest takes more than
STILL_SHARE of the bytes: hardly anything moves, and the prior's coefficients take more bytes than its basis saves."""
FINER_UP_TO = 0.65
"""With very many points a stored basis in finer rounding is kept where it takes at most this share of the bytes; where
it takes more, the coarser one is tried too. With fewer points both are tried, since trials cost little, and a
still recording may need no more than a finer pose."""
REFINED = 2
"""How often the step for a mean error is refined, before a basis is rounded by it."""
COARSER_MODELS = 7
"""Models of up to this many coarser steps, two octaves apart, are tried where one takes more than half of a size."""
ERROR_SLOPE = 0.85
"""Rise of the logarithm of the mean error per logarithm of the step."""


@dataclass(frozen=True, eq=False)
class Choice:
    """spectra: coefficients of the chunks that were priced, by number. basis_bytes: of the stored basis."""

    header: StreamHeader
    model: Model
    spectra: Mapping[int, Floats] = field(default_factory=dict)
    basis_bytes: int = 0


def choose(
    recording: Recording, model: str = AUTO, mean_error: float | None = None, types: Collection[str] | None = None
) -> Choice:
    """The model that makes the recording smallest in about its step, among those of the given type, or of all.

    mean_error: metres; the recording's step is then only a first guess. types: the only ones of all that are tried.
    Raises CannotEncode where no model of the type fits.
    """
    if model == DIRECT or (types is not None and not any(name in types for name in MODELS)):
        return without_model(recording.like)
    every = model in (AUTO, TRANSFORM)
    stored = recording.frames >= 2 and 3 * recording.like.points <= MOST_DIMENSIONS
    if every and mean_error and stored and not known_by_name(recording):
        recording = _with_refined_step(recording, mean_error)
    if (found := _cheapest(recording, model, types)) is not None:
        return found
    if not every:
        raise CannotEncode(f"the model {model!r} does not fit this motion; model='auto' takes one that does")
    return without_model(recording.like)


def choose_for_size(recording: Recording, model: str, size: int) -> Choice:
    """`choose`, for a size in bytes: at the recording's step or a coarser one, whose model takes at most half of it."""
    choice = choose(recording, model)
    for coarser in range(1, COARSER_MODELS + 1):
        if len(choice.header.pack()) <= size / 2:
            break
        choice = choose(recording.with_step(recording.step + coarser * 2 * OCTAVE), model)
    return choice


def known_by_name(recording: Recording) -> bool:
    """Whether the prior knows the points by name."""
    return prior.for_points().joints.columns(recording.like.names) is not None


def _cheapest(recording: Recording, model: str, types: Collection[str] | None) -> Choice | None:
    """The cheapest of the models tried, None where none fits. Of a stream that has not begun, the first that fits.

    Models of directions are tried first, and markers on the prior's bones last: fitting these takes longest, and they
    save hardly more than the bytes of a stored basis.
    """
    named, every = known_by_name(recording), model in (AUTO, TRANSFORM)
    names = [model] if not every else KNOWN_NAME_MODELS if named else list(MODELS)
    names = [name for name in names if types is None or name in types]
    chunks = len(recording.chunks)
    numbers = range(0, chunks, max(1, -(-chunks // PRICED_CHUNKS)))
    if named and every and chunks > 1 and (found := _clearly_cheapest(recording, _in_order_tried(names), chunks // 2)):
        return found
    best: Choice | None = None
    least = np.inf
    for name in _in_order_tried(names):
        on_bones = not named and name == "points-prior"
        few_bytes = best is not None and len(best.header.pack()) < WORTH_PRIOR * least
        many = recording.like.points > points.MANY_POINTS  # not tried on the prior's bones beside a stored basis
        if best and on_bones and (few_bytes or many):
            continue
        if best and name == "directions-prior" and _hardly_moves(best, least):
            continue
        for candidate in _fitted(name, recording):
            if not recording.chunks:
                return candidate
            price, candidate = _priced(candidate, recording, numbers)
            if price >= least:
                break  # the others of this type differ little
            best, least = candidate, price
            if many and len(candidate.header.pack()) <= FINER_UP_TO * price:
                break
    return best


def _hardly_moves(choice: Choice, size: float) -> bool:
    """Whether most bytes of many points are those of the pose at rest. choice: with a stored basis; size: its bytes."""
    at_rest = len(choice.header.pack()) - choice.basis_bytes
    return choice.model.points > STILL_POINTS and at_rest > STILL_SHARE * size


def _in_order_tried(names: Sequence[str]) -> list[str]:
    """In the order in which models are tried."""
    return sorted(names, key=lambda name: -MODELS[name].number)


def _clearly_cheapest(recording: Recording, names: Sequence[str], number: int) -> Choice | None:
    """The model that is by far the cheapest for one chunk; None where this chunk does not decide."""
    candidates = [candidate for name in names for candidate in _fitted(name, recording)]
    tried = parallel.over(lambda c: _priced(c, recording, range(number, number + 1)), candidates)
    priced = sorted(tried, key=lambda each: each[0])
    is_clear = len(priced) == 1 or (priced and priced[0][0] < CLEARLY * priced[1][0])
    return priced[0][1] if is_clear else None


def _fitted(name: str, recording: Recording) -> Iterator[Choice]:
    """The models of a type. Those of named points are the decoder's own, which it keeps for other recordings too."""
    named = known_by_name(recording)
    for fitted in MODELS[name].fit(recording):
        header = StreamHeader.of_model(name, fitted)
        own = fitted.basis if isinstance(fitted, directions.StoredDirections | points.StoredPoints) else None
        basis_bytes = 0 if own is None else len(own.pack())
        try:
            model = header.read_model(recording.like) if named else fitted.model(recording.like)
            yield Choice(header, model, basis_bytes=basis_bytes)
        except Corrupt:  # numbers that a decoder would refuse
            continue


def without_model(like: Motion) -> Choice:
    """For engines that need none."""
    return Choice(StreamHeader(), Model.without_rows(like.names, like.rate))


def _priced(candidate: Choice, recording: Recording, numbers: range) -> tuple[float, Choice]:
    """Bytes, with the squared errors of points at their price in bits, from some of the chunks; and the candidate."""
    model, chunks = candidate.model, recording.chunks
    encoders = [ChunkEncoder(model, chunks[i], spectrum=recording.spectrum(model, i)) for i in numbers]
    price_of_error = 1 / (quantise.SLOPE * float(step_size(recording.step)) ** 2)
    trials = list(parallel.over(lambda e: e.trial(recording.step), encoders))
    bits = sum(t.quantised.bits + price_of_error * t.squared for t in trials)
    scale = recording.frames / max(1, sum(e.frames for e in encoders))
    spectra = {i: e.spectrum for i, e in zip(numbers, encoders, strict=True) if e.spectrum is not None}
    return len(candidate.header.pack()) + scale * bits / 8, replace(candidate, spectra=spectra)


def _with_refined_step(recording: Recording, mean_error: float) -> Recording:
    """The recording with the step at which a stored basis gives about this mean error."""
    sample = recording.chunks[:: max(1, -(-len(recording.chunks) // PRICED_CHUNKS))]
    for _ in range(REFINED):
        try:
            model = points.stored_points(recording, recording.step).model(recording.like)
        except Corrupt:  # numbers that a decoder would refuse
            break
        recording = recording.with_step(_nearer_step(model, sample, recording.step, mean_error))
    return recording


def _nearer_step(model: Model, sample: Sequence[Floats], step: int, mean_error: float) -> int:
    encoders = [ChunkEncoder(model, s) for s in sample]
    error = sum(e.trial(step).distance for e in encoders)
    found = error / max(1, sum(s.shape[0] * s.shape[1] for s in sample))
    octaves = float(np.log2(max(found, mean_error / 8) / mean_error))
    change = round(OCTAVE * octaves / ERROR_SLOPE)
    return int(np.clip(step - change, 1 - coefficients.MAX_STEP, coefficients.MAX_STEP - 1))
