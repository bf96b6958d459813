"""Synthetic recordings of more than one person alone: props, an animal, a robe, several people, empty frames.

    solids (cones, boxes) of a frame ─► fresh random points on their common surface ─► PointClouds

As in `sequences.record`, every frame has new points, and the seed determines all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mocodec.pointcloud import PointClouds
from mocodec.testing import sequences
from mocodec.testing.actors import Actor
from mocodec.testing.sequences import Performance
from mocodec.typing import Booleans, Floats, Integers

RATE = 15.0
PERSON_POINTS, DOG_POINTS, CHAIR_POINTS, ROBE_POINTS = 8000, 5000, 3000, 6000
WAVES = 5  # folds around a robe


@dataclass(frozen=True, eq=False)
class Cone:
    """A truncated cone. start, stop (3,): centres of its discs; near, far: their radii, metres."""

    start: Floats
    stop: Floats
    near: float
    far: float

    @property
    def area(self) -> float:
        """Surface area, square metres."""
        return float(np.pi * self._parts.sum())

    @property
    def _parts(self) -> Floats:
        """Areas of the mantle and of both discs, divided by π."""
        slant = np.hypot(np.linalg.norm(self.stop - self.start), self.near - self.far)
        return np.array([(self.near + self.far) * slant, self.near**2, self.far**2])

    @property
    def frame(self) -> tuple[Floats, float, Floats, Floats]:
        """Axis, length, and two directions across."""
        axis = self.stop - self.start
        length = float(np.linalg.norm(axis))
        axis = axis / length
        side = np.cross(axis, [1.0, 0, 0] if abs(axis[0]) < 0.9 else [0, 1.0, 0])
        side /= np.linalg.norm(side)
        return axis, length, side, np.cross(axis, side)

    def sample(self, points: int, rng: np.random.Generator) -> Floats:
        """Random points (n, 3), uniform over the surface."""
        axis, length, side, across = self.frame
        part = rng.choice(3, points, p=self._parts / self._parts.sum())
        share, turn, out = rng.random(points), rng.uniform(0, 2 * np.pi, points), np.sqrt(rng.random(points))
        along = _along_cone(self.near, self.far, share)
        along = np.where(part == 0, along, part - 1.0)
        radius = (self.near + along * (self.far - self.near)) * np.where(part == 0, 1.0, out)
        around = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * across
        return self.start + (along * length)[:, None] * axis + radius[:, None] * around

    def contains(self, points: Floats) -> Booleans:
        """Whether each of the points (n, 3) lies inside, by more than 2 mm."""
        axis, length, *_ = self.frame
        along = (points - self.start) @ axis
        away = np.linalg.norm(points - self.start - along[:, None] * axis, axis=1)
        radius = self.near + np.clip(along / length, 0, 1) * (self.far - self.near)
        return (along > 0.002) & (along < length - 0.002) & (away < radius - 0.002)


@dataclass(frozen=True, eq=False)
class Box:
    """An axis-aligned box. low, high (3,): corners, metres."""

    low: Floats
    high: Floats

    @property
    def area(self) -> float:
        """Surface area, square metres."""
        return float(2 * self._faces.sum())

    @property
    def _faces(self) -> Floats:
        x, y, z = self.high - self.low
        return np.array([y * z, x * z, x * y])

    def sample(self, points: int, rng: np.random.Generator) -> Floats:
        """Random points (n, 3), uniform over the surface."""
        axis = rng.choice(3, points, p=self._faces / self._faces.sum())
        places = rng.uniform(self.low, self.high, (points, 3))
        rows = np.arange(points)
        places[rows, axis] = np.where(rng.random(points) < 0.5, self.low[axis], self.high[axis])
        return places

    def contains(self, points: Floats) -> Booleans:
        """Whether each of the points (n, 3) lies inside, by more than 2 mm."""
        inside = (points > self.low + 0.002) & (points < self.high - 0.002)
        return inside[:, 0] & inside[:, 1] & inside[:, 2]


def _along_cone(near: float, far: float, share: Floats) -> Floats:
    """Position between the discs, 0 … 1, before which this share of the mantle's area lies."""
    if abs(far - near) < 1e-9:
        return share
    return (np.sqrt(near**2 + share * (far**2 - near**2)) - near) / (far - near)


Solids = Sequence[Cone | Box]


def surface_points(solids: Solids, points: int, rng: np.random.Generator) -> tuple[Floats, Integers]:
    """Random points (points, 3) on the outer surface of all solids together, and the solid (points,) of each."""
    area = np.array([solid.area for solid in solids])
    found, owners = np.zeros((0, 3)), np.zeros(0, np.int64)
    while len(found) < points:
        owner = np.sort(rng.choice(len(solids), 2 * points, p=area / area.sum()))
        places = np.concatenate([s.sample(int((owner == k).sum()), rng) for k, s in enumerate(solids)])
        hidden = np.any([solid.contains(places) for solid in solids], axis=0)
        chosen = rng.permutation(np.flatnonzero(~hidden))
        found, owners = np.concatenate([found, places[chosen]]), np.concatenate([owners, owner[chosen]])
    return found[:points], owners[:points]


def chair_solids(place: Sequence[float]) -> Solids:
    """A seat, a back behind it (z < 0) and four legs."""
    at = np.asarray(place, float)
    corners = [((-0.22, 0.42, -0.2), (0.22, 0.45, 0.22)), ((-0.22, 0.45, -0.22), (0.22, 0.9, -0.19))]
    corners += [((x, 0.0, z), (x + 0.03, 0.42, z + 0.03)) for x in (-0.22, 0.19) for z in (-0.22, 0.19)]
    return [Box(at + low, at + high) for low, high in corners]


def dog_solids(seconds: float) -> Solids:
    """A dog that walks along x at 0.6 m/s: trunk, neck, head, muzzle, tail, and four legs that swing."""
    at = np.array([0.6 * seconds - 0.5, 0.52 + 0.01 * np.sin(12 * seconds), 0.0])
    wag = 0.08 * np.sin(9 * seconds)

    def cone(start: Sequence[float], stop: Sequence[float], near: float, far: float) -> Cone:
        return Cone(at + np.asarray(start), at + np.asarray(stop), near, far)

    result = [
        cone((-0.3, 0, 0), (0.3, 0.02, 0), 0.11, 0.14),
        cone((0.25, 0.04, 0), (0.45, 0.2, 0), 0.1, 0.07),
        cone((0.4, 0.21, 0), (0.56, 0.21, 0), 0.085, 0.075),
        cone((0.55, 0.19, 0), (0.68, 0.17, 0), 0.045, 0.035),
        cone((-0.28, 0.05, 0), (-0.52, 0.2, wag), 0.03, 0.015),
    ]
    for x, phase in ((0.24, 0.0), (-0.24, np.pi / 2)):
        for z in (-0.08, 0.08):
            swing = 0.45 * np.sin(8 * seconds + phase + (np.pi if z > 0 else 0.0))
            knee = np.array([x + 0.24 * np.sin(swing), -0.24 * np.cos(swing), z])
            foot = knee + 0.26 * np.array([np.sin(swing - 0.3), -np.cos(swing - 0.3), 0])
            result += [cone((x, 0.0, z), knee.tolist(), 0.06, 0.04), cone(knee.tolist(), foot.tolist(), 0.038, 0.025)]
    return result


def robe_points(hips: Floats, seconds: float, points: int, rng: np.random.Generator) -> Floats:
    """A skirt with folds from the chest (0.3 m above the hips (3,)) to the ankles; it swings."""
    height, turn = rng.random(points) ** 0.8, rng.uniform(0, 2 * np.pi, points)
    fold = 0.025 * height * np.sin(WAVES * turn + 3 * seconds) + 0.02 * height * np.sin(2 * turn - 5 * seconds)
    radius = 0.2 + 0.18 * height + fold
    middle = hips + np.array([0.0, 0.3, 0.0]) - np.array([0.0, 1.0, 0.0]) * (height * (hips[1] + 0.2))[:, None]
    sway = 0.05 * np.sin(4 * seconds) * height[:, None] * np.array([1.0, 0, 0])
    return middle + sway + radius[:, None] * np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)


def _recorded(frames: int, points_of: Callable[[int, np.random.Generator], Floats]) -> PointClouds:
    places = [points_of(k, np.random.default_rng([7, k])).astype(np.float32).astype(np.float64) for k in range(frames)]
    return PointClouds(places, RATE, up="y")


def _positions(performance: Performance | tuple[Performance, Performance], frames: int) -> list[Floats]:
    return [np.asarray(p) for p in sequences.record(performance, PERSON_POINTS, seed=1).positions[:frames]]


def chair(actor: Actor, frames: int) -> PointClouds:
    """A chair."""
    return _recorded(frames, lambda _, rng: surface_points(chair_solids((0, 0, 0)), CHAIR_POINTS, rng)[0])


def dog(actor: Actor, frames: int) -> PointClouds:
    """A walking dog."""
    return _recorded(frames, lambda k, rng: surface_points(dog_solids(k / RATE), DOG_POINTS, rng)[0])


def person_and_chair(actor: Actor, frames: int) -> PointClouds:
    """Jumping jacks in front of a chair."""
    person = _positions(sequences.jumping_jacks(actor, frames, RATE), frames)
    solids = chair_solids((0.1, 0, -0.8))
    return _recorded(frames, lambda k, rng: np.concatenate([person[k], surface_points(solids, CHAIR_POINTS, rng)[0]]))


def two_people(actor: Actor, frames: int) -> PointClouds:
    """Two people: one does jumping jacks, one turns."""
    people = _positions(sequences.pair(actor, frames, RATE), frames)
    return _recorded(frames, lambda k, _: people[k])


def person_in_a_robe(actor: Actor, frames: int) -> PointClouds:
    """A person turning in a robe, which hides the legs."""
    performance = sequences.turning(actor, frames, RATE)
    person = _positions(performance, frames)

    def points_of(k: int, rng: np.random.Generator) -> Floats:
        hips = performance.root[k]
        away = np.hypot(person[k][:, 0] - hips[0], person[k][:, 2] - hips[2])
        seen = (person[k][:, 1] > hips[1] + 0.3) | (away > 0.35) | (person[k][:, 1] < 0.08)
        return np.concatenate([person[k][seen], robe_points(hips, k / RATE, ROBE_POINTS, rng)])

    return _recorded(frames, points_of)


def empty_frames(actor: Actor, frames: int) -> PointClouds:
    """A person who is absent from the first third of the frames and from the last ones."""
    person = _positions(sequences.jumping_jacks(actor, frames, RATE), frames)
    return _recorded(frames, lambda k, _: person[k] if frames // 3 <= k < frames - frames // 6 else np.zeros((0, 3)))


def lost_track(actor: Actor, frames: int) -> PointClouds:
    """A cut in the middle: the person is elsewhere in another pose, turned away, so that tracking fails."""
    first = _positions(sequences.jumping_jacks(actor, frames, RATE), frames)
    second = _positions(sequences.sitting(actor, frames, RATE).moved((2.0, 0.0, 1.0), np.pi), frames)
    return _recorded(frames, lambda k, _: first[k] if k < frames // 2 else second[k])


SCENES: dict[str, Callable[[Actor, int], PointClouds]] = {
    "chair": chair,
    "dog": dog,
    "person and chair": person_and_chair,
    "two people": two_people,
    "person in a robe": person_in_a_robe,
    "empty frames": empty_frames,
    "lost track": lost_track,
}
