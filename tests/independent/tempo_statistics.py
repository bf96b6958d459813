"""The prior of tempo, and spreads and means, written from docs/payloads/tempo-models.md."""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np

from .integers import Bytes
from .ordered import BAND, BANDS, complete, log2, square
from .payloads import Array, array, basis


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


# --- spreads and means


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
