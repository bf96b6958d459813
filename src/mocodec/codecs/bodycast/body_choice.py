"""Whether the bodies that were found are worth their bytes, for points that are coded from their surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...typing import Booleans
from ..clouds.raw_frames import Cloud
from .body_model import pack_model
from .encoder import BodyEncoder
from .point_encoder import PointEncoder, PointTarget
from .point_scene import SurfaceTexture
from .pose_stream import PoseSequence

TRIED_FRAMES = 2
MAX_EXTRA_SHARE = 0.1  # of the bytes of points alone, that bodies may cost


def absences(bodies: Sequence[BodyEncoder], span: slice) -> Booleans:
    """(frames, bodies): True where a body is not in a frame."""
    rows = [[not b.is_present[i] for b in bodies] for i in range(span.start, span.stop)]
    return np.array(rows, bool).reshape(span.stop - span.start, len(bodies))


def bodies_pay(
    bodies: Sequence[BodyEncoder], frames: Sequence[Cloud], span: slice, coloured: bool, target: PointTarget
) -> bool:
    """Whether points of all frames take at most MAX_EXTRA_SHARE more bytes with the bodies than alone.

    A thing may look like a body, and a short recording does not earn back what is sent once. Judged by the first frames
    of a chunk, `span`, that have a body.
    """
    is_absent = absences(bodies, span)
    chosen = np.flatnonzero(~is_absent.all(axis=1))[:TRIED_FRAMES]
    if not len(chosen):
        return True
    coded = [body.encode_chunk(span) for body in bodies]
    poses = [PoseSequence(sequence.rotations[chosen], sequence.roots[chosen]) for _, sequence in coded]
    some, whole = [frames[span.start + k] for k in chosen.tolist()], [slice(0, len(chosen))]
    textures = [SurfaceTexture(body.model) for body in bodies]
    beside = PointEncoder(some, whole, textures, [poses], [is_absent[chosen]], coloured)
    alone = PointEncoder(some, whole, [], [[]], [is_absent[chosen, :0]], coloured)
    bound = alone.bound(target)
    bytes_beside, bytes_alone = (len(encoder.coded(bound)[0]) / len(chosen) for encoder in (beside, alone))
    poses_bytes = sum(len(streams.poses) for streams, _ in coded) / (span.stop - span.start)
    once = sum(len(pack_model(body.model)) for body in bodies) / len(frames)
    return bytes_beside + poses_bytes + once <= (1 + MAX_EXTRA_SHARE) * bytes_alone
