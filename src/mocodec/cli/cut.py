"""`mocodec cut`: a stretch of time out of a file.

    .mocz → .mocz   whole chunks are copied as they are, where the cut falls on their borders and they stand alone;
                    otherwise the stretch is decoded and coded again, and the new promise is the sum of the two errors
    anything else   is read, cut and written

Why not always copy: a codec may need a chunk's neighbours (its declared margin), and a cut at any frame is worth more
to a user than one at a chunk's border. `--chunks` widens the cut to the borders, so that nothing is coded twice.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import click
import numpy as np

from .. import api, codecs, container
from ..encoded import Chunk, Encoded, extras_between
from ..errors import BadInput, CannotEncode
from ..motion import Motion, source_from
from . import files, quantities

Time = tuple[float | None, int | None]
RECODING_SHARE = 0.5  # of the first promise, granted to coding a second time


@click.command("cut")
@click.argument("source", metavar="FILE")
@click.option(
    "--from", "begin", type=quantities.TIME, default="0f", help="Where to begin: 12.5s, or 1500f for a frame."
)
@click.option("--to", "end", type=quantities.TIME, help="Where to end; that frame is left out. Default: the end.")
@click.option("-o", "--output", required=True, metavar="OUT", help="The file to write; its suffix is the format.")
@click.option(
    "--chunks", is_flag=True, help="Widen the cut to whole chunks of a .mocz, so that nothing is coded again."
)
@click.option("-q", "--quiet", is_flag=True, help="No summary.")
@files.reader_options
def command(source: str, begin: Time, end: Time | None, output: str, chunks: bool, quiet: bool, **options: Any) -> None:
    """Take the frames of FILE from one time to another into OUT.

    From .mocz to .mocz nothing is coded again where the cut falls on chunk borders (--chunks sees to that); elsewhere
    the stretch is coded again to half the promised error, and OUT promises the sum of both.
    """
    compressed = files.is_mocz(source) or files.is_url(source) or (source == "-" and not options["format_"])
    if chunks and not (compressed and files.is_mocz(output)):
        raise click.UsageError("--chunks is for a cut from one .mocz file to another")
    if not compressed:
        recording = files.read(source, **options)
        start, stop = frames(begin, end, recording.rate, len(recording))
        files.write(output, recording[start:stop], quiet=quiet)
        how = "cut"
    else:
        with api.open(files.source_of(source)) as opened:
            start, stop = frames(begin, end, opened.rate, len(opened))
            if chunks:
                start, stop = whole_chunks(opened.encoded, start, stop)
            if files.is_mocz(output) or output == "-":
                encoded, how = cut(opened, start, stop)
                files.write_bytes(output, container.pack(encoded))
            else:
                files.write(output, opened[start:stop], quiet=quiet)
                how = "decoded"
    if not quiet:
        click.echo(f"{output}: frames {start} to {stop - 1} of {source}, {how}", err=True)


def frames(begin: Time, end: Time | None, rate: float, count: int) -> tuple[int, int]:
    """Times as frames [start, stop): the first at or after each. Raises a usage error where nothing is between."""

    def frame(time: Time) -> int:
        seconds, index = time
        return math.ceil(seconds * rate - 1e-6) if seconds is not None else index or 0

    start, stop = frame(begin), min(count, frame(end)) if end else count
    if start >= stop:
        raise click.UsageError(
            f"nothing to cut: the file has {count} frames, {count / rate:g} s, the cut is {start} to {stop}"
        )
    return start, stop


def whole_chunks(encoded: Encoded[Any], start: int, stop: int) -> tuple[int, int]:
    """The cut widened to the borders of the chunks that it touches."""
    touched = [chunk for chunk in encoded.chunks if chunk.stop > start and chunk.start < stop]
    return touched[0].start, touched[-1].stop


def cut(opened: api.File, start: int, stop: int) -> tuple[Encoded[Any], str]:
    """Frames [start, stop) as a file of their own, and how that was done, in words."""
    copied = copy(opened.encoded, start, stop)
    if copied is not None and same(opened.codec.decode(copied), opened[start:stop]):
        return copied, "chunks copied, nothing coded again"
    return recode(opened, start, stop)


def copy(encoded: Encoded[Any], start: int, stop: int) -> Encoded[Any] | None:
    """The chunks of frames [start, stop) as they are; None where the cut divides one or they need their neighbours."""
    if encoded.margin and (start, stop) != (0, encoded.frames):
        return None
    if (start, stop) != whole_chunks(encoded, start, stop):
        return None
    kept = [Chunk(c.start - start, c.frames, c.payload) for c in encoded.chunks if start <= c.start < stop]
    about = encoded.about
    about = dataclasses.replace(
        about,
        extras=extras_between(about.extras, start, stop, about.rate),
        source=source_from(about.source, start),
    )
    return dataclasses.replace(encoded, about=about, chunks=kept)


def same(a: Any, b: Any) -> bool:
    """Whether two motions are equal to the last digit that counts; point clouds are compared frame by frame."""
    pairs = [(a.positions, b.positions)] if isinstance(a, Motion) else zip(a.positions, b.positions, strict=True)
    return all(p.shape == q.shape and np.allclose(p, q, rtol=0, atol=1e-9, equal_nan=True) for p, q in pairs)


def recode(opened: api.File, start: int, stop: int) -> tuple[Encoded[Any], str]:
    """The decoded frames coded again with the file's codec and settings; its bound grows by the second error.

    Raises CannotEncode where the codec no longer takes the settings that the file was made with.
    """
    encoded, stretch = opened.encoded, opened[start:stop]
    settings: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in encoded.settings.items()}
    bounds: dict[str, float] = {name: settings[name] for name in ("max_error", "mean_error") if settings.get(name)}
    settings |= {name: RECODING_SHARE * bound for name, bound in bounds.items()}
    settings.pop("size", None)
    try:
        again = api.with_options(codecs.codec_class(encoded.codec)(), **settings).encode(stretch)
    except BadInput as error:
        raise CannotEncode(f"the cut must be coded again, and that failed: {error}; try --chunks") from error
    promised = {name: (1 + RECODING_SHARE) * bound for name, bound in bounds.items()}
    grown = "".join(f", promised {n.replace('_', ' ')} now {quantities.bound(b)}" for n, b in promised.items())
    return dataclasses.replace(again, settings={**again.settings, **promised}), f"coded again{grown}"
