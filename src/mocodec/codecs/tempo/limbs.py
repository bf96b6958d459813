"""Poses of a body whose bones do not stretch, by where each bone points: fewer numbers, and straighter ones.

    pose (frames, points, 3) ─forward─► coordinates (frames, dimensions) ─inverse─► pose

A bone of constant length points somewhere on a sphere: two numbers, the turn that takes its usual direction there (the
sphere's logarithm). Bones that begin in one joint and stand still against each other turn together: a *hub*, three
numbers. A hand is *carried*: its direction is counted from the frame of the bone before it. A thigh is not: the pelvis
turns and trembles, and the leg makes up for it; so its direction is counted in the frame of the body.

An arm that swings is a straight line in these coordinates and a curve in those of its points; and of 31 joints' 93
coordinates 58 remain.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ... import native
from ...motion import Floats

SHORTEST_M = 1e-7
"""A bone shorter than this is no bone: its end stays with its start."""
RIGID = 1e-4
"""Bones of one joint whose angle never varies by more than this, radians, turn together."""
APART = 0.05
"""The bones of a hub make an angle of at least this, in sines."""


@dataclass(frozen=True, eq=False)
class Limbs:
    """A tree of bones. All three (points,) or (points, 3); of roots only the parent counts.

    parents: a parent stands before its children, −1 for the root. vectors: from parent to point where all coordinates
    are 0, metres, in the frame that the bone is counted in. hub: it turns with the others of its parent that are so
    marked. carried: counted from the frame of the bone that ends in its parent.
    """

    parents: tuple[int, ...]
    vectors: Floats
    hub: NDArray[np.bool_]
    carried: NDArray[np.bool_]

    @cached_property
    def lengths(self) -> Floats:
        return np.sqrt((self.vectors**2).sum(axis=1))

    @cached_property
    def still(self) -> NDArray[np.bool_]:
        """Points that stay where their parent is."""
        return self.lengths <= SHORTEST_M

    @cached_property
    def plan(self) -> Plan:
        return _plan(self)

    def built(self, offsets: Floats) -> Limbs:
        """The same limbs on a body of another build: offsets (points, 3) from parent to point in any pose."""
        size = np.sqrt((offsets**2).sum(axis=1))
        vectors = self.vectors / np.maximum(self.lengths, 1e-30)[:, None] * size[:, None]
        for children in self.plan.children.values():
            vectors[children] = turned_to(offsets[children], self.vectors[children])
        return replace(self, vectors=vectors)

    @property
    def dimensions(self) -> int:
        return 2 * len(self.plan.bones) + 3 * len(self.plan.hubs)

    def forward(self, pose: Floats) -> Floats:
        """Coordinates (frames, dimensions), radians, of poses (frames, points, 3): first all bones', then all hubs'."""
        out = np.empty((self.dimensions, len(pose)))
        bones, hubs = self.plan.split(out)
        for block in blocks(len(pose)):
            self.found(pose[block], bones[..., block], hubs[..., block])
        bones[:], hubs[:] = unwrapped(bones), unwrapped(hubs)
        return out.T

    def found(self, pose: Floats, bones: Floats, hubs: Floats) -> Floats:
        """The frames (3, 3, slots, frames) of all that carries, in poses (frames, points, 3).

        The turns of bones (2, bones, frames) and of hubs (3, hubs, frames) are written to where they are to be.
        """
        plan, offsets = self.plan, _offsets(pose, self.parents)
        found = np.empty((3, 3, plan.slots, len(pose)))
        for level in plan.levels:
            for hub in level.hubs:
                pair = offsets[:, hub.pair]
                if hub.carrier is not None:
                    pair = _into(hub.home, _into(found[:, :, hub.carrier], pair))
                hubs[:, hub.number] = _rotation_vector(_framed_by(pair) @ hub.still.T)
                found[:, :, hub.slot] = turning(hubs[:, hub.number])
                hub.carry(found)
            if level.points:
                here = offsets[:, level.points]
                if level.carriers is not None:
                    here = _into(found[:, :, level.carriers], here)
                turns = _logarithm(_into(level.rest, here))
                bones[:, level.numbers] = turns
                own = found[:, :, level.slots]
                k = own.shape[2]
                _frames(level.rest[:, :, :k], turns[:, :k], _Turned.by(_squares(turns[:, :k])), own)
                level.carry(found)
        return found

    def inverse(self, coordinates: Floats) -> Floats:
        """Poses (frames, points, 3), metres, their mean in the origin."""
        turns = np.ascontiguousarray(coordinates.T)
        out = np.empty((3, len(self.parents), len(coordinates)))
        for block in blocks(len(coordinates)):
            np.matmul(self._sums, self._directions(turns[:, block]), out=out[..., block])
        return out.T

    @cached_property
    def _sums(self) -> Floats:
        """What each direction (in the order of `Plan.points`) moves each point by, about the mean of all."""
        along = np.eye(len(self.parents))
        for j, p in enumerate(self.parents):
            if p >= 0:
                along[j] += along[p]
        return ((along - along.mean(axis=0)) * self.lengths)[:, self.plan.points]

    def _directions(self, turns: Floats) -> Floats:
        """Where each bone points in the body's frame, (3, bones, frames) in the order of `Plan.points`, after turns
        (dimensions, frames)."""
        plan, frames = self.plan, turns.shape[1]
        bones, hubs = plan.split(turns)
        bones, hubs = bones[:, plan.order], np.ascontiguousarray(hubs)
        turned = _Turned.by(np.concatenate([_squares(bones), _squares(hubs)]))
        if (kernel := native.kernel("tempo_limbs")) is not None:
            return kernel(bones, hubs, *turned, *plan.program)
        k, n, free = plan.framed, len(plan.bones), plan.free
        found = np.empty((3, 3, plan.slots, frames))
        _frames(plan.rest[:, :, :k], bones[:, :k], turned.of(slice(k)), found[:, :, :k])
        found[:, :, k:] = _turning(hubs, turned.of(slice(n, None)))
        for level in plan.levels:
            for hub in level.hubs:
                hub.carry(found)
            level.carry(found)
        out = np.empty((3, len(plan.points), frames))
        out[:, :k] = found[2, :, :k]
        _tilted(plan.rest[:, :, k:], bones[:, k:], turned.of(slice(k, n)), out[:, k:n])
        out[:, n:] = plan.of_hubs
        if k + free < len(plan.points):
            out[:, k + free :] = _out_of(found[:, :, plan.carriers[k + free :]], out[:, k + free :])
        return out

    def metric(self, coordinates: Floats) -> Floats:
        """How far the points move in all when coordinates do, (dimensions, dimensions): the mean of Jᵀ J over these."""
        n = self.dimensions
        moved = np.repeat(coordinates, 2 * n, axis=0).reshape(len(coordinates), 2, n, n)
        moved[:, 0] += NUDGE * np.eye(n)
        moved[:, 1] -= NUDGE * np.eye(n)
        poses = self.inverse(moved.reshape(-1, n)).reshape(len(coordinates), 2, n, -1)
        jacobian = (poses[:, 0] - poses[:, 1]) / (2 * NUDGE)
        return np.einsum("fac,fbc->ab", jacobian, jacobian) / len(coordinates)


NUDGE = 1e-4


BLOCK = 512
"""Frames worked on at a time: enough to be fast, few enough to stay in a processor's cache."""


def blocks(frames: int) -> Iterator[slice]:
    return (slice(first, min(first + BLOCK, frames)) for first in range(0, frames, BLOCK))


BODY = -1

Slots = slice | NDArray[np.int64]
"""Places among the frames of all that carries: a slice where they stand in a row, so that nothing is copied."""


@dataclass(frozen=True, eq=False)
class Hub:
    """A hub and where things of it are.

    number, among hubs; slot, of its frame; carrier: the slot of the frame that it is counted in (none: the body's);
    home (3, 3, 1, 1): the axes of the body, as the carrier's axes see them at rest; pair: the two of its bones that are
    least in line, which say how it is turned, and still: their frame (3, 3) when it is not.
    """

    number: int
    slot: int
    carrier: slice | None
    home: Floats
    pair: list[int]
    still: Floats

    def carry(self, found: Floats) -> None:
        """From its carrier's frame into the body's, in place."""
        if self.carrier is not None:
            own = slice(self.slot, self.slot + 1)
            found[:, :, own] = _out_of(found[:, :, self.carrier], _out_of(self.home, found[:, :, own]))


@dataclass(frozen=True, eq=False)
class Level:
    """What can be turned at once, since all that carries it is known: hubs, and bones, first those that carry others.

    points; numbers: of their coordinates; slots: of those that carry others; carriers: slots of the frames that all of
    them, and those, are counted in (none: the body's); rest (3, 3, bones, 1): their axes, as their carrier's see them.
    """

    hubs: tuple[Hub, ...]
    points: list[int]
    numbers: list[int]
    slots: slice
    carriers: Slots | None
    carriers_of_framed: Slots | None
    rest: Floats

    def carry(self, found: Floats) -> None:
        """The frames of its bones from their carriers' into the body's, in place."""
        if self.carriers_of_framed is not None:
            found[:, :, self.slots] = _out_of(found[:, :, self.carriers_of_framed], found[:, :, self.slots])


@dataclass(frozen=True, eq=False)
class Plan:
    """The order of the work. A carrier is a bone, −2 − joint for a hub, or BODY.

    bones, hubs (by their joint): in the order of their coordinates. order: of the bones in the order of work, first
    those that are `framed` since they carry others, then the `free` ones that the body carries, then the rest. slot:
    where the frame of each carrier stands, those of hubs last. axes: of bones, hubs and body where nothing is turned,
    (3, 3), columns; a bone's third is its direction.

    points: bones in the order of work, then those of hubs, `of_hubs`: where these point, (3, n, 1); carriers: of all of
    them, their slots. rest (3, 3, bones, 1): axes in the order of work, as their carriers' see them.
    """

    bones: tuple[int, ...]
    hubs: tuple[int, ...]
    children: dict[int, list[int]]
    carrier: dict[int, int]
    slot: dict[int, int]
    axes: dict[int, Floats]
    levels: tuple[Level, ...]
    order: NDArray[np.int64]
    framed: int
    free: int
    points: NDArray[np.int64]
    carriers: NDArray[np.int64]
    rest: Floats
    of_hubs: Floats

    @property
    def slots(self) -> int:
        return self.framed + len(self.hubs)

    def split(self, turns: Floats) -> tuple[Floats, Floats]:
        """Turns (dimensions, frames) of bones, (2, bones, frames), and of hubs, (3, hubs, frames): views."""
        edge, frames = 2 * len(self.bones), turns.shape[1]
        bones = turns[:edge].reshape(len(self.bones), 2, frames)
        hubs = turns[edge : edge + 3 * len(self.hubs)].reshape(len(self.hubs), 3, frames)
        return bones.swapaxes(0, 1), hubs.swapaxes(0, 1)

    @cached_property
    def program(self) -> tuple[NDArray[np.int64], Floats, Floats, Floats]:
        """For the compiled module: (turns, 6) in order whether it is a hub, its number among those, the slots of its
        carrier's frame and of its own (−1: none), and the first of its directions and the one past its last; `rest` of
        bones and of hubs, (n, 3, 3); and `of_hubs`, (n, 3)."""
        rows: list[tuple[int, ...]] = []
        homes = np.zeros((len(self.hubs), 3, 3))
        for level in self.levels:
            rows += ((0, b, self.carriers[b], b, b, b + 1) for b in range(level.slots.start, level.slots.stop))
            for hub in level.hubs:
                own = np.flatnonzero(self.carriers[len(self.bones) :] == hub.slot) + len(self.bones)
                carrier = -1 if hub.carrier is None else hub.carrier.start
                rows.append((1, hub.number, carrier, hub.slot, int(own[0]), int(own[-1]) + 1))
                homes[hub.number] = hub.home[..., 0, 0]
        rows += ((0, b, self.carriers[b], -1, b, b + 1) for b in range(self.framed, len(self.bones)))
        rest = np.ascontiguousarray(self.rest[..., 0].transpose(2, 0, 1))
        return np.array(rows, np.int64).reshape(-1, 6), rest, homes, np.ascontiguousarray(self.of_hubs[..., 0].T)


def _plan(limbs: Limbs) -> Plan:
    children: dict[int, list[int]] = {}
    for j, p in enumerate(limbs.parents):
        if p >= 0 and limbs.hub[j] and not limbs.still[j]:
            children.setdefault(p, []).append(j)
    bones = [j for j, p in enumerate(limbs.parents) if p >= 0 and not limbs.hub[j] and not limbs.still[j]]
    ends: dict[int, int] = {}  # the frame that a joint's children may be carried by
    carrier: dict[int, int] = {}
    depth = {BODY: 0}
    level_of: dict[int, int] = {}
    for j, p in enumerate(limbs.parents):
        before = ends.get(p, BODY)
        ends[j] = before
        if p < 0 or limbs.still[j]:
            continue
        if limbs.hub[j]:
            first = children[p][0]
            carrier[j] = carrier[first] if j != first else (before if limbs.carried[j] else BODY)
            ends[j] = -2 - p
            depth[ends[j]] = depth[carrier[j]] + 1
            level_of[ends[j]] = depth[carrier[j]]
        else:
            held = -2 - p if p in children and -2 - p in depth else before
            carrier[j] = held if limbs.carried[j] else BODY
            ends[j] = j
            depth[j] = depth[carrier[j]] + 1
            level_of[j] = depth[carrier[j]]
    carrying = set(carrier.values())
    framed = sorted((b for b in bones if b in carrying), key=level_of.__getitem__)
    leaves = sorted((b for b in bones if b not in carrying), key=level_of.__getitem__)
    points, hubs = [*framed, *leaves], list(children)
    slots = (
        {BODY: -1} | {b: slot for slot, b in enumerate(framed)} | {-2 - h: len(framed) + i for i, h in enumerate(hubs)}
    )
    axes = {b: _axes(limbs.vectors[b] / limbs.lengths[b]) for b in bones}
    axes |= {c: np.eye(3) for c in (BODY, *(-2 - h for h in hubs))}
    rest = {b: (axes[carrier[b]].T @ axes[b]).T for b in bones}

    def stacked(of: Sequence[int]) -> Floats:
        return np.array([rest[b] for b in of]).reshape(-1, 3, 3).transpose(1, 2, 0)[..., None]

    def slots_of(of: Sequence[int]) -> Slots | None:
        places = np.array([slots[carrier[b]] for b in of], np.int64)
        return None if (places < 0).any() or not len(of) else _in_a_row(places)

    def hub(joint: int) -> Hub:
        of_hub = children[joint]
        pair = _least_in_line(limbs.vectors, of_hub)
        still = _framed_by(limbs.vectors[pair].T[..., None])[0]
        at = slots[carrier[of_hub[0]]]
        held = None if at < 0 else slice(at, at + 1)
        home = axes[carrier[of_hub[0]]][..., None, None]
        return Hub(hubs.index(joint), slots[-2 - joint], held, home, pair, still)

    levels = []
    for at in range(max(level_of.values(), default=-1) + 1):
        here = [b for b in framed if level_of[b] == at]
        start = sum(level_of[b] < at for b in framed)
        every = [*here, *(b for b in leaves if level_of[b] == at)]
        levels.append(
            Level(
                tuple(hub(h) for h in hubs if level_of[-2 - h] == at),
                every,
                [bones.index(b) for b in every],
                slice(start, start + len(here)),
                slots_of(every),
                slots_of(here),
                stacked(every),
            )
        )
    turning_together = [j for h in hubs for j in children[h]]
    return Plan(
        tuple(bones),
        tuple(hubs),
        children,
        carrier,
        slots,
        axes,
        tuple(levels),
        np.array([bones.index(b) for b in points], np.int64),
        len(framed),
        sum(carrier[b] == BODY for b in leaves),
        np.array([*points, *turning_together], np.int64),
        np.array(
            [*(slots[carrier[b]] for b in points), *(slots[-2 - limbs.parents[j]] for j in turning_together)], int
        ),
        stacked(points),
        (limbs.vectors[turning_together] / limbs.lengths[turning_together, None]).T[..., None],
    )


def _in_a_row(places: NDArray[np.int64]) -> Slots:
    """The same as a slice, if it is one."""
    first = int(places[0])
    return slice(first, first + len(places)) if (np.diff(places) == 1).all() else places


def _least_in_line(vectors: Floats, bones: Sequence[int]) -> list[int]:
    """The two of these bones that span the most."""
    pairs = [[a, b] for i, a in enumerate(bones) for b in bones[i + 1 :]]
    return max(pairs, key=lambda pair: float((np.cross(*vectors[pair]) ** 2).sum())) if pairs else [bones[0]] * 2


def _framed_by(pair: Floats) -> Floats:
    """Right-handed frames (frames, 3, 3), columns, of two vectors (3, 2, frames): half between, and across."""
    a, b = _unit(pair[:, 0]), _unit(pair[:, 1])
    first, second = a + b, a - b
    third = np.cross(first, second, axis=0)
    return np.stack([_unit(first), _unit(second), _unit(third)], axis=-1).swapaxes(0, 1)


def _unit(vectors: Floats) -> Floats:
    """Vectors (3, …) of length 1; zero ones stay so."""
    return vectors / np.maximum(np.sqrt((vectors * vectors).sum(axis=0)), 1e-30)


def _axes(direction: Floats) -> Floats:
    """A frame (3, 3), columns, whose third axis is this direction."""
    helper = np.eye(3)[np.abs(direction).argmin()]
    first = helper - direction * (helper @ direction)
    first /= np.sqrt(first @ first)
    return np.asarray(np.stack([first, np.cross(direction, first), direction], axis=1), np.float64)


def _offsets(pose: Floats, parents: Sequence[int]) -> Floats:
    """From parent to point, (3, points, frames)."""
    points = np.ascontiguousarray(pose.T)
    return points - points[:, [max(p, 0) for p in parents]]


def _over(a: Floats, b: Floats, otherwise: float) -> Floats:
    """a / b, where b is not tiny."""
    tiny = b < 1e-8
    return np.where(tiny, otherwise, a / np.where(tiny, 1.0, b))


def _logarithm(local: Floats) -> Floats:
    """The turn (2, …) that takes the third axis to these directions (3, …), of any length."""
    level = np.sqrt(local[0] ** 2 + local[1] ** 2)
    return local[:2] * _over(np.arctan2(level, local[2]), level, 0.0)


def unwrapped(turns: Floats) -> Floats:
    """Turns (n, …, frames) that go on past half a turn, rather than come back from the other side."""
    crossed = (np.diff(turns) ** 2).sum(axis=0) > np.pi**2
    if not crossed.any():
        return turns
    odd = np.zeros(turns.shape[1:], bool)
    odd[..., 1:] = np.cumsum(crossed, axis=-1) % 2 == 1
    angle = np.sqrt((turns**2).sum(axis=0))
    return np.where(odd, turns * (1 - _over(np.full_like(angle, 2 * np.pi), angle, 0.0)), turns)


class _Turned(NamedTuple):
    """What turns by some angles need, each of the shape of the angles: sin a / a, cos a, and (1 − cos a) / a²."""

    sine: Floats
    cosine: Floats
    versed: Floats

    @classmethod
    def by(cls, squared: Floats) -> _Turned:
        """By the series of a quarter of the angle where that is small, which is twice as fast as NumPy's own sines."""
        if squared.max(initial=0.0) <= HALF_TURN:
            quarter = squared * (-1 / 16)
            share, cosine = _series(quarter, _SINES), _series(quarter, _COSINES)
            share *= cosine
            cosine *= cosine
            cosine *= 2
            cosine -= 1
        else:
            half = np.maximum(np.sqrt(squared) * 0.5, 1e-150)
            share, cosine = np.sin(half) / half, np.cos(half)
        versed = share * share
        versed *= 0.5
        share *= cosine
        return cls(share, 1 - versed * squared, versed)

    def of(self, some: slice) -> _Turned:
        return _Turned(*(each[some] for each in self))


HALF_TURN = 10.0
"""Angles, squared, that series are good for: just beyond half a turn, and more than that is hardly ever seen."""
_SINES = tuple(1 / math.factorial(2 * k + 1) for k in range(8))
_COSINES = tuple(1 / math.factorial(2 * k) for k in range(9))


def _series(x: Floats, terms: Sequence[float]) -> Floats:
    """terms[0] + terms[1] x + terms[2] x² + …"""
    out = x * terms[-1]
    for term in terms[-2:0:-1]:
        out += term
        out *= x
    out += terms[0]
    return out


def _squares(turns: Floats) -> Floats:
    """Angles, squared, of turns (n, …)."""
    return np.einsum("n...,n...->...", turns, turns)


def _tilted(rest: Floats, turns: Floats, turned: _Turned, out: Floats) -> None:
    """Where the third axes (3, bones, frames) of frames at rest (3, 3, bones, 1) point after turns (2, bones, frames)
    that tilt them towards the first and the second."""
    np.multiply(rest[0], turns[0] * turned.sine, out=out)
    out += rest[1] * (turns[1] * turned.sine)
    out += rest[2] * turned.cosine


def _frames(rest: Floats, turns: Floats, turned: _Turned, out: Floats) -> None:
    """All three axes after such turns, (3, 3, bones, frames), by Rodrigues' formula."""
    tilt = rest[0] * turns[0]
    tilt += rest[1] * turns[1]
    np.multiply(tilt, turned.sine, out=out[2])
    out[2] += rest[2] * turned.cosine
    tilt *= turned.versed
    tilt += rest[2] * turned.sine
    np.subtract(rest[0], turns[0] * tilt, out=out[0])
    np.subtract(rest[1], turns[1] * tilt, out=out[1])


def turning(turns: Floats) -> Floats:
    """Rotation matrices (3, 3, …), columns first, of rotation vectors (3, …)."""
    return _turning(turns, _Turned.by(_squares(turns)))


def _turning(turns: Floats, turned: _Turned) -> Floats:
    out = turns[:, None] * (turns * turned.versed)
    flat, across = out.reshape(9, *turns.shape[1:]), turns * turned.sine
    flat[::4] += turned.cosine
    flat[[5, 6, 1]] += across
    flat[[7, 2, 3]] -= across
    return out


def _into(frames: Floats, vectors: Floats) -> Floats:
    """Vectors (3, …) in frames (3, 3, …), whose axes stand first."""
    out = frames[:, 0] * vectors[0]
    out += frames[:, 1] * vectors[1]
    out += frames[:, 2] * vectors[2]
    return out


def _out_of(frames: Floats, vectors: Floats) -> Floats:
    """The inverse of `_into`; also of the axes of frames, (3, 3, …)."""
    out = frames[0] * vectors[..., 0, None, :, :]
    out += frames[1] * vectors[..., 1, None, :, :]
    out += frames[2] * vectors[..., 2, None, :, :]
    return out


def turn_between(rest: Floats, vectors: Floats) -> Floats:
    """Rotation vectors (3, frames) that bring a rigid set (n, 3) nearest to vectors (3, n, frames) (Kabsch)."""
    between = np.einsum("anf,nb->fab", vectors, rest)
    u, _, vt = np.linalg.svd(between)
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return _rotation_vector(u @ vt)


def turned_to(shape: Floats, like: Floats) -> Floats:
    """A rigid set (n, 3), turned so that it lies nearest to another."""
    return shape @ turning(turn_between(shape, like.T[..., None]))[..., 0]


def _rotation_vector(m: Floats) -> Floats:
    """Rotation vectors (3, frames), at most π long, of matrices (frames, 3, 3)."""
    trace = m.trace(axis1=1, axis2=2)
    four = np.stack([trace, m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]])  # the largest part of the quaternion is divided by
    pick = four.argmax(axis=0)
    w = np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]])
    q = np.empty((4, len(m)))
    q[0], q[1:] = 1 + trace, w
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        here = pick == a + 1
        part = m[here]
        q[0, here] = w[a, here]
        q[1 + a, here] = 1 + part[:, a, a] - part[:, b, b] - part[:, c, c]
        q[1 + b, here] = part[:, b, a] + part[:, a, b]
        q[1 + c, here] = part[:, c, a] + part[:, a, c]
    q *= np.where(q[0] < 0, -1.0, 1.0)
    size = np.sqrt((q[1:] ** 2).sum(axis=0))
    return q[1:] * _over(2 * np.arctan2(size, q[0]), size, 0.0)


def fit(poses: Sequence[Floats], parents: Sequence[int], builds: Sequence[Floats] | None = None) -> Limbs:
    """The limbs of runs of poses (frames, points, 3), in the body's frame: hubs, usual directions, what is carried."""
    offsets = [_offsets(p, parents) for p in poses]
    points = len(parents)
    vectors = _usual(offsets)
    hub = _hubs(offsets, parents, vectors, builds)
    marks = _carried(parents, vectors)
    limbs = Limbs(tuple(parents), _with_rigid_hubs(vectors, offsets, parents, hub), hub, np.zeros(points, bool))
    for j in np.flatnonzero(marks):
        limbs = carry(limbs, poses, int(j))
    return limbs


CARRIED = 1.4
"""A bone is carried where all that hangs on it reaches no farther than the bone before it is long, times this."""


def _carried(parents: Sequence[int], vectors: Floats) -> NDArray[np.bool_]:
    """Hands, feet and forearms; and all that hangs on what is carried."""
    lengths = np.sqrt((vectors**2).sum(axis=1))
    reach = np.zeros(len(parents))
    for j in range(len(parents) - 1, -1, -1):
        if parents[j] >= 0:
            reach[parents[j]] = max(reach[parents[j]], reach[j] + lengths[j])
    out, before = np.zeros(len(parents), bool), np.zeros(len(parents))
    for j, p in enumerate(parents):
        if p < 0:
            continue
        before[j] = lengths[p] if lengths[p] > SHORTEST_M else before[p]
        out[j] = before[j] > 0 and (out[p] or reach[j] + lengths[j] < CARRIED * before[j])
    return out & (lengths > SHORTEST_M)


def _usual(runs: Sequence[Floats]) -> Floats:
    """Mean directions (points, 3) of offsets (3, points, frames) in many runs, of the mean length."""
    frames = sum(r.shape[2] for r in runs)
    length = np.asarray(sum(np.sqrt((r**2).sum(axis=0)).sum(axis=1) for r in runs)) / frames
    direction = np.asarray(sum(r.sum(axis=2) for r in runs)).T
    size = np.sqrt((direction**2).sum(axis=1, keepdims=True))
    safe = np.where(size > 1e-9 * frames, direction / np.maximum(size, 1e-30), [0.0, 1.0, 0.0])
    return safe * length[:, None]


def _hubs(
    runs: Sequence[Floats], parents: Sequence[int], vectors: Floats, builds: Sequence[Floats] | None
) -> NDArray[np.bool_]:
    """Of the bones that begin in one joint, those that stand still against each other; not all in one line.

    builds: the offsets (points, 3) of each run's skeleton, whose angles they must have; else their own middle one.
    """
    lengths = np.sqrt((vectors**2).sum(axis=1))
    out = np.zeros(len(parents), bool)
    for joint in range(len(parents)):
        bones = [j for j, p in enumerate(parents) if p == joint and lengths[j] > SHORTEST_M]
        best: list[int] = []
        for first in bones:
            together, spread = [first], 0.0
            for other in (b for b in bones if b != first):
                angles = [_angle(r[:, first], r[:, other]) for r in runs]
                middle = [float(np.median(a)) for a in angles]
                if builds is None:
                    middle = [float(np.median(middle))] * len(runs)
                else:
                    middle = [float(_angle(b[first], b[other])) for b in builds]
                off = max(float(np.abs(a - m).max()) for a, m in zip(angles, middle, strict=True))
                if off < RIGID:
                    together.append(other)
                    spread = max(spread, abs(float(np.sin(middle[0]))))
            if len(together) > max(1, len(best)) and spread > APART:
                best = together
        out[best] = True
    return out


def _angle(a: Floats, b: Floats) -> Floats:
    """Between vectors (3, …)."""
    return np.arctan2(np.sqrt((np.cross(a, b, axis=0) ** 2).sum(axis=0)), (a * b).sum(axis=0))


def _with_rigid_hubs(
    vectors: Floats, offsets: Sequence[Floats], parents: Sequence[int], hub: NDArray[np.bool_]
) -> Floats:
    """Vectors whose hubs have the shape that they really have, turned to their usual directions."""
    out = vectors.copy()
    for joint in sorted({p for p, turns in zip(parents, hub, strict=True) if turns}):
        children = [j for j, p in enumerate(parents) if hub[j] and p == joint]
        shape = offsets[0][:, children, offsets[0].shape[2] // 2].T
        out[children] = turned_to(shape, vectors[children])
    return out


def carry(limbs: Limbs, poses: Sequence[Floats], bone: int) -> Limbs:
    """Limbs with this bone (or the hub that it is of) carried, and its usual direction in that frame."""
    marks = limbs.carried.copy()
    joint = limbs.parents[bone]
    children = limbs.plan.children[joint] if limbs.hub[bone] else [bone]
    marks[children] = True
    found = replace(limbs, carried=marks)
    carrier = found.plan.carrier[bone]
    mean = _usual([_carried_offsets(found, p, carrier)[:, children] for p in poses])
    vectors = limbs.vectors.copy()
    vectors[children] = turned_to(vectors[children], mean) if limbs.hub[bone] else mean
    return replace(found, vectors=vectors)


def _carried_offsets(limbs: Limbs, pose: Floats, carrier: int) -> Floats:
    """Offsets (3, points, frames) in poses (frames, points, 3), in the frame of a carrier."""
    offsets = _offsets(pose, limbs.parents)
    if carrier == BODY:
        return offsets
    plan = limbs.plan
    found = limbs.found(pose, *plan.split(np.empty((limbs.dimensions, len(pose)))))
    own = [plan.slot[carrier]]
    return _into(plan.axes[carrier][..., None, None], _into(found[:, :, own], offsets))
