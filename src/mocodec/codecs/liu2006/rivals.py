"""The paper's own counts, of an encoded motion (Table 2) and of the two rivals it is compared with (Table 3).

The paper counts scalars, whatever their width: a ratio here is coordinates of the motion over scalars stored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ... import metrics
from ...encoded import Encoded
from ...geometry import body_frame
from ...motion import Floats, Motion
from ...stages import basis
from . import models
from .codec import read_segments, read_shared
from .roles import Roles


@dataclass(frozen=True)
class Statistics:
    """What an encoded motion consists of. Averages of components are over segments and groups, as in Table 2."""

    segments: int
    components: tuple[tuple[int, ...], ...]
    average_components: float
    control_points: int
    normalisation_control_points: int
    scalars: int
    scalar_ratio: float
    bytes_by_part: dict[str, int]


def statistics(encoded: Encoded[Motion]) -> Statistics:
    """Count segments, components, control points, scalars and bytes. Raises Corrupt."""
    played = read_shared(encoded)[1]
    segments = read_segments(encoded.chunks, played)[0]
    of_models = [model for one in segments for model in one.groups]
    scalars = sum(one.markers.numbers.size for one in segments)
    scalars += sum(model.mean.size + model.basis.size + model.track.numbers.size for model in of_models)
    parts = {"shared": sum(map(len, encoded.shared))}
    for chunk in encoded.chunks:
        sections = models.split(chunk.payload, models.sections_of(played))
        head, splits, markers, means, *of_groups, gaps, residual = sections
        framing = len(chunk.payload) - sum(map(len, sections))
        for part, size in (
            ("heads", framing + len(head)),
            ("key frames", len(splits)),
            ("normalisation markers", len(markers)),
            ("means", len(means)),
            ("bases", sum(map(len, of_groups[::2]))),
            ("projections", sum(map(len, of_groups[1::2]))),
            ("gaps", len(gaps)),
            ("residual", len(residual)),
        ):
            parts[part] = parts.get(part, 0) + size
    return Statistics(
        segments=len(segments),
        components=tuple(tuple(model.basis.shape[1] for model in one.groups) for one in segments),
        average_components=float(np.mean([model.basis.shape[1] for model in of_models])) if of_models else 0.0,
        control_points=sum(len(model.track.keys) for model in of_models),
        normalisation_control_points=sum(len(one.markers.keys) for one in segments),
        scalars=scalars,
        scalar_ratio=encoded.frames * played.points * 3 / scalars,
        bytes_by_part=parts,
    )


@dataclass(frozen=True)
class Rival:
    """Ratio and errors of a method of Table 3; d in normalised coordinates and in the world's, percent."""

    components: tuple[int, ...]
    scalar_ratio: float
    d_normalised: float
    d_world: float


def global_pca(motion: Motion, played: Roles, tolerance: float = 0.030) -> Rival:
    """One PCA of the whole sequence of normalised poses, every frame's projection kept."""
    return piecewise_pca(motion, played, [slice(0, len(motion))], tolerance)


def piecewise_pca(motion: Motion, played: Roles, cuts: Sequence[slice], tolerance: float = 0.030) -> Rival:
    """A PCA of each segment, every frame's projection kept, the normalisation markers as they are.

    All other markers go through one PCA, which leaves tolerance × √markers, metres (root mean square over frames).
    """
    rest = np.concatenate(played.groups)
    frame = body_frame.from_markers(motion.positions[:, played.normalisation], motion.up)
    poses = body_frame.to_body(motion.positions[:, rest], frame).reshape(len(motion), -1)
    decoded = np.empty_like(poses)
    components: list[int] = []
    scalars = len(motion) * 3 * len(played.normalisation)
    for cut in cuts:
        mean = poses[cut].mean(axis=0)
        away = poses[cut] - mean
        directions, variances = basis.fit(away.T @ away / len(away))
        k = models.components_needed(variances, tolerance, len(rest))
        projections = away @ directions[:, :k]
        decoded[cut] = projections @ directions[:, :k].T + mean
        components.append(k)
        scalars += projections.size + directions[:, :k].size + mean.size
    positions = motion.positions.copy()
    positions[:, rest] = body_frame.to_world(decoded.reshape(len(motion), -1, 3), frame)
    return Rival(
        components=tuple(components),
        scalar_ratio=motion.positions.size / scalars,
        d_normalised=d_normalised(motion, positions, played),
        d_world=metrics.distortion_percent(motion.positions, positions),
    )


def d_normalised(motion: Motion, decoded: Floats, played: Roles) -> float:
    """d in percent, of all points, with the original and the decoded (frames, points, 3) each in its own body frame."""
    original, ours = (
        body_frame.to_body(positions, body_frame.from_markers(positions[:, played.normalisation], motion.up))
        for positions in (motion.positions, decoded)
    )
    return metrics.distortion_percent(original, ours)
