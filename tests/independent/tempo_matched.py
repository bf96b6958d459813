"""Skeletons under other names in tempo, written from docs/payloads/tempo-models.md."""

from __future__ import annotations

import numpy as np

from .integers import Bytes
from .ordered import (
    BANDS,
    cholesky,
    complete,
    cross,
    divide,
    length,
    ordered_sum,
    orthonormal,
    principal,
    product,
    square,
    unit,
)
from .payloads import Array, array
from .tempo_statistics import Model, Prior, Recording, predicted_spreads, with_heading_and_place
from .trees import (
    BODY,
    Frame,
    Tree,
    axes,
    breadth_first,
    in_order,
    metric,
    prior_tree,
    rotations,
    rounded_offsets,
    through_tree,
)


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
