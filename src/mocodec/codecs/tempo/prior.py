"""What was learned from other people's motion and ships with the package: bases, spreads and the coder's tables.

A prior is one .npz beside this package, named in every file that uses it by the first four bytes of its BLAKE2b hash.
`scripts/train_prior` makes it. Bases are float32, so that every machine multiplies by the same numbers; all that the
entropy coder depends on is integer.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from ...errors import UnknownCodec
from ...motion import Floats
from . import lanes

Integers = NDArray[np.int64]

FILE = "people.npz"
ID_BYTES = 4


@dataclass(frozen=True, eq=False)
class PointSet:
    """What is known about one set of points.

    names; pose (points, 3), metres, y up; bases: one a band of frequencies, (components, 3 points), orthonormal rows;
    spreads (rows, bands) and means (rows,), log₂ in 1/32 octave, of heading, three of place, and the components.
    """

    names: tuple[str, ...]
    pose: Floats
    bases: tuple[Floats, ...]
    spreads: Integers
    means: Integers


@dataclass(frozen=True, eq=False)
class Prior:
    id: bytes
    sets: tuple[PointSet, ...]
    coder: lanes.Tables


def read(data: bytes) -> Prior:
    """A prior from the bytes of its file."""
    with np.load(io.BytesIO(data), allow_pickle=False) as f:
        sets = tuple(
            PointSet(
                tuple(str(n) for n in f[f"{s}.names"]),
                f[f"{s}.pose"].astype(np.float64),
                tuple(b.astype(np.float64) for b in f[f"{s}.bases"]),
                f[f"{s}.spreads"].astype(np.int64),
                f[f"{s}.means"].astype(np.int64),
            )
            for s in map(str, f["sets"])
        )
        coder = lanes.Tables.of(f["tables"])
    return Prior(hashlib.blake2b(data, digest_size=ID_BYTES).digest(), sets, coder)


_others: list[Prior] = []


@cache
def _packaged() -> Prior:
    return read(resources.files("mocodec").joinpath("priors", FILE).read_bytes())


def shipped() -> Prior:
    """The prior that is used for encoding: the one inside this package, unless another is `installed`."""
    return _others[-1] if _others else _packaged()


@contextmanager
def installed(data: bytes) -> Iterator[Prior]:
    """Within this context another prior is used, and can be decoded with: for judging one on people it has not seen."""
    _others.append(read(data))
    try:
        yield _others[-1]
    finally:
        _others.pop()


def named(id_: bytes) -> Prior:
    """The prior of this hash. Raises UnknownCodec where this package does not have it."""
    for prior in (*_others, _packaged()):
        if prior.id == id_:
            return prior
    raise UnknownCodec(
        f"coded with prior {id_.hex()}, but this package has {_packaged().id.hex()}: it needs another version"
    )
