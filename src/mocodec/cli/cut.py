"""`mocodec cut`: cut a time range out of a file.

    .mocz → .mocz   if the cut is on chunk borders and chunks decode alone, chunks are copied without loss;
                    otherwise the range is decoded and encoded again, and the new promise is the sum of both bounds
    other → .mocz   the range is encoded by the default codec, without a target
    anything else   is read, cut and written

Why not always copy: a codec may need the neighbours of a chunk (its declared margin), and users want to cut at any
frame, not only at chunk borders. `--chunks` widens the cut to chunk borders, so that nothing is encoded twice.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, cast

import click
import numpy as np

from .. import api, codecs, container
from ..encoded import Chunk, Encoded, Recording
from ..errors import BadInput, CannotEncode
from ..motion import Motion, extras_between, source_from
from ..signals import bounds
from . import files, quantities, sections

Time = tuple[float | None, int | None]
ERRORS = ("max_error", "mean_error", "max_rotation")
SECOND_BOUND = 0.5
"""Bound of the second encoding, as a share of the first bound."""


@click.command("cut", cls=sections.Command)
@click.argument("source", metavar="FILE")
@click.option(
    "--from",
    "begin",
    type=quantities.TIME,
    default="0f",
    help="Start: 12.5s, or 1500f for frame 1500. Default: the first frame.",
)
@click.option(
    "--to", "end", type=quantities.TIME, help="End; the frame there is not included. Default: the last frame, included."
)
@click.option("-o", "--output", required=True, metavar="OUT", help="The file to write, in the format of its suffix.")
@click.option(
    "--chunks", is_flag=True, help="Widen the cut to whole chunks of a .mocz, so that nothing is encoded again."
)
@click.option("-q", "--quiet", is_flag=True, help="Print no summary.")
@files.reader_options
def command(source: str, begin: Time, end: Time | None, output: str, chunks: bool, quiet: bool, **options: Any) -> None:
    """Write a time range of FILE to OUT. Without a range, FILE is converted to the format of OUT.

    From .mocz to .mocz, chunks are copied without loss if the cut is on chunk borders (--chunks widens it to these).
    Otherwise the range is encoded again with half the promised error, and OUT promises the sum of both errors.
    From another format to .mocz, the range is encoded as by `mocodec encode` without a target.
    """
    files.refuse_output(source, output)
    compressed = files.holds_compressed(source, options["format_"])
    if chunks and not (compressed and files.is_mocz(output)):
        raise click.UsageError("--chunks works only from a .mocz file to a .mocz file")
    if not compressed:
        with files.working(f"reading {source}"):
            recording = files.read(source, **options)
        start, stop = frame_range(begin, end, recording.rate, len(recording))
        files.write(output, recording[start:stop], quiet=quiet)
        how = f"cut and encoded, {_promise_of(output)}" if files.is_mocz(output) else "cut"
    else:
        files.require_no_options(source, files.given(**{**options, "format_": None}))
        with api.open(files.source_of(source)) as opened:
            start, stop = frame_range(begin, end, opened.rate, len(opened))
            if chunks:
                start, stop = whole_chunks(opened.encoded, start, stop)
            if files.is_mocz(output) or output == "-":
                with files.working(f"cutting {source}"):
                    encoded, how = cut(opened, start, stop)
                files.write_bytes(output, container.pack(encoded))
            else:
                files.write(output, opened[start:stop], quiet=quiet)
                how = "decoded"
    if not quiet:
        files.line(f"{output}: frames {start} to {stop - 1} of {source}, {how}", err=True)


def _promise_of(path: str) -> str:
    """The promise of a file that was encoded without a target, and how to choose another, in words."""
    with api.open(path) as opened:
        bound = opened.encoded.promise.get("max_error")
    promised = f"promised max error {quantities.bound(bound)}" if bound else "without a bound on the error"
    return f"{promised} (`mocodec encode` takes other targets)"


def frame_range(begin: Time, end: Time | None, rate: float, count: int) -> tuple[int, int]:
    """Two times as frames [start, stop): the first frame at or after each. Raises a usage error for an empty range."""

    def frame_at(time: Time) -> int:
        seconds, index = time
        return math.ceil(seconds * rate - 1e-6) if seconds is not None else index or 0

    start, stop = frame_at(begin), min(count, frame_at(end)) if end else count
    if start >= count:
        raise click.UsageError(f"--from is frame {start}, the recording has {count} frames ({count / rate:.6g} s)")
    if start >= stop:
        raise click.UsageError(f"the time range is empty: --from is frame {start}, --to is frame {stop}")
    return start, stop


def whole_chunks(encoded: Encoded[Any], start: int, stop: int) -> tuple[int, int]:
    """The range, widened to the borders of its first and last chunk."""
    chunks = [chunk for chunk in encoded.chunks if chunk.stop > start and chunk.start < stop]
    return chunks[0].start, chunks[-1].stop


def cut(opened: api.File[Recording], start: int, stop: int) -> tuple[Encoded[Any], str]:
    """Frames [start, stop) as a recording of their own, and how it was made, in words."""
    copied = copied_chunks(opened.encoded, start, stop)
    if copied is not None and positions_equal(opened.codec.decode(copied), opened[start:stop]):
        return copied, "chunks copied, nothing encoded again"
    return reencoded(opened, start, stop)


def copied_chunks(encoded: Encoded[Any], start: int, stop: int) -> Encoded[Any] | None:
    """The chunks of frames [start, stop), copied; None if the range divides one or they need their neighbours."""
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
    settings = encoded.settings if (start, stop) == (0, encoded.frames) else _settings_of_part(encoded.settings)
    return dataclasses.replace(encoded, about=about, chunks=kept, settings=settings)


def positions_equal(a: Recording, b: Recording) -> bool:
    """Whether the positions of two recordings agree within 1e-9 m, and the components of rotations within 1e-9."""
    if isinstance(a, Motion) and isinstance(b, Motion):
        pairs = [(a.positions, b.positions)]
        pairs += [(a.rotations, b.rotations)] if a.rotations is not None and b.rotations is not None else []
    else:
        pairs = list(zip(a.positions, b.positions, strict=True))
    return all(p.shape == q.shape and np.allclose(p, q, rtol=0, atol=1e-9, equal_nan=True) for p, q in pairs)


def reencoded(opened: api.File[Recording], start: int, stop: int) -> tuple[Encoded[Any], str]:
    """The decoded frames, encoded again with the codec and settings of the file; the bound grows by the second error.

    Raises CannotEncode if this version of the codec does not accept the settings of the file.
    """
    encoded, part = opened.encoded, opened[start:stop]
    settings: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in encoded.settings.items()}
    codec = codecs.codec_class(encoded.codec)
    # A codec without a field for the promise, which took over where another failed, adds no error to it.
    kept = {name: settings.pop(name) for name in ERRORS if name in settings and not hasattr(codec, name)}
    errors: dict[str, float] = {name: settings[name] for name in ERRORS if settings.get(name)}
    settings |= {name: SECOND_BOUND * bound for name, bound in errors.items()}
    for name in ("size", "psnr"):  # of the whole file, and of colours that were coded once
        settings.pop(name, None)
    if settings.pop("skeleton", None) is not None and hasattr(opened.codec, "track") and len(encoded.shared) == 1:
        settings["skeleton"] = cast(Any, opened.codec).track(encoded, slice(start, stop))
    signal_error = settings.pop("signal_error", None)
    try:
        again = api.with_options(codec(), **settings).encode(part)
    except BadInput as error:
        raise CannotEncode(f"this cut needs a second encoding, which failed: {error}; try --chunks") from error
    promised = {name: (1 + SECOND_BOUND) * bound for name, bound in errors.items()}
    texts = {n: f"{b:g}°" if n == "max_rotation" else quantities.bound(b) for n, b in promised.items()}
    grown = "".join(f", promised {n.replace('_', ' ')} now {text}" for n, text in texts.items())
    kept = _settings_of_part({**kept, **({"signal_error": signal_error} if signal_error else {})})
    return dataclasses.replace(again, settings={**again.settings, **promised, **kept}), f"encoded again{grown}"


def _settings_of_part(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that also hold for a part: without an error of signals that is relative to their range, which is smaller
    in a part, and without the mean error of colours.
    """
    lost = {"psnr"} | ({"signal_error"} if bounds.is_relative(settings.get("signal_error") or "") else set[str]())
    return {name: value for name, value in settings.items() if name not in lost}
