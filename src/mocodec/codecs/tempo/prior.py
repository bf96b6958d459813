"""What was learned from other people's motion and ships with the package: bases, spreads and the coder's tables.

A prior is one .npz beside this package, named in every file that uses it by the first four bytes of its BLAKE2b hash.
`scripts/train_prior` makes it. Bases are float32, so that every machine multiplies by the same numbers; all that the
entropy coder depends on is integer.

    people.npz     the joints of one skeleton, by name
    limbs.npz      where its bones point, on any build
    bodies.npz     the bones, as places and turns: for points of any other names (`mapped`)
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import resources
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UnknownCodec
from ...motion import Floats
from . import lanes
from .limbs import Limbs

Integers = NDArray[np.int64]

FILE, LIMBS_FILE, BONES_FILE = "people.npz", "limbs.npz", "bodies.npz"
ID_BYTES = 4


@dataclass(frozen=True, eq=False)
class PointSet:
    """What is known about one set of points.

    names; pose (points, 3), metres, y up; bases: one a band of frequencies, (components, dimensions), orthonormal rows;
    spreads (rows, bands) and means (rows,), log₂ in 1/32 octave, of heading, three of place, and the components.
    limbs: a pose is not the points' coordinates less the mean pose's then, but those of its limbs, weighed by `reach`,
    (dimensions, dimensions). columns (points,): where in a pose the points of the limbs stand.
    """

    names: tuple[str, ...]
    pose: Floats
    bases: tuple[Floats, ...]
    spreads: Integers
    means: Integers
    limbs: Limbs | None = None
    reach: Floats | None = None
    columns: Integers | None = None

    @cached_property
    def unweighed_bases(self) -> tuple[Floats, ...]:
        """`bases` that undo `weighed` too."""
        if self.reach is None:
            return self.bases
        unreach = np.asarray(np.linalg.inv(self.reach), np.float64)
        return tuple(b @ unreach for b in self.bases)

    def coordinates(self, poses: Floats) -> Floats:
        """Poses (frames, points, 3) about the origin, headed as the mean pose, as numbers (frames, dimensions)."""
        if self.limbs is None:
            return (poses - self.pose).reshape(len(poses), -1)
        return self.limbs.forward(poses if self.columns is None else _reordered(poses, self.columns))

    def weighed(self, spectrum: Floats) -> Floats:
        """Coordinates, or their spectrum, so that an error of one is about an error of one in the points."""
        return spectrum if self.reach is None else spectrum @ self.reach

    def posed(self, coordinates: Floats) -> Floats:
        """The inverse of `coordinates`."""
        if self.limbs is None:
            return coordinates.reshape(-1, *self.pose.shape) + self.pose
        poses = self.limbs.inverse(coordinates)
        return poses if self.columns is None else _reordered(poses, np.argsort(self.columns))


def _reordered(poses: Floats, columns: Integers) -> Floats:
    """poses[:, columns], with frames next to each other in memory."""
    return np.take(poses.T, columns, axis=1).T


@dataclass(frozen=True, eq=False)
class Bones:
    """What is known about how bones move: each as its joint and three points that turn with it.

    parents (bones,): the bone that each begins at. usual (bands,): how large components are in the middle. set: the
    points, (4 bones,): joint and three turning points, bone after bone.
    """

    names: tuple[str, ...]
    parents: Integers
    usual: Integers
    set: PointSet

    @property
    def joints(self) -> Floats:
        """Their mean places, (bones, 3)."""
        return self.set.pose[::4]


@dataclass(frozen=True, eq=False)
class Prior:
    id: bytes
    sets: tuple[PointSet, ...]
    coder: lanes.Tables
    bones: Bones | None = None


def read(data: bytes) -> Prior:
    """A prior from the bytes of its file."""
    with np.load(io.BytesIO(data), allow_pickle=False) as f:
        arrays = dict(f)
    sets = tuple(_point_set(arrays, s) for s in map(str, arrays["sets"]))
    bones = None
    if "bones.parents" in arrays:
        of_bones = _point_set(arrays, "bones")
        bones = Bones(
            of_bones.names[::4],
            arrays["bones.parents"].astype(np.int64),
            arrays["bones.usual"].astype(np.int64),
            of_bones,
        )
    id_ = hashlib.blake2b(data, digest_size=ID_BYTES).digest()
    return Prior(id_, sets, lanes.Tables.of(arrays["tables"]), bones)


def _point_set(arrays: dict[str, NDArray[Any]], name: str) -> PointSet:
    return PointSet(
        tuple(str(n) for n in arrays[f"{name}.names"]),
        arrays[f"{name}.pose"].astype(np.float64),
        tuple(b.astype(np.float64) for b in arrays[f"{name}.bases"]),
        arrays[f"{name}.spreads"].astype(np.int64),
        arrays[f"{name}.means"].astype(np.int64),
        *_limbs(arrays, name),
    )


def _limbs(f: Mapping[str, NDArray[Any]], s: str) -> tuple[Limbs | None, Floats | None]:
    if f"{s}.reach" not in f:
        return None, None
    hub, carried = f[f"{s}.marks"]
    parents = tuple(int(p) for p in f[f"{s}.parents"])
    return Limbs(parents, f[f"{s}.vectors"].astype(np.float64), hub, carried), f[f"{s}.reach"].astype(np.float64)


_others: list[tuple[Prior, ...]] = []


def packaged_bytes(file: str = FILE) -> bytes:
    """The file of a prior inside this package."""
    return resources.files("mocodec").joinpath("priors", file).read_bytes()


@cache
def _packaged(file: str = FILE) -> Prior:
    return read(packaged_bytes(file))


def shipped() -> Prior:
    """The prior that is used for encoding: the one inside this package, unless others are `installed`."""
    return _others[-1][0] if _others else _packaged()


def of_limbs() -> Prior | None:
    """The prior that knows limbs, to be used for encoding; none where others are `installed` that do not."""
    used = _others[-1] if _others else (_packaged(LIMBS_FILE),)
    return next((p for p in used if p.sets and p.sets[0].limbs is not None), None)


def of_bones() -> Prior | None:
    """The prior that knows bones, to be used for encoding; none where others are `installed` that do not."""
    used = _others[-1] if _others else (_packaged(BONES_FILE),)
    return next((p for p in used if p.bones is not None), None)


@contextmanager
def installed(*data: bytes) -> Iterator[Prior]:
    """Within this context other priors are used, and can be decoded with: for judging them on people they have not
    seen. The first is for points by name; it is given."""
    _others.append(tuple(map(read, data)))
    try:
        yield _others[-1][0]
    finally:
        _others.pop()


def named(id_: bytes) -> Prior:
    """The prior of this hash. Raises UnknownCodec where this package does not have it."""
    packaged = (_packaged(file) for file in (FILE, LIMBS_FILE, BONES_FILE))
    for prior in chain(*_others, packaged):
        if prior.id == id_:
            return prior
    raise UnknownCodec(
        f"coded with prior {id_.hex()}, but this package has {_packaged().id.hex()}: it needs another version"
    )
