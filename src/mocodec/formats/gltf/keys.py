"""Sparse cubic key frames: few keys whose splines keep every joint within a tolerance at every frame.

    track ─► longest segments within its tolerance ─► keys ─► forward kinematics ─► largest error ─► tolerances ─┐
                          ▲──────────────────────────────────────────────────────────────────────────────────────┘

A segment interpolates its two keys; its two tangents are fitted to the frames between by least squares. Segments share
only their keys, so the longest possible segments, one after the other, need about the fewest keys that a tolerance
allows. A rotation's tolerance is the tolerance in metres over the reach of the joints below.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ...errors import CannotEncode
from ...typing import Booleans, Floats, Integers

ROUNDS = 7
"""Tolerances that are tried for the tracks, to come close to the tolerance of the joints from below."""
RIDGE = 1e-9
"""Added to the normal equations: segments of one frame between two keys have two tangents."""


class Curve(NamedTuple):
    """A cubic spline. keys (k,): frames. values, in_tangents, out_tangents (k, width): tangents per frame."""

    keys: Integers
    values: Floats
    in_tangents: Floats
    out_tangents: Floats

    def sample(self, frames: int, is_rotation: bool) -> Floats:
        """Values (frames, width) at all frames."""
        at = np.arange(frames)
        last = len(self.keys) - 1
        key = np.clip(np.searchsorted(self.keys, at, side="right") - 1, 0, max(last - 1, 0))
        after = np.minimum(key + 1, last)
        span = np.maximum(self.keys[after] - self.keys[key], 1)[:, None]
        h00, h10, h01, h11 = _hermite(np.clip((at - self.keys[key])[:, None] / span, 0.0, 1.0))
        values = h00 * self.values[key] + h01 * self.values[after]
        values = values + span * (h10 * self.out_tangents[key] + h11 * self.in_tangents[after])
        return values / np.linalg.norm(values, axis=1, keepdims=True) if is_rotation else values


class Property(NamedTuple):
    """What is to be keyed: values (frames, width), whether they are quaternions, and the metres that a unit moves."""

    values: Floats
    is_rotation: bool
    reach: float


def fit(properties: Sequence[Property], error_of: Callable[[list[Floats]], float], tolerance_m: float) -> list[Curve]:
    """A curve for each property, so that `error_of` of their samples is at most the tolerance, metres.

    Raises CannotEncode if keys at every frame do not suffice.
    """
    frames = len(properties[0].values) if properties else 0
    best, low, high, share = list[Curve](), 0.0, np.inf, 0.5
    for _ in range(ROUNDS):
        curves = _curves(properties, [share * tolerance_m / p.reach for p in properties])
        error = error_of([c.sample(frames, p.is_rotation) for c, p in zip(curves, properties, strict=True)])
        if error <= tolerance_m:
            best, low = curves, share
            share = min(2 * share, (share + high) / 2)
        else:
            high = share
            share = (low + share) / 2 if low else share * min(0.9 * tolerance_m / error, 0.5)
    if not best:
        best = _curves(properties, [0.0 for _ in properties])
        if error_of([p.values for p in properties]) > tolerance_m:
            raise CannotEncode(f"key frames cannot keep the joints within {tolerance_m:g} m")
    return best


def _curves(properties: Sequence[Property], tolerances: Sequence[float]) -> list[Curve]:
    """A curve for each property by longest segments within its tolerance; all properties step together."""
    frames = len(properties[0].values)
    values = np.zeros((len(properties), frames, 4))
    for row, prop in zip(values, properties, strict=True):
        row[:, : prop.values.shape[1]] = prop.values
    limits, rotates = np.array(tolerances), np.array([prop.is_rotation for prop in properties])
    moves = np.abs(values - values[:, :1]).max(axis=(1, 2)) > limits
    keys: list[list[int]] = [[0] for _ in properties]
    tangents: list[list[Floats]] = [[] for _ in properties]
    flat = values.reshape(-1, 4)
    active = np.flatnonzero(moves) if frames > 1 else np.zeros(0, np.int64)
    search = _Search.start(active, np.zeros(len(active), np.int64), np.full(len(active), 2), flat, frames)
    while len(active):
        pairs, errors = _segments(flat, active * frames + search.begin, search.length, rotates[active])
        search = search.narrowed(pairs, errors <= limits[active])
        done = np.flatnonzero(search.good + 1 >= search.bad)
        for i in done.tolist():
            keys[active[i]].append(int(search.begin[i] + search.good[i]))
            tangents[active[i]].append(search.pairs[i])
        if len(done):
            begin = search.begin.copy()
            begin[done] += search.good[done]
            fresh = _Search.start(active, begin, search.good, flat, frames)
            moved = begin != search.begin
            search = _Search(*(np.where(_like(moved, old), new, old) for old, new in zip(search, fresh, strict=True)))
            going = begin < frames - 1
            active, search = active[going], _Search(*(part[going] for part in search))
    return [_assembled(p.values, np.array(k), t) for p, k, t in zip(properties, keys, tangents, strict=True)]


def _like(mask: Booleans, values: Floats) -> Booleans:
    """A mask (n,) that broadcasts over values (n, …)."""
    return mask.reshape(-1, *[1] * (values.ndim - 1))


class _Search(NamedTuple):
    """The search for the longest segment of each property: one of `good` frames fits, one of `bad` frames does not.

    begin: the first frame. most: frames to the end. length: the next to try. pairs (n, 2, 4): tangents of the segment
    of `good` frames.
    """

    begin: Integers
    most: Integers
    good: Integers
    bad: Integers
    length: Integers
    pairs: Floats

    @staticmethod
    def start(active: Integers, begin: Integers, guess: Integers, flat: Floats, frames: int) -> _Search:
        most = np.maximum(frames - 1 - begin, 1)
        at = active * frames + np.minimum(begin, frames - 2)
        straight = np.repeat((flat[at + 1] - flat[at])[:, None], 2, axis=1)
        length = np.minimum(np.maximum(guess, 2), most)
        return _Search(begin, most, np.ones_like(begin), most + 1, length, straight)

    def narrowed(self, pairs: Floats, fits: Booleans) -> _Search:
        """The search after trying `length`: doubled until it does not fit, then halved."""
        good, bad = np.where(fits, self.length, self.good), np.where(fits, self.bad, self.length)
        length = np.where(bad > self.most, np.minimum(2 * self.length, self.most), (good + bad) // 2)
        return _Search(self.begin, self.most, good, bad, length, np.where(fits[:, None, None], pairs, self.pairs))


def _assembled(values: Floats, keys: Integers, pairs: list[Floats]) -> Curve:
    """The curve of keys (k,) and the tangents of the segments between them."""
    width = values.shape[1]
    both, none = np.array(pairs).reshape(-1, 2, 4)[:, :, :width], np.zeros((1, width))
    return Curve(keys, values[keys], np.concatenate([none, both[:, 1]]), np.concatenate([both[:, 0], none]))


def _segments(flat: Floats, starts: Integers, lengths: Integers, rotates: Booleans) -> tuple[Floats, Floats]:
    """Least-squares tangents (n, 2, 4) per frame of segments of `flat` (frames, 4), and their largest errors (n,)."""
    first, last = flat[starts], flat[starts + lengths]
    straight = last - first
    pairs, errors = np.repeat(straight[:, None], 2, axis=1), np.zeros(len(starts))
    some = np.flatnonzero(lengths > 1)
    if len(some):
        counts = lengths[some] - 1
        bounds = np.concatenate([[0], np.cumsum(counts)[:-1]])
        owner = np.repeat(some, counts)
        step = np.arange(counts.sum()) - np.repeat(bounds, counts) + 1
        h00, h10, h01, h11 = _hermite((step / lengths[owner])[:, None])
        inner = flat[starts[owner] + step]
        base = h00 * first[owner] + h01 * last[owner]
        rest = inner - base - (h10 + h11) * straight[owner]
        a, b, c = (np.add.reduceat(x, bounds) for x in (h10 * h10, h10 * h11, h11 * h11))
        a, c = a * (1 + RIDGE), c * (1 + RIDGE)
        u, v = np.add.reduceat(h10 * rest, bounds), np.add.reduceat(h11 * rest, bounds)
        pairs[some] += np.stack([c * u - b * v, a * v - b * u], axis=1) / (a * c - b * b)[:, None]
        made = base + h10 * pairs[owner, 0] + h11 * pairs[owner, 1]
        turning = rotates[owner][:, None]
        made /= np.where(turning, np.maximum(np.linalg.norm(made, axis=1, keepdims=True), 1e-9), 1.0)
        off = np.sqrt(np.sum((made - inner) ** 2, axis=1)) * np.where(rotates[owner], 2.0, 1.0)
        errors[some] = np.maximum.reduceat(off, bounds)
    return pairs / lengths[:, None, None], errors


def _hermite(t: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """The cubic Hermite basis (glTF 2.0, appendix C.5): start, its tangent, end, its tangent."""
    return 2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, 3 * t**2 - 2 * t**3, t**3 - t**2
