"""Simulation of an inverted index: vectors in clusters; a search compares only the clusters nearest to the query.

vectors ─k-means─► clusters, each with the list of its vectors
query of n windows ─each: nearest clusters─► vectors ─minus the place in the query─► candidates ─► exact distances
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocodec.archive import similarity
from mocodec.typing import Integers

from .large import similar

Vectors = NDArray[np.floating[Any]]

FRAMES = 10_000_000
CLUSTERS, ROUNDS, LEARNED_FROM = 1024, 8, 40_000
PROBED = (4, 16, 64)
QUERIES, WINDOWS, NEAREST = 20, 13, 10
NOISE_M = 0.03


def measure(vault: Path) -> dict[str, Any]:
    """Share of vectors compared, time, and share of results equal to the full search, by number of searched clusters.

    A query is 4 s of the index with noise of 3 cm on each component.
    """
    _, found = similar(vault, FRAMES, ["recording"])
    vectors = found.vectors.astype(np.float32)
    found = type(found)(**{**found.__dict__, "vectors": vectors})
    random = np.random.default_rng(1)
    centres = learned(vectors[random.permutation(len(vectors))[:LEARNED_FROM]], random)
    cluster = nearest(vectors, centres, 1)[:, 0]
    order = np.argsort(cluster, kind="stable")
    first = np.searchsorted(cluster[order], np.arange(CLUSTERS + 1))
    recording = np.repeat(np.arange(len(found.first) - 1), np.diff(found.first))
    is_usable = np.append(recording[: 1 - WINDOWS] == recording[WINDOWS - 1 :], False)
    usable = np.flatnonzero(is_usable)
    queries = [
        vectors[at : at + WINDOWS] + random.normal(0, NOISE_M, (WINDOWS, vectors.shape[1])).astype(np.float32)
        for at in random.permutation(usable)[:QUERIES]
    ]
    rows: list[dict[str, Any]] = []
    exact: list[Integers] = []
    begun = time.process_time()
    for query in queries:
        exact.append(np.argsort(similarity._along(found, query))[:NEAREST])
    rows.append({"probed": 0, "compared": 1.0, "nearest": 1.0, "ten": 1.0, "ms": per_query(begun)})
    for probed in PROBED:
        begun, compared, same, ten = time.process_time(), 0, 0, 0.0
        for query, expected in zip(queries, exact, strict=True):
            starts = candidates(query, centres, order, first, probed)
            starts = starts[is_usable[np.clip(starts, -1, len(is_usable) - 1)] & (starts >= 0)]
            compared += len(starts)
            apart = ((vectors[starts[:, None] + np.arange(WINDOWS)] - query) ** 2).sum(axis=(1, 2))
            best = starts[np.argsort(apart)[:NEAREST]]
            same += int(len(best) > 0 and best[0] == expected[0])
            ten += len(np.intersect1d(best, expected)) / NEAREST
        rows.append(
            {
                "probed": probed,
                "compared": compared / QUERIES / len(vectors),
                "nearest": same / QUERIES,
                "ten": ten / QUERIES,
                "ms": per_query(begun),
            }
        )
    return {"frames": FRAMES, "vectors": len(vectors), "clusters": CLUSTERS, "rows": rows}


def per_query(begun: float) -> float:
    """Milliseconds of processor time since `begun`, for each query."""
    return 1e3 * (time.process_time() - begun) / QUERIES


def learned(sample: Vectors, random: np.random.Generator) -> Vectors:
    """Centres (CLUSTERS, components) by k-means."""
    centres = sample[random.permutation(len(sample))[:CLUSTERS]].copy()
    for _ in range(ROUNDS):
        own = nearest(sample, centres, 1)[:, 0]
        sums = np.zeros_like(centres)
        np.add.at(sums, own, sample)
        counts = np.bincount(own, minlength=CLUSTERS)
        centres[counts > 0] = sums[counts > 0] / counts[counts > 0, None]
    return centres


def nearest(vectors: Vectors, centres: Vectors, count: int) -> Integers:
    """The numbers of the nearest centres of each vector, (vectors, count)."""
    squares = (centres**2).sum(axis=1)
    parts = [
        np.argpartition(squares - 2 * part @ centres.T, count - 1, axis=1)[:, :count]
        for part in np.array_split(vectors, -(-len(vectors) // 8192))
    ]
    return np.concatenate(parts)


def candidates(query: Vectors, centres: Vectors, order: Integers, first: Integers, probed: int) -> Integers:
    """Possible starts of a run like the query: vectors of the clusters near a window, minus the place of the window.
    Three windows of the query are looked up: its ends and its middle."""
    found: list[Integers] = []
    for place in (0, len(query) // 2, len(query) - 1):
        for c in nearest(query[place : place + 1], centres, probed)[0]:
            found.append(order[first[c] : first[c + 1]] - place)
    return np.unique(np.concatenate(found))
