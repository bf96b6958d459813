"""The method: bodies tracked through all frames, their surface in one image, and points that no body explains.

encode   first frame ─► people ─► trackers: all joints at once ─► poses ─► spectra ─► entropy coder
                                      │
         points of all frames, moved back into the canonical pose ─► atlas: the mean surface, stored once, H.265
                                      │
         outliers ─► centimetre cells in an octree; or all points, within a bound or exactly
decode   atlas ─► points on the surface ──poses, skinning──► points in the world + outliers
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ... import progress
from ...encoded import Chunk, Encoded
from ...errors import BadInput, CannotEncode
from ...formats.gltf import Surface
from ...geometry.articulation import Pose
from ...motion import Motion
from ...pointcloud import PointClouds
from ...typing import Booleans, Bytes, Floats
from .. import base
from ..clouds.raw_frames import MAX_COORDINATE_M, Cloud, pack_raw_frames, usable_points
from ..clouds.tracked_motion import joints_of_links, tracked_motion
from . import exact_points, lattice_frames, residual_scale
from .body_choice import absences, bodies_pay, bytes_alone
from .body_model import MAX_POINTS, body_model, unpack_models
from .chunk_payload import ChunkStreams, pack_chunk, unpack_chunk
from .decoder import BodyDecoder, SceneDecoder
from .encoder import BodyEncoder, CodingParameters
from .exact_octree import pack_smallest
from .outliers import find_outliers, pack_outliers
from .people import MIN_FIRST_POINTS, assign_points, start_trackers
from .point_encoder import PointEncoder, PointTarget
from .point_scene import ChunkBodies
from .point_targets import COARSEST_BOUND_M
from .pose_stream import PoseSequence, unpack_poses
from .residual_scale import SURFACE_PERCENT
from .tracking import MIN_BODY_POINTS

CRF_GAIN = 8  # x265's rate factor of the picture, at residual 0 less that at 25
MIN_OUTLIER_SHARE = 0.01  # of a single body's points, below which a frame has no outliers
EXACT = "exact"
EXCLUSIVE = ("max_error", "mean_error", "size", "ratio")  # targets of which a file meets one
MAX_EXTENT_M = 100  # of a frame without a body, unless an error is asked for: larger ones have a wrong unit
ANYWHERE_M = float(np.finfo(np.float32).max)  # every point counts, however far away
FEW_POINTS = 5000  # of a recording, up to which it may take fewer bytes than a body
LEAST_BODY_BYTES, MOST_SAVED = 1100, 0.5  # of a model; share of the points' bytes that a body saves, at most
FILE_BYTES, CHUNK_BYTES = 600, 48  # about what a container needs besides its chunks, and for each


@dataclass(frozen=True)
class Bodycast:
    """Settings of bodycast, the default codec for point clouds of people: tracked bodies and their surfaces.

    Targets, at most one of the first four: max_error: no point is farther from the nearest decoded point than this, and
    no decoded point from the nearest point, metres; mean_error: neither mean of these distances is larger; size: bytes
    of the file; ratio: to float32 positions and 8-bit colours. psnr: of the luma between nearest points, dB. With a
    target all points are coded; a smaller error always takes more bytes.

    residual: without a target, how closely the decoded points follow the data, in percent; more takes more bytes. From
    0 to 25 the poses and the surface become finer; above 25 all points are coded within a bound that falls to 0.1 mm at
    100, and the file promises it; "exact" keeps every point. precision: of exact points, metres; 0 keeps all bits of
    32-bit floats. skeleton: a Motion, or the path of one, whose first frame is the pose of the first frame; a list of
    them for several people; without one, bodies are fitted. people: how many are tracked at most; points of others are
    outliers. pose_step: metres that the surface moves for one step of a joint. points: of a decoded frame up to 25
    percent; by default as many as a frame of the data has. cells: of the atlas. surface_quality: of the atlas, x265's
    rate factor, lower is better. The values of pose_step, cells and surface_quality are those of residual 0. strangers:
    code outlier points. tracked_points: most points of a frame that the tracker uses. chunk_frames: frames that decode
    together.
    """

    name: ClassVar[str] = "bodycast"
    max_error: float | None = None
    mean_error: float | None = None
    size: int | None = None
    ratio: float | None = None
    psnr: float | None = None
    residual: float | str = 0
    skeleton: Any = None
    people: int = 4
    precision: float = 0.0
    pose_step: float = 0.003
    points: int | None = None
    cells: int = 10_000
    surface_quality: int = 30
    strangers: bool = True
    tracked_points: int = 2500
    chunk_frames: int = 150

    def encode(self, clouds: PointClouds) -> Encoded[PointClouds]:
        """Frames without a body are coded as points within a bound, by default of 5 mm. Where all points are
        coded and the bodies would take more bytes than they save, bodies are left out, unless a skeleton is given.

        Raises CannotEncode for a target that cannot be met, BadInput for settings or a skeleton that cannot be used.
        """
        if isinstance(clouds, Motion):
            raise CannotEncode("bodycast codes point clouds, not motions")
        self.require_settings()
        self._require_colours(clouds)
        if self.residual == EXACT and any(np.isinf(points).any() for points in clouds.positions):
            raise CannotEncode("residual exact cannot keep points at infinity: leave them out")
        frames = [usable_points(clouds, frame) for frame in range(len(clouds))]
        coloured = clouds.colours is not None
        starts = range(0, len(frames), self.chunk_frames)
        spans = [slice(start, min(start + self.chunk_frames, len(frames))) for start in starts]
        self._require_range(clouds, spans)
        with progress.phase(0.0, 0.6):
            is_tracked = not self._is_smaller_alone(frames, spans, coloured)
            bodies = self._bodies(frames, clouds.up, coloured) if is_tracked else []
        shared = tuple(body.packed_model for body in bodies)
        settings = self._stored_settings()
        if not self._has_target and self._codes_points(bodies):
            settings["max_error"] = self._bound_of_residual(bodies, frames, spans, coloured)
        target = PointTarget(settings.get("max_error"), self.mean_error)
        may_leave_out = self._codes_points(bodies) and bodies and self.skeleton is None
        if may_leave_out and not bodies_pay(bodies, frames, spans, coloured, target):
            bodies, shared = [], ()
        if self._has_target or self._percent > SURFACE_PERCENT or self.residual == EXACT:
            frames = [usable_points(clouds, frame, ANYWHERE_M) for frame in range(len(clouds))]
        with progress.phase(0.6, 1.0):
            if self._codes_points(bodies):
                payloads = self._point_chunks(bodies, frames, spans, coloured, clouds.raw_bytes, settings)
            else:
                payloads = [self._chunk(bodies, frames, span, coloured) for span in progress.over(spans)]
        chunks = [Chunk(s.start, s.stop - s.start, payload) for s, payload in zip(spans, payloads, strict=True)]
        colours = [] if coloured else None
        about = PointClouds([], clouds.rate, colours, None, clouds.up, clouds.source, clouds.extras)
        return Encoded(self.name, about, chunks, shared, settings=settings)

    @staticmethod
    def decode(encoded: Encoded[PointClouds], frames: slice | None = None) -> PointClouds:
        """The point clouds, or a slice of their frames. Raises Corrupt."""
        like = encoded.about
        scene = SceneDecoder(unpack_models(encoded.shared), like.colours is not None)
        positions, colours = list[Floats](), list[Bytes]()
        start, stop = encoded.range(frames)
        for chunk in progress.over(encoded.covering(start, stop)):
            wanted = max(0, start - chunk.start), min(chunk.frames, stop - chunk.start)
            for points, colour in scene.decode_chunk(chunk, *wanted):
                positions.append(points)
                colours.append(np.zeros((len(points), 3), np.uint8) if colour is None else colour)
        return PointClouds(
            positions, like.rate, colours if scene.coloured else None, None, like.up, like.source, like.extras
        )

    @staticmethod
    def track(encoded: Encoded[PointClouds], frames: slice | None = None, body: int = 0) -> Motion:
        """A tracked body, counted from 0: markerless motion capture, which can be written as BVH.

        Raises Corrupt; BadInput for a body that the recording does not have.
        """
        models = unpack_models(encoded.shared)
        model = body_model(models, body)
        start, stop = encoded.range(frames)
        poses = list[Pose]()
        for chunk in encoded.covering(start, stop):
            stream = unpack_chunk(chunk, len(models)).bodies[body].poses
            sequence = unpack_poses(model.atlas.body, stream, chunk.frames, model.pose_steps)
            poses += [sequence[i] for i in range(chunk.frames) if start <= chunk.start + i < stop]
        return tracked_motion(encoded, model.atlas.body, poses)

    @staticmethod
    def surface(encoded: Encoded[PointClouds], body: int = 0) -> Surface:
        """The static surface of a body, skinned to the joints of `track`: what a GLB shows.

        Raises Corrupt; BadInput for a body that the recording does not have.
        """
        decoder = BodyDecoder(body_model(unpack_models(encoded.shared), body))
        joints, rest = joints_of_links(decoder.body)
        weights = np.stack([decoder.skin.weights, 1 - decoder.skin.weights], axis=1)
        colours = decoder.colours if decoder.model.coloured else None
        return Surface(decoder.skin.points, colours, joints[decoder.skin.links], weights, rest)

    @property
    def parameters(self) -> CodingParameters:
        """What the residual asks for. Exact points need no fine poses; points within a bound the finest surface."""
        percent = SURFACE_PERCENT if self._has_target else min(self._percent, SURFACE_PERCENT)
        share = percent / SURFACE_PERCENT
        pose_step = self.pose_step * 4.0**-share
        return CodingParameters(
            pose_step_m=pose_step,
            refines_poses=pose_step < self.pose_step,
            atlas_cells=round(self.cells * 2.0**share),
            key_crf=max(self.surface_quality - round(CRF_GAIN * share), 0),
            points=self.points,
        )

    @property
    def _percent(self) -> float:
        return 0.0 if isinstance(self.residual, str) else float(self.residual)

    def require_settings(self) -> None:
        """Raises BadInput for settings that cannot be used."""
        if (isinstance(self.residual, str) and self.residual != EXACT) or not 0 <= self._percent <= 100:
            raise BadInput(f'residual is a percentage from 0 to 100, or "{EXACT}"')
        if not 100 <= self.cells <= 1_000_000 or not (self.points is None or 1 <= self.points <= MAX_POINTS):
            raise BadInput("cells is a number from 100 to a million, points one from 1 to a million")
        if not 1e-4 <= self.pose_step <= 1 or not 0 <= self.precision <= 1 or self.chunk_frames < 1 or self.people < 1:
            raise BadInput(
                "pose_step is 0.1 mm to a metre, precision at most a metre; people, chunk_frames at least one"
            )

        targets = [name for name in EXCLUSIVE if getattr(self, name) is not None]
        if len(targets) > 1:
            raise BadInput(f"bodycast meets one target at a time, not {' and '.join(targets)}; psnr goes with any")
        if self._has_target and self.residual == EXACT:
            raise BadInput("residual exact keeps every bit of every point: leave out the targets")
        for name in (*EXCLUSIVE, "psnr"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise BadInput(f"{name} must be above zero, not {value}")

    @property
    def _has_target(self) -> bool:
        """Whether a target says how close the points are, not the residual."""
        is_given = any(getattr(self, name) is not None for name in EXCLUSIVE)
        return is_given or (self.psnr is not None and self._percent <= SURFACE_PERCENT)

    def _require_colours(self, clouds: PointClouds) -> None:
        """Raises CannotEncode for a target of the colours of points without colours."""
        if self.psnr is not None and clouds.colours is None:
            raise CannotEncode("psnr is a target for the colours of points, and these points have none: leave it out")

    def _require_range(self, clouds: PointClouds, spans: Sequence[slice]) -> None:
        """Raises CannotEncode, before any body is tracked, for points too far apart for the target.

        The bound of a residual depends on the tracked bodies: here it is the coarsest that the residual may stand for.
        """
        if not (self._has_target or self.residual == EXACT or self._percent > SURFACE_PERCENT):
            return
        bound = residual_scale.bound_of_residual(max(self._percent, SURFACE_PERCENT), COARSEST_BOUND_M)
        if self._has_target:
            bound = PointTarget(self.max_error, self.mean_error, self.size or self.ratio, self.psnr).first_bound
        for span in spans:
            frames = [usable_points(clouds, frame, ANYWHERE_M) for frame in range(span.start, span.stop)]
            if self.residual == EXACT:
                exact_points.require_range(frames, self.precision)
            else:
                lattice_frames.require_range(frames, bound)

    def _is_smaller_alone(self, frames: Sequence[Cloud], spans: Sequence[slice], coloured: bool) -> bool:
        """Whether points within a bound are so few that no body can be worth its bytes: then none is searched."""
        count = sum(len(points) for points, _ in frames)
        is_bounded = self.max_error is not None or self.mean_error is not None
        if self.skeleton is not None or not is_bounded or not 0 < count <= FEW_POINTS:
            return False
        alone = bytes_alone(frames, spans, coloured, PointTarget(self.max_error, self.mean_error))
        return MOST_SAVED * alone < LEAST_BODY_BYTES

    def _codes_points(self, bodies: Sequence[BodyEncoder]) -> bool:
        return self._has_target or self._percent > SURFACE_PERCENT or (not bodies and self.residual != EXACT)

    def _bodies(self, frames: Sequence[Cloud], up: str, coloured: bool) -> list[BodyEncoder]:
        """The bodies of a recording with their models; none where no frame shows one. Raises BadInput."""
        if not any(len(points) for points, _ in frames):
            raise CannotEncode(
                f"no frame has points within {MAX_COORDINATE_M:g} m of the origin: there is no body to code"
            )
        first = next((i for i, (points, _) in enumerate(frames) if len(points) >= MIN_FIRST_POINTS), None)
        if first is None:
            return []
        try:
            bodies = self._track(frames, first, up)
            if self.skeleton is None:
                bodies = [body for body in bodies if body.is_explained]
            counts = [len(p) for p, _ in frames[first:] if len(p) >= MIN_BODY_POINTS]
            for body in bodies:
                body.build_model(self.parameters, int(np.mean(counts)), coloured, is_only_body=len(bodies) == 1)
        except (CannotEncode, BadInput):
            extent_m = float(np.ptp(frames[first][0], axis=0).max())
            if self.skeleton is not None or (extent_m > MAX_EXTENT_M and not self._has_target):
                raise  # a skeleton that does not fit, or a wrong unit
            return []
        return bodies

    def _bound_of_residual(
        self, bodies: Sequence[BodyEncoder], frames: Sequence[Cloud], spans: Sequence[slice], coloured: bool
    ) -> float:
        """The bound that the residual stands for, metres. A recording without a body has points at any residual."""
        surface = self._chunk(bodies, frames, spans[0], coloured) if bodies else b""
        first = residual_scale.first_bound([body.model for body in bodies], surface, frames[spans[0]], coloured)
        return residual_scale.bound_of_residual(max(self._percent, SURFACE_PERCENT), first)

    def _point_chunks(
        self,
        bodies: Sequence[BodyEncoder],
        frames: Sequence[Cloud],
        spans: Sequence[slice],
        coloured: bool,
        raw_bytes: int,
        settings: Mapping[str, Any],
    ) -> list[bytes]:
        """The payload of each chunk with all its points. settings: with the targets. Raises CannotEncode."""
        shared_bytes = sum(len(body.packed_model) for body in bodies)
        coded = [[body.encode_chunk(span) for body in bodies] for span in spans]
        absent = [absences(bodies, span) for span in spans]
        empty = [
            ChunkStreams(a, b"", b"", b"", tuple(stream for stream, _ in own))
            for a, own in zip(absent, coded, strict=True)
        ]
        beside = (
            shared_bytes + sum(len(pack_chunk(streams)) for streams in empty) + FILE_BYTES + CHUNK_BYTES * len(spans)
        )
        file_bytes = self.size if self.ratio is None else raw_bytes / self.ratio
        size = None if file_bytes is None else file_bytes - beside
        textures = [body.texture for body in bodies]
        poses = [[sequence for _, sequence in own] for own in coded]
        chunk_bodies = [ChunkBodies(textures, *own) for own in zip(poses, absent, strict=True)]
        encoder = PointEncoder(frames, spans, chunk_bodies, coloured)
        parts = encoder.encode(PointTarget(settings.get("max_error"), self.mean_error, size, self.psnr, beside))
        return [pack_chunk(streams._replace(exact_points=part)) for streams, part in zip(empty, parts, strict=True)]

    @property
    def _skeletons(self) -> list[Any]:
        if self.skeleton is None:
            return []
        return self.skeleton if isinstance(self.skeleton, list) else [self.skeleton]

    def _stored_settings(self) -> dict[str, Any]:
        settings = base.settings(self)
        if self.skeleton is not None:
            settings["skeleton"] = [s if isinstance(s, str) else "given" for s in self._skeletons]
        return settings

    def _track(self, frames: Sequence[Cloud], first: int, up: str) -> list[BodyEncoder]:
        """Every body through all frames. first: the frame that the bodies are taken from."""
        trackers = start_trackers(frames[first], self._skeletons, up, self.tracked_points, self.people)
        bodies = [BodyEncoder(tracker) for tracker in trackers]
        for i, (points, colours) in progress.over(list(enumerate(frames))):
            body_of = assign_points(points, trackers) if i >= first else np.full(len(points), -1)
            for number, body in enumerate(bodies):
                rows = np.flatnonzero(body_of == number)
                own = points[rows], None if colours is None else colours[rows]
                body.add_frame(i, own, is_tracked=i > first)
        return bodies

    def _chunk(self, bodies: Sequence[BodyEncoder], frames: Sequence[Cloud], span: slice, coloured: bool) -> bytes:
        """The payload of a run of frames."""
        is_absent = absences(bodies, span)
        coded = [body.encode_chunk(span) for body in bodies]
        streams = tuple(stream for stream, _ in coded)
        if self.residual == EXACT:
            textures, poses = [body.texture for body in bodies], [sequence for _, sequence in coded]
            chunk_bodies = ChunkBodies(textures, poses, is_absent)
            exact = pack_smallest(frames[span], self.precision, coloured, chunk_bodies)
            return pack_chunk(ChunkStreams(is_absent, b"", b"", exact, streams))
        outliers = self._outliers(bodies, [poses for _, poses in coded], frames, span, is_absent)
        raw_frames = [frame for frame, absent in zip(frames[span], is_absent, strict=True) if absent.all()]
        return pack_chunk(
            ChunkStreams(is_absent, pack_raw_frames(raw_frames), pack_outliers(outliers, coloured), b"", streams)
        )

    def _outliers(
        self,
        bodies: Sequence[BodyEncoder],
        decoded: Sequence[PoseSequence],
        frames: Sequence[Cloud],
        span: slice,
        is_absent: Booleans,
    ) -> list[Cloud]:
        """The outliers of each frame of a run. decoded: the poses of each body as they are decoded."""
        result = list[Cloud]()
        for k, (points, colours) in enumerate(frames[span]):
            i = span.start + k
            present = [number for number in range(len(bodies)) if not is_absent[k, number]]
            share = max((bodies[number].outlier_share[i] for number in present), default=0.0)
            if self.strangers and present and (share >= MIN_OUTLIER_SHARE or len(bodies) > 1):
                surfaces = [bodies[number].person.posed_template(decoded[number][k]) for number in present]
                result.append(find_outliers((points, colours), np.concatenate(surfaces)))
            else:
                result.append((points[:0], None if colours is None else colours[:0]))
        return result
