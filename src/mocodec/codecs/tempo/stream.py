"""Tempo as a stream: frames in as they come, chunks out; chunks in, positions out.

    encoder = tempo.Encoder(about, max_error=0.005, latency_seconds=0.1)
    for frames in camera: wire.send(encoder.push(frames))          a chunk is as long as the latency
    decoder = tempo.Decoder(encoder.shared, about)
    for chunk in wire: show(decoder.push(chunk))

Every chunk decodes alone, so a receiver may begin anywhere and lose any chunk. docs/tempo/results.md has the cost.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...encoded import Chunk, most_chunk_frames
from ...errors import BadInput
from ...motion import Motion
from ...typing import Floats
from . import chunk, model_choice, target
from .chunk import ChunkEncoder
from .codec import DEFAULT_MAX_ERROR, FROZEN_SHARE
from .header import StreamHeader
from .models import Recording
from .pose import heading
from .preparation import prepare


class Encoder:
    """Codes frames as they come. Its `shared` bytes are what a Decoder begins with.

    about: any motion with the names, rate and up axis of the stream, and its skeleton if there is one; its frames are
    not coded. max_error: metres. latency_seconds: how long a chunk is, and so how long a frame may wait: 0.1 to 10.
    like: an earlier recording of the same points, for a model where the prior does not know them. Raises BadInput.
    """

    def __init__(
        self,
        about: Motion,
        max_error: float = DEFAULT_MAX_ERROR,
        latency_seconds: float = 0.5,
        like: Motion | None = None,
    ) -> None:
        if not 0.1 <= latency_seconds <= 10 or not (np.isfinite(max_error) and max_error > 0):
            raise BadInput("latency_seconds must lie between 0.1 and 10, and max_error must be positive")
        if like is not None and like.names != about.names:
            raise BadInput("the earlier recording must have the same points")
        self.about = about
        self.max_error = max_error
        self.chunk_frames = max(1, min(int(latency_seconds * about.rate), most_chunk_frames(about.points)))
        earlier = [] if like is None else [prepare(like.positions, like.up).smooth]
        choice = model_choice.choose(Recording(earlier, about, target.step_for_bound(max_error)))
        self._model = choice.model
        self.shared: tuple[bytes, ...] = (choice.header.pack(),)
        self._waiting = np.zeros((0, about.points, 3))
        self._start = 0

    def push(self, positions: Floats) -> list[Chunk]:
        """The chunks that frames (n, points, 3), metres, NaN in gaps, complete. Raises BadInput, CannotEncode."""
        frames = np.asarray(positions, np.float64)
        if frames.ndim != 3 or frames.shape[1:] != self._waiting.shape[1:]:
            raise BadInput(f"frames must be (n, {self.about.points}, 3), not {frames.shape}")
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
        coded = Chunk(self._start, frames, target.to_bound([encoder], self.max_error)[0])
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
        self._model = StreamHeader.unpack(tuple(shared), about.points).read_model(about)

    def push(self, coded: Chunk) -> Floats:
        """The positions (frames, points, 3) of a chunk, in the axes of `about`. Raises Corrupt."""
        return heading.from_y_up(chunk.decode(self._model, [coded])[0], self.about.up)
