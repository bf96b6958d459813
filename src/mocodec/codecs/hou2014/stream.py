"""The bytes of hou2014: a header that all chunks share, and a payload for each chunk.

    header    unit, quantisation step, mean pose, weights, error bound, and the file's own left transform
    payload   clip lengths, the quantised coefficients of all clips of the chunk, gaps, corrections

`docs/papers/hou2014.md` lists the fields and the reasons for them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from ... import native
from ...entropy import coder, varint
from ...errors import Corrupt
from ...fields import Record, array, positive_float, raw, signed, sized, unsigned
from ...stages import bounded, dct, frozen, quantise
from ...typing import Floats, Integers
from . import left_transform, parameters
from .left_transform import LeftTransform

MEAN_POSE, POINT_WEIGHTS, ERROR_BOUND, CUSTOM_UNIT, CLIP_STEPS, ADAPTIVE_CLIPS, SHARED_TRANSFORMS = (
    1 << bit for bit in range(7)
)
"""Flags on disk: never change one."""

LARGEST_RUNG = 1 << 12
"""Limit for every rung in a file: 64 octaves of the ladder of steps."""
MAX_TRANSFORM_ENTRIES = 1 << 24
"""Limit for the entries of all left transforms of a file together."""
LONGEST_SERIES = 1 << 14
"""Frames of a clip up to which the compiled module decodes it: beyond, its tables take much memory."""


@dataclass(frozen=True, eq=False)
class SharedHeader:
    """The fields that all chunks share.

    points: number of points. transforms: one or more left transforms, cut to `components` columns. shared_transforms:
    they are stored in blobs of their own, not in the header. rung: the quantisation step of coefficients is unit ·
    2^(rung / 64). clip_frames: L; 0 if clips are adaptive. unit: metres. mean_numbers (3 points,): the mean pose in
    multiples of unit · 2^(mean_rung / 64). weight_rungs (points,): the encoder multiplied the coordinates of a point by
    2^(rung / 64). max_error: metres. clip_steps: each clip has a quantisation step of its own.
    """

    points: int
    transforms: tuple[LeftTransform, ...]
    components: int
    rung: int
    clip_frames: int
    unit: float = parameters.UNIT_M
    mean_numbers: Integers | None = None
    mean_rung: int = 0
    weight_rungs: Integers | None = None
    max_error: float | None = None
    clip_steps: bool = False
    shared_transforms: bool = False

    def steps_m(self, rung_offsets: Integers) -> Floats:
        """Quantisation steps in metres of clips with these rung offsets, (clips,)."""
        return np.array([self.unit * quantise.step(self.rung + o) for o in rung_offsets.tolist()], np.float64)

    @property
    def mean_pose(self) -> Floats:
        """(3 points,), metres; zeros if the header has no mean pose."""
        if self.mean_numbers is None:
            return np.zeros(3 * self.points)
        return np.asarray(self.mean_numbers * (self.unit * quantise.step(self.mean_rung)), np.float64)

    @property
    def row_weights(self) -> Floats:
        """Factor of each row of M, (3 points,)."""
        return row_weights(self.weight_rungs, self.points)

    def pack(self, parents: Sequence[int] | None) -> bytes:
        """The first shared blob. parents: parent of each point in the skeleton (−1: none), if any."""
        flags = (
            MEAN_POSE * (self.mean_numbers is not None)
            | POINT_WEIGHTS * (self.weight_rungs is not None)
            | ERROR_BOUND * (self.max_error is not None)
            | CUSTOM_UNIT * (self.unit != parameters.UNIT_M)
            | CLIP_STEPS * self.clip_steps
            | ADAPTIVE_CLIPS * (self.clip_frames == 0)
            | SHARED_TRANSFORMS * self.shared_transforms
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
            "mean": None if self.mean_numbers is None else self.mean_numbers.reshape(-1, 3),
            "transform": b"" if self.shared_transforms else self.transforms[0].pack(parents),
        }
        return HEADER.pack(values)


def _with_flag(flag: int) -> Callable[[Mapping[str, Any]], bool]:
    return lambda known: bool(known["flags"] & flag)


def _without_flag(flag: int) -> Callable[[Mapping[str, Any]], bool]:
    return lambda known: not known["flags"] & flag


HEADER = Record(
    "hou2014: the shared bytes",
    unsigned("flags"),
    unsigned("components"),
    signed("rung", most=LARGEST_RUNG),
    unsigned("clip_frames", least=1, when=_without_flag(ADAPTIVE_CLIPS)),
    positive_float("unit", when=_with_flag(CUSTOM_UNIT)),
    positive_float("max_error", when=_with_flag(ERROR_BOUND)),
    *sized(array("weight_rungs", ("points",), most=LARGEST_RUNG, when=_with_flag(POINT_WEIGHTS))),
    signed("mean_rung", most=LARGEST_RUNG, when=_with_flag(MEAN_POSE)),
    *sized(array("mean", ("points", 3), when=_with_flag(MEAN_POSE))),
    raw("transform", when=_without_flag(SHARED_TRANSFORMS)),
)


def unpack_header(blobs: Sequence[bytes], points: int, parents: Sequence[int] | None) -> SharedHeader:
    """The header from the shared blobs of a file. Raises Corrupt."""
    if not blobs:
        raise Corrupt("hou2014: the shared bytes are missing")
    values = HEADER.unpack(blobs[0], points=points)
    transform_blobs = blobs[1:] if values["transform"] is None else [values["transform"]]
    transforms = tuple(_read_transforms(transform_blobs, 3 * points, parents))
    components = values["components"]
    if not transforms:
        raise Corrupt("hou2014: the shared bytes hold no left transform")
    if components > min(map(len, transforms)):
        raise Corrupt(f"hou2014: the header uses {components} components, more than a left transform has")
    return SharedHeader(
        points=points,
        transforms=tuple(transform.leading(components) for transform in transforms),
        components=components,
        rung=values["rung"],
        clip_frames=values["clip_frames"] or 0,
        unit=parameters.UNIT_M if values["unit"] is None else values["unit"],
        mean_numbers=None if values["mean"] is None else values["mean"].ravel(),
        mean_rung=values["mean_rung"] or 0,
        weight_rungs=values["weight_rungs"],
        max_error=values["max_error"],
        clip_steps=bool(values["flags"] & CLIP_STEPS),
        shared_transforms=bool(values["flags"] & SHARED_TRANSFORMS),
    )


def _read_transforms(
    blobs: Sequence[bytes], dimensions: int, parents: Sequence[int] | None
) -> Iterator[left_transform.LeftTransform]:
    """The left transforms of blobs. Raises Corrupt, also for more entries in all of them than the format allows."""
    entries = 0
    for blob in blobs:
        transform = left_transform.unpack(blob, dimensions, parents)
        entries += transform.matrix.size
        if entries > MAX_TRANSFORM_ENTRIES:
            raise Corrupt(f"hou2014: left transforms of more than {MAX_TRANSFORM_ENTRIES} entries")
        yield transform


def row_weights(weight_rungs: Integers | None, points: int) -> Floats:
    """Factor of each row of M, (3 points,), from one rung per point, (points,); ones without rungs."""
    if weight_rungs is None:
        return np.ones(3 * points)
    return np.repeat(2.0 ** (weight_rungs / quantise.LADDER), 3)


@dataclass(frozen=True, eq=False)
class QuantisedClips:
    """The quantised coefficients of consecutive clips: those of one chunk, or of a whole motion.

    lengths (N,): L_i. bandwidth: number of DCT frequencies kept in the longest clip; shorter clips keep the same share.
    coefficients (sum of l_i, k): S_iᵀ as integers, clip after clip. transform_index (N,): the left transform of each
    clip. rung_offsets (N,): rungs to add to the header's rung for the quantisation step of each clip.
    """

    lengths: Integers
    bandwidth: int
    coefficients: Integers
    transform_index: Integers
    rung_offsets: Integers

    @property
    def frequencies(self) -> Integers:
        """l_i, (N,)."""
        return frequencies_per_clip(self.lengths, self.bandwidth)

    @property
    def spectra(self) -> list[Integers]:
        """S_iᵀ as integers, (l_i, k) for each clip."""
        return np.split(self.coefficients, np.cumsum(self.frequencies)[:-1])


def join_clips(
    lengths: Integers,
    spectra: Sequence[Integers],
    transform_index: Integers,
    rung_offsets: Integers,
    components: int | None = None,
) -> QuantisedClips:
    """Clips with these spectra, (any l_i, any k) each, at the smallest bandwidth that keeps every nonzero coefficient.

    components: those that are kept; all by default.
    """
    needed = np.array([extent(spectrum)[0] for spectrum in spectra], np.int64)
    bandwidth = int((-(-needed * lengths.max() // lengths)).max())
    frequencies = frequencies_per_clip(lengths, bandwidth)
    k = spectra[0].shape[1] if components is None else components
    coefficients = np.zeros((int(frequencies.sum()), k), np.int64)
    for spectrum, out in zip(spectra, np.split(coefficients, np.cumsum(frequencies)[:-1]), strict=True):
        count = min(len(spectrum), len(out))
        out[:count] = spectrum[:count, :k]
    return QuantisedClips(lengths, bandwidth, coefficients, transform_index, rung_offsets)


def extent(spectrum: Integers) -> tuple[int, int]:
    """Frequencies and components of a spectrum (l, k) up to the last coefficient that is not zero."""
    if (kernel := native.kernel("integers_extent")) is not None:
        return kernel(spectrum)
    frequencies, components = (np.flatnonzero(spectrum.any(axis=axis)).max(initial=-1) + 1 for axis in (1, 0))
    return int(frequencies), int(components)


def frequencies_per_clip(lengths: Integers, bandwidth: int) -> Integers:
    """l_i, (N,): `bandwidth` for the longest clip, in proportion to its length for any other, rounded up."""
    return -(-bandwidth * lengths // max(int(lengths.max(initial=0)), 1))


def _coding_order(lengths: Integers, frequencies: Integers) -> Integers:
    """Order in which rows of coefficients are coded: by frequency in hertz, then by clip.

    A coefficient then follows the same coefficient of the previous clip, which predicts its magnitude best.
    """
    clip = np.repeat(np.arange(len(lengths)), frequencies)
    frequency = np.arange(len(clip)) - np.repeat(np.cumsum(frequencies) - frequencies, frequencies)
    return np.lexsort((clip, frequency * lengths.max() // lengths[clip]))


def pack_clips(clips: QuantisedClips, header: SharedHeader) -> bytes:
    """Lengths, bandwidth, steps, left transforms and coefficients of the clips of one chunk."""
    numbers = [clips.bandwidth]
    if not header.clip_frames:
        numbers = [len(clips.lengths), *clips.lengths.tolist(), clips.bandwidth]
    parts = [varint.write(numbers)]
    if header.clip_steps:
        parts.append(_with_size(coder.pack(clips.rung_offsets[:, None])))
    if len(header.transforms) > 1:
        parts.append(_with_size(coder.pack(clips.transform_index[:, None])))
    order = _coding_order(clips.lengths, clips.frequencies)
    parts.append(_with_size(coder.pack(clips.coefficients[order])))
    return b"".join(parts)


def unpack_clips(data: bytes, at: int, frames: int, header: SharedHeader) -> tuple[QuantisedClips, int]:
    """The clips of a chunk of `frames` frames from data[at:], and the offset after them. Raises Corrupt."""
    lengths, at = unpack_lengths(data, at, frames, header)
    (bandwidth,), at = varint.read(data, 1, at)
    if bandwidth > lengths.max():
        raise Corrupt(f"hou2014: a chunk keeps {bandwidth} frequencies of a clip of {lengths.max()} frames")
    n = len(lengths)
    rung_offsets = transform_index = np.zeros(n, np.int64)
    if header.clip_steps:
        part, at = _read_sized(data, at)
        rung_offsets = coder.unpack(part, (n, 1))[:, 0]
        if np.abs(rung_offsets).max() > LARGEST_RUNG:
            raise Corrupt(f"hou2014: a clip has a rung offset outside ±{LARGEST_RUNG}")
    if len(header.transforms) > 1:
        part, at = _read_sized(data, at)
        transform_index = coder.unpack(part, (n, 1))[:, 0]
        if not 0 <= transform_index.min() <= transform_index.max() < len(header.transforms):
            raise Corrupt(f"hou2014: a clip uses a left transform that is not one of the {len(header.transforms)}")
    part, at = _read_sized(data, at)
    frequencies = frequencies_per_clip(lengths, bandwidth)
    coefficients = np.empty((int(frequencies.sum()), header.components), np.int64)
    coefficients[_coding_order(lengths, frequencies)] = coder.unpack(part, coefficients.shape)
    return QuantisedClips(lengths, bandwidth, coefficients, transform_index, rung_offsets), at


def unpack_lengths(data: bytes, at: int, frames: int, header: SharedHeader) -> tuple[Integers, int]:
    """L_i of the clips of a chunk: implied by the header, or stored if clips are adaptive."""
    if header.clip_frames:
        return equal_lengths(frames, header.clip_frames), at
    (n,), at = varint.read(data, 1, at)
    if not 0 < n <= frames:
        raise Corrupt(f"hou2014: a chunk of {frames} frames has {n} clips")
    lengths, at = varint.read(data, n, at)
    if min(lengths) < 1 or sum(lengths) != frames:
        raise Corrupt(f"hou2014: the clips of a chunk of {frames} frames have {sum(lengths)} frames in total")
    return np.array(lengths, np.int64), at


def equal_lengths(frames: int, clip_frames: int) -> Integers:
    """L_i of equal clips of L frames. The last clip is shorter; the paper crops the sequence instead."""
    full, rest = divmod(frames, clip_frames)
    return np.array([clip_frames] * full + [rest] * (rest > 0), np.int64)


def reconstruct(clips: QuantisedClips, header: SharedHeader) -> Floats:
    """Positions (frames, points, 3) of the clips: B S_i D̃_iᵀ, the decoder of section IV-C. Used by the encoder too."""
    kernel, series_of = native.kernel("reconstruct_clips"), native.kernel("CosineSeries")
    if kernel is None or series_of is None or not clips.bandwidth or clips.lengths.max() > LONGEST_SERIES:
        return reconstruct_by_numpy(clips, header)
    series = [
        _series(series_of, *of_clip) for of_clip in zip(clips.lengths.tolist(), clips.frequencies.tolist(), strict=True)
    ]
    steps = header.steps_m(clips.rung_offsets) if header.clip_steps else np.ones(len(series))
    rows = np.empty((int(clips.lengths.sum()), 3 * header.points))
    kernel(clips.coefficients, series, clips.transform_index, steps, np.stack(_products(header)), rows)
    return rows.reshape(-1, header.points, 3)


@lru_cache(maxsize=16)
def _series(kernel: Callable[[int, int], Any], frames: int, frequencies: int) -> Any:
    """The compiled inverse DCT of the lowest frequencies of clips of `frames` frames."""
    return kernel(frames, frequencies)


def reconstruct_by_numpy(clips: QuantisedClips, header: SharedHeader) -> Floats:
    """`reconstruct` without the compiled module: the same to 1e-12 m."""
    frequencies, matrices = clips.frequencies, _products(header)
    rows = np.empty((int(clips.lengths.sum()), 3 * header.points))
    at = frame = 0
    for length, run in equal_length_runs(clips.lengths):
        n, l = run.stop - run.start, int(frequencies[run.start])  # noqa: E741
        spectra = clips.coefficients[at : at + n * l].reshape(n, l, header.components).astype(np.float64)
        at += n * l
        if header.clip_steps:
            spectra *= header.steps_m(clips.rung_offsets[run])[:, None, None]
        out = rows[frame : frame + n * length]
        frame += n * length
        if len(matrices) == 1 and dct.is_by_matrix(length, l) and _is_basis_first_faster(spectra, rows.shape[1]):
            of_points = spectra @ matrices[0][:-1]
            of_points[:, 0] += matrices[0][-1] * length**0.5
            dct.inverse_runs(of_points, out.reshape(n, length, -1))
            continue
        curves = np.ones((n, length, header.components + 1))  # the last column stands for the mean pose
        dct.inverse_panels(spectra, curves)
        if len(matrices) == 1:
            np.matmul(curves.reshape(n * length, -1), matrices[0], out=out)
        else:
            for i, j in enumerate(clips.transform_index[run].tolist()):
                np.matmul(curves[i], matrices[j], out=out[i * length : (i + 1) * length])
    return rows.reshape(-1, header.points, 3)


def _is_basis_first_faster(spectra: Floats, columns: int) -> bool:
    """Whether B, of `columns` rows, comes before the inverse DCT: by the multiplications for a frame of a long clip.

    spectra (clips, l, k).
    """
    _, known, components = spectra.shape
    of_panels = sum(count * (panel.stop - panel.start) for panel, count in dct.panels(spectra))
    return 0 < known * columns < of_panels + 2 * components * columns


def _products(header: SharedHeader) -> list[Floats]:
    """What turns curves in steps into positions in metres, (k + 1, 3 points) of each left transform: Bᵀ, step and
    weights in one matrix, and the mean pose below it. Clips with steps of their own are in metres already."""
    step = 1.0 if header.clip_steps else header.unit * quantise.step(header.rung)
    scale, mean = step / header.row_weights, header.mean_pose
    return [np.concatenate([transform.matrix.T * scale, mean[None]]) for transform in header.transforms]


def pack_payload(clips: bytes, packed_gaps: bytes, corrections: bytes) -> bytes:
    """The payload of a chunk from its packed parts."""
    return clips + _with_size(packed_gaps) + corrections


def unpack_payload(data: bytes, frames: int, header: SharedHeader) -> Floats:
    """Positions of a chunk, (frames, points, 3), NaN in gaps. Raises Corrupt."""
    clips, at = unpack_clips(data, 0, frames, header)
    part, at = _read_sized(data, at)
    positions = reconstruct(clips, header)
    if header.max_error is not None:
        positions = bounded.unpack(data[at:], positions, header.max_error, part)
    elif at != len(data):
        raise Corrupt(f"hou2014: a chunk has {len(data) - at} bytes after its last field")
    return frozen.restore(positions, part)


def equal_length_runs(lengths: Integers) -> list[tuple[int, slice]]:
    """Runs of consecutive clips of equal length, as (length, clips): one DCT call serves a run."""
    edges = [0, *(np.flatnonzero(np.diff(lengths)) + 1).tolist(), len(lengths)]
    return [(int(lengths[a]), slice(a, b)) for a, b in pairwise(edges)]


def _with_size(data: bytes) -> bytes:
    return varint.write([len(data)]) + data


def _read_sized(data: bytes, at: int) -> tuple[bytes, int]:
    """The inverse of `_with_size`, and the offset after it. Raises Corrupt."""
    (size,), at = varint.read(data, 1, at)
    if at + size > len(data):
        raise Corrupt(f"hou2014: a field of {size} bytes is longer than the {len(data) - at} bytes left")
    return data[at : at + size], at + size
