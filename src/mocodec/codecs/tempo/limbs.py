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

from collections.abc import Sequence
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
        plan, frames = self.plan, len(pose)
        out = np.empty((self.dimensions, frames))
        offsets = _offsets(pose, self.parents)
        found: dict[int, Floats] = {}
        for level in plan.levels:
            for hub in level.hubs:
                children = plan.children[hub]
                pair = plan.pairs[hub]
                inside = _into(found.get(plan.carrier[children[0]]), offsets[:, pair])
                turns = unwrapped(_rotation_vector(_framed_by(inside) @ plan.rest[hub].T))
                out[plan.at_hub(hub)] = turns
                found[-2 - hub] = _within(found.get(plan.carrier[children[0]]), turning(turns))
            for carrier, group in level.groups:
                axes = plan.stacked(group)
                inside = _into(found.get(carrier), offsets[:, group])
                local = axes[:, 0].T[..., None] * inside[0]
                local += axes[:, 1].T[..., None] * inside[1]
                local += axes[:, 2].T[..., None] * inside[2]
                turns = unwrapped(_logarithm(local))
                for i, bone in enumerate(group):
                    out[plan.at_bone(bone)] = turns[:, i]
                    if bone in plan.carriers:
                        turned = _Turned.by(np.sqrt(turns[0, i] ** 2 + turns[1, i] ** 2))
                        found[bone] = _framed(found.get(carrier), plan.axes[bone], turns[:, i], turned)
        return out.T

    def inverse(self, coordinates: Floats) -> Floats:
        """Poses (frames, points, 3), metres, their mean in the origin."""
        return _summed(self._turned(np.ascontiguousarray(coordinates.T)), self.parents)

    def _turned(self, values: Floats) -> Floats:
        """Offsets (3, points, frames) from parent to point, in the body's frame, of turns (dimensions, frames)."""
        plan, frames = self.plan, values.shape[1]
        bones = values[: 2 * len(plan.bones)].reshape(len(plan.bones), 2, frames)
        hubs = values[2 * len(plan.bones) :][: 3 * len(plan.hubs)].reshape(len(plan.hubs), 3, frames)
        of_bones = _Turned.by(np.sqrt(bones[:, 0] ** 2 + bones[:, 1] ** 2))
        of_hubs = _Turned.by(np.sqrt(hubs[:, 0] ** 2 + hubs[:, 1] ** 2 + hubs[:, 2] ** 2))
        if (kernel := native.kernel("tempo_limbs")) is not None:
            axes = plan.stacked(plan.bones) if plan.bones else np.zeros((0, 3, 3))
            return kernel(bones, *of_bones, hubs, *of_hubs, *plan.program, axes, self.lengths, self.vectors)
        offsets = np.zeros((3, len(self.parents), frames))
        found: dict[int, Floats] = {}
        for level in plan.levels:
            for hub in level.hubs:
                children, number = plan.children[hub], plan.hubs.index(hub)
                frame = _within(found.get(plan.carrier[children[0]]), _turning(hubs[number], of_hubs.of(number)))
                found[-2 - hub] = frame
                offsets[:, children] = _out_of(frame, self.vectors[children].T[..., None])
            for carrier, group in level.groups:
                numbers = [plan.bones.index(b) for b in group]
                turns, turned = bones[numbers].swapaxes(0, 1), of_bones.of(numbers)
                x, y = turns[0] * turned.sine, turns[1] * turned.sine
                axes = plan.stacked(group) * self.lengths[list(group), None, None]
                inside = axes[:, :, 0].T[..., None] * x
                inside += axes[:, :, 1].T[..., None] * y
                inside += axes[:, :, 2].T[..., None] * turned.cosine
                offsets[:, group] = _out_of(found.get(carrier), inside)
                for i, bone in enumerate(group):
                    if bone in plan.carriers:
                        found[bone] = _framed(found.get(carrier), plan.axes[bone], turns[:, i], turned.of(i))
        return offsets

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


@dataclass(frozen=True, eq=False)
class Level:
    """What can be turned at once, since all that carries it is known: hubs, bones, and the bones by their carrier."""

    hubs: tuple[int, ...]
    bones: tuple[int, ...]
    groups: tuple[tuple[int, tuple[int, ...]], ...]


@dataclass(frozen=True, eq=False)
class Plan:
    """The order of the work. A carrier is a bone, −2 − joint for a hub, or BODY."""

    bones: tuple[int, ...]
    hubs: tuple[int, ...]
    children: dict[int, list[int]]
    carrier: dict[int, int]
    carriers: frozenset[int]
    levels: tuple[Level, ...]
    axes: dict[int, Floats]
    """Of each bone the frame (3, 3) whose third column is its direction."""
    pairs: dict[int, list[int]]
    """Of each hub the two bones that are least in line; they say how it is turned."""
    rest: dict[int, Floats]
    """The frame (3, 3) of those two where the hub is not turned."""

    def at_bone(self, bone: int) -> slice:
        at = 2 * self.bones.index(bone)
        return slice(at, at + 2)

    def at_hub(self, hub: int) -> slice:
        at = 2 * len(self.bones) + 3 * self.hubs.index(hub)
        return slice(at, at + 3)

    @cached_property
    def program(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """For the compiled module: (turns, 6) in order whether it is a hub, its number among those, the place of its
        carrier's frame and of its own (−1: none), its first child and the one past its last (of a bone, its point);
        and the children."""
        places = {carrier: place for place, carrier in enumerate(sorted(self.carriers - {BODY}))}
        rows: list[tuple[int, ...]] = []
        children: list[int] = []
        for level in self.levels:
            for hub in level.hubs:
                of_hub = self.children[hub]
                carrier, own = places.get(self.carrier[of_hub[0]], -1), places.get(-2 - hub, -1)
                rows.append((1, self.hubs.index(hub), carrier, own, len(children), len(children) + len(of_hub)))
                children += of_hub
            for bone in level.bones:
                own = places.get(bone, -1)
                rows.append((0, self.bones.index(bone), places.get(self.carrier[bone], -1), own, bone, bone + 1))
        return np.array(rows, np.int64).reshape(-1, 6), np.array(children, np.int64)

    def stacked(self, bones: Sequence[int]) -> Floats:
        return np.stack([self.axes[b] for b in bones])


BODY = -1


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
    carriers = frozenset(carrier.values())
    levels = []
    for depth_ in range(max(level_of.values(), default=-1) + 1):
        hubs = tuple(h for h in children if level_of[-2 - h] == depth_)
        here = tuple(b for b in bones if level_of[b] == depth_)
        by: dict[int, list[int]] = {}
        for b in here:
            by.setdefault(carrier[b], []).append(b)
        levels.append(Level(hubs, here, tuple((c, tuple(group)) for c, group in by.items())))
    axes = {b: _axes(limbs.vectors[b] / limbs.lengths[b]) for b in bones}
    pairs = {hub: _least_in_line(limbs.vectors, of_hub) for hub, of_hub in children.items()}
    rest = {hub: _framed_by(limbs.vectors[pair].T[..., None])[0] for hub, pair in pairs.items()}
    return Plan(tuple(bones), tuple(children), children, carrier, carriers, tuple(levels), axes, pairs, rest)


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
    points = np.ascontiguousarray(pose.transpose(2, 1, 0))
    return points - points[:, [max(p, 0) for p in parents]]


def _summed(offsets: Floats, parents: Sequence[int]) -> Floats:
    """Offsets (3, points, frames) along the tree, as poses (frames, points, 3) about their mean."""
    for j, p in enumerate(parents):
        if p >= 0:
            offsets[:, j] += offsets[:, p]
    offsets -= offsets.mean(axis=1, keepdims=True)
    return np.ascontiguousarray(offsets.transpose(2, 1, 0))


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
    def by(cls, angle: Floats) -> _Turned:
        half = angle / 2
        sine, cosine = np.sin(half), np.cos(half)
        share = _over(sine, half, 1.0)
        return cls(share * cosine, 1 - 2 * sine * sine, 0.5 * share * share)

    def of(self, numbers: int | list[int]) -> _Turned:
        return _Turned(*(each[numbers] for each in self))


def _framed(carrier: Floats | None, axes: Floats, turns: Floats, turned: _Turned) -> Floats:
    """The frame (3, 3, frames) of a bone turned by (2, frames), out of its carrier's: at rest that frame itself."""
    vector = axes[:, 1, None] * turns[0] - axes[:, 0, None] * turns[1]
    return _within(carrier, _turning(vector, turned))


def turning(turns: Floats) -> Floats:
    """Rotation matrices (3, 3, frames) of rotation vectors (3, frames)."""
    return _turning(turns, _Turned.by(np.sqrt((turns**2).sum(axis=0))))


def _turning(turns: Floats, turned: _Turned) -> Floats:
    sine, cos, versed = turned
    x, y, z = turns
    out = np.empty((3, 3, turns.shape[1]))
    out[0, 0], out[1, 1], out[2, 2] = cos + versed * x * x, cos + versed * y * y, cos + versed * z * z
    for a, b, product, left in ((0, 1, x * y, z), (0, 2, x * z, -y), (1, 2, y * z, x)):
        out[a, b] = versed * product - sine * left
        out[b, a] = versed * product + sine * left
    return out


def _within(carrier: Floats | None, frame: Floats) -> Floats:
    """Frames (3, 3, frames) that are given in a carrier's, in the body's."""
    return _out_of(carrier, frame)


def _into(carrier: Floats | None, vectors: Floats) -> Floats:
    """Vectors (3, n, frames) of the body in a carrier's frame."""
    return vectors if carrier is None else np.einsum("abf,anf->bnf", carrier, vectors)


def _out_of(carrier: Floats | None, vectors: Floats) -> Floats:
    """The inverse of `_into`."""
    if carrier is None:
        return vectors
    out = carrier[:, 0, None] * vectors[0]
    out += carrier[:, 1, None] * vectors[1]
    out += carrier[:, 2, None] * vectors[2]
    return out


def turn_between(rest: Floats, vectors: Floats) -> Floats:
    """Rotation vectors (3, frames) that bring a rigid set (n, 3) nearest to vectors (3, n, frames) (Kabsch)."""
    between = np.einsum("anf,nb->fab", vectors, rest)
    u, _, vt = np.linalg.svd(between)
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return _rotation_vector(u @ vt)


def turned_to(shape: Floats, like: Floats) -> Floats:
    """A rigid set (n, 3), turned so that it lies nearest to another."""
    return shape @ turning(turn_between(shape, like.T[..., None]))[..., 0].T


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
        limbs = _carry(limbs, poses, int(j))
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


def _carry(limbs: Limbs, poses: Sequence[Floats], bone: int) -> Limbs:
    """Limbs with this bone (or the hub that it is of) carried, and its usual direction in that frame."""
    marks = limbs.carried.copy()
    joint = limbs.parents[bone]
    children = limbs.plan.children[joint] if limbs.hub[bone] else [bone]
    marks[children] = True
    found = replace(limbs, carried=marks)
    carrier = found.plan.carrier[bone]
    mean = _usual([_into(_carrier_frame(found, p, carrier), _offsets(p, limbs.parents)[:, children]) for p in poses])
    vectors = limbs.vectors.copy()
    vectors[children] = turned_to(vectors[children], mean) if limbs.hub[bone] else mean
    return replace(found, vectors=vectors)


def _carrier_frame(limbs: Limbs, pose: Floats, carrier: int) -> Floats | None:
    """The frame (3, 3, frames) of a carrier in these poses."""
    if carrier == BODY:
        return None
    plan, values = limbs.plan, np.ascontiguousarray(limbs.forward(pose).T)
    chain = [carrier]
    while chain[-1] != BODY:
        at = chain[-1]
        chain.append(plan.carrier[plan.children[-2 - at][0] if at < BODY else at])
    frame = None
    for at in reversed(chain[:-1]):
        if at < BODY:
            frame = _within(frame, turning(values[plan.at_hub(-2 - at)]))
        else:
            turns = values[plan.at_bone(at)]
            turned = _Turned.by(np.sqrt(turns[0] ** 2 + turns[1] ** 2))
            frame = _framed(frame, plan.axes[at], turns, turned)
    return frame
