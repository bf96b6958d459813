"""`mocodec decode`: a .mocz file to .c3d, .trc, .bvh and other formats."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from .. import api, container, formats
from ..encoded import Encoded, Recording, restore
from ..errors import BadInput, Corrupt, MocodecError
from ..motion import Motion
from ..typing import Floats
from . import DAMAGED, files, many, sections
from . import output as output_options


@click.command("decode", cls=sections.Command)
@click.argument("sources", metavar="IN.mocz...", nargs=-1, required=True)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="OUT",
    help="The file to write, in the format of its suffix; '-' is standard output; of many files, the folder.",
)
@click.option("--format", "format_", metavar="NAME", help="Format of standard output or many files: c3d, trc, npz, …")
@click.option("--salvage", is_flag=True, help="Write the undamaged frames of a damaged file; lost frames become gaps.")
@click.option("--json", "as_json", is_flag=True, help="Of many files, print the summary as JSON.")
@click.option("-q", "--quiet", is_flag=True, help="Print no notes, and of many files no summary.")
@output_options.options
@many.jobs_option
@many.again_option
def command(
    sources: tuple[str, ...],
    output: str,
    format_: str | None,
    salvage: bool,
    as_json: bool,
    quiet: bool,
    jobs: int,
    again: bool,
    **options: Any,
) -> int | None:
    """Decode IN.mocz (a path, a URL, ARCHIVE/NAME of an archive, or "-") into OUT: .c3d .trc .npz … by suffix, a
    folder for point clouds.

    For point clouds, OUT.bvh is the motion of the tracked body, OUT.glb the same with the surface of the body.

    With --salvage the undamaged frames of a damaged file are written, and the exit code is still 4.

    Several files, or a folder, are decoded into the folder OUT under the same names: to --format, or each to the format
    that it was encoded from. Run the command again to go on after an interruption.
    """
    if many.is_many(sources, output):
        if salvage:
            raise click.UsageError("--salvage works on one file at a time")
        refuse_file(output)
        found = many.find_readable("decode", sources, (files.SUFFIX,))
        suffixes = {source.path: suffix_of(source.path, format_) for source in found}
        given = {name: list(value) if isinstance(value, tuple) else value for name, value in options.items() if value}
        work = many.Settings({"format_": format_, **given}, jobs, again, as_json, quiet)
        return many.run("decode", found, many.output_names(found, suffixes), output, work)
    if files.contradicts(format_, output):
        raise click.UsageError(f"--format is for standard output and many files; the suffix of {output} says its own")
    source = sources[0]
    refuse_other_formats(source, output)
    files.refuse_output(source, output)
    lost: list[str] = []
    changes, writer_options = output_options.split(options)
    more: dict[str, Any] = {}
    suffix = files.suffix_of_format(format_) if format_ else Path(output).suffix.lower()
    with files.working(f"decoding {source}"):
        if salvage:
            recording, lost = salvaged(container.Reader(files.source_of(source), salvage=True))
        else:
            recording, more = decoded_for(source, suffix)
        recording, notes = output_options.prepared(recording, suffix, changes)
    with files.working(f"writing {output}"):
        files.write(output, recording, format_, quiet, **writer_options, **more)
    for note in [] if quiet else notes:
        files.line(f"note: {note}", err=True)
    for line in lost:
        files.line(f"mocodec: {source}: {line}", err=True)
    return DAMAGED if lost else None


def one(
    source: str, where: str, format_: str | None = None, may_replace: bool = True, **options: Any
) -> dict[str, Any]:
    """Decode one of many files to `where`, a folder if it has no suffix; returns its record for the summary."""
    refuse_other_formats(source, where)
    target = Path(where)
    if target.exists() and not may_replace:
        raise BadInput(f"{where} exists and was not written by this command; --again replaces it")
    suffix = target.suffix.lower() if format_ or target.suffix.lower() in formats.FORMATS else ""
    changes, writer_options = output_options.split(options)
    recording, more = decoded_for(source, suffix)
    recording, notes = output_options.prepared(recording, suffix, changes)
    target.parent.mkdir(parents=True, exist_ok=True)
    if suffix or isinstance(recording, Motion):
        api.write(target, recording, **writer_options, **more)
        left_out = formats.dropped(f"motion{suffix}", recording) if suffix else []
        notes += [f"{suffix} cannot store {', '.join(left_out)}"] if left_out else []
        return {"frames": len(recording), "notes": notes}
    api.write(target, recording, overwrite=True)
    return {"frames": len(recording), "notes": []}


def refuse_file(output: str) -> None:
    """Raises a usage error if the output of many files is not a folder."""
    if output == "-" or Path(output).suffix.lower() in formats.FORMATS or Path(output).is_file():
        raise click.UsageError(f"{output}: many files are written to a folder; name one with -o")


def suffix_of(source: str, format_: str | None) -> str:
    """The suffix for a .mocz of many: that of the format asked for, or of the one that it was encoded from.

    "" for the folder of a point cloud's frames; .npz if the file does not say its format or cannot be opened.
    """
    if format_ is not None:
        suffix = files.suffix_of_format(format_)
        if suffix not in formats.WRITABLE:
            raise click.UsageError(f"{format_!r} is no format to write; the formats are {' '.join(formats.WRITABLE)}")
        return suffix
    try:
        with api.open(files.source_of(source)) as opened:
            suffix = f".{opened.encoded.about.source.get('format')}"
            is_motion = len(opened.shape) == 3
    except MocodecError:  # `one` raises it again
        return ".npz"
    if not is_motion:
        return ".npz" if suffix == ".npz" else ""
    return suffix if suffix in formats.WRITABLE else ".npz"


def refuse_other_formats(source: str, output: str) -> None:
    """Raises a usage error for a source that is no .mocz, and for an output that is one; it names the right command."""
    if files.is_mocz(output):
        raise click.UsageError(
            f"{output}: decode does not compress again; copy the file, or cut it: `mocodec cut {source} -o {output}`"
        )
    if Path(source).suffix.lower() in formats.FORMATS and not files.is_url(source):
        raise click.UsageError(
            f"{source} is not a .mocz file, so there is nothing to decode; to convert it to another format, run "
            f"`mocodec convert {source} {output}`; "
            f"to compress it, `mocodec encode {source} -o {Path(source).stem}.mocz`"
        )


def decoded_for(source: str, suffix: str) -> tuple[Recording, dict[str, Any]]:
    """The recording for a file with this suffix, and options for its writer.

    For point clouds and the suffix of a motion: the motion of the tracked body, for a .glb also its surface.
    """
    with api.open(files.source_of(source)) as opened:
        if len(opened.shape) == 3 or suffix not in formats.FORMATS or suffix in formats.CLOUDS:
            return opened[:], {}
        codec: Any = opened.codec
        if not hasattr(codec, "track"):
            raise BadInput(
                f"{source}: its codec tracks no body, so there is no motion to write; name a folder for .ply files"
            )
        has_surface = suffix in (".glb", ".gltf") and hasattr(codec, "surface")
        with opened.errors_name_file():
            return codec.track(opened.encoded), {"surface": codec.surface(opened.encoded)} if has_surface else {}


def salvaged(reader: container.Reader) -> tuple[Motion, list[str]]:
    """The motion of a damaged file, with gaps for lost frames, and the loss in words.

    Raises Corrupt if all frames are lost, BadInput for point clouds.
    """
    with api.File[Motion](reader) as opened:
        if len(opened.shape) != 3:
            raise BadInput("--salvage works for motions only, not for point clouds")
        runs = reader.intact_runs()
        lost = [*reader.problems, *(message for _, message in reader.damage())]
        if not runs:
            raise Corrupt(f"{reader.source.name}: no frame can be salvaged: " + "; ".join(lost))
        positions = np.full(opened.shape, np.nan)
        for start, stop in runs:
            positions[start:stop] = opened[start:stop].positions
        rotations = salvaged_rotations(opened, runs)
        encoded: Encoded[Motion] = opened.encoded
        if any(number is None for number, _ in reader.damage()):
            encoded = dataclasses.replace(encoded, about=dataclasses.replace(encoded.about, extras={}))
        missing = opened.shape[0] - sum(stop - start for start, stop in runs)
        lost += [f"{missing} frames are gaps"] if missing else []
        return restore(encoded, positions, rotations=rotations), lost


def salvaged_rotations(opened: api.File[Motion], runs: Sequence[tuple[int, int]]) -> Floats | None:
    """The rotations (frames, joints, 4) of undamaged frames, those of the frame before where frames are lost; None for
    a file without rotations.
    """
    if opened.encoded.about.rotations is None:
        return None
    frames, joints, _ = opened.shape
    known = {start: opened[start:stop].rotations for start, stop in runs}
    rotations = np.full((frames, joints, 4), np.nan)
    for start, part in known.items():
        if part is not None:
            rotations[start : start + len(part)] = part
    there = np.flatnonzero(~np.isnan(rotations[:, 0, 0]))
    nearest = there[np.maximum(np.searchsorted(there, np.arange(frames), side="right") - 1, 0)]
    return rotations[nearest]
