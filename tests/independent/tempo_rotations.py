"""Rotations in tempo, written from docs/payloads/tempo-rotations.md; only NumPy's arithmetic is used."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from math import atan2, cos, pi, sin, sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import tempo
from .integers import Bytes, integers
from .payloads import Array, Chunks
from .tempo_statistics import Model, Recording, prior, stored_basis

FIXED, HUB, SWING, FREE, HINGE, HINGE_CODED, UNIVERSAL, UNIVERSAL_REFINED, UNIVERSAL_CODED = range(9)
SIDE = (0, 0, 1, 4, 0, 1, 0, 1, 2)
ORDERS = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")
ONE = np.array([1.0, 0, 0, 0])
PAGE = Path(__file__).parents[2] / "docs" / "payloads" / "tempo-rotations.md"
LISTED = re.findall(r"^    (\d.*)$", PAGE.read_text().split("### Reference rules")[1].split("###")[0], re.MULTILINE)
REFERENCE = np.array([row.split()[1:] for row in " ".join(LISTED).split("; ")], int)
"""(31, 8): rule, flags, form, locked, pair, usual rotation."""


class Tree(NamedTuple):
    """parents, offsets (joints, 3); limits: orders, frames (joints, 4), ranges (joints, 3, 2), or None."""

    parents: list[int]
    offsets: Array
    limits: tuple[tuple[str, ...], Array, Array] | None


def times(p: Array, q: Array) -> Array:
    w, v, x, u = p[0], p[1:], q[0], q[1:]
    return np.concatenate([[w * x - v @ u], w * u + x * v + np.cross(v, u)])


def back(q: Array) -> Array:
    return q * [1, -1, -1, -1]


def turn(q: Array, v: Array) -> Array:
    return times(times(q, np.concatenate([[0.0], v])), back(q))[1:]


def normal(v: Array) -> Array:
    return v / sqrt(v @ v)


def about(axis: Array, angle: float) -> Array:
    return np.concatenate([[cos(angle / 2)], sin(angle / 2) * axis])


def matrix(q: Array) -> Array:
    return np.stack([turn(q, e) for e in np.eye(3)], axis=1)


def quaternion(m: Array) -> Array:
    """The eigenvector of the largest eigenvalue of Bar-Itzhack's matrix."""
    k = np.zeros((4, 4))
    k[0, 0] = np.trace(m)
    k[0, 1:] = k[1:, 0] = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    k[1:, 1:] = m + m.T - np.trace(m) * np.eye(3)
    return np.linalg.eigh(k)[1][:, -1]


def euler(order: str, q: Array) -> list[float]:
    i, j, k = ("xyz".index(letter) for letter in order)
    sign = 1 if (j - i) % 3 == 1 else -1
    m = matrix(q)
    first, last = atan2(-sign * m[j, k], m[k, k]), atan2(-sign * m[i, j], m[i, i])
    return [first, float(np.arcsin(np.clip(sign * m[i, k], -1, 1))), last]


@dataclass
class Joint:
    rule: int
    placed: bool
    branch: int
    usual: Array
    pair: tuple[int, int]
    order: str = ""
    frame: Array = field(default_factory=lambda: ONE)
    locked: list[float | None] = field(default_factory=list)
    first: int = 0
    anchor: int = 0
    targets: list[int] = field(default_factory=list)
    vectors: list[Array] = field(default_factory=list)

    def parts(self) -> tuple[list[Array], list[Array]]:
        """The constants before, between and after the free axes, and those axes."""
        constants, axes = [self.frame], []
        for letter, angle in zip(self.order, self.locked, strict=True):
            axis = np.eye(3)["xyz".index(letter)]
            if angle is None:
                axes.append(axis)
                constants.append(ONE)
            else:
                constants[-1] = times(constants[-1], about(axis, angle))
        constants[-1] = times(constants[-1], back(self.frame))
        return constants, axes

    def of_angles(self, angles: list[float]) -> Array:
        constants, axes = self.parts()
        q = constants[0]
        for axis, angle, constant in zip(axes, angles, constants[1:], strict=True):
            q = times(times(q, about(axis, angle)), constant)
        return q

    def usual_angles(self) -> list[float]:
        m = times(times(back(self.frame), self.usual), self.frame)
        free = [i for i, angle in enumerate(self.locked) if angle is None]
        if not any(self.locked):
            if len(free) == 1:
                return [(2 * atan2(m[1 + "xyz".index(self.order[free[0]])], m[0]) + pi) % (2 * pi) - pi]
            a, b = (self.order[i] for i in free)
            return euler(a + next(c for c in "xyz" if c not in a + b) + b, m)[::2]
        return [euler(self.order, m)[i] for i in free]

    def weights(self) -> Array:
        vectors = np.array(self.vectors)
        longest = vectors[np.argmax((vectors**2).sum(axis=1))]
        return vectors @ (longest / sqrt(longest @ longest))

    def aimed(self) -> tuple[Array, float]:
        """The aimed vector, and the lever."""
        w = self.weights()
        vector = w @ np.array(self.vectors)
        return vector, sqrt(vector @ vector) / sqrt(w @ w)


class Layer:
    def __init__(self, data: bytes, tree: Tree) -> None:
        part = Bytes(data)
        self.tree, count = tree, len(tree.parents)
        self.own_frame, units = bool(part.take(1)[0]), part.varint()
        self.reach = units / 10_000 if units else part.float64()
        known = REFERENCE if part.varint() else np.zeros((count, 8), int)
        digits, _, angle_count = (part.varint() for _ in range(3))
        sizes = [part.varint() for _ in range(4)]
        rows, usual = (integers(part.take(size), count, width) for size, width in zip(sizes, (5, 3), strict=False))
        steps = integers(part.take(sizes[2]), angle_count, 1)
        constants = np.frombuffer(part.take(sizes[3]), "<f8").tolist()
        self.angles = [float(np.radians(row[0] / 10**digits)) for row in steps]
        self.joints = [
            self.joint(j, (np.array(row) + known[j, :5]).tolist(), (np.array(v) + known[j, 5:]) / 16, constants)
            for j, (row, v) in enumerate(zip(rows, usual, strict=True))
        ]
        assert not constants
        assert not self.angles
        self.count = 0
        for joint in self.joints:
            joint.first = self.count
            self.count += SIDE[joint.rule]
        for j in reversed(range(count)):
            self.carry(j)
        for joint in self.joints:
            kept = [i for i, v in enumerate(joint.vectors) if sqrt(v @ v) > 1e-4]
            joint.targets, joint.vectors = [joint.targets[i] for i in kept], [joint.vectors[i] for i in kept]
        self.nominal = np.concatenate([np.zeros(0), *(self.nominal_of(joint) for joint in self.joints)])
        self.known = prior(part.take(4).hex())
        self.basis = stored_basis(part.rest(), self.count, [-1] * self.count, self.known) if self.count else None
        self.factor = self.cholesky()

    def joint(self, j: int, row: list[int], v: Array, constants: list[float]) -> Joint:
        rule, flags, form, locked, pair = row
        size = sqrt(v @ v)
        usual = about(v / size, size) if size else ONE
        found = Joint(rule, bool(flags & 1), -1 if flags & 2 else 1, usual, divmod(pair, len(self.tree.parents)))
        if form == 7:
            assert self.tree.limits is not None
            orders, frames, ranges = self.tree.limits
            found.order, found.frame = orders[j], frames[j]
            found.locked = [0.0 if (r == 0).all() else None for r in ranges[j]]
        if rule == FIXED and form == 7:
            found.usual = found.of_angles([self.angles.pop(0) for _ in range(found.locked.count(None))])
            found.order = ""
        elif rule == FIXED:
            found.usual = np.array([constants.pop(0) for _ in range(4)]) if form else ONE
        elif form == 7:
            pass
        elif form:
            found.order = ORDERS[form - 1]
            kinds = [locked // 9, locked // 3 % 3, locked % 3]
            found.locked = [(None, 0.0)[k] if k < 2 else constants.pop(0) for k in kinds]
        return found

    def carry(self, j: int) -> None:
        joint, offset, parents = self.joints[j], np.zeros(3), self.tree.parents
        joint.anchor = j
        if self.own_frame and parents[j] >= 0 and not joint.placed:
            joint.anchor, offset = parents[j], self.tree.offsets[j]
            joint.targets.append(j)
            joint.vectors.append(offset)
        for child in (c for c, p in enumerate(parents) if p == j):
            of = self.joints[child]
            if of.placed:
                continue
            start = offset
            if not self.own_frame:
                start = self.tree.offsets[child]
                joint.targets.append(child)
                joint.vectors.append(start)
            if of.rule == FIXED:
                long = [i for i, v in enumerate(of.vectors) if sqrt(v @ v) > 1e-4]
                joint.targets += [of.targets[i] for i in long]
                joint.vectors += [start + turn(of.usual, of.vectors[i]) for i in long]

    def nominal_of(self, joint: Joint) -> Any:
        if joint.rule in (HINGE_CODED, UNIVERSAL_CODED):
            return joint.usual_angles()
        return {SWING: [0.0], FREE: [1.0, 0, 0, 0], UNIVERSAL_REFINED: []}.get(joint.rule, []) + (
            joint.usual_angles()[1:] if joint.rule == UNIVERSAL_REFINED else []
        )

    def cholesky(self) -> Array:
        if not self.count:
            return np.zeros((0, 0))
        targets = self.forward([joint.usual for joint in self.joints], self.tree.offsets, placed=False)
        rows = []
        for i in range(self.count):
            ends = []
            for change in (1e-4, -1e-4):
                side = self.nominal.copy()
                side[i] += change
                ends.append(self.points(*self.frame(targets, side)))
            rows.append((ends[0] - ends[1]).ravel() / 2e-4)
        g = np.array(rows) @ np.array(rows).T
        return np.linalg.cholesky(g + 1e-5 * max(np.diag(g).max(), self.reach**2) * np.eye(self.count))

    def forward(self, local: list[Array], held: Array, placed: bool = True) -> Array:
        positions, world = np.array(held), list[Array]()
        for j, parent in enumerate(self.tree.parents):
            world.append(local[j] if parent < 0 else times(world[parent], local[j]))
            if parent >= 0 and not (placed and self.joints[j].placed):
                carrier = world[j if self.own_frame else parent]
                positions[j] = positions[parent] + turn(carrier, self.tree.offsets[j])
        return positions

    def points(self, local: list[Array], positions: Array) -> Array:
        """Joints and shell points (joints, 4, 3)."""
        world, out = list[Array](), []
        for j, parent in enumerate(self.tree.parents):
            world.append(local[j] if parent < 0 else times(world[parent], local[j]))
            out.append([positions[j], *(positions[j] + self.reach * matrix(world[j]).T)])
        return np.array(out)

    def frame(self, targets: Array, side: Array) -> tuple[list[Array], Array]:
        """Local rotations and positions of a frame."""
        local, world, positions = list[Array](), list[Array](), np.zeros_like(targets)
        for j, (joint, parent) in enumerate(zip(self.joints, self.tree.parents, strict=True)):
            held, above = parent < 0 or joint.placed, ONE if parent < 0 else world[parent]
            if held:
                positions[j] = targets[j]
            elif not self.own_frame:
                positions[j] = positions[parent] + turn(above, self.tree.offsets[j])
            values = side[joint.first : joint.first + SIDE[joint.rule]]
            aims = [turn(back(above), targets[t] - positions[joint.anchor]) for t in joint.targets]
            q = self.rotation(j, joint, aims, values, above, targets, positions)
            local.append(q)
            world.append(times(above, q))
            if self.own_frame and not held:
                positions[j] = positions[parent] + turn(world[j], self.tree.offsets[j])
        return local, positions

    def rotation(
        self, j: int, joint: Joint, aims: list[Array], values: Array, above: Array, targets: Array, positions: Array
    ) -> Array:
        if joint.rule == FIXED:
            return joint.usual
        if joint.rule == FREE:
            return times(joint.usual, normal(values))
        if joint.rule in (HINGE_CODED, UNIVERSAL_CODED):
            return joint.of_angles(values.tolist())
        if joint.rule == HUB:
            return hub(joint, aims)
        if joint.rule == HINGE:
            return joint.of_angles([hinge(joint, aims)])
        if joint.rule == SWING:
            return self.swing(j, joint, aims, values[0], above, targets, positions)
        return joint.of_angles(two_angles(joint, aims, values[0] if len(values) else None))

    def swing(
        self, j: int, joint: Joint, aims: list[Array], twist: float, above: Array, targets: Array, positions: Array
    ) -> Array:
        vector, _ = joint.aimed()
        d, e = normal(vector), normal(joint.weights() @ np.array(aims))
        u = turn(joint.usual, d)
        n = normal(np.concatenate([[1 + u @ e], np.cross(u, e)]))
        q = times(times(n, joint.usual), about(d, twist))
        terms = []
        for c, parent in enumerate(self.tree.parents):
            child = self.joints[c]
            if parent != j or child.rule != HINGE:
                continue
            world = times(above, q)
            if self.own_frame:
                held = joint.placed or self.tree.parents[j] < 0
                start = positions[j] if held else positions[self.tree.parents[j]] + turn(world, self.tree.offsets[j])
            else:
                start = targets[c] if child.placed else positions[j] + turn(world, self.tree.offsets[c])
            seen = child.weights() @ np.array([turn(back(world), targets[t] - start) for t in child.targets])
            constants, (axis,) = child.parts()
            aimed, lever = child.aimed()
            sigma = lever / sqrt(aimed @ aimed)
            a = turn(constants[0], axis)
            along = d * (d @ a)
            of = axis @ turn(constants[1], aimed)
            terms.append((sigma * seen @ (a - along), sigma * seen @ np.cross(d, a), sigma * (of - seen @ along)))
        return times(q, about(d, refined(0.0, terms))) if terms else q


def refined(x0: float, terms: list[tuple[Any, Any, Any]]) -> float:
    x = x0
    for _ in range(4):
        v = [a * cos(x) + b * sin(x) - e for a, b, e in terms]
        g = [b * cos(x) - a * sin(x) for a, b, _ in terms]
        x -= (0.0009 * (x - x0) + np.dot(g, v)) / (0.0009 + np.dot(g, g))
    return float(x)


def pair_frame(a: Array, b: Array) -> Array:
    x = normal(a)
    z = normal(np.cross(x, b))
    return np.stack([x, np.cross(z, x), z], axis=1)


def hub(joint: Joint, aims: list[Array]) -> Array:
    a, b = joint.pair
    m = pair_frame(aims[a], aims[b]) @ pair_frame(joint.vectors[a], joint.vectors[b]).T
    for _ in range(3):
        r = [m @ v for v in joint.vectors]
        inertia = sum(x @ x * np.eye(3) - np.outer(x, x) for x in r)
        t = np.linalg.solve(inertia, sum(np.cross(x, aim) for x, aim in zip(r, aims, strict=True)))
        m = matrix(normal(np.concatenate([[1.0], t / 2]))) @ m
    return quaternion(m)


def hinge(joint: Joint, aims: list[Array]) -> float:
    (before, after), (a,) = joint.parts()
    u, e = [turn(after, v) for v in joint.vectors], [turn(back(before), aim) for aim in aims]
    return atan2(
        sum(np.cross(a, x) @ y for x, y in zip(u, e, strict=True)),
        sum(x @ y - (a @ x) * (a @ y) for x, y in zip(u, e, strict=True)),
    )


def two_angles(joint: Joint, aims: list[Array], coded: float | None) -> list[float]:
    (before, between, after), (a, b) = joint.parts()
    vector, lever = joint.aimed()
    w, e = turn(after, normal(vector)), turn(back(before), normal(joint.weights() @ np.array(aims)))
    n, along = turn(back(between), a), b * (b @ w)
    across, side, height = n @ (w - along), n @ np.cross(b, w), e @ a - n @ along
    if coded is None:
        ratio = np.clip(height / sqrt(across**2 + side**2), -1, 1)
        second = atan2(side, across) + joint.branch * float(np.arccos(ratio))
    else:
        second = refined(coded, [(lever * across, lever * side, lever * height)])
    u = turn(between, along + (w - along) * cos(second) + np.cross(b, w) * sin(second))
    return [atan2(np.cross(u, e) @ a, u @ e - (u @ a) * (e @ a)), second]


def decode(shared: list[bytes], chunks: Chunks, like: Recording, tree: Tree) -> tuple[Array, Array]:
    """Rotations (frames, joints, 4) and positions (frames, joints, 3)."""
    layer = Layer(shared[1], tree)
    split = []
    for frames, payload in chunks:
        part = Bytes(payload)
        split.append((frames, part.blob(), part.rest()))
    targets = tempo.decode(shared[0], [(frames, rest) for frames, _, rest in split], like)
    rotations, positions, start = list[Any](), list[Any](), 0
    for frames, own, _ in split:
        for local, here in chunk(layer, own, frames, targets[start : start + frames], like):
            rotations.append(local)
            positions.append(here)
        start += frames
    return np.array(rotations), np.array(positions)


def chunk(layer: Layer, data: bytes, frames: int, targets: Array, like: Recording) -> list[tuple[Any, Array]]:
    side = np.tile(layer.nominal, (frames, 1))
    if data:
        part = Bytes(data)
        kind = part.take(1)[0]
        grid = 2.0 ** (part.folded() / 256) if kind else 0.0
        if kind & 1:
            return direct(layer, part.rest(), frames, grid)
        side, targets = transformed(layer, part, frames, targets, grid, like)
    return [layer.frame(target, values) for target, values in zip(targets, side, strict=True)]


def transformed(
    layer: Layer, part: Bytes, frames: int, targets: Array, grid: float, like: Recording
) -> tuple[Array, Array]:
    count, joints = layer.count, len(layer.joints)
    groups = -(-count // 3)
    basis, nothing = layer.basis, np.full((4, 18), -4000)
    spreads = nothing if basis is None else np.concatenate([nothing, basis.spreads[-count:]])
    means = nothing[:, 0] if basis is None else np.concatenate([nothing[:, 0], basis.means[-count:]])
    model = Model([], spreads, means, layer.known["tables"], lambda rows: rows)
    named = like._replace(names=("",) * (joints + groups))
    values, step, lists = tempo.coefficients(part, frames, model, named)
    side = np.tile(layer.nominal, (frames, 1))
    if count and len(values):
        c = (values - 0.05 * np.sign(values))[:, 4:] * 2.0 ** (step / 32)
        assert basis is not None
        y = c @ basis.rows @ np.linalg.inv(layer.factor)
        f, t = np.arange(len(values)), np.arange(frames)
        waves = np.cos(pi * (t[:, None] + 0.5) * f / frames) * np.where(f == 0, sqrt(1 / frames), sqrt(2 / frames))
        side = side + waves @ y
    padded = np.pad(3 * layer.reach * side, ((0, 0), (0, 3 * groups - count))).reshape(frames, groups, 3)
    both = np.concatenate([targets, padded], axis=1)
    tempo.correct(both, lists, grid, np.ones(joints + groups))
    return both[:, joints:].reshape(frames, -1)[:, :count] / (3 * layer.reach), both[:, :joints]


def direct(layer: Layer, data: bytes, frames: int, grid: float) -> list[tuple[Any, Array]]:
    lengths = np.sqrt((layer.tree.offsets**2).sum(axis=1))
    parents, joints = layer.tree.parents, layer.joints
    reach = [layer.reach] * len(joints)
    for j in reversed(range(len(joints))):
        reach[j] += lengths[j] * layer.own_frame
        if parents[j] >= 0:
            reach[parents[j]] = max(reach[parents[j]], reach[j] + lengths[j] * (not layer.own_frame))
    widths = [0 if x.rule == FIXED else x.locked.count(None) if x.order else 4 for x in joints]
    held = [x.placed or p < 0 for x, p in zip(joints, parents, strict=True)]
    total = sum(widths) + 3 * sum(held)
    columns = tempo.direct_columns(data, frames, total) * grid
    out = []
    for row in columns:
        at, local, positions = 0, list[Array](), np.zeros((len(joints), 3))
        for j, joint in enumerate(joints):
            own = row[at : at + widths[j]] / reach[j]
            at += widths[j]
            if not widths[j]:
                local.append(joint.usual)
            else:
                local.append(joint.of_angles(own.tolist()) if joint.order else times(joint.usual, normal(own)))
            if held[j]:
                positions[j] = row[at : at + 3]
                at += 3
        out.append((local, layer.forward(local, positions)))
    return out
