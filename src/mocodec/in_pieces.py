# pyright: strict
"""Recordings that do not fit into memory: encoded block by block, decoded and measured as they are written.

blocks ─sample─► model ─► header ─┐
   └──────────► chunks ───────────┴─► file beside its final name ─all promises kept─► renamed
                  └─decode─► errors
"""

from __future__ import annotations

import io
import itertools
import operator
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, BinaryIO, cast

import numpy as np

from . import container, formats, metrics, packing
from . import progress as progress_
from .codecs.base import Codec
from .codecs.tempo import Tempo
from .codecs.tempo.in_pieces import Piece, PieceEncoder, joined
from .encoded import Chunk, Encoded
from .errors import BadInput, CannotEncode, Corrupt
from .formats.blocks import Blocks
from .motion import Motion
from .selection import counted

SAMPLED_SECONDS, MOST_SAMPLED = 300.0, 1 << 20
"""Length of the sample that the model is fitted to, in seconds, and its size in samples (frames × points), at most."""
SAMPLED_PARTS = 12
"""Number of parts of the sample, spread over the recording, where a source can be read anywhere."""
CHUNK_OVERHEAD_BYTES, END_BYTES = 18, 32
"""What the container adds to a chunk, and to a file, at most."""


@dataclass(frozen=True)
class Written:
    """What was written: frames and points, bytes of the file, of its extras and of its signals, errors of the decoded
    file in metres.

    mean_error, max_error: NaN without samples. samples: points in frames that are not missing.
    """

    frames: int
    points: int
    bytes: int
    extras_bytes: int
    signal_bytes: int
    mean_error: float
    max_error: float
    samples: int

    @property
    def ratio(self) -> float:
        """Size as float32 positions over the size of the file."""
        return self.frames * self.points * 12 / self.bytes


def write(
    blocks: Iterable[Motion], path: str | PathLike[str], chosen: Codec[Any], frames: int | None = None
) -> Written:
    """A recording that comes in blocks, as a .mocz: see `mocodec.encode_blocks`. Raises BadInput, CannotEncode."""
    if not isinstance(chosen, Tempo):
        raise BadInput(f"tempo encodes in blocks, {chosen.name} does not")
    source = blocks if isinstance(blocks, Blocks) else None
    frames = None if frames is None else _number(frames)
    frames = frames or (source.frames if source is not None else None)
    with formats.writing_whole(path) as file:
        first, rest = _first_frames(_checked(blocks))
        about = first[:0] if source is None else source.about
        if rest is None:
            whole = replace(first, extras=about.extras, source=about.source)
            blob = packing.pack(chosen, whole)
            file.write(blob)
            return _measured_whole(whole, blob)
        with _reading():
            sample, cuts = (first, []) if source is None else source.sample(len(first), SAMPLED_PARTS, first)
        encoder = PieceEncoder(chosen, sample, cuts, frames)
        written = _write(encoder, replace(encoder.about, extras=about.extras, source=about.source), file,
                         itertools.chain([first], rest), chosen, frames)  # fmt: skip
        _require_promises(written, encoder.settings)
        return written


def _number(frames: Any) -> int:
    """A number of frames. Raises BadInput for anything else."""
    try:
        number = operator.index(frames)
    except TypeError:
        number = 0
    if number < 1:
        raise BadInput(f"frames is the number of frames of the recording, not {frames!r}")
    return number


def _checked(blocks: Iterable[Motion]) -> Iterator[Motion]:
    """Blocks without extras. Raises BadInput for one that does not follow from the first.

    Positions and rotations are copied, since a generator may fill one array again for each block.
    """
    first: Motion | None = None
    is_ours = isinstance(blocks, Blocks)
    for number, block in enumerate(_readable(blocks)):
        if not isinstance(block, Motion):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise BadInput(f"block {number} is a {type(block).__name__}, not a motion")
        first = block if first is None else first
        same = (block.names, block.rate, block.up) == (first.names, first.rate, first.up)
        if not same or (block.rotations is None) != (first.rotations is None):
            raise BadInput(
                f"block {number} has {_of_block(block)}, the first {_of_block(first)}: names of points, "
                "rotations, rate and vertical axis are the same in all blocks"
            )
        if len(block):
            block = replace(block, extras={}) if block.extras else block
            yield block if is_ours else _copied(block)


def _of_block(block: Motion) -> str:
    """What all blocks of a recording share, in words."""
    rotations = "no rotations" if block.rotations is None else "rotations"
    return f"{counted(block.points, 'point')}, {rotations}, {block.rate:g} Hz, {block.up} up"


def _copied(block: Motion) -> Motion:
    """The block with arrays of its own."""
    rotations = None if block.rotations is None else block.rotations.copy()
    return replace(block, positions=block.positions.copy(), rotations=rotations)


@contextmanager
def _reading() -> Generator[None, None, None]:
    """Raises BadInput for a source that cannot be read: an OSError would be taken for one of the output."""
    try:
        yield
    except OSError as error:
        raise BadInput(f"the source cannot be read: {error}") from error


def _readable(blocks: Iterable[Motion]) -> Iterator[Motion]:
    """The blocks. Raises BadInput."""
    with _reading():
        yield from blocks


def _first_frames(blocks: Iterator[Motion]) -> tuple[Motion, Iterator[Motion] | None]:
    """Frames enough for a sample, and the blocks after them; None if there are none. Raises BadInput without frames."""
    taken: list[Motion] = []
    for block in blocks:
        taken.append(block)
        wanted = max(2, min(int(SAMPLED_SECONDS * block.rate), MOST_SAMPLED // max(1, block.points)))
        if sum(map(len, taken)) > wanted:
            return joined(taken), blocks
    if not taken:
        raise BadInput("the source has no frames")
    return joined(taken), None


def _write(
    encoder: PieceEncoder, about: Motion, file: Any, blocks: Iterable[Motion], codec: Tempo, frames: int | None
) -> Written:
    header = io.BytesIO()
    writer = container.Writer(header, about=about, codec=Tempo.name, settings=encoder.settings, shared=encoder.shared)
    extras = (writer.extras_bytes, writer.signal_bytes)
    if frames and (codec.size or codec.ratio):
        raw = frames * about.points * 12
        wanted = codec.size if codec.size else int(raw / (codec.ratio or 1)) + sum(extras)
        chunks = 1 + frames // encoder.chunk_frames
        left = wanted - len(header.getvalue()) - END_BYTES - CHUNK_OVERHEAD_BYTES * chunks
        encoder.limit(left / frames)
    file.write(header.getvalue())
    out = _Counted(file, len(header.getvalue()))
    writer.file = cast(BinaryIO, out)
    errors = Errors()

    def write(pieces: list[Piece]) -> None:
        for piece in pieces:
            for chunk in piece.chunks:
                writer.add(chunk)
            errors.add(piece.motion, decoded(encoder, piece))
            if frames:
                progress_.report(errors.frames / frames)

    for block in blocks:
        write(encoder.push(block))
    write(encoder.finish())
    writer.close()
    found = errors.written(about.points, out.bytes, extras)
    if frames and (codec.size or codec.ratio) and found.frames != frames:
        raise BadInput(f"the source has {found.frames} frames, not the {frames} that were declared")
    return found


def decoded(encoder: PieceEncoder, piece: Piece) -> Motion:
    """What the chunks of a piece decode to. Raises CannotEncode if they do not, an internal error."""
    first = piece.chunks[0].start
    chunks = [Chunk(c.start - first, c.frames, c.payload) for c in piece.chunks]
    try:
        return Tempo.decode(Encoded(Tempo.name, encoder.about, chunks, encoder.shared))
    except Corrupt as error:
        raise CannotEncode(f"tempo does not decode its own chunks, so nothing was written ({error})") from error


class _Counted:
    """A file to write to that counts bytes, of which there are `bytes`: a pipe does not tell where it is."""

    def __init__(self, file: Any, bytes: int) -> None:
        self.file, self.bytes = file, bytes

    def write(self, data: bytes) -> None:
        self.bytes += len(data)
        self.file.write(data)


class Errors:
    """Distances of decoded frames from the original, summed up block by block."""

    def __init__(self) -> None:
        self.frames, self.samples, self._sum, self._largest = 0, 0, 0.0, 0.0

    def add(self, original: Motion, result: Motion) -> None:
        """Raises CannotEncode where gaps differ, an internal error."""
        found = metrics.errors(original.positions, result.positions)
        if not found.same_gaps:
            raise CannotEncode("tempo did not restore the gaps, so nothing was written")
        if np.isnan(found.max):
            raise CannotEncode("tempo decoded positions that are not numbers, so nothing was written")
        self.frames += len(original)
        self.samples += found.samples
        self._sum += found.sum
        self._largest = max(self._largest, found.max)

    def written(self, points: int, size: int, extras: tuple[int, int]) -> Written:
        """size: bytes of the file; extras: of its extras and of its signals."""
        none = self.samples == 0
        mean, largest = (np.nan, np.nan) if none else (self._sum / self.samples, self._largest)
        return Written(self.frames, points, size, *extras, mean, largest, self.samples)


def _measured_whole(motion: Motion, blob: bytes) -> Written:
    errors = Errors()
    with container.Reader(blob) as reader:
        parts = reader.info()["bytes_by_part"]
        errors.add(motion, packing.codecs.codec_class(reader.encoded.codec).decode(reader.encoded))
    return errors.written(motion.points, len(blob), (parts["extras"], parts["signals"]))


def _require_promises(written: Written, settings: dict[str, Any]) -> None:
    """Raises CannotEncode for a promise that the decoded file does not keep."""
    found = {"max_error": written.max_error, "mean_error": written.mean_error, "size": written.bytes}
    broken = [
        name for name, value in found.items() if name in settings and not (value <= settings[name] or value != value)
    ]
    wanted = settings.get("ratio")
    if wanted and written.frames * written.points * 12 < wanted * (
        written.bytes - written.extras_bytes - written.signal_bytes
    ):
        broken.append("ratio")
    if broken:
        raise CannotEncode(f"tempo did not keep its promise ({', '.join(broken)}), so nothing was written")
