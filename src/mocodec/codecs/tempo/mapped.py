"""Points that the prior does not know, as points on the bones that it knows: its model of them, for a few bytes each.

    prior of bones: for each bone its joint, and three points that turn with it ──► components, spreads
    the bone of each point, and where it sits on it ──► what the point makes of joint and turn   W
    components · Wᵀ ─orthonormal, strongest first─► bases of the points     Σ over components ─► spreads of their rows

A point that is fixed to a bone is exactly linear in where the bone's joint is and how the bone is turned, so what the
prior knows about these it knows about any markers or joints. What skin, noise and other people's ways do on top is
given a level.

The coder depends on the spreads, so all arithmetic here is on single numbers in a written order: no product of matrices
that a machine may sum in its own way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...motion import Floats
from . import contexts
from .model import EDGES_MHZ, HEADING, POSE, Model
from .prior import Bones, PointSet, Prior

Integers = NDArray[np.int64]

SCALE_UNIT, OFFSET_UNIT = 1 / 64, 1 / 32
"""Steps of the body's size against the prior's, and of a point's offset from its joint, metres."""
REACH_M = 0.15
"""How far from its joint a turning point is: turns then count as much as they do at a marker's usual distance."""
LEVELS = 5
"""What bones explain, at 1 Hz and how it rises an octave; what they do not, the same; and white noise."""
LEVEL_UNIT = 4
"""Levels are stored in eighths of an octave."""
MEAN_BELOW = 128
"""A component's mean over a chunk against its movement at 0.2 Hz over the root of the frames (1/32 octave)."""
ROUNDS = 1
"""How often the bases are brought nearer to the strongest directions."""
FAINTEST = 1e-10
"""Directions that move less than this share of the strongest (squared) are left to what is not explained."""


@dataclass(frozen=True, eq=False)
class Stored:
    """What is stored.

    digits: the mean pose is in 2^(−digits) m. pose (points, 3): less where the prior's body in its mean pose has the
    points, if `on_body`. scale: of the body. where (points,): each point's bone, −1 for none. offsets (points, 3): from
    the bone's joint, along the axes that the bone has at rest. levels (5,).
    """

    digits: int
    pose: Integers
    on_body: bool
    scale: int
    where: Integers
    offsets: Integers
    levels: Integers

    def pack(self) -> bytes:
        pose = self.pose if self.on_body else np.diff(self.pose, axis=0, prepend=0)
        parts = [coder.pack(a) for a in (pose, self.where[:, None] + 1, self.offsets)]
        head = [varint.signed(int(n)) for n in (self.digits * 2 + self.on_body, self.scale, *self.levels)]
        return varint.write([*head, *map(len, parts)]) + b"".join(parts)

    @classmethod
    def unpack(cls, data: bytes, points: int, bones: Bones) -> tuple[Stored, bytes]:
        """And the bytes that follow. Raises Corrupt."""
        numbers, at = varint.read(data, 2 + LEVELS + 3)
        first, scale, *levels = (varint.unsigned(n) for n in numbers[:-3])
        parts = []
        for size, columns in zip(numbers[-3:], (3, 1, 3), strict=True):
            if at + size > len(data):
                raise Corrupt("tempo: a body that ends too early")
            parts.append(coder.unpack(data[at : at + size], (points, columns)))
            at += size
        pose, where, offsets = parts[0], parts[1][:, 0] - 1, parts[2]
        fits = -120 <= first <= 120 and 1 <= scale <= 4096 and max(map(abs, levels)) <= 2000
        if not fits or np.abs(pose).max() > 1 << 40 or np.abs(offsets).max() > 1 << 16:
            raise Corrupt("tempo: a body that is out of range")
        if where.min() < -1 or where.max() >= len(bones.names):
            raise Corrupt("tempo: a bone that is not there")
        on_body = bool(first & 1)
        pose = pose if on_body else np.cumsum(pose, axis=0)
        return cls(first >> 1, pose, on_body, scale, where, offsets, np.array(levels, np.int64)), data[at:]

    @property
    def weights(self) -> Floats:
        """What each point makes of its bone's joint and of its three turning points, (points, 4)."""
        return shares(self.where, np.asarray(self.offsets * OFFSET_UNIT, np.float64), self.scale * SCALE_UNIT)

    def place(self, bones: Bones) -> Floats:
        """The mean pose, (points, 3), metres."""
        stored = np.ldexp(self.pose.astype(np.float64), -self.digits)
        return stored + on_body(self, bones) if self.on_body else stored


def on_body(stored: Stored, bones: Bones) -> Floats:
    """Where the prior's body in its mean pose has the points, about their mean: (points, 3)."""
    return spread_over(bones.set.pose.reshape(1, -1), stored.weights, stored.where).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Movements:
    """What bones explain of points: for each band of frequencies orthonormal rows (3 points − 3, 3 points), and how
    large the prior makes them at each frequency, squared: (rows, frequencies)."""

    bases: tuple[Floats, ...]
    explained: tuple[Floats, ...]


def movements(stored: Stored, bones: Bones) -> Movements:
    weights = stored.weights
    free = 3 * len(weights) - 3
    strength = power(bones.set.spreads[POSE:])
    alike = np.tile(np.eye(3), len(weights)) / np.sqrt(len(weights))  # moves of all points
    bases, explained = [], []
    for band, modes in enumerate(bones.set.bases):
        moved = spread_over(modes, weights, stored.where)
        basis = directions(moved * np.sqrt(strength[:, nodes_of(band)].max(axis=1))[:, None], free)
        variance = np.zeros((free, len(bones.usual)))
        variance[: len(basis)] = times(times(basis, moved.T.copy()) ** 2, strength)
        bases.append(completed(basis, free, alike))
        explained.append(variance)
    return Movements(tuple(bases), tuple(explained))


def model(stored: Stored, found: Movements, bones: Bones, prior: Prior, names: tuple[str, ...], rate: float) -> Model:
    """The model of points on bones, once their movements are known."""
    like = bones.set
    spreads = spreads_of(found, bones.usual, stored.levels)
    moved, means = of_whole_body(like, len(names))
    points = PointSet(
        names,
        stored.place(bones),
        found.bases,
        np.concatenate([moved, spreads]),
        np.concatenate([means, spreads[:, 2] - MEAN_BELOW]),
    )
    return Model(points, prior, rate)


def of_whole_body(like: PointSet, points: int) -> tuple[Integers, Integers]:
    """Spreads (rows, frequencies) and means (rows,) of heading and place, as known of other points, of so many."""
    change = int(contexts.log2(np.array([len(like.names)]))[0] - contexts.log2(np.array([points]))[0]) // 2
    moved, means = like.spreads[:POSE].copy(), like.means[:POSE].copy()
    moved[HEADING + 1 :] -= change
    means[HEADING + 1 :] -= change
    return moved, means


def spreads_of(found: Movements, usual: Integers, levels: Integers) -> Integers:
    """The spreads of the rows, (rows, frequencies), at these levels. usual (frequencies,): a middling component's."""
    gain, gain_rise, left, left_rise, white = (int(v) * LEVEL_UNIT for v in levels)
    gains = power(gain + gain_rise * _OCTAVES // contexts.OCTAVE)
    noise = power(usual + left + left_rise * _OCTAVES // contexts.OCTAVE) + power(np.full(len(_OCTAVES), white))
    curves = [contexts.log2_of(e * gains + noise) // 2 for e in found.explained]
    return np.stack([curves[_band_of(f)][:, i] for i, f in enumerate(contexts.BANDS_MHZ)], axis=1)


_OCTAVES = contexts.log2(np.maximum(np.array(contexts.BANDS_MHZ), 1)) - contexts.log2(np.array([1000]))
_OCTAVES[0] = _OCTAVES[1]


def shares(where: Integers, offsets: Floats, scale: float) -> Floats:
    """What each point makes of its bone's joint and three turning points, (points, 4); nothing without a bone."""
    own = offsets / REACH_M
    joint = scale - ((own[:, :1] + own[:, 1:2]) + own[:, 2:])
    return np.where((where >= 0)[:, None], np.concatenate([joint, own], axis=1), 0.0)


def spread_over(modes: Floats, weights: Floats, where: Integers) -> Floats:
    """Components (modes, 4 bones · 3) as movements of the points about their mean: (modes, 3 points)."""
    found = modes.reshape(len(modes), -1, 4, 3)[:, where]
    moved = found[:, :, 0] * weights[:, 0, None]
    for i in range(1, 4):
        moved = moved + found[:, :, i] * weights[:, i, None]
    mean = sum_of(moved.swapaxes(0, 1)) / len(weights)
    return (moved - mean[:, None]).reshape(len(modes), -1)


def nodes_of(band: int) -> slice:
    """The frequencies among `BANDS_MHZ` that one basis serves."""
    inside = [i for i, f in enumerate(contexts.BANDS_MHZ) if _band_of(f) == band]
    return slice(inside[0], inside[-1] + 1)


def _band_of(millihertz: int) -> int:
    return sum(millihertz > e for e in EDGES_MHZ)


def directions(scaled: Floats, most: int) -> Floats:
    """Orthonormal directions (k, 3 points) of movements (modes, 3 points), strongest first."""
    found = orthonormal(scaled, most)
    for _ in range(ROUNDS):
        if len(found):
            found = orthonormal(times(times(found, scaled.T.copy()), scaled), most)
    return found


def orthonormal(rows: Floats, most: int, shortest: float = 1e-30) -> Floats:
    """Gram–Schmidt on rows, the longest that is left first; rows too short (squared) to say anything are dropped."""
    left = rows.T.copy()
    size = sum_of(left**2)
    floor = max(shortest, float(size.max(initial=0.0)) * FAINTEST)
    out = np.zeros((left.shape[0], min(most, len(rows))))
    for count in range(out.shape[1]):
        longest = int(size.argmax())
        if size[longest] < floor:
            return out[:, :count].T.copy()
        direction = left[:, longest] / np.sqrt(size[longest])
        direction = direction - sum_of((out[:, :count] * sum_of(out[:, :count] * direction[:, None])).T)
        unit = direction / np.sqrt(sum_of(direction**2))
        out[:, count] = unit
        left -= unit[:, None] * sum_of(left * unit[:, None])
        size = sum_of(left**2)
        size[longest] = 0.0
    return out.T.copy()


def completed(rows: Floats, count: int, without: Floats) -> Floats:
    """Orthonormal rows with more after them, up to `count`, by Householder's reflections, and none of other such rows.
    The coder does not depend on these."""
    n = rows.shape[1]
    known = np.concatenate([rows, without])
    mirrors: list[Floats] = []
    for i in range(len(known)):
        mirror = known[i, i:].copy()
        mirror[0] += 1.0 if mirror[0] >= 0 else -1.0
        mirror /= np.sqrt(mirror @ mirror)
        known[:, i:] -= np.outer(known[:, i:] @ mirror, 2 * mirror)
        mirrors.append(mirror)
    missing = np.eye(n)[len(known) :]
    for i, mirror in reversed(list(enumerate(mirrors))):
        missing[:, i:] -= np.outer(missing[:, i:] @ mirror, 2 * mirror)
    return np.concatenate([rows, missing])[:count]


def power(logs: Integers) -> Floats:
    """4^log of logarithms in 1/32 octave, from a table: the same on every machine."""
    twice = 2 * logs
    return np.ldexp(_FRACTIONS[twice & 31], twice >> 5)


_FRACTIONS = np.array([round(2 ** (i / 32) * (1 << 20)) / (1 << 20) for i in range(32)])


def times(a: Floats, b: Floats) -> Floats:
    """The product of matrices, summed in order."""
    out = np.zeros((len(a), b.shape[1]))
    for column, row in zip(a.T, b, strict=True):
        out += column[:, None] * row
    return out


def sum_of(a: Floats) -> Floats:
    """The sum along the first axis, by halves."""
    while len(a) > 1:
        half = len(a) // 2
        first = a[:half] + a[half : 2 * half]
        if len(a) % 2:
            first[0] = first[0] + a[-1]
        a = first
    return a[0] if len(a) else np.zeros(a.shape[1:])
