"""The rotations of a stream, chunk by chunk, by the rules of an earlier recording."""

from __future__ import annotations

import numpy as np

from ....motion import Motion
from ....typing import Floats
from ..chunk import BOUND_SLOPE
from ..coding.contexts import OCTAVE
from . import choose, payload, shell
from .chunk_layer import ChunkLayer, Original, Promise
from .encoder import BOUND_STEP, Encoder


class StreamEncoder:
    """The rotations of a stream, by the rules of an earlier recording of the same skeleton. Raises BadInput."""

    def __init__(self, like: Motion, max_error: float, reach_m: float) -> None:
        self.promise = Promise(max_error, None, None)
        fitting = Encoder(like, reach_m, self.promise)
        self.step = round(np.log2(BOUND_STEP * max_error) * OCTAVE)
        self.layer, self.shared = fitting.fitted([choose.chunk_values(fitting.rules, fitting.values)], self.step)

    def part(self, positions: Floats, rotations: Floats, targets: Floats) -> bytes:
        """The part of a chunk: positions (frames, joints, 3), rotations (frames, joints, 4), and the positions that the
        inner stream decodes to. Raises CannotEncode.
        """
        rules = self.layer.rules
        original = Original(positions, rotations, shell.world_rotations(rules.skeleton, rotations))
        values = choose.chunk_values(rules, choose.side_values(rules, positions, rotations))
        chunk = ChunkLayer(self.layer, original, values, targets)
        draft = chunk.draft(self.step, BOUND_SLOPE)
        if chunk.broken(*chunk.solved(draft), self.promise).any():
            return chunk.mended(self.step, self.promise)
        return payload.pack_transforms(self.layer, [(draft.numbers, draft.grid)])[0]
