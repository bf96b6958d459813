"""How tempo's prior is learned: mean pose, a basis for each band of frequencies, spreads, and the coder's tables.

    recordings of people ──► mean pose ──► coordinates in the body's frame ──DCT──► covariance of each band ──► bases
                              spectra in those bases ──► spreads ──► coefficients in several steps ──► tables

Each recording counts by the square root of its length, so that neither long recordings nor many takes of one person
dominate. Each step adds up small arrays of each recording, in the order of the recordings (`Each`).
`scripts/train_prior` has the recordings in memory. `mocodec prior train` has them in an archive
(`archive.train_prior`): any number of processes gives the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ... import formats
from ...entropy import lanes, symbols
from ...errors import BadInput
from ...geometry import kinematics, rigid
from ...motion import Motion, Skeleton
from ...stages import dct
from ...typing import Floats, Integers
from .coding import contexts, rows
from .coding.rows import POSE
from .models import prior
from .models.coordinates import Coordinates, DirectionCoordinates, PointCoordinates
from .models.markers_on_bones import ARM_M
from .models.model import BANDS, Model, Statistics, smooth_heading
from .models.prior import BoneMotion, JointSet
from .pose import bone_directions, heading, tree_fitting
from .preparation import chunk_bounds

LEAST_RECORDINGS = 3
FREQUENCIES = len(contexts.BANDS_MHZ)
CHUNK_SECONDS = 4.0
BETWEEN_PEOPLE = 0.06
"""Weight of people's different proportions in the basis of the lowest band, relative to how they move."""
FLIP_M = 0.25
"""A recording in which a point moves this far in one frame has errors in it, and is left out."""
STEPS = tuple(range(-320, -96, 16))
"""log₂ of the steps (m) at which the tables are learned, 1/32 octave: about 1 mm to 12 cm."""
TABLE_CHUNKS = 6
"""Chunks of each recording that the tables are learned from."""
UNLIKELY = -400
"""Frequencies where no magnitude is expected to reach this (log₂ in steps, 1/32 octave) teach the tables nothing."""
DEAD_ZONE = 0.38
"""Coefficients are rounded up from this fraction on."""
LEAST_SYMBOLS = 500
"""Tables with fewer symbols borrow from the neighbouring classes."""
SAMPLE_EVERY, MOST_SAMPLES = 8, 300_000
"""The mean pose and the bone tree are learned from every SAMPLE_EVERY-th pose, at most about MOST_SAMPLES poses."""
SHARED = 1e-3
"""Weight of all frequencies in the basis of each band."""
REDUNDANT_BONES = ("lhipjoint", "rhipjoint", "lthumb", "rthumb")
"""Joints whose bones move as others do."""
BONE_COMPONENTS = 128


Each = Callable[[Callable[[Motion], Any]], Iterator[Any]]
"""The results of a function of each recording, in the order of the recordings. The function can be pickled."""


@dataclass(frozen=True)
class Facts:
    """What decides whether a recording is learned from. skeleton: None without rotations. problem: or ""."""

    frames: int
    names: tuple[str, ...]
    skeleton: Skeleton | None
    problem: str = ""


def facts(motion: Motion) -> Facts:
    """The facts of a recording."""
    skeleton = motion.skeleton if motion.rotations is not None else None
    problem = "" if skeleton else "no rotations"
    if not problem and motion.gaps.any():
        problem = "gaps"
    if not problem and (len(motion) < 2 or _has_flips(motion)):
        problem = "a leap" if len(motion) > 1 else "one frame"
    return Facts(len(motion), motion.names, skeleton, problem)


def usable(found: Sequence[Facts]) -> list[int]:
    """Numbers of the recordings that are learned from.

    They have rotations, no gaps, no leaps, and the joints of the first such one. Raises BadInput if there are too few.
    """
    sound = [i for i, one in enumerate(found) if not one.problem]
    chosen = [i for i in sound if found[i].names == found[sound[0]].names]
    if len(chosen) < LEAST_RECORDINGS:
        raise BadInput(
            f"a prior is learned from at least {LEAST_RECORDINGS} recordings of one skeleton with rotations, without "
            f"gaps and leaps, not {len(chosen)}"
        )
    return chosen


def in_memory(motions: Sequence[Motion]) -> Each:
    """Recordings in memory, one after another."""
    return partial(map_in_memory, motions)


def map_in_memory(motions: Sequence[Motion], work: Callable[[Motion], Any]) -> Iterator[Any]:
    """The work for each motion."""
    return map(work, motions)


def people(folder: Path, leave_out: Sequence[str] = ()) -> dict[str, list[Motion]]:
    """The recordings of each person: one folder of .amc a person."""
    found = {}
    for person in sorted(p for p in folder.iterdir() if p.is_dir() and p.name not in leave_out):
        motions = [formats.read(f) for f in sorted(person.glob("*.amc"))]
        found[person.name] = [m for m in motions if isinstance(m, Motion) and not _has_flips(m)]
    return found


def _has_flips(motion: Motion) -> bool:
    return bool(np.abs(np.diff(motion.positions, axis=0)).max() > FLIP_M)


def train_points(recordings: Mapping[str, Sequence[Motion]]) -> bytes:
    """The file of the prior of positions: joints by name, and how bones move."""
    return points_file(*_of_people(recordings))


def train_directions(recordings: Mapping[str, Sequence[Motion]]) -> bytes:
    """The file of the prior of bone directions."""
    return directions_file(*_of_people(recordings))


def _of_people(recordings: Mapping[str, Sequence[Motion]]) -> tuple[Each, list[Facts]]:
    motions = [m for person in recordings.values() for m in person]
    return in_memory(motions), [Facts(len(m), m.names, m.skeleton) for m in motions]


def train(motions: Iterable[Motion]) -> bytes:
    """A file of priors of one's own, for `prior.used`, from recordings of the same skeleton with rotations.

    Recordings in which a joint leaps are left out. Raises BadInput for recordings of other joints, or without them.
    """
    listed = list(motions)
    found = [facts(m) for m in listed]
    chosen = usable(found)
    return own_file(in_memory([listed[i] for i in chosen]), [found[i] for i in chosen])


def own_file(each: Each, found: Sequence[Facts]) -> bytes:
    """The file of priors of one's own; found: the facts of each recording."""
    return prior.pack_own(points_file(each, found), directions_file(each, found))


def points_file(each: Each, found: Sequence[Facts]) -> bytes:
    """The file of the prior of positions."""
    joints = joint_set(each, found, directions=False)
    return write(joints, coder_tables(joints, each), bone_motion(each, found))


def directions_file(each: Each, found: Sequence[Facts]) -> bytes:
    """The file of the prior of bone directions."""
    joints = joint_set(each, found, directions=True)
    return write(joints, coder_tables(joints, each))


def write(joints: JointSet, tables: Integers, bones: BoneMotion | None = None) -> bytes:
    """A prior's file, as `prior.read` reads it."""
    arrays: dict[str, np.ndarray] = {"tables": tables.astype(np.uint16)}
    arrays |= _arrays("", joints.names, joints.coordinates.pose, joints.statistics, np.float32)
    if isinstance(joints.coordinates, DirectionCoordinates):
        tree = joints.coordinates.tree
        arrays |= {
            "parents": np.array(tree.parents, np.int16),
            "vectors": tree.vectors.astype(np.float32),
            "hub": tree.hub,
            "relative": tree.relative,
            "metric_root": joints.coordinates.metric_root.astype(np.float32),
        }
    if bones is not None:
        names = tuple(f"{name}{end}" for name in bones.names for end in ("", ".x", ".y", ".z"))
        arrays |= _arrays("bones.", names, bones.pose, bones.statistics, np.float16)
        arrays["bones.parents"] = bones.parents.astype(np.int16)
        arrays["bones.median_spread"] = bones.median_spread.astype(np.int16)
    out = io.BytesIO()
    np.savez_compressed(out, allow_pickle=False, **arrays)
    return out.getvalue()


def _arrays(
    prefix: str, names: tuple[str, ...], pose: Floats, statistics: Statistics, precision: type
) -> dict[str, np.ndarray]:
    return {
        f"{prefix}names": np.array(names),
        f"{prefix}pose": pose.astype(np.float32),
        f"{prefix}bases": np.array(statistics.bases, precision),
        f"{prefix}spreads": statistics.spreads.astype(np.int16),
        f"{prefix}means": statistics.means.astype(np.int16),
    }


def bone_motion(each: Each, found: Sequence[Facts]) -> BoneMotion:
    """How the bones of people move, from recordings of joints with the rotations of their bones."""
    skeleton = found[0].skeleton
    assert skeleton is not None
    columns = [i for i, name in enumerate(skeleton.names) if name not in REDUNDANT_BONES]
    parents = []
    for i in columns:
        above = skeleton.parents[i]
        while above >= 0 and above not in columns:
            above = skeleton.parents[above]
        parents.append(columns.index(above) if above >= 0 else len(parents))
    points = joint_set(partial(each_with_arms, each, columns), found, directions=False)
    kept, count = points.statistics, POSE + BONE_COMPONENTS
    statistics = Statistics(tuple(b[:BONE_COMPONENTS] for b in kept.bases), kept.spreads[:count], kept.means[:count])
    median = np.median(statistics.spreads[POSE:], axis=0).astype(int)
    names = tuple(skeleton.names[i] for i in columns)
    return BoneMotion(names, np.array(parents), median, points.coordinates.pose, statistics)


def each_with_arms(each: Each, columns: Sequence[int], work: Callable[[Motion], Any]) -> Iterator[Any]:
    """The work for the points that rotate with the bones of each recording."""
    return each(partial(_with_arms, columns, work))


def _with_arms(columns: Sequence[int], work: Callable[[Motion], Any], motion: Motion) -> Any:
    return work(rotating_points(motion, columns))


def rotating_points(motion: Motion, columns: Sequence[int]) -> Motion:
    """For each bone its joint and three points that rotate with it, `ARM_M` along the axes it has at rest."""
    assert motion.skeleton is not None
    assert motion.rotations is not None
    rotations = kinematics.world_rotations(motion.skeleton, motion.rotations)[:, columns]
    joints = motion.positions[:, columns]
    arms = [joints, *(joints + rigid.rotate(rotations, axis) for axis in ARM_M * np.eye(3))]
    names = [f"{motion.names[i]}{end}" for i in columns for end in ("", ".x", ".y", ".z")]
    positions = np.stack(arms, axis=2).reshape(len(motion), -1, 3)
    return Motion(positions, motion.rate, tuple(names), motion.up)


def joint_set(each: Each, found: Sequence[Facts], directions: bool) -> JointSet:
    """Mean pose, bases and spreads of recordings of one set of points; of their bones' directions, if asked for."""
    every = SAMPLE_EVERY * -(-sum(one.frames for one in found) // (SAMPLE_EVERY * MOST_SAMPLES))
    names, samples = zip(*each(partial(_sample, every)), strict=True)
    pose = heading.mean_pose(np.concatenate(samples)).astype(np.float32).astype(np.float64)
    del samples
    coordinates = direction_coordinates(each, found, pose, every) if directions else PointCoordinates(pose)
    dimensions = coordinates.dimensions
    flat = JointSet(names[0], coordinates, _identity(dimensions))
    means = np.zeros((len(found), POSE + dimensions))
    covariance = np.zeros((BANDS, dimensions, dimensions))
    for number, (mean, own) in enumerate(each(partial(_moments, flat))):
        means[number] = mean
        covariance += own
    between = np.cov(means[:, POSE:].T)
    kept = dimensions if directions else dimensions - 3  # nothing moves the mean of all points
    overall = SHARED * covariance.sum(0) / np.trace(covariance.sum(0))
    bases = [_basis(c / np.trace(c) + overall, kept) for c in covariance]
    low = covariance[0] / np.trace(covariance[0]) + BETWEEN_PEOPLE * between / np.trace(between)
    bases[0] = _basis(low + overall, kept)
    fitted = JointSet(names[0], coordinates, _identity(dimensions, tuple(bases)))
    return replace(fitted, statistics=_with_spreads(fitted, each))


def _sample(every: int, motion: Motion) -> tuple[tuple[str, ...], Floats]:
    """The names of the points, and every `every`-th pose."""
    return motion.names, _centred(heading.to_y_up(motion.positions[::every], motion.up))


def _moments(joints: JointSet, motion: Motion) -> tuple[Floats, Floats]:
    """Mean (rows,) and covariance of each band (bands, dimensions, dimensions) of a recording's coefficients."""
    model = model_of(joints, motion)
    spectra = list(_spectra(model, motion))
    mean = np.mean([s[0] / np.sqrt(len(s)) for s in spectra], axis=0)
    covariance = np.zeros((BANDS, len(mean) - POSE, len(mean) - POSE))
    for s in spectra:
        s[0] -= mean * np.sqrt(len(s))
        for c, band in zip(covariance, model.bands(len(s)), strict=True):
            c += s[band, POSE:].T @ s[band, POSE:] / np.sqrt(len(spectra))
    return mean, covariance


def _identity(dimensions: int, bases: tuple[Floats, ...] | None = None) -> Statistics:
    """Statistics that say nothing of magnitudes, with these bases or each coordinate by itself."""
    bases = bases or (np.eye(dimensions),) * BANDS
    count = POSE + len(bases[0])
    return Statistics(bases, np.zeros((count, FREQUENCIES), int), np.zeros(count, int))


def model_of(joints: JointSet, motion: Motion) -> Model:
    """The model of a recording, with the proportions of its skeleton. Its tables code nothing."""
    coordinates: Coordinates = joints.coordinates
    if isinstance(coordinates, DirectionCoordinates):
        assert motion.skeleton is not None
        coordinates = replace(coordinates, tree=coordinates.tree.with_offsets(motion.skeleton.offsets))
    return Model(
        joints.names, coordinates, joints.statistics, lanes.StaticTables.of(np.zeros((0, 1), np.int64)), motion.rate
    )


def direction_coordinates(each: Each, found: Sequence[Facts], pose: Floats, every: int) -> DirectionCoordinates:
    """The bone tree of the mean proportions, and the metric root of its coordinates."""
    skeletons = [one.skeleton for one in found if one.skeleton is not None]
    assert len(skeletons) == len(found)
    aligned = list(each(partial(_aligned, pose, every)))
    tree = tree_fitting.fit(aligned, skeletons[0].parents, [skeleton.offsets for skeleton in skeletons])
    metric = np.zeros((tree.dimensions, tree.dimensions))
    for one, skeleton, poses in zip(found, skeletons, aligned, strict=True):
        own = tree.with_offsets(skeleton.offsets)
        coordinates = bone_directions.forward(own, poses[:: max(1, len(poses) // 8)])
        metric += np.sqrt(one.frames) * bone_directions.metric(own, coordinates)
    root = np.linalg.cholesky(metric / sum(np.sqrt(one.frames) for one in found))
    return DirectionCoordinates(pose, tree, np.asarray(root, np.float64), np.arange(len(pose)))


def _aligned(pose: Floats, every: int, motion: Motion) -> Floats:
    """Every `every`-th pose, in the body's frame."""
    centred = _centred(heading.to_y_up(motion.positions, motion.up))
    out = []
    for a, b in chunk_bounds(len(centred), motion.rate, CHUNK_SECONDS):
        angle = dct.inverse(smooth_heading(heading.heading(centred[a:b], pose), motion.rate), b - a)
        out.append(heading.rotate(centred[a:b], -angle)[::every])
    return np.concatenate(out)


def _centred(positions: Floats) -> Floats:
    return positions - positions.mean(axis=1, keepdims=True)


def _spectra(model: Model, motion: Motion) -> Iterable[Floats]:
    positions = heading.to_y_up(motion.positions, motion.up)
    for start, stop in chunk_bounds(len(positions), motion.rate, CHUNK_SECONDS):
        yield model.analyse(positions[start:stop])


def _basis(covariance: Floats, kept: int) -> Floats:
    """Orthonormal rows, strongest first."""
    _, vectors = np.linalg.eigh(covariance)
    return vectors[:, ::-1].T[:kept].astype(np.float32).astype(np.float64)


def _with_spreads(joints: JointSet, each: Each) -> Statistics:
    count_rows = POSE + len(joints.statistics.bases[0])
    total, count = np.full((count_rows, FREQUENCIES - 1), 1e-9), np.full(FREQUENCIES - 1, 1e-9)
    means, weight = np.full(count_rows, 1e-9), 1e-9
    for own_total, own_count, own_means, own_weight in each(partial(_magnitudes, joints)):
        total += own_total
        count += own_count
        means += own_means
        weight += own_weight
    logs = np.round(contexts.OCTAVE * np.log2(total / count)).astype(int)
    return replace(
        joints.statistics,
        spreads=np.concatenate([logs[:, :1], logs], axis=1),
        means=np.round(contexts.OCTAVE * np.log2(means / weight)).astype(int),
    )


def _magnitudes(joints: JointSet, motion: Motion) -> tuple[Floats, Floats, Floats, float]:
    """Sums of magnitudes of a recording (rows, frequencies) and their weights (frequencies,); of the means (rows,) and
    their weight."""
    nodes = np.array(contexts.BANDS_MHZ[1:])
    total, count = np.zeros((POSE + len(joints.statistics.bases[0]), len(nodes))), np.zeros(len(nodes))
    spectra = list(_spectra(model_of(joints, motion), motion))
    weight = 1 / np.sqrt(len(spectra))
    means = np.zeros(len(total))
    for s in spectra:
        millihertz = np.arange(1, len(s)) * motion.rate * 500 / len(s)
        near = np.abs(np.log(millihertz[:, None] / nodes)).argmin(axis=1)
        of_node = near[:, None] == np.arange(len(nodes))
        total += np.abs(s[1:]).T @ (of_node * (weight * np.sqrt(120 / motion.rate)))
        count += weight * of_node.sum(axis=0)
        means += np.abs(s[0]) * weight / np.sqrt(len(s))
    return total, count, means, weight * len(spectra)


def coder_tables(joints: JointSet, each: Each, steps: Sequence[int] = STEPS) -> Integers:
    """Frequencies (tables, symbols), of 2¹², of the symbols in each context."""
    counts = np.zeros((contexts.SHAPES * contexts.CLASSES, symbols.SYMBOLS))
    for own in each(partial(_symbol_counts, joints, tuple(steps))):
        counts += own
    return _frequencies(_smoothed(counts))


def _symbol_counts(joints: JointSet, steps: Sequence[int], motion: Motion) -> Floats:
    """How often each symbol (tables, symbols) occurs in the first chunks of a recording."""
    counts = np.zeros((contexts.SHAPES * contexts.CLASSES, symbols.SYMBOLS))
    model = model_of(joints, motion)
    for s in islice(_spectra(model, motion), TABLE_CHUNKS):
        for step in steps:
            values = _rounded(s, rows.sizes(model.rows, len(s), step))
            expected = model.expected(len(s), step)
            known = (expected > UNLIKELY).any(axis=1).sum()
            symbol = symbols.of_magnitudes(np.abs(values[:known]))
            tables = contexts.all_tables(contexts.base(expected[:known]), symbols.SMALLEST[symbol])
            both = tables.ravel() * symbols.SYMBOLS + symbol.ravel()
            counts += np.bincount(both, minlength=counts.size).reshape(counts.shape)
    return counts


def _rounded(coefficients: Floats, size: Floats) -> Integers:
    """Integers of coefficients, those of the pose rounded towards zero by the dead zone."""
    scaled = np.abs(coefficients) / size
    up = np.where(np.arange(len(size)) < POSE, 0.5, DEAD_ZONE)
    return (np.sign(coefficients) * np.floor(scaled + up)).astype(np.int64)


def _smoothed(counts: Floats) -> Floats:
    """Classes with few symbols borrow from the classes beside them."""
    shaped = counts.reshape(contexts.SHAPES, contexts.CLASSES, -1)
    out = shaped.copy()
    for reach in range(1, contexts.CLASSES):
        few = out.sum(axis=2, keepdims=True) < LEAST_SYMBOLS
        if not few.any():
            break
        left, right = np.roll(shaped, reach, axis=1), np.roll(shaped, -reach, axis=1)
        left[:, :reach] = 0
        right[:, -reach:] = 0
        out += np.where(few, left + right, 0)
    return out.reshape(counts.shape)


def _frequencies(counts: Floats) -> Integers:
    """Integers ≥ 1 that sum to 2¹² in each row, in proportion to the counts."""
    out = []
    for row in counts + 0.02:
        f = np.maximum(1, np.floor(row / row.sum() * lanes.TOTAL).astype(int))
        f[f.argmax()] += lanes.TOTAL - f.sum()
        out.append(f)
    return np.array(out)
