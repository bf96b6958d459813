"""`mocodec encode`: a recording to a .mocz file, which is decoded and measured before it is written."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from .. import api, codecs, formats, metrics, progress
from ..codecs.tempo.models import prior as own_prior
from ..encoded import TARGETS, Recording
from ..errors import CannotEncode
from ..motion import Motion
from ..packing import DEFAULT_CODECS
from . import clouds, files, in_pieces, many, quantities, sections, verify
from .codec_options import OPTIONS, codec_with

target_option = partial(sections.option, section=sections.TARGETS)
cloud_option = partial(sections.option, section=sections.CLOUDS)


@click.command("encode", cls=sections.Command)
@click.argument("sources", metavar="IN...", nargs=-1, required=True)
@click.option(
    "-o",
    "--output",
    metavar="OUT",
    help='The .mocz file to write, or "-" for standard output; of many files, the folder to write to. Default of one: '
    "NAME.mocz beside it, if there is none yet.",
)
@target_option("--max-error", type=quantities.LENGTH, help="No point of any frame is farther off than this: 2mm.")
@target_option(
    "--mean-error", type=quantities.LENGTH, help="The average distance over all points and frames is at most this: 1mm."
)
@target_option(
    "--ratio", type=quantities.RATIO, metavar="N", help="At least N times smaller than float32 positions: 100."
)
@target_option("--size", type=quantities.SIZE, help="The file is at most this large: 50kB.")
@target_option(
    "--max-rotation",
    type=quantities.DEGREES,
    metavar="DEGREES",
    help="No joint is rotated farther off than this: 1deg. Alone or with another target.",
)
@click.option("--codec", type=click.Choice(list(codecs.CODECS)), help="Default: tempo; bodycast for point clouds.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="A setting of the codec; can be repeated. An unknown NAME lists the settings.",
)
@click.option(
    "--chunk-seconds",
    type=quantities.DURATION,
    metavar="SECONDS",
    help="Length of a chunk, the part of a file that one damaged byte costs; default: 4. Shorter chunks take more "
    "bytes.",
)
@click.option(
    "--signal-error",
    metavar="ERROR",
    help="How far samples of signals may be off: 12bit or 0.1% of their range, or by label 'Fz*=0.5N,EMG*=12bit'. "
    "Default: not at all.",
)
@click.option("--bare", is_flag=True, help="Leave out analog channels, events and parameters.")
@click.option("--prior", metavar="FILE", help="A prior of your own, by `mocodec prior train`; decoding needs it too.")
@click.option(
    "--in-pieces",
    "piecewise",
    is_flag=True,
    help="Encode block by block, in some hundred MB of memory; default for .c3d .npy .npz .bvh .trc .amc .csv above "
    "256 MB.",
)
@click.option("--at-once", is_flag=True, help="Never encode block by block.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON on standard output.")
@click.option("-q", "--quiet", is_flag=True, help="Print no summary.")
@cloud_option(
    "--residual",
    type=quantities.RESIDUAL,
    metavar="PERCENT|exact",
    help="In place of a target: 0 sends a moving surface, 26 to 100 all points, closer and closer; 'exact' keeps "
    "every bit (both with bodycast).",
)
@cloud_option("--psnr", type=quantities.DECIBELS, help="The colours have at least this PSNR: 40dB.")
@cloud_option(
    "--skeleton",
    type=click.Path(),
    metavar="FILE",
    help="A .bvh or .amc whose first frame has the pose of the first cloud.",
)
@many.jobs_option
@many.again_option
@files.reader_options
def command(
    sources: tuple[str, ...],
    output: str | None,
    codec: str | None,
    settings: tuple[str, ...],
    signal_error: str | None,
    prior: str | None,
    piecewise: bool,
    at_once: bool,
    bare: bool,
    as_json: bool,
    quiet: bool,
    jobs: int,
    again: bool,
    **options: Any,
) -> int | None:
    """Compress the recording IN (.c3d .trc .bvh .amc .npz …, a folder of .ply or .pcd, or "-") into a .mocz file.

    `mocodec encode walk.c3d` writes walk.mocz beside it, and replaces no file; -o names another one.

    Without a target, no point of a motion is farther off than 5 mm (tempo). The file is decoded and measured before it
    is written; the summary on standard error shows the measured error.

    Several files, or a folder, are compressed into the folder OUT under the same names; run the command again to go on
    after an interruption. Files that are done are skipped: those whose source, output and options have not changed.
    """
    if piecewise and at_once:
        raise click.UsageError("--in-pieces and --at-once exclude each other; give one of them")
    pieces = piecewise if piecewise or at_once else None
    targets = files.given(**{name: options.pop(name) for name in TARGETS})
    own_options = files.given(**{name: options.pop(name) for name in OPTIONS})
    settings += tuple(f"{name}={value}" for name, value in own_options.items())
    chosen: dict[str, Any] = {"codec": codec, "settings": list(settings), "targets": targets, "bare": bare}
    chosen |= files.given(signal_error=signal_error, prior=prior)
    if output is None:
        output = beside(sources)
    if many.is_many(sources, output):
        found = many.find_readable("encode", sources, formats.FORMATS)
        refuse_file(output)
        refuse_settings(codec, settings, targets)
        outputs = many.output_names(found, {source.path: files.SUFFIX for source in found})
        work = many.Settings({**chosen, **files.given(pieces=pieces, **options)}, jobs, again, as_json, quiet)
        return many.run("encode", found, outputs, output, work)
    source = sources[0]
    if output == "-":
        files.refuse_terminal()
    if output != "-" and Path(output).suffix and not files.is_mocz(output):
        raise click.UsageError(f"{output}: encode writes .mocz files; `mocodec convert` converts between other formats")
    files.refuse_output(source, output)
    _, record = written(source, output, pieces, quiet, **chosen, **options)
    for text in record.pop("notes", ()):
        files.note(source, text)
    if as_json:
        files.echo(json.dumps({"file": source, "output": output, **record}, indent=2), err=output == "-")
    elif not quiet:
        files.line(summary(output, record), err=True)
    return None


def beside(sources: Sequence[str]) -> str:
    """The output of one recording where none is named: NAME.mocz beside it. Raises a usage error for other sources, and
    where that file exists.
    """
    source = sources[0]
    if many.is_many(sources):
        many.find_readable("encode", sources, formats.FORMATS)
        raise click.UsageError("name the folder for the .mocz files of these recordings: -o OUT")
    if source == "-" or files.is_compressed(source) or any(mark in source for mark in "*?["):
        raise click.UsageError("name the output: -o OUT")
    where = Path(source)
    name = Path(os.path.abspath(source)).name if where.is_dir() else where.stem
    output = (Path(os.path.abspath(source)).parent if not where.name else where.parent) / f"{name}{files.SUFFIX}"
    if os.path.lexists(output):
        raise click.UsageError(f"{output} exists: name the output, -o OUT, which is replaced")
    return str(output)


def one(
    source: str, where: str, may_replace: bool = True, pieces: bool | None = None, **chosen: Any
) -> dict[str, Any]:  # fmt: skip
    """Encode one of many files to `where`; returns its record for the summary.

    pieces: as asked for by the user; of formats that cannot be read in pieces, a file is encoded at once.
    """
    Path(where).parent.mkdir(parents=True, exist_ok=True)
    if not files.takes(source, None, "fps"):  # of motions beside point clouds
        chosen.pop("fps", None)
    recording, record = written(source, where, pieces if formats.can_read_blocks(source) else None, True, **chosen)
    if recording is not None:
        kind = codec_with(chosen["codec"] or api.default_codec(recording), chosen["settings"], chosen["targets"])
        lost = api.not_kept(recording, kind)
        left_out = [f"not kept: {', '.join(lost)}"] if lost else []
        record["notes"] = [*left_out, *formats.notes(recording)]
    return with_file_ratio(record)


NOT_OF_READERS = ("codec", "settings", "targets", "bare", "signal_error", "prior")
"""Choices of `command` that are no options of readers."""


def written(
    source: str, output: str, pieces: bool | None, quiet: bool, **chosen: Any
) -> tuple[Recording | None, dict[str, Any]]:
    """Encode a source to a file or standard output: its recording and its record.

    Where it was encoded in pieces, the recording is None, and the record has `notes`.
    """
    size = {"source_bytes": Path(source).stat().st_size} if Path(source).is_file() else {}
    options = files.given(**{name: value for name, value in chosen.items() if name not in NOT_OF_READERS})
    if (record := in_pieces.encoded(source, output, pieces, chosen, options)) is not None:
        return None, record | size
    recording, record, blob = encoded(source, **chosen, quiet=quiet)
    files.write_bytes(output, blob)
    return recording, record | size


def with_file_ratio(record: dict[str, Any]) -> dict[str, Any]:
    """The record with the size of the source, if it is one file, over that of its .mocz."""
    return record | ({"file_ratio": record["source_bytes"] / record["bytes"]} if "source_bytes" in record else {})


def encoded(
    source: str,
    codec: str | None,
    settings: Sequence[str],
    targets: dict[str, float],
    bare: bool,
    signal_error: str | None = None,
    quiet: bool = False,
    prior: str | None = None,
    **options: Any,
) -> tuple[Recording, dict[str, Any], bytes]:
    """The recording of a source, what was measured on its .mocz, and the bytes of that.

    Says before the work what will not be kept, unless `quiet`.

    Raises CannotEncode if the decoded bytes do not keep their promise.
    """
    with files.working(f"reading {source}"):
        recording = files.read(source, **options)
    if bare:
        recording = formats.without_extras(recording)
    chosen = codec_with(codec or api.default_codec(recording), settings, targets)
    if (lost := api.not_kept(recording, chosen)) and not quiet:
        files.line(f"note: {files.printable(source)}: not kept: {', '.join(lost)}", err=True)
    with files.working(f"encoding {source} with {chosen.name}"), own_prior.used(prior):
        with progress.phase(0.0, 0.9):
            blob = api.pack(chosen, recording, signal_error)
        with progress.phase(0.9, 1.0), api.open(blob) as opened:
            decoded, facts = opened[:], opened.info
    found, broken = verify.check(targets, recording, decoded, facts)
    if broken:
        raise CannotEncode(f"{chosen.name} did not keep its promise, so nothing was written: {'; '.join(broken)}")
    files.with_notes(source, decoded)
    record = measures(recording, decoded, facts)
    return recording, record if isinstance(recording, Motion) else record | found, blob


def refuse_file(output: str) -> None:
    """Raises a usage error if the output of many files is not a folder."""
    if output == "-" or files.is_mocz(output) or (Path(output).exists() and not Path(output).is_dir()):
        raise click.UsageError(
            f"{output}: many files are written to a folder; name one with -o, or an archive: mocodec archive build"
        )


def refuse_settings(codec: str | None, settings: Sequence[str], targets: dict[str, float]) -> None:
    """Raises a usage error for settings that no codec in question accepts: before any file is read."""
    problems: list[click.UsageError] = []
    for name in [codec] if codec else DEFAULT_CODECS:
        try:
            codec_with(name, settings, targets)
        except click.UsageError as error:
            problems.append(error)
        else:
            return
    raise problems[0]


def measures(recording: Recording, decoded: Recording, facts: Mapping[str, Any]) -> dict[str, Any]:
    """The record of an encoded file: bytes, ratio to float32 positions and, for a motion, errors in metres."""
    stored, parts = facts["bytes"], facts["bytes_by_part"]
    record: dict[str, Any] = {"codec": facts["codec"], "frames": len(recording), "bytes": stored}
    record |= {
        "motion": stored - parts["extras"] - parts["signals"],
        "signals": parts["signals"],
        "extras": parts["extras"],
    }
    record |= {"raw_bytes": recording.raw_bytes, "ratio": recording.raw_bytes / stored}
    if isinstance(recording, Motion) and isinstance(decoded, Motion):
        error = metrics.compare(recording, decoded, stored)
        record |= {"mean_error": error.mean_error, "max_error": error.max_error}
        record["samples"] = int((~recording.gaps).sum())
    return record


def summary(output: str, record: Mapping[str, Any]) -> str:
    """One line: bytes, ratio, the parts where motion is not nearly all of the file, and the measured error."""
    name = "standard output" if output == "-" else output
    stored, raw, source = record["bytes"], record["raw_bytes"], record.get("source_bytes")
    line = f"{name}: {quantities.size(stored)}"
    if not raw or record["extras"] + record["signals"] > stored / 100:
        line += f" of {source:,} ({source / stored:.1f} : 1)" if source else ""
        motion = f" ({raw / record['motion']:.1f} : 1 against float32)" if raw else " (no points)"
        line += f": motion {record['motion']:,}{motion}, signals {record['signals']:,}, rest {record['extras']:,}"
    else:
        line += f", {record['ratio']:.1f} : 1 against float32"
    if "d1" in record:
        line += f", {clouds.in_words(record)}"
    elif "mean_error" in record and raw:
        line += f", mean error {quantities.length(record['mean_error'])}, max {quantities.length(record['max_error'])}"
    return line
