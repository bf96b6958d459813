"""`mocodec convert`: a recording from one format to another, without compression."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .. import formats
from ..encoded import Recording
from ..errors import BadInput
from ..motion import Motion
from ..selection import counted
from . import decode, files, output, sections


def reader_options(command: Any) -> Any:
    """The options of readers, of which --rate is --from-rate here: --rate is that of the output."""
    command = files.reader_options(command)
    for option in command.__click_params__:
        if option.name == "rate":
            option.name, option.opts = "from_rate", ["--from-rate"]
    return command


@click.command("convert", cls=sections.Command)
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT", required=False)
@click.option("-o", "--output", "other_target", metavar="OUT", help="Another way to name OUT.")
@click.option("--to-format", metavar="NAME", help="Format of standard output: c3d, bvh, npz, …")
@output.options
@click.option("-q", "--quiet", is_flag=True, help="Print no summary and no notes.")
@reader_options
def command(
    source: str, target: str | None, other_target: str | None, to_format: str | None, quiet: bool, **options: Any
) -> None:
    """Convert IN to OUT, in the format of its suffix, without compression.

    IN is a file of any format, a .mocz (also a URL), a folder of .ply or .pcd, or "-". OUT is a .bvh .amc .c3d .trc
    .glb .npz …, a folder for point clouds, or "-". Rotations stay rotations: an .amc becomes a .bvh with a joint at the
    start of each bone, a .bvh an .amc with its .asf beside it. A note says what the format of OUT cannot hold.

    --unit, --up, --start and --from-rate say how IN is read, in place of what it says; --to-unit, --to-up and --to-rate
    (or --rate) say how OUT is to be.
    """
    if (target is None) == (other_target is None):
        raise click.UsageError("name the file to write once: mocodec convert IN OUT")
    name = target if target is not None else str(other_target)
    if files.is_mocz(name) or (to_format or "").lower().lstrip(".") == files.SUFFIX[1:]:
        raise click.UsageError(f"convert does not compress; run `mocodec encode {source} -o {name}`")
    files.refuse_output(source, name)
    changes, writer_options = output.split(options)
    suffix = Path(f"x.{to_format.lstrip('.')}" if to_format else name).suffix.lower()
    with files.working(f"reading {source}"):
        recording, more = read(source, suffix, options)
    try:
        recording, notes = output.prepared(recording, suffix, changes)
    except BadInput as error:
        raise BadInput(f"{source}: {error}") from error
    with files.working(f"writing {name}"):
        files.write(name, recording, to_format, quiet, **writer_options, **more)
    if not quiet:
        for note in notes:
            files.line(f"note: {note}", err=True)
        files.line(summary(name, recording), err=True)


def read(source: str, suffix: str, options: dict[str, Any]) -> tuple[Recording, dict[str, Any]]:
    """The recording for a file with this suffix, and options for its writer (see `decode.decoded_for`)."""
    reader = {name: value for name, value in options.items() if name not in (*output.CHANGES, *output.WRITERS)}
    if files.holds_compressed(source, reader["format_"]):
        given = sorted(name for name in files.given(**reader) if name != "format_")
        if given:
            shown = ", ".join(f"--{name.replace('_', '-')}" for name in given)
            raise click.UsageError(
                f"a .mocz says how it is read: {shown} cannot override that; --to-… change the output"
            )
        return decode.decoded_for(source, suffix)
    reader["rate"] = reader.pop("from_rate")
    try:
        recording = files.read(source, **reader)
    except BadInput as error:
        error.args = (str(error).replace("(--rate)", "(--from-rate)"),)
        raise
    notes = click.get_current_context().obj.get("notes", [])
    notes[:] = [note.replace("(--rate)", "(--from-rate)") for note in notes]
    return recording, {}


def summary(name: str, recording: Recording) -> str:
    """One line: what was written."""
    where = "standard output" if name == "-" else name
    if not isinstance(recording, Motion):
        return f"{where}: {counted(len(recording), 'frame')} of point clouds at {recording.rate:g} Hz"
    kept = recording.rotations is not None and "joint rotations" not in formats.dropped(where_of(name), recording)
    points = counted(recording.points, "joint" if kept else "point")
    return f"{where}: {counted(len(recording), 'frame')} of {points} at {recording.rate:g} Hz"


def where_of(name: str) -> str:
    """A file name with a suffix that the list of formats knows."""
    return name if Path(name).suffix.lower() in formats.FORMATS else "x.npz"
