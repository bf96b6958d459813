"""`scripts/bench COMMAND …`: runs a benchmark by name; without a command, lists them.

A command's module is imported when the command runs.
"""

from __future__ import annotations

import sys
from importlib import import_module

import click

from mocodec.errors import MocodecError

COMMANDS = {
    "all": ("reproduce:all_command", "Measure everything again and write every table and figure: many hours."),
    "tables": ("reproduce:tables_command", "Write every Markdown table again from the stored results."),
    "eval": ("motion.command:command", "Every codec and rival over recordings, to equal errors."),
    "report": ("motion.command:report_command", "Write the report of eval again, from its results."),
    "liu2006": ("papers.liu2006:command", "Tables and figures of Liu and McMillan (2006)."),
    "hou2014": ("papers.hou2014:command", "Tables and figures of Hou et al. (2014)."),
    "lien2006": ("papers.lien2006:command", "Tables and figures of Lien and Bajcsy (2006)."),
    "tempo": ("tempo:command", "tempo against SZ3 and hou2014 on CMU recordings: docs/tempo/results.md."),
    "tempo-parts": ("tempo_parts:command", "tempo without each of its parts."),
    "rotations": ("rotations:command", "tempo with rotations, against positions alone."),
    "chunk-lengths": ("chunk_lengths:command", "Bytes of shorter chunks of tempo, which lose less when damaged."),
    "bounds": ("bounds:command", "tempo and SZ3 under fine hard maxima, and encoding speed."),
    "corrections": ("corrections:command", "The lattice engine in corrections under a hard bound."),
    "unknown": ("unknown:command", "tempo on points outside its prior."),
    "cloud": ("cloud.command:command", "Codecs of point clouds, ours and rivals."),
    "cloud-grid": ("cloud.grid:command", "Tracking errors of bodycast, over 768 conditions."),
    "cloud-long": ("cloud.long:command", "Long sequences of point clouds, as whole files."),
    "cloud-objects": ("cloud.object_scenes:command", "Props, animals, robes and several people, against an octree."),
    "cloud-points": ("cloud.points:command", "Points within a bound against Draco, at equal error."),
    "cloud-speed": ("cloud.speed:command", "Speed of point clouds within a bound, by the length of the recording."),
    "cloud-stream": ("cloud.packets:command", "Packets with all points of a frame, against a file."),
    "cloud-summary": ("cloud.summary:command", "Requirements and results of point clouds on one page."),
    "tracking": ("cloud.tracking:command", "Tracking and recovery of a body: eight motions."),
    "first-poses": ("cloud.first_poses:command", "First poses without a skeleton."),
    "lab": ("lab:command", "Whole C3D files of laboratories: markers within 0.2 mm, signals exact or within 12 bits."),
    "signals": ("lab:signals_command", "Signals of C3D files, exact, against pcodec, xz and FLAC."),
    "archive": ("archive.command:command", "Archives: sizes, windows for learning, queries, retrieval."),
    "speed": ("speed.command:command", "Speed of codecs, entropy coder and readers, single thread."),
    "speed-table": ("speed.against_sz3:command", "tempo and SZ3 in one process: decoding, encoding, windows, opening."),
    "speed-published": ("speed.published:command", "Speed of hou2014 and liu2006 to mean errors."),
    "long": ("speed.long_recordings:command", "Hours of motion, encoded in blocks and whole: time, memory, bytes."),
    "viewer": ("viewer:command", "The page of mocodec view in Chromium: seeking, playing, sizes."),
    "readers": ("readers.command:command", "Our readers against ezc3d and py-c3d; bytes of model outputs."),
    "fetch": ("fetch:command", "Download recordings from their publishers."),
    "test": ("tests.command:command", "Test the benchmarks themselves."),
}
"""Module and attribute of each command, and its line in the list."""


class Commands(click.Group):
    """The group of the commands in COMMANDS."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module, attribute = COMMANDS[cmd_name][0].split(":")
        return getattr(import_module(f"benchmarks.{module}"), attribute)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, line) in COMMANDS.items()])


@click.group("bench", cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
def main() -> None:
    """Measure the codecs of mocodec. Run from the root of the repository; docs/evaluation.md explains the results."""


if __name__ == "__main__":
    try:
        main(prog_name="scripts/bench")
    except MocodecError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(3)
