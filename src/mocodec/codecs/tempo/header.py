"""The shared bytes of a tempo stream: which model, and independent options.

byte of flags · [rate of the distinct frames] · then one of three forms
    model       [weights] · [neighbours] · prior · the fitted model
    direct      [weights] · [neighbours]               no chunk needs a model
    fallback    the shared bytes of hou2014, which codes the chunks
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ...entropy import varint
from ...errors import Corrupt
from ...motion import Motion, Skeleton, point_columns
from ...stages.lattice import Neighbours
from .models import MODELS, prior
from .models.model import Model
from .models.recording import FittedModel

MODEL_BITS = 3
"""The low two bits are the number of the model."""
DIRECT, WEIGHTS, FALLBACK, REPEATS, NEIGHBOURS = 4, 8, 16, 32, 64
"""Flags. Never change them."""
WEIGHT_OCTAVE = 16
"""Weights are stored as log₂ in sixteenths."""
LARGEST_MILLIHERTZ = 1 << 40


@dataclass(frozen=True)
class StreamHeader:
    """model: name in MODELS, None for direct coding. millihertz: rate of the distinct frames, None if none repeats.

    weights: a byte a point, empty without weights. neighbours: of the lattice engine, None where no chunk uses it.
    fallback: the shared bytes of hou2014. fitted: prior and model.
    """

    model: str | None = None
    fitted: bytes = b""
    weights: bytes = b""
    fallback: bytes | None = None
    millihertz: int | None = None
    neighbours: bytes | None = None

    @classmethod
    def of_model(cls, name: str, fitted: FittedModel, weights: bytes = b"") -> StreamHeader:
        return cls(name, fitted.prior_id + fitted.pack(), weights)

    def pack(self) -> bytes:
        flags = DIRECT if self.model is None and self.fallback is None else 0
        flags |= MODELS[self.model].number if self.model is not None else 0
        flags |= WEIGHTS * bool(self.weights) | FALLBACK * (self.fallback is not None)
        flags |= REPEATS * (self.millihertz is not None) | NEIGHBOURS * (self.neighbours is not None)
        rate = b"" if self.millihertz is None else varint.write([self.millihertz])
        beside = b"" if self.neighbours is None else varint.write([len(self.neighbours)]) + self.neighbours
        return bytes([flags]) + rate + self.weights + beside + (self.fallback or b"") + self.fitted

    @classmethod
    def unpack(cls, shared: tuple[bytes, ...], points: int) -> StreamHeader:
        """Raises Corrupt."""
        if len(shared) != 1 or not shared[0]:
            raise Corrupt("tempo: a stream has one part of shared bytes")
        flags, at = shared[0][0], 1
        millihertz, weights, neighbours = None, b"", None
        if flags & REPEATS:
            (millihertz,), at = varint.read(shared[0], 1, at)
            if not 0 < millihertz < LARGEST_MILLIHERTZ:
                raise Corrupt("tempo: a rate of distinct frames that is out of range")
        exclusive = flags & (DIRECT | FALLBACK)
        if flags > 2 * NEIGHBOURS - 1 or (exclusive and flags & MODEL_BITS) or exclusive == DIRECT | FALLBACK:
            raise Corrupt(f"tempo: unknown flags {flags:#x} in the shared bytes")
        if flags & WEIGHTS:
            weights, at = shared[0][at : at + points], at + points
            if flags & FALLBACK or len(weights) < points:
                raise Corrupt("tempo: weights that do not fit the points")
        if flags & NEIGHBOURS:
            (length,), at = varint.read(shared[0], 1, at)
            neighbours, at = shared[0][at : at + length], at + length
            if flags & FALLBACK or len(neighbours) < length:
                raise Corrupt("tempo: neighbours that do not fit the points")
        rest = shared[0][at:]
        if flags & FALLBACK:
            return cls(fallback=rest, millihertz=millihertz)
        if flags & DIRECT:
            if rest:
                raise Corrupt("tempo: the shared bytes do not end where they should")
            return cls(weights=weights, millihertz=millihertz, neighbours=neighbours)
        name = next(n for n, m in MODELS.items() if m.number == flags & MODEL_BITS)
        return cls(name, rest, weights, None, millihertz, neighbours)

    def read_model(self, like: Motion) -> Model:
        """The model for a motion with these names, rate and skeleton. Raises Corrupt, UnknownCodec."""
        tree = like.skeleton
        key = b"" if tree is None else np.array(tree.parents).tobytes() + tree.offsets.tobytes()
        return _read_model(
            self.model,
            self.fitted,
            self.weights,
            self.neighbours,
            like.names,
            like.rate,
            like.up,
            _SkeletonKey(key, tree),
        )


@dataclass(frozen=True)
class _SkeletonKey:
    """Compares skeletons by their bones: each opening of a file reads a skeleton of its own."""

    bones: bytes
    skeleton: Skeleton | None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _SkeletonKey) and self.bones == other.bones

    def __hash__(self) -> int:
        return hash(self.bones)


@lru_cache(maxsize=8)
def _read_model(
    name: str | None,
    fitted: bytes,
    weights: bytes,
    neighbours: bytes | None,
    names: tuple[str, ...],
    rate: float,
    up: str,
    skeleton: _SkeletonKey,
) -> Model:
    beside = Neighbours.unpack(neighbours, len(names)) if neighbours is not None else None
    if name is None:
        return replace(with_weights(Model.without_rows(names, rate), weights), neighbours=beside)
    id_, rest = fitted[: prior.ID_BYTES], fitted[prior.ID_BYTES :]
    if len(id_) < prior.ID_BYTES:
        raise Corrupt("tempo: the shared bytes end within the name of the prior")
    like = Motion(np.zeros((0, len(names), 3)), rate, names, up, skeleton.skeleton)
    model = MODELS[name].unpack(rest, prior.by_id(id_), like).model(like)
    return replace(with_weights(model, weights), neighbours=beside)


def pack_weights(names: tuple[str, ...], weights: Mapping[str, float]) -> bytes:
    """A byte a point: log₂ of its weight in sixteenths, rounded up. Raises BadInput for an unknown name."""
    point_columns(names, list(weights))
    return bytes(int(np.ceil(WEIGHT_OCTAVE * np.log2(weights.get(name, 1.0)))) for name in names)


def with_weights(model: Model, weights: bytes) -> Model:
    """The model with the weights of `pack_weights`, if there are any."""
    if not weights:
        return model
    return replace(model, weights=2.0 ** (np.frombuffer(weights, np.uint8) / WEIGHT_OCTAVE))
