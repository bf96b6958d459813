"""Trees of bones, written from docs/payloads/tempo-models.md."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .ordered import cross, ordered_sum, product, unit
from .payloads import Array
from .tempo_statistics import Prior, Recording

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


def prior_tree(known: Prior) -> Tree:
    return Tree([int(p) for p in known["parents"]], known["vectors"], known["hub"], known["relative"])


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
