"""The paper's own measures: counts of an encoded motion (Table 2), and global and piecewise PCA (Table 3).

The paper counts scalars of any width. A ratio here is the coordinates of the motion over the stored scalars.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ... import metrics
from ...encoded import Encoded
from ...geometry import body_frame
from ...motion import Motion
from ...stages import basis
from ...typing import Floats
from . import segment_model
from .decoding import read_segments, read_shared
from .marker_groups import MarkerGroups


@dataclass(frozen=True)
class SequenceStatistics:
    """The counts of Table 2.

    components: of each segment, of each PCA group. average_components: over segments and groups. control_points: key
    frames of all PCA models. scalars: as listed at the end of section 3.4. bytes_by_part: adds up to the payload bytes.
    """

    segments: int
    components: tuple[tuple[int, ...], ...]
    average_components: float
    control_points: int
    normalisation_control_points: int
    scalars: int
    scalar_ratio: float
    bytes_by_part: dict[str, int]


def statistics(encoded: Encoded[Motion]) -> SequenceStatistics:
    """Count segments, components, control points, scalars and bytes. Raises Corrupt."""
    markers = read_shared(encoded)[1]
    segments = read_segments(encoded.chunks, markers)[0]
    pca_models = [model for segment in segments for model in segment.groups]
    scalars = sum(segment.markers.numbers.size for segment in segments)
    scalars += sum(model.mean.size + model.basis.size + model.track.numbers.size for model in pca_models)
    return SequenceStatistics(
        segments=len(segments),
        components=tuple(tuple(model.basis.shape[1] for model in segment.groups) for segment in segments),
        average_components=float(np.mean([model.basis.shape[1] for model in pca_models])) if pca_models else 0.0,
        control_points=sum(len(model.track.keys) for model in pca_models),
        normalisation_control_points=sum(len(segment.markers.keys) for segment in segments),
        scalars=scalars,
        scalar_ratio=encoded.frames * markers.points * 3 / scalars,
        bytes_by_part=_bytes_by_part(encoded, markers),
    )


def _bytes_by_part(encoded: Encoded[Motion], markers: MarkerGroups) -> dict[str, int]:
    """Bytes of each kind of section over all chunks; "heads" includes the section lengths."""
    parts = {"shared": sum(map(len, encoded.shared))}
    for chunk in encoded.chunks:
        sections = segment_model.split_sections(chunk.payload, segment_model.section_count(markers))
        head, splits, marker_values, means, *group_sections, gaps, residual = sections
        section_lengths = len(chunk.payload) - sum(map(len, sections))
        for part, size in (
            ("heads", section_lengths + len(head)),
            ("key frames", len(splits)),
            ("normalisation markers", len(marker_values)),
            ("means", len(means)),
            ("bases", sum(map(len, group_sections[::2]))),
            ("projections", sum(map(len, group_sections[1::2]))),
            ("gaps", len(gaps)),
            ("residual", len(residual)),
        ):
            parts[part] = parts.get(part, 0) + size
    return parts


@dataclass(frozen=True)
class PcaResult:
    """A row of Table 3. components: of each segment. d: distortion rate in percent, in body frame and world."""

    components: tuple[int, ...]
    scalar_ratio: float
    d_normalised: float
    d_world: float


def global_pca(motion: Motion, markers: MarkerGroups, tolerance: float = 0.030) -> PcaResult:
    """Table 3, "Global PCA": one PCA of all normalised poses, with the projection of every frame stored."""
    return piecewise_pca(motion, markers, [slice(0, len(motion))], tolerance)


def piecewise_pca(
    motion: Motion, markers: MarkerGroups, segments: Sequence[slice], tolerance: float = 0.030
) -> PcaResult:
    """Table 3, "Piecewise PCA": a PCA of each segment, with the projection of every frame stored.

    The normalisation markers are stored unchanged. One PCA serves all other markers; its discarded components leave at
    most `tolerance` metres, root mean square over frames and markers.
    """
    rest = np.concatenate(markers.pca_groups)
    frame = body_frame.from_markers(motion.positions[:, markers.normalisation], motion.up)
    poses = body_frame.to_body(motion.positions[:, rest], frame).reshape(len(motion), -1)
    decoded = np.empty_like(poses)
    component_counts: list[int] = []
    scalars = len(motion) * 3 * len(markers.normalisation)
    for segment in segments:
        mean = poses[segment].mean(axis=0)
        centred = poses[segment] - mean
        components, variances = basis.fit(centred.T @ centred / len(centred))
        k = segment_model.components_needed(variances, tolerance, len(rest))
        projections = centred @ components[:, :k]
        decoded[segment] = projections @ components[:, :k].T + mean
        component_counts.append(k)
        scalars += projections.size + components[:, :k].size + mean.size
    positions = motion.positions.copy()
    positions[:, rest] = body_frame.to_world(decoded.reshape(len(motion), -1, 3), frame)
    return PcaResult(
        components=tuple(component_counts),
        scalar_ratio=motion.positions.size / scalars,
        d_normalised=d_normalised(motion, positions, markers),
        d_world=metrics.distortion_percent(motion.positions, positions),
    )


def d_normalised(motion: Motion, decoded: Floats, markers: MarkerGroups) -> float:
    """Distortion rate d in percent over all points. Original and decoded poses are each in their own body frame."""
    original_poses, decoded_poses = (
        body_frame.to_body(positions, body_frame.from_markers(positions[:, markers.normalisation], motion.up))
        for positions in (motion.positions, decoded)
    )
    return metrics.distortion_percent(original_poses, decoded_poses)
