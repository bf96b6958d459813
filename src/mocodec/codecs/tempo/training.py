"""How the prior is learned: mean pose, a basis for each band of frequencies, spreads, and the coder's tables.

    recordings of people ──► mean pose ──► poses in the body frame ──DCT──► covariance of each band ──► bases
                              spectra in those bases ──► spreads ──► coefficients at several steps ──► tables

Each recording counts by the square root of its length, so that neither long nor many takes of one person rule.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from ... import formats
from ...geometry import kinematics, rigid
from ...motion import Floats, Motion
from . import body, chunks, contexts, cosine, lanes, limbs, mapped, symbols
from .model import EDGES_MHZ, POSE, Model, smooth_heading, without_slopes
from .prior import Bones, PointSet, Prior, read

BANDS = len(contexts.BANDS_MHZ)
CHUNK_SECONDS = 4.0
BETWEEN_PEOPLE = 0.06
"""How much people's different proportions count in the basis of the lowest band, against how they move."""
FLIP_M = 0.25
"""A recording in which a point moves this far in one frame has errors in it, and teaches nothing."""
STEPS = tuple(range(-320, -96, 16))
"""log₂ of the steps (m) at which the tables are learned, in 1/32 octave: about 1 mm to 12 cm."""


def people(folder: Path, leave_out: Sequence[str] = ()) -> dict[str, list[Motion]]:
    """The recordings of each person: one folder of .amc a person."""
    found = {}
    for person in sorted(p for p in folder.iterdir() if p.is_dir() and p.name not in leave_out):
        motions = [formats.read(f) for f in sorted(person.glob("*.amc"))]
        found[person.name] = [m for m in motions if isinstance(m, Motion) and not _flips(m)]
    return found


def _flips(motion: Motion) -> bool:
    return bool(np.abs(np.diff(motion.positions, axis=0)).max() > FLIP_M)


def chunk_bounds(frames: int, rate: float, seconds: float = CHUNK_SECONDS) -> list[tuple[int, int]]:
    """Frames cut into equal chunks of about `seconds`."""
    count = max(1, round(frames / (rate * seconds)))
    return list(pairwise(frames * i // count for i in range(count + 1)))


def train(recordings: Mapping[str, Sequence[Motion]], with_limbs: bool = False) -> bytes:
    """The prior's file."""
    motions = [m for person in recordings.values() for m in person]
    points = point_set(motions, with_limbs)
    tables = coder_tables([points], [motions])
    return write([points], tables)


def train_bones(recordings: Mapping[str, Sequence[Motion]], other: Prior) -> bytes:
    """The file of a prior that knows bones only, with the coder's tables of another."""
    tables = other.coder.frequencies[: other.coder.idle]
    return write([], tables, bones_of([m for person in recordings.values() for m in person]))


def write(sets: Sequence[PointSet], tables: np.ndarray, bones: Bones | None = None) -> bytes:
    arrays: dict[str, np.ndarray] = {"sets": np.arange(len(sets)), "tables": tables.astype(np.uint16)}
    for i, s in enumerate(sets):
        arrays |= _arrays(str(i), s, np.float32)
        if s.limbs is not None and s.reach is not None:
            arrays[f"{i}.parents"] = np.array(s.limbs.parents, np.int16)
            arrays[f"{i}.vectors"] = s.limbs.vectors.astype(np.float32)
            arrays[f"{i}.marks"] = np.stack([s.limbs.hub, s.limbs.carried])
            arrays[f"{i}.reach"] = s.reach.astype(np.float32)
    if bones is not None:
        arrays |= _arrays("bones", bones.set, np.float16)
        arrays["bones.parents"] = bones.parents.astype(np.int16)
        arrays["bones.usual"] = bones.usual.astype(np.int16)
    out = io.BytesIO()
    np.savez_compressed(out, allow_pickle=False, **arrays)
    return out.getvalue()


def _arrays(name: str, points: PointSet, precision: type) -> dict[str, np.ndarray]:
    return {
        f"{name}.names": np.array(points.names),
        f"{name}.pose": points.pose.astype(np.float32),
        f"{name}.bases": np.array(points.bases, precision),
        f"{name}.spreads": points.spreads.astype(np.int16),
        f"{name}.means": points.means.astype(np.int16),
    }


def bones_of(motions: Sequence[Motion]) -> Bones:
    """How the bones of people move, from recordings of joints with the turns of their bones."""
    skeleton = motions[0].skeleton
    assert skeleton is not None
    columns = [i for i, name in enumerate(skeleton.names) if name not in LIKE_OTHERS]
    parents = []
    for i in columns:
        above = skeleton.parents[i]
        while above >= 0 and above not in columns:
            above = skeleton.parents[above]
        parents.append(columns.index(above) if above >= 0 else len(parents))
    turning = [turning_points(m, columns) for m in motions]
    points = point_set(turning)
    rows = slice(POSE, POSE + COMPONENTS)
    kept = replace(
        points,
        bases=tuple(b[:COMPONENTS] for b in points.bases),
        spreads=np.concatenate([points.spreads[:POSE], points.spreads[rows]]),
        means=points.means[: rows.stop],
    )
    usual = np.median(kept.spreads[POSE:], axis=0).astype(int)
    return Bones(tuple(skeleton.names[i] for i in columns), np.array(parents), usual, kept)


LIKE_OTHERS = ("lhipjoint", "rhipjoint", "lthumb", "rthumb")
"""Joints whose bones tell nothing that others do not."""
COMPONENTS = 128


def turning_points(motion: Motion, columns: Sequence[int]) -> Motion:
    """Of each bone its joint and three points that turn with it, `mapped.REACH_M` along the axes it has at rest."""
    assert motion.skeleton is not None
    assert motion.rotations is not None
    turns = kinematics.world_rotations(motion.skeleton, motion.rotations)[:, columns]
    joints = motion.positions[:, columns]
    arms = [joints, *(joints + rigid.rotate(turns, axis) for axis in mapped.REACH_M * np.eye(3))]
    names = [f"{motion.names[i]}{end}" for i in columns for end in ("", ".x", ".y", ".z")]
    positions = np.stack(arms, axis=2).reshape(len(motion), -1, 3)
    return Motion(positions, motion.rate, tuple(names), motion.up)


def point_set(motions: Sequence[Motion], with_limbs: bool = False) -> PointSet:
    """Mean pose, bases and spreads of recordings of one set of points; as limbs, where they have a skeleton's."""
    names = motions[0].names
    sample = np.concatenate([_centred(body.level(m.positions[::8], m.up)) for m in motions])
    pose = body.mean_pose(sample).astype(np.float32).astype(np.float64)
    limbs, reach = _limbs(motions, pose) if with_limbs else (None, None)
    dimensions = 3 * len(names) if limbs is None else limbs.dimensions
    empty = np.zeros((len(EDGES_MHZ) + 1, dimensions, dimensions))
    flat = PointSet(
        names,
        pose,
        tuple(np.eye(dimensions) for _ in empty),
        np.zeros((POSE + dimensions, BANDS), int),
        np.zeros(0, int),
        limbs,
        reach,
    )
    prior = Prior(b"", (flat,), lanes.Tables.of(np.full((1, 1), lanes.TOTAL)))
    spectra = [list(_spectra(Model(of_body(flat, m), prior, m.rate), m)) for m in motions]
    means = np.array([np.mean([s[0] / np.sqrt(len(s)) for s in of_one], axis=0) for of_one in spectra])
    covariance = empty
    for motion, of_one, mean in zip(motions, spectra, means, strict=True):
        model = Model(flat, prior, motion.rate)
        for s in of_one:
            s = s.copy()
            s[0] -= mean * np.sqrt(len(s))
            for c, band in zip(covariance, model.bands(len(s)), strict=True):
                c += s[band, POSE:].T @ s[band, POSE:] / np.sqrt(len(of_one))
    between = np.cov(means[:, POSE:].T)
    kept = dimensions if with_limbs else dimensions - 3  # nothing moves the mean of all points
    bases = [_basis(c / np.trace(c) + 1e-3 * covariance.sum(0) / np.trace(covariance.sum(0)), kept) for c in covariance]
    low = covariance[0] / np.trace(covariance[0]) + BETWEEN_PEOPLE * between / np.trace(between)
    bases[0] = _basis(low + 1e-3 * covariance.sum(0) / np.trace(covariance.sum(0)), kept)
    fitted = replace(flat, bases=tuple(bases))
    return replace(fitted, **_spreads(fitted, prior, motions))


def of_body(points: PointSet, motion: Motion) -> PointSet:
    """The set with the limbs of this motion's skeleton."""
    if points.limbs is None or motion.skeleton is None:
        return points
    return replace(points, limbs=points.limbs.built(motion.skeleton.offsets))


def _limbs(motions: Sequence[Motion], pose: Floats) -> tuple[limbs.Limbs, Floats]:
    """Limbs of the mean build, and the reach of their coordinates: the root of how far points move with them."""
    assert motions[0].skeleton is not None
    headed = [_headed(m, pose) for m in motions]
    found = limbs.fit(headed, motions[0].skeleton.parents, [m.skeleton.offsets for m in motions if m.skeleton])
    metric = np.zeros((found.dimensions, found.dimensions))
    for m, poses in zip(motions, headed, strict=True):
        assert m.skeleton is not None
        own = found.built(m.skeleton.offsets)
        metric += np.sqrt(len(m)) * own.metric(own.forward(poses[:: max(1, len(poses) // 8)]))
    return found, np.asarray(np.linalg.cholesky(metric / sum(np.sqrt(len(m)) for m in motions)), np.float64)


def _headed(motion: Motion, pose: Floats) -> Floats:
    """Every eighth pose in the body's frame."""
    centred = _centred(body.level(motion.positions, motion.up))
    out = []
    for a, b in chunk_bounds(len(centred), motion.rate):
        angle = cosine.inverse(smooth_heading(body.heading(centred[a:b], pose), motion.rate), b - a)
        out.append(body.turn(centred[a:b], -angle)[::8])
    return np.concatenate(out)


def _centred(positions: Floats) -> Floats:
    return positions - positions.mean(axis=1, keepdims=True)


def _spectra(model: Model, motion: Motion) -> Iterable[Floats]:
    positions = body.level(motion.positions, motion.up)
    for start, stop in chunk_bounds(len(positions), motion.rate):
        yield without_slopes(model.analyse(positions[start:stop]), SLOPE_STEP)


def _basis(covariance: Floats, kept: int) -> Floats:
    """Orthonormal rows, strongest first."""
    _, vectors = np.linalg.eigh(covariance)
    return vectors[:, ::-1].T[:kept].astype(np.float32).astype(np.float64)


def _spreads(points: PointSet, prior: Prior, motions: Sequence[Motion]) -> dict[str, np.ndarray]:
    bands = np.array(contexts.BANDS_MHZ[1:])
    rows = POSE + len(points.bases[0])
    total, count = np.full((rows, len(bands)), 1e-9), np.full(len(bands), 1e-9)
    means, weight = np.full(rows, 1e-9), 1e-9
    for motion in motions:
        model = Model(replace(of_body(points, motion), spreads=np.zeros((rows, BANDS), int)), prior, motion.rate)
        spectra = list(_spectra(model, motion))
        for s in spectra:
            w = 1 / np.sqrt(len(spectra))
            f = np.arange(1, len(s)) * motion.rate * 500 / len(s)
            near = np.abs(np.log(f[:, None] / bands)).argmin(axis=1)
            np.add.at(total.T, near, np.abs(s[1:]) * w * np.sqrt(120 / motion.rate))
            np.add.at(count, near, w)
            means += np.abs(s[0]) * w / np.sqrt(len(s))
            weight += w
    logs = np.round(contexts.OCTAVE * np.log2(total / count)).astype(int)
    return {
        "spreads": np.concatenate([logs[:, :1], logs], axis=1),
        "means": np.round(contexts.OCTAVE * np.log2(means / weight)).astype(int),
    }


def coder_tables(
    sets: Sequence[PointSet], motions: Sequence[Sequence[Motion]], steps: Sequence[int] = STEPS
) -> np.ndarray:
    """Frequencies (tables, symbols) of the symbols met in each context, out of 2¹²."""
    counts = np.zeros((contexts.SHAPES * contexts.CLASSES, symbols.SYMBOLS))
    prior = Prior(b"", tuple(sets), lanes.Tables.of(np.full((1, 1), lanes.TOTAL)))
    for points, of_set in zip(sets, motions, strict=True):
        for motion in of_set:
            model = Model(of_body(points, motion), prior, motion.rate)
            for s in list(_spectra(model, motion))[:6]:
                for step in steps:
                    values = quantised(s, chunks.sizes(model, len(s), step))
                    expected = model.expected(len(s), step)
                    known = (expected > -400).any(axis=1).sum()
                    symbol = symbols.of(np.abs(values[:known]))
                    chosen = contexts.all_tables(contexts.base(expected[:known]), symbols.FIRSTS[symbol])
                    np.add.at(counts, (chosen.ravel(), symbol.ravel()), 1)
    return frequencies(_smoothed(counts))


SLOPE_STEP = -256


def quantised(coefficients: Floats, size: Floats) -> np.ndarray:
    """Whole numbers of steps, those of the pose drawn towards zero."""
    scaled = np.abs(coefficients) / size
    dead = np.where(np.arange(len(size)) < POSE, 0.5, DEAD)
    return (np.sign(coefficients) * np.floor(scaled + dead)).astype(np.int64)


DEAD = 0.38


def _smoothed(counts: np.ndarray) -> np.ndarray:
    """Classes with few symbols lean on the classes beside them."""
    shaped = counts.reshape(contexts.SHAPES, contexts.CLASSES, -1)
    out = shaped.copy()
    for reach in range(1, contexts.CLASSES):
        few = out.sum(axis=2, keepdims=True) < 500
        if not few.any():
            break
        left, right = np.roll(shaped, reach, axis=1), np.roll(shaped, -reach, axis=1)
        left[:, :reach] = 0
        right[:, -reach:] = 0
        out += np.where(few, left + right, 0)
    return out.reshape(counts.shape)


def frequencies(counts: np.ndarray) -> np.ndarray:
    """Whole numbers ≥ 1 that sum to 2¹² in each row, in proportion to the counts."""
    rows = []
    for row in counts + 0.02:
        f = np.maximum(1, np.floor(row / row.sum() * lanes.TOTAL).astype(int))
        f[f.argmax()] += lanes.TOTAL - f.sum()
        rows.append(f)
    return np.array(rows)


__all__ = ["people", "read", "train"]
