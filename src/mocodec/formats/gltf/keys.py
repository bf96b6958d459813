"""Sparse cubic key frames: few keys whose splines keep every joint within a tolerance at every frame.

    track ─► longest segments within its tolerances ─► keys ─► forward kinematics ─► errors of joints ─┐
                          ▲── tolerances of a track at a frame: smaller where the joints below are off ─┘

A segment interpolates its two keys; its two tangents are fitted to the frames between by least squares. Segments share
only their keys, so the longest possible segments, one after the other, need about the fewest keys that the tolerances
allow. The tolerance of a rotation begins as the tolerance in metres over the reach of the joints below.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ...errors import CannotEncode
from ...typing import Booleans, Floats, Integers

ROUNDS = 4
"""Searches with tolerances that follow the errors of the joints."""
START = 0.7
"""First tolerance of a track, as a share of the tolerance of the joints."""
AIM, DAMPING, NEAR_FRAMES = 0.9, 0.7, 6
"""A tolerance is multiplied by (AIM · tolerance of the joints / their error within NEAR_FRAMES) ^ DAMPING."""
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
    """An animated value: values (frames, width), whether they are quaternions, and the metres that a unit moves."""

    values: Floats
    is_rotation: bool
    reach: float


def fit(properties: Sequence[Property], errors_of: Callable[[list[Floats]], Floats], tolerance_m: float) -> list[Curve]:
    """A curve for each property, so that no error exceeds the tolerance, metres.

    errors_of: from samples of the properties, for each property and frame the largest error (properties, frames) of
    what it moves, metres. Raises CannotEncode if keys at every frame do not suffice.
    """
    from scipy.ndimage import maximum_filter1d

    if not properties:
        return []
    frames = len(properties[0].values)
    values = np.zeros((len(properties), frames, 4))
    for row, prop in zip(values, properties, strict=True):
        row[:, : prop.values.shape[1]] = prop.values
    rotates = np.array([prop.is_rotation for prop in properties])
    reach = np.where(rotates, 2.0, 1.0) * [prop.reach for prop in properties]  # a quaternion moves half its angle

    def sampled(is_key: Booleans) -> tuple[list[Curve], Floats, Floats]:
        curves = _through(values, is_key, rotates, properties)
        samples = [c.sample(frames, p.is_rotation) for c, p in zip(curves, properties, strict=True)]
        off = [np.linalg.norm(s - p.values, axis=1) for s, p in zip(samples, properties, strict=True)]
        return curves, errors_of(samples), np.array(off) * reach[:, None]

    tolerances = np.repeat((START * tolerance_m / reach)[:, None], frames, axis=1)
    is_key = _longest_segments(values, tolerances, rotates)
    for _ in range(ROUNDS):
        _, errors, _ = sampled(is_key)
        around = maximum_filter1d(errors, 2 * NEAR_FRAMES + 1, axis=1, mode="nearest")
        ratio = (AIM * tolerance_m / np.maximum(around, 1e-3 * tolerance_m)) ** DAMPING
        tolerances = tolerances * np.clip(ratio, 0.4, 2.0)
        is_key = _longest_segments(values, tolerances, rotates)
    while True:
        curves, errors, own = sampled(is_key)
        if errors.max() <= tolerance_m:
            return curves
        more = _split(is_key, errors, own, tolerance_m)
        if not (more & ~is_key).any():
            raise CannotEncode(f"key frames cannot keep the joints within {tolerance_m:g} m")
        is_key |= more


def still(curve: Curve, frames: int) -> Curve:
    """A curve of one key with the same key at the last frame."""
    at = np.unique([0, frames - 1])
    values, none = np.repeat(curve.values, len(at), axis=0), np.zeros((len(at), curve.values.shape[1]))
    return Curve(at, values, none, none)


def _split(is_key: Booleans, errors: Floats, own: Floats, tolerance_m: float) -> Booleans:
    """Keys to add: in each run of frames beyond the tolerance, at its peak, of the property that is farthest off.

    errors, own (properties, frames): the largest error of what a property moves, and its part in it, metres. Where only
    keys are beyond the tolerance, every property gets a key.
    """
    worst = errors.max(axis=0)
    is_beyond = worst > tolerance_m
    run = np.cumsum(np.diff(is_beyond, prepend=False) & is_beyond) * is_beyond
    more = np.zeros_like(is_key)
    for number in range(1, int(run.max()) + 1):
        frames = np.flatnonzero(run == number)
        at = frames[worst[frames].argmax()]
        moved = np.where((errors[:, at] > tolerance_m) & ~is_key[:, at], own[:, at], -1.0)
        more[moved.argmax() if moved.max() >= 0 else slice(None), at] = True
    return more


def _through(values: Floats, is_key: Booleans, rotates: Booleans, properties: Sequence[Property]) -> list[Curve]:
    """The curves with these keys (properties, frames), whose tangents fit the frames between."""
    owner, at = np.nonzero(is_key)
    begins = np.flatnonzero(owner[1:] == owner[:-1])
    frames = is_key.shape[1]
    starts, lengths = owner[begins] * frames + at[begins], np.diff(at)[begins]
    none = np.ones(values.shape[0] * frames)
    pairs, _ = _segments(values.reshape(-1, 4), none, starts, lengths, rotates[owner[begins]])
    tangents_in, tangents_out = np.zeros((2, len(at), 4))
    tangents_out[begins], tangents_in[begins + 1] = pairs[:, 0], pairs[:, 1]
    curves = list[Curve]()
    for number, prop in enumerate(properties):
        mine, width = owner == number, prop.values.shape[1]
        keys = at[mine]
        curves.append(Curve(keys, prop.values[keys], tangents_in[mine, :width], tangents_out[mine, :width]))
    return curves


def _longest_segments(values: Floats, tolerances: Floats, rotates: Booleans) -> Booleans:
    """Keys (properties, frames) between the longest segments within the tolerances; all properties step together.

    values (properties, frames, 4), tolerances (properties, frames). A property that stays within them has one key.
    """
    count, frames = tolerances.shape
    is_key = np.zeros((count, frames), bool)
    is_key[:, 0] = True
    flat, limits = values.reshape(-1, 4), tolerances.reshape(-1)
    moves = (np.sqrt(np.sum((values - values[:, :1]) ** 2, axis=2)) > tolerances).any(axis=1)
    active = np.flatnonzero(moves)
    search = _Search.start(np.zeros(len(active), np.int64), np.full(len(active), 2), frames)
    while len(active):
        starts = active * frames + search.begin
        _, errors = _segments(flat, limits, starts, search.length, rotates[active])
        search = search.narrowed(errors <= 1.0)
        done = search.good + 1 >= search.bad
        if done.any():
            begin = search.begin + np.where(done, search.good, 0)
            is_key[active[done], begin[done]] = True
            fresh = _Search.start(begin, search.good, frames)
            search = _Search(*(np.where(done, new, old) for old, new in zip(search, fresh, strict=True)))
            going = begin < frames - 1
            active, search = active[going], _Search(*(part[going] for part in search))
    return is_key


class _Search(NamedTuple):
    """The search for the longest segment of each property: one of `good` frames fits, one of `bad` frames does not.

    begin: the first frame. most: frames to the end. length: the next to try.
    """

    begin: Integers
    most: Integers
    good: Integers
    bad: Integers
    length: Integers

    @staticmethod
    def start(begin: Integers, guess: Integers, frames: int) -> _Search:
        most = np.maximum(frames - 1 - begin, 1)
        return _Search(begin, most, np.ones_like(begin), most + 1, np.minimum(np.maximum(guess, 2), most))

    def narrowed(self, fits: Booleans) -> _Search:
        """The search after trying `length`: doubled until it does not fit, then halved."""
        good, bad = np.where(fits, self.length, self.good), np.where(fits, self.bad, self.length)
        length = np.where(bad > self.most, np.minimum(2 * self.length, self.most), (good + bad) // 2)
        return _Search(self.begin, self.most, good, bad, length)


def _segments(
    flat: Floats, limits: Floats, starts: Integers, lengths: Integers, rotates: Booleans
) -> tuple[Floats, Floats]:
    """Least-squares tangents (n, 2, 4) per frame of segments of `flat` (frames, 4).

    Also their largest errors (n,), each as a share of its frame's limit.
    """
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
        off = np.sqrt(np.sum((made - inner) ** 2, axis=1)) / limits[starts[owner] + step]
        errors[some] = np.maximum.reduceat(off, bounds)
    return pairs / lengths[:, None, None], errors


def _hermite(t: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """The cubic Hermite basis (glTF 2.0, appendix C.5): start, its tangent, end, its tangent."""
    return 2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, 3 * t**2 - 2 * t**3, t**3 - t**2
