# pyright: strict
"""Search for similar motion: a vector for every 0.2 s of an archive, with the distances of poses over 1.6 s.

    window of 1.6 s ─8 poses, less place and heading of the middle─► (8, points, 3) ─32 components─► vector

Vectors are scaled so that the distance of two windows is about the RMS distance of their points, in metres. A query is
compared at several tempos. The index is a file beside the catalogue, one for each set of points, written as a whole.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import api
from ..codecs.tempo.pose import heading
from ..errors import BadInput, Corrupt, MocodecError
from ..formats import replace_whole
from ..motion import Motion
from ..stages import gaps
from ..typing import Floats, Integers
from . import encoding, remote
from .database import Entry, Recordings, open_archive
from .lock import only_builder

Float32 = NDArray[np.float32]

FOLDER = "similar"
WINDOW_S, HOP_S, POSES = 1.6, 0.2, 8
COMPONENTS = 32
TEMPOS = (0.8, 0.9, 1.0, 1.11, 1.25)
TRAINING_WINDOWS = 20_000
"""Windows that the components are learned from, at most."""
SMOOTHING_S = 0.1
"""Poses are means over this time, in seconds: faster detail does not matter for the look of a motion."""
VERSION = 1


@dataclass(frozen=True)
class Hit:
    """A part of a recording that is like a query: seconds [start, stop), distance (m) and the tempo of the query."""

    name: str
    start: float
    stop: float
    distance: float
    tempo: float


@dataclass(frozen=True)
class Index:
    """The vectors of recordings with one set of points.

    names, contents: of the recordings, with the hash of their .mocz; first (recordings + 1,): the first vector of each.
    pose (points, 3): the mean pose, y up. mean (values,), basis (components, values): of flattened windows. vectors
    (windows, components).
    """

    points: tuple[str, ...]
    names: tuple[str, ...]
    contents: tuple[str, ...]
    first: Integers
    pose: Floats
    mean: Floats
    basis: Floats
    vectors: Floats

    def pack(self) -> bytes:
        """The bytes of the index's file."""
        out = io.BytesIO()
        arrays = {"points": np.array(self.points), "names": np.array(self.names), "contents": np.array(self.contents)}
        arrays |= {"first": self.first, "pose": self.pose.astype(np.float32), "mean": self.mean.astype(np.float32)}
        arrays |= {"basis": self.basis.astype(np.float32), "vectors": self.vectors.astype(np.float16)}
        np.savez(out, allow_pickle=False, version=np.array(VERSION), **arrays)
        return out.getvalue()

    @classmethod
    def read(cls, path: Path) -> Index:
        """Raises Corrupt for a damaged index and for one of another version: `archive index` makes it again."""
        try:
            with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
                arrays: dict[str, Any] = dict(file)
            if int(arrays.pop("version")) != VERSION:
                raise ValueError("another version")
            texts = {name: tuple(str(t) for t in arrays.pop(name)) for name in ("points", "names", "contents")}
            return cls(**texts, **{n: a if n == "first" else a.astype(np.float32) for n, a in arrays.items()})
        except Exception as error:  # whatever a damaged .npz raises
            raise Corrupt(f"{path}: the index is damaged ({error}); make it again: mocodec archive index") from error


def index(where: str | PathLike[str], report_to: Callable[[int, int, str], None] | None = None) -> int:
    """Make or renew the indexes of an archive; recordings that they have are not read again. Returns the windows.

    Raises BadInput if the archive cannot be written or another process changes it.
    """
    folder, total = remote.local_folder(where, "a change"), 0
    with only_builder(folder), open_archive(where) as archive:
        (folder / FOLDER).mkdir(exist_ok=True)
        by_layout: dict[str, list[Entry]] = {}
        for entry in archive.query("kind == 'motion' and points > 0"):
            by_layout.setdefault(entry.row.layout, []).append(entry)
        count, done = sum(map(len, by_layout.values())), 0
        for layout, entries in by_layout.items():

            def show(name: str) -> None:
                nonlocal done
                done += 1
                if report_to is not None:
                    report_to(done, count, name)

            path = folder / FOLDER / f"{layout}.npz"
            made = _built(entries, path, show)
            if made is not None:
                replace_whole(path, made.pack())
                total += len(made.vectors)
        for path in (folder / FOLDER).glob("*.npz"):
            if path.stem not in by_layout:
                path.unlink()
    return total


def _built(entries: Sequence[Entry], path: Path, show: Callable[[str], None]) -> Index | None:
    """The index of recordings of one set of points; None if none of them is long enough."""
    old = _known(path)
    flat, kept = dict[str, Floats](), dict[str, Floats]()
    pose, points = (None, ()) if old is None else (old.pose, old.points)
    for entry in entries:
        content = entry.row.content
        if old is not None and content in old.contents:
            at = old.contents.index(content)
            kept[content] = old.vectors[old.first[at] : old.first[at + 1]]
        elif content not in flat:
            try:
                motion = api.decode(entry.place, Motion)
            except MocodecError:  # a damaged recording has no vectors; `verify` names it
                continue
            points = points or motion.names
            if pose is None:
                pose = _mean_pose(motion)
            flat[content] = windows(motion, pose)
        show(entry.row.name)
    if pose is None:
        return None
    if old is not None:
        mean, basis = old.mean, old.basis
    else:
        mean, basis = _components(np.concatenate([*flat.values(), np.zeros((0, POSES * pose.size))]))
    vectors = kept | {content: ((values - mean) @ basis.T) for content, values in flat.items()}
    chosen = [entry for entry in entries if len(vectors.get(entry.row.content, ()))]
    if not chosen:
        return None
    first = np.cumsum([0, *(len(vectors[entry.row.content]) for entry in chosen)])
    return Index(
        tuple(points),
        tuple(entry.row.name for entry in chosen),
        tuple(entry.row.content for entry in chosen),
        first,
        pose,
        mean,
        basis,
        np.concatenate([vectors[entry.row.content] for entry in chosen]),
    )


def _known(path: Path) -> Index | None:
    """The index of an earlier run, if it is there and undamaged."""
    try:
        return Index.read(path) if path.exists() else None
    except Corrupt:
        return None


def _mean_pose(motion: Motion) -> Floats:
    placed = _filled(motion)[:: max(1, len(motion) // 200)]
    return heading.mean_pose(placed - placed.mean(axis=1, keepdims=True))


def _filled(motion: Motion) -> Floats:
    """Positions with y up, gaps filled."""
    positions = gaps.fill(motion.positions)[0] if motion.gaps.any() else motion.positions
    return heading.to_y_up(positions, motion.up)


def _components(flat: Floats) -> tuple[Floats, Floats]:
    """Mean and leading principal components of flattened windows."""
    flat = flat[:: max(1, len(flat) // TRAINING_WINDOWS)]
    mean = flat.mean(axis=0) if len(flat) else np.zeros(flat.shape[1])
    centred = flat - mean
    if len(flat) < flat.shape[1]:
        values = np.linalg.svd(centred, full_matrices=False)[2]
    else:
        values = np.linalg.eigh(centred.T @ centred)[1][:, ::-1].T
    return mean, values[:COMPONENTS]


def windows(motion: Motion, pose: Floats, tempo: float = 1.0) -> Floats:
    """(windows, POSES · points · 3): a window every HOP_S · tempo; none of a motion shorter than a window."""
    rate = motion.rate
    count = int((len(motion) - WINDOW_S * tempo * rate) / (HOP_S * tempo * rate)) + 1
    if count < 1 or len(motion) < 2:
        return np.zeros((0, POSES * pose.size))
    placed = _filled(motion)
    reach = max(0, round(SMOOTHING_S * rate / 2))
    sums = np.concatenate([np.zeros((1, *placed.shape[1:])), np.cumsum(placed, axis=0)])
    spacing = WINDOW_S / POSES
    at = np.arange(count)[:, None] * HOP_S + (np.arange(POSES) + 0.5) * spacing
    frames = np.clip(np.rint(at * tempo * rate).astype(np.int64), 0, len(motion) - 1)
    low, high = np.maximum(frames - reach, 0), np.minimum(frames + reach + 1, len(motion))
    poses = (sums[high] - sums[low]) / (high - low)[..., None, None]
    middle = poses[:, POSES // 2 - 1 : POSES // 2 + 1].mean(axis=1)
    angle = heading.heading(middle - middle.mean(axis=1, keepdims=True), pose)
    poses -= poses.mean(axis=(1, 2), keepdims=True)
    shape = poses.shape
    turned = heading.rotate(poses.reshape(count, -1, 3), -angle)
    return turned.reshape(count, -1) / np.sqrt(shape[1] * shape[2])


def search(
    recordings: Recordings, query: Motion, count: int = 10, tempos: Sequence[float] = TEMPOS, leave_out: str = ""
) -> list[Hit]:
    """The parts of recordings that are most like a query, nearest first; they do not overlap.

    query: of the same points as the recordings, and at least 1.6 s at one of the tempos. tempos: how much slower the
    query may have been: at 2, a query of 4 s is compared with 2 s of the archive. leave_out: name of a recording that
    is not searched.
    Raises BadInput without an index of these points or for a query that is too short; Corrupt for a damaged index.
    """
    found = _index_of(recordings, query)
    allowed = set(recordings.names)
    best: list[tuple[float, int, int, float]] = []
    for tempo in tempos:
        vectors = (windows(query, found.pose, tempo) - found.mean) @ found.basis.T
        if not len(vectors):
            continue
        distances = _along(found, vectors)
        order = np.argsort(distances)[: 50 * count]
        best += [(float(distances[i]), int(i), len(vectors), tempo) for i in order if np.isfinite(distances[i])]
    shortest = WINDOW_S * min(tempos)
    if not best and query.seconds < shortest:
        raise BadInput(f"a query lasts at least {shortest:.2g} s, not {query.seconds:.2g} s")
    hits: list[Hit] = []
    for distance, at, length, tempo in sorted(best):
        recording = int(np.searchsorted(found.first, at, side="right")) - 1
        name, start = found.names[recording], (at - int(found.first[recording])) * HOP_S
        stop = start + WINDOW_S + (length - 1) * HOP_S
        overlaps = any(hit.name == name and start < hit.stop and hit.start < stop for hit in hits)
        if name in allowed and name != leave_out and not overlaps:
            hits.append(Hit(name, start, stop, distance, tempo))
        if len(hits) == count:
            break
    return hits


def _index_of(recordings: Recordings, query: Motion) -> Index:
    """The index of recordings with the points of a query; of a remote archive only this one is fetched."""
    own = _index(recordings, encoding.layout_of(query.names))
    if own is not None:
        return own
    others = [] if remote.is_url(recordings.folder) else sorted(Path(recordings.folder, FOLDER).glob("*.npz"))
    for found in map(Index.read, others):
        if found.points == query.names:
            return found
        if sorted(found.points) == sorted(query.names):
            raise BadInput("the query has its points in another order; select them in that of the archive")
    raise BadInput(
        f"{recordings.folder}: no index of recordings with the points of the query; make it: mocodec archive index"
    )


def _index(recordings: Recordings, layout: str) -> Index | None:
    """The index of one set of points, if there is one. Raises Corrupt."""
    try:
        path = recordings.local_file(f"{FOLDER}/{layout}.npz")
    except BadInput:  # it is not on the server
        return None
    return Index.read(path) if path.exists() else None


def _along(found: Index, query: Any) -> Float32:
    """(windows,): RMS distance of the query's windows to those from each window on; infinite past a recording's end."""
    vectors, query = found.vectors, query.astype(np.float32)
    squares = (vectors**2).sum(axis=1)
    total = np.full(len(vectors), np.inf, np.float32)
    usable = len(vectors) - len(query) + 1
    if usable < 1:
        return total
    summed = np.zeros(usable, np.float32)
    products = vectors @ query.T
    for k, own in enumerate((query**2).sum(axis=1)):
        summed += (squares + own - 2 * products[:, k])[k : k + usable]
    total[:usable] = np.sqrt(np.maximum(summed, 0) / len(query))
    ends = found.first[1:]
    for back in range(1, len(query)):  # the query would run into the next recording
        total[np.maximum(ends - back, found.first[:-1])[ends > found.first[:-1]]] = np.inf
    return total


@dataclass(frozen=True)
class Pair:
    """Two recordings that show the same: share of the shorter one that the other has too, at a distance (m); equal: to
    the last byte."""

    one: str
    other: str
    share: float
    distance: float
    equal: bool


def duplicates(recordings: Recordings, within_m: float = 0.02, share: float = 0.8) -> list[Pair]:
    """Pairs of recordings of which one shows what the other does, apart from place and heading.

    within_m: how near corresponding windows are. share: how much of the shorter recording must match the other, at one
    offset in time. Recordings shorter than 1.6 s are compared byte by byte only. Raises Corrupt.
    """
    rows = list(recordings.rows())
    pairs: dict[tuple[str, str], Pair] = {}
    by_content: dict[str, list[str]] = {}
    for row in rows:
        by_content.setdefault(row.content, []).append(row.name)
    for names in by_content.values():
        for i, one in enumerate(names):
            pairs |= {(one, other): Pair(one, other, 1.0, 0.0, True) for other in names[i + 1 :]}
    allowed = {row.name for row in rows}
    for found in (_index(recordings, layout) for layout in sorted({row.layout for row in rows if row.layout})):
        for pair in () if found is None else _near(found, within_m, share):
            if pair.one in allowed and pair.other in allowed:
                pairs.setdefault((pair.one, pair.other), pair)
    return sorted(pairs.values(), key=lambda pair: (-pair.share, pair.distance, pair.one, pair.other))


def _near(found: Index, within_m: float, share: float) -> list[Pair]:
    """Pairs of one index, by votes of near windows for an offset of two recordings."""
    vectors, first = found.vectors, found.first
    squares = (vectors**2).sum(axis=1)
    result: list[Pair] = []
    for a in range(len(found.names)):
        own = slice(int(first[a]), int(first[a + 1]))
        later = slice(int(first[a + 1]), len(vectors))
        if later.start == later.stop:
            continue
        squared = squares[own, None] + squares[None, later] - 2 * vectors[own] @ vectors[later].T
        mine, theirs = np.nonzero(squared < within_m**2)
        if not len(mine):
            continue
        other = np.searchsorted(first, theirs + later.start, side="right") - 1
        offset = theirs + later.start - first[other] - mine
        keys, votes = np.unique(np.stack([other, offset]), axis=1, return_counts=True)
        for b in np.unique(keys[0]):
            of_b = keys[0] == b
            most = int(votes[of_b].max())
            at = int(keys[1][of_b][votes[of_b].argmax()])
            part = most / min(own.stop - own.start, int(first[b + 1] - first[b]))
            if part >= share:
                same = (other == b) & (offset == at)
                mean = float(np.sqrt(np.maximum(squared[mine[same], theirs[same]], 0)).mean())
                result.append(Pair(found.names[a], found.names[int(b)], min(part, 1.0), mean, False))
    return result
