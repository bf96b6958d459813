"""The prior, learned from other people's motion and shipped with the package: bases, spreads and the coder's tables.

A prior is one .npz beside this package, identified in every file that uses it by its BLAKE2b digest of four bytes.
`scripts/train_prior` makes it. Bases are float32, so that every machine multiplies by the same numbers; all that the
entropy coder depends on is integer. `mocodec prior train` makes priors of one's own: `used` encodes with them, and
`by_id` finds them for decoding in the folders of MOCODEC_PRIORS.

    points.npz        positions of the joints of one skeleton, by name; and how bones move, for markers on them
    directions.npz    directions of the bones of that skeleton, for any proportions
"""

from __future__ import annotations

import hashlib
import io
import os
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....entropy.lanes import StaticTables
from ....errors import BadInput, UnknownCodec
from ....geometry.body_frame import normalised_label
from ....typing import Floats, Integers
from ..pose.bone_tree import BoneTree
from .coordinates import Coordinates, DirectionCoordinates, PointCoordinates
from .model import Statistics

POINTS_FILE, DIRECTIONS_FILE = "points.npz", "directions.npz"
ID_BYTES = 4


@dataclass(frozen=True, eq=False)
class JointSet:
    """Joints that the prior knows by name."""

    names: tuple[str, ...]
    coordinates: Coordinates
    statistics: Statistics

    def columns(self, names: tuple[str, ...]) -> Integers | None:
        """For each joint of the set, which of these names is its, whatever prefix and spelling; None if they differ."""
        found = _columns(names, self.names)
        return None if found is None else np.array(found)

    @property
    def tree(self) -> BoneTree:
        """The bone tree of a set whose coordinates are directions."""
        assert isinstance(self.coordinates, DirectionCoordinates)
        return self.coordinates.tree


@lru_cache(maxsize=16)
def _columns(names: tuple[str, ...], known_names: tuple[str, ...]) -> tuple[int, ...] | None:
    labels, known = ([normalised_label(n) for n in some] for some in (names, known_names))
    if len(set(labels)) != len(labels) or sorted(labels) != sorted(known):
        return None
    return tuple(labels.index(label) for label in known)


@dataclass(frozen=True, eq=False)
class BoneMotion:
    """How bones move, each as its joint and three points that rotate with it.

    parents (bones,): the bone that each starts at. median_spread (frequencies,): of the components. pose (4 bones, 3):
    joint and three rotating points, bone after bone. statistics: of the positions of these points.
    """

    names: tuple[str, ...]
    parents: Integers
    median_spread: Integers
    pose: Floats
    statistics: Statistics

    @property
    def joints(self) -> Floats:
        """Mean positions of the joints, (bones, 3)."""
        return self.pose[::4]


@dataclass(frozen=True, eq=False)
class Prior:
    """The prior of one kind of coordinates."""

    id: bytes
    joints: JointSet
    tables: StaticTables
    bones: BoneMotion | None = None

    @property
    def for_directions(self) -> bool:
        return isinstance(self.joints.coordinates, DirectionCoordinates)


def read(data: bytes) -> Prior:
    """A prior from the bytes of its file."""
    with np.load(io.BytesIO(data), allow_pickle=False) as f:
        arrays: dict[str, NDArray[Any]] = dict(f)
    names, pose, statistics = _joints(arrays, "")
    coordinates: Coordinates = PointCoordinates(pose)
    if "parents" in arrays:
        tree = BoneTree(
            tuple(int(p) for p in arrays["parents"]),
            arrays["vectors"].astype(np.float64),
            arrays["hub"],
            arrays["relative"],
        )
        coordinates = DirectionCoordinates(pose, tree, arrays["metric_root"].astype(np.float64), np.arange(len(names)))
    bones = None
    if "bones.parents" in arrays:
        of_points, mean, motion = _joints(arrays, "bones.")
        bones = BoneMotion(
            of_points[::4],
            arrays["bones.parents"].astype(np.int64),
            arrays["bones.median_spread"].astype(np.int64),
            mean,
            motion,
        )
    id_ = hashlib.blake2b(data, digest_size=ID_BYTES).digest()
    return Prior(id_, JointSet(names, coordinates, statistics), StaticTables.of(arrays["tables"]), bones)


def _joints(arrays: Mapping[str, NDArray[Any]], prefix: str) -> tuple[tuple[str, ...], Floats, Statistics]:
    return (
        tuple(str(n) for n in arrays[f"{prefix}names"]),
        arrays[f"{prefix}pose"].astype(np.float64),
        Statistics(
            tuple(b.astype(np.float64) for b in arrays[f"{prefix}bases"]),
            arrays[f"{prefix}spreads"].astype(np.int64),
            arrays[f"{prefix}means"].astype(np.int64),
        ),
    )


def packaged_bytes(file: str) -> bytes:
    """The file of a prior inside this package."""
    return resources.files("mocodec").joinpath("priors", file).read_bytes()


@cache
def _packaged(file: str) -> Prior:
    return read(packaged_bytes(file))


_installed: list[tuple[Prior, Prior]] = []


def for_points() -> Prior:
    """The prior of positions used for encoding: the packaged one, unless another is `installed`."""
    return _installed[-1][0] if _installed else _packaged(POINTS_FILE)


def for_directions() -> Prior:
    """The prior of bone directions used for encoding."""
    return _installed[-1][1] if _installed else _packaged(DIRECTIONS_FILE)


@contextmanager
def installed(points: bytes | None = None, directions: bytes | None = None) -> Iterator[tuple[Prior, Prior]]:
    """Uses other priors within this context, to test on people whom the packaged ones were trained on."""
    both = (
        for_points() if points is None else read(points),
        for_directions() if directions is None else read(directions),
    )
    _installed.append(both)
    try:
        yield both
    finally:
        _installed.pop()


def by_id(id_: bytes) -> Prior:
    """The prior of this hash: of the package, or one's own. Raises UnknownCodec where neither has it."""
    candidates = [p for pair in _installed for p in pair]
    for prior in (*candidates, *(_packaged(file) for file in (DIRECTIONS_FILE, POINTS_FILE))):
        if prior.id == id_:
            return prior
    for path in _own_files():
        with suppress(BadInput):
            for prior in _own(str(path), path.stat().st_mtime_ns):
                if prior.id == id_:
                    return prior
    raise UnknownCodec(
        f"coded with the prior {id_.hex()}, which this version of mocodec does not have; for a prior of your own, name "
        f"its folder in {FOLDERS_VARIABLE}"
    )


FOLDERS_VARIABLE = "MOCODEC_PRIORS"
"""Environment variable: folders of priors of one's own (*.prior), separated as in PATH."""
OWN_SUFFIX = ".prior"
MOST_OWN_BYTES = 1 << 26

_folders: list[str] = []


def search_in(folder: str) -> None:
    """Look for priors of one's own in this folder too: of an archive."""
    if folder not in _folders:
        _folders.append(folder)


def _own_files() -> list[Path]:
    folders = [*_folders, *filter(None, os.environ.get(FOLDERS_VARIABLE, "").split(os.pathsep))]
    return [path for folder in folders for path in sorted(Path(folder).glob(f"*{OWN_SUFFIX}"))]


def pack_own(points: bytes, directions: bytes) -> bytes:
    """The file of a prior of one's own: the two .npz in one .zip, the same bytes each time."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as packed:
        for name, data in ((POINTS_FILE, points), (DIRECTIONS_FILE, directions)):
            packed.writestr(zipfile.ZipInfo(name), data)
    return out.getvalue()


def unpack_own(data: bytes) -> tuple[bytes, bytes]:
    """The two .npz in a prior of one's own. Raises BadInput."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            if sum(info.file_size for info in packed.infolist()) > MOST_OWN_BYTES:
                raise ValueError("it is too large")
            points, directions = packed.read(POINTS_FILE), packed.read(DIRECTIONS_FILE)
        for file in (points, directions):
            read(file)
        return points, directions
    except Exception as error:  # whatever damaged .zip and .npz files raise
        raise BadInput(f"this is not a prior that `mocodec prior train` wrote ({error})") from error


@lru_cache(maxsize=16)
def _own(path: str, _: int) -> tuple[Prior, Prior]:
    try:
        points, directions = unpack_own(Path(path).read_bytes())
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}") from error
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    return read(points), read(directions)


@contextmanager
def used(path: str | None) -> Iterator[None]:
    """Within this context tempo encodes with a prior of one's own; None: those of the package. Raises BadInput."""
    if path is None:
        yield
        return
    try:
        _installed.append(_own(os.path.abspath(path), os.stat(path).st_mtime_ns))
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}") from error
    try:
        yield
    finally:
        _installed.pop()
