"""One body while it is encoded: its poses in all frames, and the model that is made of it."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...errors import CannotEncode, Corrupt
from ...geometry.articulation import Pose
from ...geometry.body_matching import FramePoints
from ...typing import Bytes, Integers
from ..clouds.raw_frames import Cloud
from . import video
from .body_model import MAX_POINTS, BodyModel, pack_model, unpack_model
from .chunk_payload import BodyStreams
from .point_scene import SurfaceTexture
from .pose_stream import PoseSequence, PoseSteps, pack_poses, unpack_poses
from .surface_mask import surface_cells
from .texture_atlas import Atlas, CellSums, atlas_planes
from .tracking import MIN_BODY_POINTS, CanonicalPoints, PersonTracker

HIDDEN_FACTOR = 1.35  # cells of the atlas per cell of visible surface; the others lie inside joints
SURFACE_FRAMES = 48  # frames that the key picture is made of
LINK_FRAMES = 14  # frames from which links of template points are learned
MIN_MOVING_FRAMES = 8  # with fewer, neither links are learned nor poses refined
MAX_PLAN_POINTS = 60_000  # from which tiles are planned
LATER_CRF, MAX_CRF = 14, 51  # x265's rate factor of pictures that would follow the key picture, more than its own
OUTLIER_DISTANCE_M = 0.08
MAX_OUTLIER_SHARE = 0.3  # of a person's points, in the median over frames


class CodingParameters(NamedTuple):
    """What the settings mean for one body.

    pose_step_m: as in `PoseSteps`. refines_poses: whether poses are fitted to more points. atlas_cells. key_crf: x265's
    rate factor of the key picture. points: of a decoded frame; None for as many as the data have.
    """

    pose_step_m: float
    refines_poses: bool
    atlas_cells: int
    key_crf: int
    points: int | None


class BodyEncoder:
    """Collects the frames of one body with `add_frame`, then makes its model and its streams.

    is_present, outlier_share: for each frame, whether the body is in it, and the share of its points that the pose does
    not explain. After `build_model`: packed_model: the model as bytes; model: as a decoder reads it, to the last bit of
    its floats, since contexts follow from them; planes: the key picture before compression.
    """

    def __init__(self, person: PersonTracker) -> None:
        self.person = person
        self.clouds, self.poses = list[Cloud](), list[Pose]()
        self.is_present, self.outlier_share = list[bool](), list[float]()
        self.packed_model: bytes
        self.model: BodyModel
        self.planes: Bytes

    def add_frame(self, frame: int, cloud: Cloud, is_tracked: bool) -> None:
        """The points of one frame that belong to the body. is_tracked: False up to the frame with the first pose."""
        is_present = len(cloud[0]) >= MIN_BODY_POINTS
        share = 0.0
        if is_present:
            fit = self.person.fit(cloud, frame) if is_tracked else self.person.fit_of_first_pose(cloud, frame)
            share = float(np.mean(fit.residuals > OUTLIER_DISTANCE_M)) if len(fit.residuals) else 0.0
        self.outlier_share.append(share)
        self.clouds.append(cloud)
        self.poses.append(self.person.tracker.pose)
        self.is_present.append(is_present)

    @cached_property
    def texture(self) -> SurfaceTexture:
        """What points are coded from; after `build_model`."""
        return SurfaceTexture(self.model)

    @property
    def is_explained(self) -> bool:
        """Whether the poses explain most points of most frames: otherwise the points are no person's."""
        shares = [share for share, present in zip(self.outlier_share, self.is_present, strict=True) if present]
        return bool(shares) and float(np.median(shares)) <= MAX_OUTLIER_SHARE

    def build_model(
        self, parameters: CodingParameters, points_per_frame: int, coloured: bool, is_only_body: bool
    ) -> None:
        """Make the model: links learned from motion, pose steps, and the mean surface over frames.

        points_per_frame: of the whole data, which a decoded frame has if this is the only body. Raises CannotEncode.
        """
        person, present = self.person, np.flatnonzero(self.is_present)
        moves = len(present) >= MIN_MOVING_FRAMES
        if moves:
            some = _evenly_chosen(present, LINK_FRAMES)
            person.learn_links([self.clouds[i] for i in some], [self.poses[i] for i in some])
        pose_steps = PoseSteps.for_skin(person.body, person.tracker.skin, parameters.pose_step_m)
        observed = self._observe_surface(present, refine=moves and parameters.refines_poses)
        points, links = np.concatenate([o.points for o in observed]), np.concatenate([o.links for o in observed])
        rows = np.random.default_rng(0).permutation(len(points))[:MAX_PLAN_POINTS]
        cells = round(HIDDEN_FACTOR * min(parameters.atlas_cells, len(points)))
        atlas = Atlas.plan(person.body, points[rows], links[rows], cells)
        if not atlas.tiles:
            raise CannotEncode("no points lie on the body's surface: does the skeleton fit the person?")
        sums = CellSums.empty(atlas)
        sums.add(atlas, points, links, np.concatenate([o.colours for o in observed]))
        self.planes = atlas_planes(atlas, sums)
        key_picture = video.encode([self.planes], parameters.key_crf, min(parameters.key_crf + LATER_CRF, MAX_CRF))[0]
        own = points_per_frame if is_only_body else int(np.mean([len(self.clouds[i][0]) for i in present]))
        decoded_points = min(parameters.points or max(own, 1), MAX_POINTS)
        is_surface = surface_cells(atlas, self.planes, sums)
        model = BodyModel(atlas, pose_steps, is_surface, key_picture, coloured, decoded_points, picture_interval=1)
        self.packed_model = pack_model(model)
        try:
            self.model = unpack_model(self.packed_model)
        except Corrupt as error:
            raise CannotEncode(f"bodycast cannot store this body: {error}") from error

    def _observe_surface(self, present: Integers, refine: bool) -> list[CanonicalPoints]:
        """Canonical points of SURFACE_FRAMES of the frames `present`. refine: refine the poses of all of them first."""
        chosen = set(_evenly_chosen(present, SURFACE_FRAMES))
        observed = list[CanonicalPoints]()
        for i in present.tolist() if refine else sorted(chosen):
            data = self._dense_data(i)
            if refine:
                self.poses[i] = self.person.refine_pose(data, self.poses[i])
            if i in chosen:
                observed.append(self.person.to_canonical(data, self.poses[i]))
        return observed

    def _dense_data(self, frame: int) -> FramePoints:
        return self.person.dense_data(self.clouds[frame], frame)

    def encode_chunk(self, span: slice) -> tuple[BodyStreams, PoseSequence]:
        """The streams of a run of frames, and its poses as they are decoded."""
        sequence, steps = PoseSequence.from_poses(self.poses[span]), self.model.pose_steps
        stream = pack_poses(self.person.body, sequence, steps)
        return BodyStreams(stream, ()), unpack_poses(self.model.atlas.body, stream, span.stop - span.start, steps)


def _evenly_chosen(frames: Integers, limit: int) -> list[int]:
    """At most `limit` of the frames, evenly spaced."""
    return frames[np.linspace(0, len(frames) - 1, min(limit, len(frames))).round().astype(int)].tolist()
