"""Tempo as a stream: frames in as they come, chunks out; chunks in, positions out.

    encoder = tempo.Encoder(about, max_error=0.005, latency_seconds=0.1)
    for frames in camera: wire.send(encoder.push(frames))          a chunk is as long as the latency
    decoder = tempo.Decoder(encoder.shared, about)
    for chunk in wire: show(decoder.push(chunk))            with rotations: decoder.motion(chunk)

Every chunk decodes alone, so a receiver may begin anywhere and lose any chunk. docs/tempo/results.md has the cost.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ... import encoded as encodeds
from ...encoded import Chunk, Encoded, most_chunk_frames
from ...errors import BadInput
from ...motion import Motion
from ...typing import Floats
from . import chunk_decoding, hard_bound, model_choice, target
from .chunk import ChunkEncoder
from .codec import DEFAULT_MAX_ERROR, FROZEN_SHARE, Tempo
from .header import StreamHeader
from .models import Recording
from .pose import heading
from .preparation import prepare
from .rotation_layer import payload
from .rotation_layer.encoder import BOUND_SHARE
from .rotation_layer.layer import PARTS, unit_rotations
from .rotation_layer.streaming import StreamEncoder

SHELL_M = 0.03
"""Distance of a stream's shell points from their joints."""


class Encoder:
    """Codes frames as they come. Its `shared` bytes are what a Decoder begins with.

    about: any motion with the names, rate and up axis of the stream, and its skeleton if there is one; its frames are
    not coded. max_error: metres. latency_seconds: how long a chunk is, and so how long a frame may wait: 0.1 to 10.
    like: an earlier recording of the same points, for a model where the prior does not know them. rotations: keep those
    of the joints too, which `push` then takes beside the positions; `like` must have rotations. Raises BadInput.
    """

    def __init__(
        self,
        about: Motion,
        max_error: float = DEFAULT_MAX_ERROR,
        latency_seconds: float = 0.5,
        like: Motion | None = None,
        rotations: bool = False,
    ) -> None:
        if not 0.1 <= latency_seconds <= 10 or not (np.isfinite(max_error) and max_error > 0):
            raise BadInput("latency_seconds must lie between 0.1 and 10, and max_error must be positive")
        if like is not None and like.names != about.names:
            raise BadInput("the earlier recording must have the same points")
        self._rotations = _rotations_like(about, like, max_error) if rotations else None
        self.about = about
        self.max_error = max_error if self._rotations is None else BOUND_SHARE * max_error
        self.chunk_frames = max(1, min(int(latency_seconds * about.rate), most_chunk_frames(about.points)))
        earlier = [] if like is None else [prepare(like.positions, like.up).smooth]
        choice = model_choice.choose(Recording(earlier, about, target.step_for_bound(self.max_error)))
        self._model = choice.model
        self.shared: tuple[bytes, ...] = (choice.header.pack(),)
        self.shared += () if self._rotations is None else (self._rotations.shared,)
        self._waiting = np.zeros((0, about.points, 3))
        self._waiting_rotations = np.zeros((0, about.points, 4))
        self._start = 0

    def push(self, positions: Floats, rotations: Floats | None = None) -> list[Chunk]:
        """The chunks that frames (n, points, 3), metres, NaN in gaps, complete. Raises BadInput, CannotEncode.

        rotations (n, joints, 4): where the stream keeps them; frames have no gaps then.
        """
        frames = np.asarray(positions, np.float64)
        if frames.ndim != 3 or frames.shape[1:] != self._waiting.shape[1:]:
            raise BadInput(f"frames must be (n, {self.about.points}, 3), not {frames.shape}")
        if (rotations is None) != (self._rotations is None):
            raise BadInput(f"this stream keeps {'no ' * (self._rotations is None)}rotations")
        if rotations is not None:
            turned = np.asarray(rotations, np.float64)
            if turned.shape != (*frames.shape[:2], 4) or np.isnan(frames).any():
                raise BadInput(f"rotations must be (n, {self.about.points}, 4), and positions without gaps")
            turned = unit_rotations(turned, self.about.names)
            self._waiting_rotations = np.concatenate([self._waiting_rotations, turned])
        self._waiting = np.concatenate([self._waiting, frames])
        ready = len(self._waiting) // self.chunk_frames
        return [self._chunk(self.chunk_frames) for _ in range(ready)]

    def finish(self) -> list[Chunk]:
        """The chunk of the remaining frames, if there are any."""
        return [self._chunk(len(self._waiting))] if len(self._waiting) else []

    def _chunk(self, frames: int) -> Chunk:
        source = prepare(
            self._waiting[:frames], self.about.up, FROZEN_SHARE * self.max_error, self.about.skeleton is not None
        )
        encoder = ChunkEncoder.of(self._model, source, slice(None))
        coded = Chunk(self._start, frames, hard_bound.to_bound([encoder], self.max_error)[0])
        if self._rotations is not None:
            targets = heading.from_y_up(chunk_decoding.decode(self._model, [coded])[0], self.about.up)
            part = self._rotations.part(self._waiting[:frames], self._waiting_rotations[:frames], targets)
            coded = Chunk(self._start, frames, payload.join(part, coded.payload))
            self._waiting_rotations = self._waiting_rotations[frames:]
        self._start += frames
        self._waiting = self._waiting[frames:]
        return coded


class Decoder:
    """Decodes an Encoder's chunks, in any order.

    shared: the encoder's. about: any motion with the names, rate, up axis and skeleton that the encoder was given.
    Raises Corrupt, UnknownCodec.
    """

    def __init__(self, shared: Iterable[bytes], about: Motion) -> None:
        self.about = about
        self._shared = tuple(shared)
        self._has_rotations = len(self._shared) == PARTS
        self._model = StreamHeader.unpack(self._shared[:1], about.points).read_model(about)

    def push(self, coded: Chunk) -> Floats:
        """The positions (frames, points, 3) of a chunk, in the axes of `about`. Raises Corrupt."""
        if self._has_rotations:
            return self.motion(coded).positions
        return heading.from_y_up(chunk_decoding.decode(self._model, [coded])[0], self.about.up)

    def motion(self, coded: Chunk) -> Motion:
        """A chunk as a motion, with rotations if the stream has them. Raises Corrupt."""
        if not self._has_rotations:
            return replace(self.about, positions=self.push(coded), rotations=None)
        alone = Chunk(0, coded.frames, coded.payload)
        return Tempo.decode(Encoded(Tempo.name, encodeds.about(self.about), [alone], self._shared))


def _rotations_like(about: Motion, like: Motion | None, max_error: float) -> StreamEncoder:
    """What codes the rotations of a stream. Raises BadInput."""
    if like is None or like.rotations is None or like.skeleton is None or about.skeleton is None:
        raise BadInput("a stream with rotations needs an earlier recording with rotations of the same skeleton: like=…")
    if like.skeleton.parents != about.skeleton.parents or like.gaps.any():
        raise BadInput("the earlier recording must have the same joint hierarchy, and no gaps")
    return StreamEncoder(replace(like, skeleton=about.skeleton), max_error, SHELL_M)
