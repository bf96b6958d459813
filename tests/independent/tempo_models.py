"""Models of tempo, written from docs/payloads/tempo-models.md; only NumPy's arithmetic is used."""

from __future__ import annotations

import hashlib
import io
import math
import re
from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import Any, NamedTuple

import numpy as np

from .integers import Bytes
from .payloads import Array, array, basis

BAND = (0, 200, 350, 500, 700, 1000, 1400, 2000, 2800, 4000, 5600, 8000, 11000, 16000, 22000, 32000, 45000, 60000)
BANDS = (range(0, 5), range(5, 8), range(8, 10), range(10, 18))
LOG = np.array([round(32 * math.log2(1 + i / 256)) for i in range(256)])


def log2(v: Any) -> Array:
    half, exponent = np.frexp(np.asarray(v, np.float64))
    return 32 * (exponent.astype(np.int64) - 1) + LOG[np.floor((2 * half - 1) * 256).astype(np.int64)]


class Recording(NamedTuple):
    """What the container says. offsets (points, 3): of the skeleton; it and the parents None without one."""

    names: tuple[str, ...]
    rate: float
    up: str
    parents: list[int] | None = None
    offsets: Array | None = None


class Model(NamedTuple):
    """pose: positions (frames, points, 3) of dimensions (frames, d). bases include L⁻¹."""

    bases: list[Array]
    spreads: Array
    means: Array
    tables: Array
    pose: Callable[[Array], Array]


# --- the prior

Prior = dict[str, Array]


@cache
def prior(id_: str) -> Prior:
    for file in ("points.npz", "directions.npz"):
        data = resources.files("mocodec").joinpath("priors", file).read_bytes()
        if hashlib.blake2b(data, digest_size=4).hexdigest() == id_:
            with np.load(io.BytesIO(data)) as arrays:
                return {name: widened(arrays[name]) for name in arrays}
    raise KeyError(id_)


def widened(a: Array) -> Array:
    return a.astype(np.float64) if a.dtype.kind == "f" else a.astype(np.int64) if a.dtype.kind in "iu" else a


def label(name: str) -> str:
    return re.sub("[^0-9A-Z]", "", re.split("[:|]", name)[-1].upper())


def joints_by_name(known: Prior, like: Recording) -> list[int]:
    """The joint of each point."""
    labels = [label(str(n)) for n in known["names"]]
    assert sorted(labels) == sorted(label(n) for n in like.names)
    return [labels.index(label(n)) for n in like.names]


# --- ordered arithmetic


def ordered_sum(a: Array) -> Array:
    """Along the first axis."""
    while len(a) > 1:
        half = len(a) // 2
        new = a[:half] + a[half : 2 * half]
        if len(a) % 2:
            new[0] = new[0] + a[-1]
        a = new
    return a[0] if len(a) else np.zeros(a.shape[1:])


def product(a: Array, b: Array) -> Array:
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[1]):
        out = out + a[:, i, None] * b[i]
    return out


def length(v: Array) -> Array:
    return np.sqrt((v[0] * v[0] + v[1] * v[1]) + v[2] * v[2])


def unit(v: Array) -> Array:
    return v / length(v)


def cross(a: Array, b: Array) -> Array:
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


FRACTION = np.array([round(2 ** (i / 32) * 2**20) / 2**20 for i in range(32)])


def square(x: Array) -> Array:
    return np.ldexp(FRACTION[(2 * x) % 32], 2 * x >> 5)


def orthonormal(rows: Array, most: int, shortest: float) -> Array:
    rows = rows.copy()
    size = ordered_sum(rows.T**2)
    floor = max(shortest, size.max() * 1e-10)
    found: list[Array] = []
    for _ in range(min(most, len(rows))):
        i = int(size.argmax())
        if size[i] < floor:
            break
        v = rows[i] / np.sqrt(size[i])
        before = np.array(found).reshape(-1, len(v))
        part = ordered_sum((before * v).T)
        v = v - ordered_sum(before * part[:, None])
        u = v / np.sqrt(ordered_sum(v**2))
        found.append(u)
        rows = rows - u * ordered_sum((rows * u).T)[:, None]
        size = ordered_sum(rows.T**2)
        size[i] = 0
    return np.array(found).reshape(-1, rows.shape[1])


def principal(rows: Array, most: int) -> Array:
    found = orthonormal(rows, most, 1e-30)
    return orthonormal(product(product(found, rows.T), rows), most, 1e-30) if len(found) else found


def cholesky(a: Array) -> Array:
    a, lower = a.copy(), np.zeros_like(a)
    for i in range(len(a)):
        lower[i:, i] = a[i:, i] / np.sqrt(a[i, i])
        a[i:, i:] = a[i:, i:] - lower[i:, i, None] * lower[i:, i]
    return lower


def divide(rows: Array, lower: Array) -> Array:
    rows = rows.copy()
    for i in reversed(range(len(lower))):
        rows[:, i] = rows[:, i] / lower[i, i]
        for j in range(i):
            rows[:, j] = rows[:, j] - rows[:, i] * lower[i, j]
    return rows


def complete(rows: Array, excluded: Array | None = None) -> Array:
    q = (rows if excluded is None else np.concatenate([rows, excluded])).T.copy()
    n, count = q.shape
    mirrors = []
    for i in range(count):
        u = q[i:, i].copy()
        u[0] += 1 if u[0] >= 0 else -1
        u /= math.sqrt(u @ u)
        mirrors.append(u)
        q[i:] -= 2 * np.outer(u, u @ q[i:])
    more = np.eye(n)[:, count:]
    for i in reversed(range(count)):
        more[i:] -= 2 * np.outer(mirrors[i], mirrors[i] @ more[i:])
    return np.concatenate([rows, more.T])


# --- stored basis


class StoredBasis(NamedTuple):
    rows: Array
    spreads: Array
    means: Array


def stored_basis(data: bytes, dimensions: int, alike: list[int], known: Prior) -> StoredBasis:
    part = Bytes(data)
    k = part.varint() - 1
    sizes = part.varint(), part.varint()
    g = np.cumsum(array(part.take(sizes[0]), k + 1, 1))
    part.take(sizes[1])  # precisions
    rows = complete(basis(part.rest(), dimensions, k, alike).T)
    shapes = known["spreads"][4:]
    spreads = np.array([
        shapes[rank] - shapes[rank][5] + 8 * g[min(i, k)]
        for i in range(dimensions)
        for rank in [min(i, k, len(shapes) - 1)]
    ])  # fmt: skip
    return StoredBasis(
        rows,
        np.concatenate([known["spreads"][:4], spreads]),
        np.concatenate([known["means"][:4], spreads[:, 2] - 128]),
    )


# --- predicted spreads


def predicted_spreads(variances: list[Array], median: Array, levels: list[int]) -> Array:
    gain, gain_rise, rest, rest_rise, white = levels
    octave = log2(np.maximum(BAND, 1)) - log2(1000)
    octave[0] = octave[1]
    strong = square(4 * gain + (4 * gain_rise * octave) // 32)
    noise = square(median + 4 * rest + (4 * rest_rise * octave) // 32) + square(np.full(18, 4 * white))
    out = np.zeros(variances[0].shape, np.int64)
    for v, band in zip(variances, BANDS, strict=True):
        out[:, band] = log2(v[:, band] * strong[band] + noise[band]) // 2
    return out


def with_heading_and_place(
    known: Prior, prefix: str, prior_points: int, points: int, spreads: Array, means: Array
) -> tuple[Array, Array]:
    less = int(log2(prior_points) - log2(points)) // 2
    own, own_means = known[prefix + "spreads"][:4].copy(), known[prefix + "means"][:4].copy()
    own[1:] -= less
    own_means[1:] -= less
    return np.concatenate([own, spreads]), np.concatenate([own_means, means])


# --- models 0 and 1: points


def read_model(number: int, data: bytes, known: Prior, like: Recording) -> Model:
    if number == 0:
        kind, rest = data[0], data[1:]
        return named_points(known, like) if kind == 0 else markers_on_bones(rest, known, like)
    if number == 1:
        return stored_points(data, known, like)
    if number == 3:
        return stored_directions(data, known, like)
    return (named_directions if data[0] < 2 else matched_skeleton)(data, known, like)


def points_at(mean: Array) -> Callable[[Array], Array]:
    return lambda y: y.reshape(len(y), -1, 3) + mean


def named_points(known: Prior, like: Recording) -> Model:
    joint = joints_by_name(known, like)
    dimensions = [3 * j + c for j in joint for c in range(3)]
    bases = [b[:, dimensions] for b in known["bases"]]
    return Model(bases, known["spreads"], known["means"], known["tables"], points_at(known["pose"][joint]))


def markers_on_bones(data: bytes, known: Prior, like: Recording) -> Model:
    points, part = len(like.names), Bytes(data)
    digits, on_body, scale = part.folded(), part.take(1)[0], part.varint()
    levels = [part.folded() for _ in range(5)]
    sizes = [part.varint() for _ in range(3)]
    pose = array(part.take(sizes[0]), points, 3)
    bone = array(part.take(sizes[1]), points, 1)[:, 0] - 1
    offsets = array(part.take(sizes[2]), points, 3)
    assert not part.rest()
    a = offsets / 32 / 0.15
    w = np.concatenate([scale / 64 - ((a[:, :1] + a[:, 1:2]) + a[:, 2:]), a], axis=1)
    w[bone < 0] = 0

    def moved(rows: Array) -> Array:
        x = rows.reshape(len(rows), -1, 4, 3)[:, bone]
        out = x[:, :, 0] * w[:, 0, None]
        for i in (1, 2, 3):
            out = out + x[:, :, i] * w[:, i, None]
        out = out - (ordered_sum(out.swapaxes(0, 1)) / points)[:, None]
        return out.reshape(len(rows), -1)

    mean = (pose if on_body else np.cumsum(pose, axis=0)) * 2.0**-digits
    if on_body:
        mean = mean + moved(known["bones.pose"].reshape(1, -1)).reshape(-1, 3)
    y = square(known["bones.spreads"][4:])
    rows = 3 * points - 3
    translations = np.tile(np.eye(3), points) / math.sqrt(points)
    bases, variances = [], []
    for components, band in zip(known["bones.bases"], BANDS, strict=True):
        here = moved(components)
        d = principal(here * np.sqrt(y[:, band].max(axis=1))[:, None], rows)
        v = np.zeros((rows, 18))
        v[: len(d)] = product(product(d, here.T) ** 2, y)
        bases.append(complete(d, translations))
        variances.append(v)
    spreads = predicted_spreads(variances, known["bones.median_spread"], levels)
    both = with_heading_and_place(known, "bones.", 108, points, spreads, spreads[:, 2] - 128)
    return Model(bases, *both, known["tables"], points_at(mean))


def stored_points(data: bytes, known: Prior, like: Recording) -> Model:
    points, part = len(like.names), Bytes(data)
    noise = part.folded()
    pose = np.cumsum(array(part.blob(), points, 3), axis=0)
    alike = [-1, -1, -1]
    for p in range(1, points):
        apart = ((pose[:p] - pose[p]).astype(float) ** 2).sum(axis=1)
        alike += [3 * int(apart.argmin()) + c for c in range(3)]
    found = stored_basis(part.rest(), 3 * points, alike, known)
    mean = pose * 2.0 ** ((noise + 64) / 32)
    return Model([found.rows] * 4, found.spreads, found.means, known["tables"], points_at(mean))


# --- trees of bones

BODY = ("body", 0)
Frame = tuple[str, int]


class Tree:
    """parents, vectors (points, 3), and marks, in an order in which parents stand before their children."""

    def __init__(self, parents: list[int], vectors: Array, hub: Array, relative: Array) -> None:
        self.parents, self.vectors, self.hub, self.relative = parents, vectors, hub, relative
        self.lengths = np.sqrt((vectors**2).sum(axis=1))
        self.moves = [j for j, p in enumerate(parents) if p >= 0 and self.lengths[j] > 1e-7]
        self.bones = [j for j in self.moves if not hub[j]]
        self.hub_bones: dict[int, list[int]] = {}
        for j in self.moves:
            if hub[j]:
                self.hub_bones.setdefault(parents[j], []).append(j)
        self.hubs = list(self.hub_bones)
        self.reference: dict[Frame, Frame] = {}
        at: list[Frame] = []
        for j, p in enumerate(parents):
            at.append(at[p] if p >= 0 else BODY)
            if j not in self.moves:
                continue
            if hub[j]:
                if ("hub", p) not in self.reference:
                    self.reference["hub", p] = at[p] if relative[j] else BODY
                at[j] = ("hub", p)
            else:
                before = ("hub", p) if ("hub", p) in self.reference else at[p]
                self.reference["bone", j] = before if relative[j] else BODY
                at[j] = ("bone", j)

    @property
    def dimensions(self) -> int:
        return 2 * len(self.bones) + 3 * len(self.hubs)

    def frame_of(self, j: int) -> Frame:
        """The bone, or the hub that it belongs to."""
        return ("hub", self.parents[j]) if self.hub[j] else ("bone", j)

    def first_dimension(self, frame: Frame) -> int:
        kind, number = frame
        return 2 * self.bones.index(number) if kind == "bone" else 2 * len(self.bones) + 3 * self.hubs.index(number)

    def resized(self, offsets: Array) -> Tree:
        size = np.sqrt((offsets**2).sum(axis=1))
        vectors = self.vectors / np.maximum(self.lengths, 1e-30)[:, None] * size[:, None]
        for bones in self.hub_bones.values():
            u, _, vt = np.linalg.svd(self.vectors[bones].T @ offsets[bones])
            u[:, 2] *= np.sign(np.linalg.det(u @ vt))
            vectors[bones] = offsets[bones] @ (u @ vt).T
        return Tree(self.parents, vectors, self.hub, self.relative)

    def positions(self, y: Array) -> Array:
        """(frames, points, 3) of dimensions (frames, d), about their mean."""
        turn: dict[Frame, Array] = {BODY: np.broadcast_to(np.eye(3), (len(y), 3, 3))}
        out = np.zeros((len(y), len(self.parents), 3))
        for j, p in enumerate(self.parents):
            if p >= 0:
                out[:, j] = out[:, p]
            if j not in self.moves:
                continue
            frame = self.frame_of(j)
            if frame not in turn:
                i = self.first_dimension(frame)
                if self.hub[j]:
                    own = y[:, i : i + 3]
                else:
                    first, second = axes(self.vectors[j])
                    own = y[:, i, None] * second - y[:, i + 1, None] * first
                turn[frame] = turn[self.reference[frame]] @ rotation(own)
            out[:, j] += turn[frame] @ self.vectors[j]
        return out - out.mean(axis=1, keepdims=True)


def axes(vector: Array) -> tuple[Array, Array]:
    """First and second; ordered."""
    d = unit(vector)
    e = np.eye(3)[np.abs(d).argmin()]
    first = unit(e - d * ((e[0] * d[0] + e[1] * d[1]) + e[2] * d[2]))
    return first, cross(d, first)


def rotation(w: Array) -> Array:
    """Matrices (n, 3, 3) of rotation vectors (n, 3)."""
    angle = np.sqrt((w**2).sum(axis=1))[:, None, None]
    k = np.zeros((len(w), 3, 3))
    k[:, 2, 1], k[:, 0, 2], k[:, 1, 0] = w.T
    k = k - k.transpose(0, 2, 1)
    return np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (k @ k)


def rounded_offsets(like: Recording) -> Array:
    assert like.offsets is not None
    return np.rint(like.offsets * 100_000) / 100_000


def breadth_first(parents: list[int]) -> list[int]:
    order = [p for p, parent in enumerate(parents) if parent < 0]
    assert len(order) == 1
    for at in order:
        order += [p for p, parent in enumerate(parents) if parent == at]
    assert len(order) == len(parents)
    return order


def in_order(order: list[int], parents: list[int]) -> list[int]:
    return [order.index(parents[p]) if parents[p] >= 0 else -1 for p in order]


def through_tree(tree: Tree, order: list[int]) -> Callable[[Array], Array]:
    """Positions in the order of the file; order: the point of each place in the tree."""
    return lambda y: tree.positions(y)[:, np.argsort(order)]


# --- models 2 and 3: directions


def prior_tree(known: Prior) -> Tree:
    return Tree([int(p) for p in known["parents"]], known["vectors"], known["hub"], known["relative"])


def named_directions(data: bytes, known: Prior, like: Recording) -> Model:
    tree = prior_tree(known)
    joint = joints_by_name(known, like)
    order = [joint.index(j) for j in range(len(joint))]
    if data[0] == 0:
        assert len(data) == 1
        tree = tree.resized(rounded_offsets(like)[order])
    else:
        part = Bytes(data[1:])
        fine = part.folded()
        count = sum(3 if tree.hub[j] else 1 for j in tree.moves)
        numbers = iter(array(part.rest(), count, 1)[:, 0] * 2.0 ** (fine / 32))
        vectors = tree.vectors.copy()
        for j in tree.moves:
            if tree.hub[j]:
                vectors[j] += [next(numbers) for _ in range(3)]
            else:
                vectors[j] *= max(tree.lengths[j] + next(numbers), 0) / tree.lengths[j]
        tree = Tree(tree.parents, vectors, tree.hub, tree.relative)
    bases = [b @ np.linalg.inv(known["metric_root"]) for b in known["bases"]]
    return Model(bases, known["spreads"], known["means"], known["tables"], through_tree(tree, order))


def stored_directions(data: bytes, known: Prior, like: Recording) -> Model:
    points, part = len(like.names), Bytes(data)
    fine, has_tree = part.folded(), part.take(1)[0]
    sizes = [part.varint() for _ in range(2 + has_tree)]
    if has_tree:
        parents = [int(v) + p for p, v in enumerate(array(part.take(sizes.pop(0)), points, 1)[:, 0])]
    else:
        assert like.parents is not None
        parents = like.parents
    vectors = array(part.take(sizes[0]), points, 3) * 2.0 ** (fine / 32)
    marks = array(part.take(sizes[1]), points, 1)[:, 0]
    order = breadth_first(parents)
    tree = Tree(in_order(order, parents), vectors[order], marks[order] & 1 != 0, marks[order] & 2 != 0)
    if not has_tree:
        tree = tree.resized(rounded_offsets(like)[order])
    factor = (math.sin(1e-4) / 1e-4) ** 2
    lower = np.linalg.cholesky(metric(tree, factor))
    found = stored_basis(part.rest(), tree.dimensions, [-1] * tree.dimensions, known)
    bases = [found.rows @ np.linalg.inv(lower)] * 4
    return Model(bases, found.spreads, found.means, known["tables"], through_tree(tree, order))


def rotations(tree: Tree) -> list[tuple[Array, list[int]]]:
    """Axis of each dimension, and the bones that it rotates."""
    rotated: dict[Frame, list[int]] = {}
    for j in tree.moves:
        frame = tree.frame_of(j)
        while frame != BODY:
            rotated.setdefault(frame, []).append(j)
            frame = tree.reference[frame]
    out = []
    for j in tree.bones:
        first, second = axes(tree.vectors[j])
        out += [(second, rotated["bone", j]), (-first, rotated["bone", j])]
    for h in tree.hubs:
        out += [(axis, rotated["hub", h]) for axis in np.eye(3)]
    return out


def metric(tree: Tree, factor: float = 1.0) -> Array:
    points = len(tree.parents)
    move = np.zeros((tree.dimensions, points, 3))
    for i, (axis, bones) in enumerate(rotations(tree)):
        for j in bones:
            move[i, j] = cross(axis, tree.vectors[j])
    for j, p in enumerate(tree.parents):
        if p >= 0:
            move[:, j] = move[:, j] + move[:, p]
    move = move - (ordered_sum(move.swapaxes(0, 1)) / points)[:, None]
    flat = move.reshape(len(move), -1)
    a = product(flat, flat.T) * factor
    return a + 1e-6 * a.max() * np.eye(len(a))


def matched_skeleton(data: bytes, known: Prior, like: Recording) -> Model:
    points, part, theirs = len(like.names), Bytes(data[1:]), prior_tree(known)
    digits = part.folded()
    levels = [part.folded() + usual for usual in (0, 0, -24, 0, -150, 0)]
    has_tree = part.take(1)[0]
    numbers = array(part.blob(), points, 3)
    joint, before = [], -1
    for n in numbers[:, 0]:
        before += 1 + int(n)
        joint.append(before)
    marks = np.array([
        n + (int(theirs.hub[v]) + 2 * int(theirs.relative[v]) if v >= 0 else 0)
        for n, v in zip(numbers[:, 1], joint, strict=True)
    ])  # fmt: skip
    if has_tree:
        parents = [int(n) + expected_parent(p, joint, theirs) for p, n in enumerate(numbers[:, 2])]
    else:
        assert like.parents is not None
        parents = like.parents
    counts = [3 if v < 0 or (has_tree and m & 1) else int(has_tree) for v, m in zip(joint, marks, strict=True)]
    values = iter(array(part.rest(), sum(counts), 1)[:, 0])
    stored = np.array([[next(values) if c < count else 0 for c in range(3)] for count in counts]) * 2.0**-digits

    order = breadth_first(parents)
    parents, joint, marks, stored = in_order(order, parents), [joint[p] for p in order], marks[order], stored[order]
    paths = bone_paths(joint, parents, theirs)
    vectors = stored.copy()
    for j, path in enumerate(paths):
        if joint[j] >= 0:
            vectors[j] = 0
            for b in path:
                vectors[j] = vectors[j] + theirs.vectors[b]
    rest = Tree(parents, vectors, marks & 1 != 0, marks & 2 != 0)
    if has_tree:
        own = vectors.copy()
        for j in range(points):
            if joint[j] < 0:
                own[j] = stored[j]
            elif rest.hub[j]:
                own[j] = vectors[j] + stored[j]
            else:
                own[j] = vectors[j] * max(rest.lengths[j] + stored[j, 0], 0) / max(rest.lengths[j], 1e-30)
        body = Tree(parents, own, rest.hub, rest.relative)
    else:
        body = rest.resized(rounded_offsets(like)[order])
    assert [j for j in body.moves if j] == [j for j in rest.moves if j]

    lower = cholesky(metric(rest))
    bases, variances = predicted_directions(rest, paths, lower, known, theirs)
    of_y = np.concatenate([known["means"][4:, None], known["spreads"][4:, 1:]], axis=1)
    median = np.trunc(np.median(of_y, axis=0)).astype(np.int64)
    spreads = predicted_spreads(variances, median, levels[:5])
    for v, band in zip(variances, BANDS, strict=True):
        for row in np.flatnonzero(~v.any(axis=1)):
            spreads[row, band] += 4 * levels[5]
    both = with_heading_and_place(known, "", 31, points, spreads, spreads[:, 0])
    bases = [b @ np.linalg.inv(lower) for b in bases]
    return Model(bases, *both, known["tables"], through_tree(body, order))


def expected_parent(p: int, joint: list[int], theirs: Tree) -> int:
    if joint[p] < 0:
        return p - 1
    above = theirs.parents[joint[p]]
    while above >= 0:
        if above in joint:
            return max(q for q, v in enumerate(joint) if v == above)
        above = theirs.parents[above]
    return -1


def bone_paths(joint: list[int], parents: list[int], theirs: Tree) -> list[list[int]]:
    out: list[list[int]] = []
    for j, at in enumerate(joint):
        above = parents[j]
        while above >= 0 and joint[above] < 0:
            above = parents[above]
        if at < 0 or theirs.parents[at] < 0:
            out.append([])
        elif above < 0:
            out.append([at])
        elif joint[above] == at:
            out.append(out[above] or [at])
        else:
            line = [at]
            while theirs.parents[line[-1]] not in (-1, joint[above]):
                line.append(theirs.parents[line[-1]])
            out.append(line if theirs.parents[line[-1]] == joint[above] else [at])
    return out


def predicted_directions(
    rest: Tree, paths: list[list[int]], lower: Array, known: Prior, theirs: Tree
) -> tuple[list[Array], list[Array]]:
    """Bases and variances of the bands."""
    n, mapping = rest.dimensions, coordinate_map(rest, paths, theirs)
    y = square(np.concatenate([known["means"][4:, None], known["spreads"][4:, 1:]], axis=1))
    bases, variances = [], []
    for components, band in zip(known["bases"], BANDS, strict=True):
        a = product(product(divide(components, known["metric_root"]), mapping), lower)
        d = principal(a * np.sqrt(y[:, [f for f in band if f]].max(axis=1))[:, None], n)
        e = a / np.sqrt(np.maximum(ordered_sum(a.T**2), 1e-30))[:, None]
        for _ in range(2):
            e = e - product(product(e, d.T), d)
        d = np.concatenate([d, orthonormal(e, n - len(d), 1e-14)])
        v = np.zeros((n, 18))
        v[: len(d)] = product(product(d, a.T) ** 2, y)
        bases.append(complete(d))
        variances.append(v)
    return bases, variances


def coordinate_map(rest: Tree, paths: list[list[int]], theirs: Tree) -> Array:
    rotated = np.zeros((len(theirs.parents), theirs.dimensions, 3))
    for i, (axis, bones) in enumerate(rotations(theirs)):
        rotated[bones, i] = axis
    out = np.zeros((theirs.dimensions, rest.dimensions))
    turn: dict[Frame, Array] = {BODY: np.zeros((theirs.dimensions, 3))}
    for j in rest.moves:
        frame = rest.frame_of(j)
        if frame in turn:
            continue
        ref, i = turn[rest.reference[frame]], rest.first_dimension(frame)
        if rest.hub[j]:
            last = [paths[c][-1] for c in rest.hub_bones[rest.parents[j]] if paths[c]]
            b = next((b for b in last if theirs.hub[b]), None)
            own = np.zeros_like(ref) if b is None else rotated[b] - ref
            out[:, i : i + 3] = own
            turn[frame] = ref + own
            continue
        if not paths[j]:
            turn[frame] = ref
            continue
        v = rest.vectors[j]
        first, second = axes(v)
        moved = -cross(ref, unit(v))
        for b in paths[j]:
            moved = moved + cross(rotated[b], theirs.vectors[b] / length(v))
        tilt = [(moved[:, :1] * a[0] + moved[:, 1:2] * a[1]) + moved[:, 2:] * a[2] for a in (first, second)]
        out[:, i : i + 2] = np.concatenate(tilt, axis=1)
        turn[frame] = (ref + tilt[0] * second) - tilt[1] * first
    return out
