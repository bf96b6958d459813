"""Whether the bodies that were found are worth their bytes, for points that are coded from their surface.

first frame of a chunk ─► bytes with bodies, alone ─► bytes of the recording ─ clear ─► yes or no
                                                             └─ close ─► more frames: two, then runs at both ends
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...typing import Booleans, Floats, Integers
from ..clouds.raw_frames import Cloud
from .encoder import BodyEncoder
from .point_encoder import PointEncoder, PointTarget
from .point_scene import ChunkBodies
from .pose_stream import PoseSequence

RUN_FRAMES = 4  # of each longer run: references have most of their effect in its second half
CLEAR_SHARES = {1: 0.08, 2: 0.05}
"""Frames that are coded first, and the difference in bytes that decides after them: references to earlier frames, which
the first frame has none of, change it by less later.
"""


def absences(bodies: Sequence[BodyEncoder], span: slice) -> Booleans:
    """(frames, bodies): True where a body is not in a frame."""
    rows = [[not b.is_present[i] for b in bodies] for i in range(span.start, span.stop)]
    return np.array(rows, bool).reshape(span.stop - span.start, len(bodies))


def bodies_pay(
    bodies: Sequence[BodyEncoder],
    frames: Sequence[Cloud],
    spans: Sequence[slice],
    coloured: bool,
    target: PointTarget,
) -> bool:
    """Whether points of all frames take no more bytes with the bodies than alone.

    A thing may look like a body, and a short recording does not earn back the bytes of a model. spans: of chunks; the
    first one with a body stands for all.
    """
    with_bodies = [span for span in spans if not absences(bodies, span).all()]
    if not with_bodies:
        return False
    trial = _Trial(bodies, frames, with_bodies[0], coloured)
    filled = sum(any(present) for present in zip(*(body.is_present for body in bodies), strict=True))
    once = sum(len(body.packed_model) for body in bodies) + filled * trial.pose_bytes

    def share(*runs: Integers) -> float:
        beside, alone = (_recording_bytes(own, len(with_bodies), filled) for own in trial.frame_bytes(runs, target))
        return (once + beside) / alone

    for frames_coded, clear in CLEAR_SHARES.items():
        if abs((first := share(trial.present[:frames_coded])) - 1) > clear:
            return first <= 1
    return share(*_both_ends(trial.present)) <= 1


def bytes_alone(frames: Sequence[Cloud], spans: Sequence[slice], coloured: bool, target: PointTarget) -> int:
    """Bytes of the points of all frames without bodies."""
    nobody = [ChunkBodies.nobody(span.stop - span.start) for span in spans]
    encoder = PointEncoder(frames, spans, nobody, coloured)
    return sum(map(len, encoder.coded(encoder.bound(target))))


def _both_ends(present: Integers) -> tuple[Integers, ...]:
    """Runs of RUN_FRAMES at both ends, or everything if that is no more."""
    if len(present) <= 2 * RUN_FRAMES:
        return (present,)
    return present[:RUN_FRAMES], present[-RUN_FRAMES:]


def _recording_bytes(runs: Sequence[Floats], chunks: int, frames: int) -> float:
    """Bytes of a recording, whose chunks begin as these runs do and go on like their second halves."""
    first = np.mean([run[0] for run in runs])
    later = np.mean(np.concatenate([run[len(run) // 2 :] for run in runs]))
    return float(chunks * first + (frames - chunks) * later)


class _Trial:
    """Codes runs of frames of a chunk in both ways. present: frames of the chunk with a body, counted from its first.
    pose_bytes: of such a frame.
    """

    def __init__(self, bodies: Sequence[BodyEncoder], frames: Sequence[Cloud], span: slice, coloured: bool) -> None:
        self.frames, self.coloured = frames[span], coloured
        self.is_absent = absences(bodies, span)
        self.present = np.flatnonzero(~self.is_absent.all(axis=1))
        coded = [body.encode_chunk(span) for body in bodies]
        self.pose_bytes = sum(len(streams.poses) for streams, _ in coded) / len(self.present)
        self.poses = [sequence for _, sequence in coded]
        self.textures = [body.texture for body in bodies]
        self._bound: float | None = None

    def frame_bytes(self, runs: Sequence[Integers], target: PointTarget) -> tuple[list[Floats], list[Floats]]:
        """The bytes of each frame of each run, with the bodies and alone."""
        rows = np.concatenate(runs)
        ends = np.cumsum([len(run) for run in runs]).tolist()
        spans = [slice(end - len(run), end) for end, run in zip(ends, runs, strict=True)]
        some, absent = [self.frames[k] for k in rows.tolist()], [self.is_absent[run] for run in runs]
        poses = [[PoseSequence(p.rotations[run], p.roots[run]) for p in self.poses] for run in runs]
        bodies = [ChunkBodies(self.textures, *own) for own in zip(poses, absent, strict=True)]
        beside = PointEncoder(some, spans, bodies, self.coloured)
        alone = PointEncoder(some, spans, [ChunkBodies.nobody(len(run)) for run in runs], self.coloured)
        if self._bound is None:
            self._bound = alone.bound(target)
        return beside.frame_bytes(self._bound), alone.frame_bytes(self._bound)
