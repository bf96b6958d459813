"""The method: sections 3 to 5 of the paper.

    encode   first frame ──segment──► model P of cylinder links                stored once
             each frame Q ──ARTICP──► pose T of the links ───────────────────► pose stream
                             └─ Q and T(P) as maps on the links' cylinders ──► difference: depth as PNG, colour as JPEG
    decode   pose stream ──► T(P) ──moved by the difference──► points

With residual maps a decoded frame has the points of T(P) in occupied cells, and a point in every other cell that Q
occupies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ... import progress
from ...encoded import Chunk, Encoded
from ...errors import BadInput, CannotEncode, Corrupt
from ...geometry import articulated_icp, articulation, body_fit
from ...geometry.articulation import Pose
from ...motion import Motion
from ...pointcloud import PointClouds
from ...typing import Bytes, Floats, Integers
from .. import base
from ..clouds.body_record import round_body
from ..clouds.raw_frames import Cloud, is_usable, pack_raw_frames, unpack_raw_frames, usable_points
from ..clouds.tracked_motion import skeleton_motion, tracked_motion
from .chunk_payload import ChunkParts, pack_chunk, unpack_chunk
from .cylinder_model import CylinderTemplate, ResidualFormat, pack_model, round_model, stored_share, unpack_model
from .map_images import pack_images, unpack_images
from .pose_stream import dequantise, quantise
from .residual_maps import MapTile, frame_maps, map_layout, reconstruct, residual_of, sheet_size

MIN_BODY_POINTS = 50  # frames with fewer points are stored point by point
MIN_FIRST_POINTS = 4 * MIN_BODY_POINTS  # of the frame that the model is made of
SHORTEST_LINK = 0.1  # of the body's size


class TrackedFrames(NamedTuple):
    """is_body (frames,): False for frames stored point by point. poses (frames, 3 + 3 links): integers."""

    is_body: list[bool]
    poses: Integers


@dataclass(frozen=True)
class Lien2006:
    """Settings of lien2006: point clouds of people by articulated ICP and residual maps (Lien & Bajcsy 2006).

    residual: percent of the full residual maps; 0 sends poses alone. skeleton: a Motion, or the path of one (.bvh,
    .amc), whose first frame is the pose of the first frame; without one, a body is fitted. model_share: share of the
    first frame's points that become the model; the paper's data have 50 %. tracked_points: most points of the model
    and of a frame that ARTICP uses. jpeg_quality: of colour residuals, 1 to 95. chunk_frames: frames that decode
    together. global_fitting: section 3.4. articulation: joints as pivots, section 3.2.
    """

    name: ClassVar[str] = "lien2006"
    residual: float = 0
    skeleton: Any = None
    model_share: float = 0.5
    tracked_points: int = 2500
    jpeg_quality: int = 50
    chunk_frames: int = 60
    global_fitting: bool = True
    articulation: bool = True

    def encode(self, clouds: PointClouds) -> Encoded[PointClouds]:
        """Raises CannotEncode where no frame shows a body, BadInput for settings or a skeleton that cannot be used."""
        self._require_settings(clouds)
        frames = [usable_points(clouds, frame) for frame in range(len(clouds))]
        first = first_body_frame(frames)
        model, tracker = self._fit_model(frames[first], frame_normals(clouds, first), clouds.up)
        with progress.phase(0.0, 0.8):
            tracked = self._track(tracker, clouds, frames, first)
        share = stored_share(self.residual)
        tiles = map_layout(model, share) if share else []
        spans = [slice(s, min(s + self.chunk_frames, len(frames))) for s in range(0, len(frames), self.chunk_frames)]
        with progress.phase(0.8, 1.0):
            chunks = [
                Chunk(span.start, span.stop - span.start, self._chunk(model, tiles, frames, tracked, span))
                for span in progress.over(spans)
            ]
        shared = (pack_model(model, self.residual),)
        return Encoded(self.name, _without_frames(clouds), chunks, shared, settings=self._stored_settings())

    @staticmethod
    def decode(encoded: Encoded[PointClouds], frames: slice | None = None) -> PointClouds:
        """The point clouds, or a slice of their frames. Raises Corrupt."""
        model, stored = unpack_model(encoded.shared)
        tiles = map_layout(model, stored.share) if stored.share else []
        positions, colours = list[Floats](), list[Bytes]()
        start, stop = encoded.range(frames)
        for chunk in progress.over(encoded.covering(start, stop)):
            for i, (points, colour) in enumerate(decode_chunk(model, stored, tiles, chunk)):
                if start <= chunk.start + i < stop:
                    positions.append(points)
                    colours.append(colour if colour is not None else np.zeros((len(points), 3), np.uint8))
        like, coloured = encoded.about, model.colours is not None
        return PointClouds(positions, like.rate, colours if coloured else None, None, like.up, like.source, like.extras)

    @staticmethod
    def track(encoded: Encoded[PointClouds], frames: slice | None = None) -> Motion:
        """The tracked body: joints and rotations of the links, frame by frame. Raises Corrupt."""
        model, _ = unpack_model(encoded.shared)
        start, stop = encoded.range(frames)
        poses = list[Pose]()
        for chunk in encoded.covering(start, stop):
            rows = unpack_chunk(chunk, len(model.body)).poses
            poses += [dequantise(model.body, r[1:]) for i, r in enumerate(rows) if start <= chunk.start + i < stop]
        return tracked_motion(encoded, model.body, poses)

    def _require_settings(self, clouds: PointClouds) -> None:
        if isinstance(clouds, Motion):
            raise CannotEncode("lien2006 codes point clouds, not motions")
        if not 0 <= self.residual <= 100 or not 0 < self.model_share <= 1:
            raise BadInput("residual is a percentage from 0 to 100, model_share a share up to 1")
        if self.chunk_frames < 1:
            raise BadInput(f"chunk_frames must be at least 1, not {self.chunk_frames}")

    def _stored_settings(self) -> dict[str, Any]:
        settings = base.settings(self)
        if self.skeleton is not None:
            settings["skeleton"] = "given" if isinstance(self.skeleton, Motion) else str(self.skeleton)
        return settings

    def _fit_model(
        self, frame: Cloud, normals: Floats | None, up: str
    ) -> tuple[CylinderTemplate, articulated_icp.ArticpTracker]:
        """The model of the first frame, as it will be decoded, and the tracker that follows it (section 3.1)."""
        points, colours = frame
        if self.skeleton is None:
            body = body_fit.first_pose(points, up).body(one_trunk=True, shortest=SHORTEST_LINK)
        else:
            motion = skeleton_motion(self.skeleton)
            assert motion.skeleton is not None
            names, parents = motion.skeleton.names, motion.skeleton.parents
            body = articulation.from_skeleton(
                names, parents, motion.positions[0], one_trunk=True, shortest=SHORTEST_LINK
            )
            body_fit.require_near(body, points)
        order = np.random.default_rng(0).permutation(len(points))
        chosen = order[: max(2 * MIN_BODY_POINTS, round(self.model_share * len(points)))]
        near = articulated_icp.is_near(body, points[chosen])  # leaves out the floor and other people
        chosen = chosen[near] if near.sum() >= MIN_BODY_POINTS else chosen
        colours = None if colours is None else colours[chosen]
        normals = None if normals is None else normals[chosen]
        body, fitted = articulated_icp.make_model(body, points[chosen], colours, normals, among=points)
        body = round_body(body)
        some = slice(0, self.tracked_points)
        template = articulated_icp.CylinderModel(
            fitted.points[some], fitted.normals[some], None if colours is None else colours[some], fitted.links[some]
        )
        settings = articulated_icp.ArticpSettings(articulation=self.articulation, global_fitting=self.global_fitting)
        model = round_model(CylinderTemplate(body, fitted.points, colours, fitted.links))
        return model, articulated_icp.ArticpTracker(body, template, settings)

    def _track(
        self, tracker: articulated_icp.ArticpTracker, clouds: PointClouds, frames: Sequence[Cloud], first: int
    ) -> TrackedFrames:
        """The pose of every frame; a frame without a body repeats the pose before it (section 3.2)."""
        is_body = [len(points) >= MIN_BODY_POINTS and i >= first for i, (points, _) in enumerate(frames)]
        tracked = list[Pose]()
        for i in progress.over(range(first, len(frames))):
            if is_body[i]:
                pose = tracker.pose if i == first else self._fit_pose(tracker, frames[i], frame_normals(clouds, i), i)
                tracked.append(pose)
        stacked = Pose(np.stack([pose.rotations for pose in tracked]), np.stack([pose.root for pose in tracked]))
        known = quantise(tracker.body, stacked)
        poses = np.concatenate([np.zeros((1, known.shape[1]), np.int64), known])[np.cumsum(is_body)]
        return TrackedFrames(is_body, poses)

    def _fit_pose(
        self, tracker: articulated_icp.ArticpTracker, frame: Cloud, normals: Floats | None, seed: int
    ) -> Pose:
        points, colours = frame
        some = np.random.default_rng(seed).permutation(len(points))[: self.tracked_points]
        colours = None if colours is None else colours[some]
        return tracker.fit(points[some], colours, None if normals is None else normals[some], points)

    def _chunk(
        self,
        model: CylinderTemplate,
        tiles: Sequence[MapTile | None],
        frames: Sequence[Cloud],
        tracked: TrackedFrames,
        span: slice,
    ) -> bytes:
        """The payload of a run of frames."""
        is_body, poses = tracked.is_body[span], tracked.poses[span]
        raw_frames = [frame for frame, body in zip(frames[span], is_body, strict=True) if not body]
        residuals = [
            residual_of(tiles, frame_maps(model, tiles, dequantise(model.body, pose), frame))
            for frame, pose, body in zip(frames[span], poses, is_body, strict=True)
            if body and tiles
        ]
        rows = np.column_stack([[not body for body in is_body], poses])
        images = pack_images(residuals, model.colours is not None, self.jpeg_quality) if residuals else []
        return pack_chunk(ChunkParts(rows, pack_raw_frames(raw_frames), images))


def first_body_frame(frames: Sequence[Cloud]) -> int:
    """The first frame with enough points for a model. Raises CannotEncode."""
    for i, (points, _) in enumerate(frames):
        if len(points) >= MIN_FIRST_POINTS:
            return i
    raise CannotEncode(f"no frame has {MIN_FIRST_POINTS} points or more: there is no body to code")


def frame_normals(clouds: PointClouds, frame: int) -> Floats | None:
    """Unit normals of the points of `usable_points`; None without normals, or where one of them has no direction."""
    if clouds.normals is None:
        return None
    normals = np.asarray(clouds.normals[frame], np.float64)[is_usable(clouds.positions[frame])]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / length if np.isfinite(length).all() and (length > 1e-6).all() else None


def decode_chunk(
    model: CylinderTemplate, stored: ResidualFormat, tiles: Sequence[MapTile | None], chunk: Chunk
) -> Iterator[Cloud]:
    """The frames of a chunk. Raises Corrupt."""
    coloured = model.colours is not None
    parts = unpack_chunk(chunk, len(model.body))
    is_raw = parts.poses[:, 0] != 0
    raw_frames = iter(unpack_raw_frames(parts.raw_frames, int(is_raw.sum()), coloured))
    bodies = int((~is_raw).sum())
    if parts.images and not tiles:
        raise Corrupt("lien2006: a chunk has residual maps though the model says that there are none")
    residuals = iter(
        unpack_images(parts.images, bodies, sheet_size(tiles), coloured, stored.depth_by_cell)
        if parts.images
        else [None] * bodies
    )
    for row, raw in zip(parts.poses, is_raw, strict=True):
        if raw:
            yield next(raw_frames)
        else:
            yield reconstruct(model, tiles, dequantise(model.body, row[1:]), next(residuals), stored.depth_step_m)


def _without_frames(clouds: PointClouds) -> PointClouds:
    colours = None if clouds.colours is None else []
    return PointClouds([], clouds.rate, colours, None, clouds.up, clouds.source, clouds.extras)
