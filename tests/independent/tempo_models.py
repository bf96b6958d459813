"""Models of tempo, written from docs/payloads/tempo-models.md; only NumPy's arithmetic is used."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from .integers import Bytes
from .ordered import BANDS, complete, ordered_sum, principal, product, square
from .payloads import Array, array
from .tempo_matched import matched_skeleton
from .tempo_statistics import (
    Model,
    Prior,
    Recording,
    joints_by_name,
    predicted_spreads,
    stored_basis,
    with_heading_and_place,
)
from .trees import Tree, breadth_first, in_order, metric, prior_tree, rounded_offsets, through_tree


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
