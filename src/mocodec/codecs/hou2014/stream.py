"""The bytes of hou2014: a head that all chunks share, and a payload for each chunk.

    head      what the numbers mean: unit, step, mean pose, weights, bound, and the file's own transform
    payload   which clips, the quantised coefficients of all of them together, gaps, corrections

`docs/papers/hou2014.md` gives the fields and why they are so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...entropy import coder, varint
from ...errors import Corrupt
from ...fields import Record, array, positive_float, raw, signed, sized, unsigned
from ...motion import Floats
from ...stages import bounded, dct, gaps, quantise
from . import parameters, transform
from .transform import Transform

Integers = NDArray[np.int64]

CENTRED, WEIGHTED, BOUNDED, OTHER_UNIT, ALLOCATED, ADAPTIVE, SHARED = (1 << bit for bit in range(7))
"""Flags on disk: never change one."""

LARGEST_RUNG = 1 << 12


@dataclass(frozen=True, eq=False)
class Head:
    """What all chunks share.

    transforms: one or more; `shared`: they are blobs of their own rather than part of this one. components: how many of
    their columns are used. rung: coefficients are multiples of unit · 2^(rung / 64). clip_frames: L, 0 where clips are
    adaptive. mean (3 points,): multiples of unit · 2^(mean_rung / 64). weight_rungs (points,): rows were multiplied by
    2^(rung / 64). allocated: each clip has a step of its own.
    """

    points: int
    transforms: tuple[Transform, ...]
    components: int
    rung: int
    clip_frames: int
    unit: float = parameters.UNIT_M
    mean: Integers | None = None
    mean_rung: int = 0
    weight_rungs: Integers | None = None
    max_error: float | None = None
    allocated: bool = False
    shared: bool = False

    def step(self, offsets: Integers) -> Floats:
        """The step of coefficients, metres, for clips of these offsets in rungs."""
        return np.array([self.unit * quantise.step(self.rung + o) for o in offsets.tolist()], np.float64)

    @property
    def mean_pose(self) -> Floats:
        """(3 points,), metres."""
        if self.mean is None:
            return np.zeros(3 * self.points)
        return np.asarray(self.mean * (self.unit * quantise.step(self.mean_rung)), np.float64)

    @property
    def weights(self) -> Floats:
        """What each row was multiplied by, (3 points,)."""
        return row_weights(self.weight_rungs, self.points)

    def pack(self, parents: Sequence[int] | None) -> bytes:
        flags = (
            CENTRED * (self.mean is not None)
            | WEIGHTED * (self.weight_rungs is not None)
            | BOUNDED * (self.max_error is not None)
            | OTHER_UNIT * (self.unit != parameters.UNIT_M)
            | ALLOCATED * self.allocated
            | ADAPTIVE * (self.clip_frames == 0)
            | SHARED * self.shared
        )
        values = {
            "flags": flags,
            "components": self.components,
            "rung": self.rung,
            "clip_frames": self.clip_frames,
            "unit": self.unit,
            "max_error": self.max_error,
            "weight_rungs": self.weight_rungs,
            "mean_rung": self.mean_rung,
            "mean": None if self.mean is None else self.mean.reshape(-1, 3),
            "transform": b"" if self.shared else self.transforms[0].pack(parents),
        }
        return HEAD.pack(values)


def _with_flag(flag: int) -> Callable[[Mapping[str, Any]], bool]:
    return lambda known: bool(known["flags"] & flag)


def _without_flag(flag: int) -> Callable[[Mapping[str, Any]], bool]:
    return lambda known: not known["flags"] & flag


HEAD = Record(
    "hou2014: the shared bytes",
    unsigned("flags"),
    unsigned("components"),
    signed("rung", most=LARGEST_RUNG),
    unsigned("clip_frames", least=1, when=_without_flag(ADAPTIVE)),
    positive_float("unit", when=_with_flag(OTHER_UNIT)),
    positive_float("max_error", when=_with_flag(BOUNDED)),
    *sized(array("weight_rungs", ("points",), most=LARGEST_RUNG, when=_with_flag(WEIGHTED))),
    signed("mean_rung", most=LARGEST_RUNG, when=_with_flag(CENTRED)),
    *sized(array("mean", ("points", 3), when=_with_flag(CENTRED))),
    raw("transform", when=_without_flag(SHARED)),
)


def unpack_head(blobs: Sequence[bytes], points: int, parents: Sequence[int] | None) -> Head:
    """The head from the shared bytes of a file. Raises Corrupt."""
    if not blobs:
        raise Corrupt("hou2014: the shared bytes are missing")
    values = HEAD.unpack(blobs[0], points=points)
    packed = blobs[1:] if values["transform"] is None else [values["transform"]]
    transforms = tuple(transform.unpack(blob, 3 * points, parents) for blob in packed)
    components = values["components"]
    if not transforms or components > min(map(len, transforms)):
        raise Corrupt("hou2014: the shared bytes hold fewer components than they announce")
    return Head(
        points,
        tuple(one.leading(components) for one in transforms),
        components,
        values["rung"],
        values["clip_frames"] or 0,
        parameters.UNIT_M if values["unit"] is None else values["unit"],
        None if values["mean"] is None else values["mean"].ravel(),
        values["mean_rung"] or 0,
        values["weight_rungs"],
        values["max_error"],
        bool(values["flags"] & ALLOCATED),
        bool(values["flags"] & SHARED),
    )


def row_weights(rungs: Integers | None, points: int) -> Floats:
    """What each row is multiplied by, (3 points,)."""
    if rungs is None:
        return np.ones(3 * points)
    return np.repeat(2.0 ** (rungs / quantise.LADDER), 3)


@dataclass(frozen=True, eq=False)
class Clips:
    """The clips of one chunk, quantised.

    lengths (N,): L_i. band: the frequencies kept of the longest; a shorter clip keeps the same share of its own, see
    `kept`. coefficients (sum of l_i, k): clip after clip, S_iᵀ as integers. choice (N,): which transform. offsets (N,):
    each clip's step in rungs above the head's.
    """

    lengths: Integers
    band: int
    coefficients: Integers
    choice: Integers
    offsets: Integers

    @property
    def kept(self) -> Integers:
        """l_i, (N,)."""
        return kept_of(self.lengths, self.band)

    @property
    def spectra(self) -> list[Integers]:
        """S_iᵀ as integers, (l_i, k) each."""
        return np.split(self.coefficients, np.cumsum(self.kept)[:-1])


def assembled(lengths: Integers, spectra: Sequence[Integers], choice: Integers, offsets: Integers) -> Clips:
    """Clips of these spectra, (any l_i, k) each, in the narrowest band that keeps all that is not zero."""
    needed = np.array([np.flatnonzero(s.any(axis=1)).max(initial=-1) + 1 for s in spectra], np.int64)
    band = int((-(-needed * lengths.max() // lengths)).max())
    kept = kept_of(lengths, band)
    resized = [
        np.pad(s[:count], ((0, max(0, count - len(s))), (0, 0)))
        for s, count in zip(spectra, kept.tolist(), strict=True)
    ]
    return Clips(lengths, band, np.concatenate(resized), choice, offsets)


def kept_of(lengths: Integers, band: int) -> Integers:
    """l_i of clips of these lengths: `band` of the longest, in proportion of the others, rounded up."""
    return -(-band * lengths // max(int(lengths.max(initial=0)), 1))


def _coding_order(lengths: Integers, kept: Integers) -> Integers:
    """Rows of coefficients by frequency, in hertz, then by clip: a number then stands beside the same of the last clip
    and of the component before, which are the best guides to its size."""
    clip = np.repeat(np.arange(len(lengths)), kept)
    frequency = np.arange(len(clip)) - np.repeat(np.cumsum(kept) - kept, kept)
    return np.lexsort((clip, frequency * lengths.max() // lengths[clip]))


def pack_clips(clips: Clips, head: Head) -> bytes:
    numbers = [clips.band] if head.clip_frames else [len(clips.lengths), *clips.lengths.tolist(), clips.band]
    parts = [varint.write(numbers)]
    if head.allocated:
        parts.append(_sized(coder.pack(clips.offsets[:, None])))
    if len(head.transforms) > 1:
        parts.append(_sized(coder.pack(clips.choice[:, None])))
    order = _coding_order(clips.lengths, clips.kept)
    parts.append(_sized(coder.pack(clips.coefficients[order])))
    return b"".join(parts)


def unpack_clips(data: bytes, at: int, frames: int, head: Head) -> tuple[Clips, int]:
    """The clips of a chunk of so many frames, and where they end. Raises Corrupt."""
    if head.clip_frames:
        lengths = equal_lengths(frames, head.clip_frames)
    else:
        (n,), at = varint.read(data, 1, at)
        if not 0 < n <= frames:
            raise Corrupt("hou2014: more clips than frames")
        numbers, at = varint.read(data, n, at)
        if min(numbers) < 1 or sum(numbers) != frames:
            raise Corrupt("hou2014: clips that do not fill their chunk")
        lengths = np.array(numbers, np.int64)
    (band,), at = varint.read(data, 1, at)
    if band > lengths.max():
        raise Corrupt("hou2014: more frequencies than frames")
    n = len(lengths)
    offsets = choice = np.zeros(n, np.int64)
    if head.allocated:
        part, at = _part(data, at)
        offsets = coder.unpack(part, (n, 1))[:, 0]
    if len(head.transforms) > 1:
        part, at = _part(data, at)
        choice = coder.unpack(part, (n, 1))[:, 0]
    if np.abs(offsets).max() > LARGEST_RUNG or not 0 <= choice.min() <= choice.max() < len(head.transforms):
        raise Corrupt("hou2014: a clip of a step or transform that is not there")
    part, at = _part(data, at)
    kept = kept_of(lengths, band)
    coefficients = np.empty((int(kept.sum()), head.components), np.int64)
    coefficients[_coding_order(lengths, kept)] = coder.unpack(part, coefficients.shape)
    return Clips(lengths, band, coefficients, choice, offsets), at


def equal_lengths(frames: int, clip_frames: int) -> Integers:
    """L_i of clips of L frames, the last one shorter: nothing is cropped."""
    full, rest = divmod(frames, clip_frames)
    return np.array([clip_frames] * full + [rest] * (rest > 0), np.int64)


def reconstruct(clips: Clips, head: Head) -> Floats:
    """Positions (frames, points, 3) of the clips: B S_i D̃_iᵀ, the decoder of section IV-C. Both ends use this."""
    kept = clips.kept
    rows: list[Floats] = []
    at = 0
    for length, run in runs(clips.lengths):
        n, l = run.stop - run.start, int(kept[run.start])  # noqa: E741
        spectra = clips.coefficients[at : at + n * l].reshape(n, l, head.components)
        at += n * l
        curves = dct.inverse(spectra * head.step(clips.offsets[run])[:, None, None], length, axis=1)
        if len(head.transforms) == 1:
            rows.append(curves.reshape(n * length, head.components) @ head.transforms[0].matrix.T)
        else:
            rows.extend(c @ head.transforms[j].matrix.T for c, j in zip(curves, clips.choice[run], strict=True))
    positions = np.concatenate(rows)
    if head.weight_rungs is not None:
        positions /= head.weights
    if head.mean is not None:
        positions += head.mean_pose
    return positions.reshape(-1, head.points, 3)


def pack_payload(clips: bytes, mask: bytes, corrections: bytes) -> bytes:
    return clips + _sized(mask) + corrections


def unpack_payload(data: bytes, frames: int, head: Head) -> Floats:
    """Positions of a chunk, (frames, points, 3), gaps and all. Raises Corrupt."""
    clips, at = unpack_clips(data, 0, frames, head)
    part, at = _part(data, at)
    mask = gaps.unpack(part, (frames, head.points))
    positions = reconstruct(clips, head)
    if head.max_error is not None:
        positions = bounded.unpack(data[at:], positions, head.max_error)
    elif at != len(data):
        raise Corrupt("hou2014: a chunk of the wrong size")
    return gaps.apply(positions, mask)


def runs(lengths: Integers) -> list[tuple[int, slice]]:
    """Runs of clips of one length, so that their transforms are one call."""
    edges = [0, *(np.flatnonzero(np.diff(lengths)) + 1).tolist(), len(lengths)]
    return [(int(lengths[a]), slice(a, b)) for a, b in pairwise(edges)]


def _sized(data: bytes) -> bytes:
    return varint.write([len(data)]) + data


def _part(data: bytes, at: int) -> tuple[bytes, int]:
    (size,), at = varint.read(data, 1, at)
    if at + size > len(data):
        raise Corrupt("hou2014: a part that runs past its end")
    return data[at : at + size], at + size
