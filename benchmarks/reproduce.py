"""Measures all results with one command, and writes all tables from the stored results."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import click

from mocodec import __version__

from .results import read_json

RESULTS = Path("docs/results")


def commands(folder: Path) -> list[list[str]]:
    """The commands for all tables and figures, in an order that respects their inputs."""
    output = ["-o", str(folder)]
    return [
        ["eval", "-o", str(folder / __version__)],
        ["liu2006", *output],
        ["hou2014", *output],
        ["lien2006", *output],
        ["readers"],
        ["archive"],
        ["tempo-parts"],
        ["tempo"],
        ["unknown"],
        ["cloud", *output],
        ["cloud-grid", *output],
        ["cloud-long", *output],
        ["cloud-points", *output],
        ["cloud-objects", *output],
        ["cloud-speed", *output],
        ["cloud-stream", *output],
        ["tracking", *output],
        ["first-poses", *output],
        ["cloud-summary", str(folder)],
        ["speed", "--store"],
        ["speed-published"],
    ]


@click.command("all")
@click.option("-o", "--output", default=RESULTS, show_default=True, type=click.Path(path_type=Path))
def all_command(output: Path) -> None:
    """Run every benchmark, one after the other, and fill the pages. Takes many hours; stops at the first failure.

    eval, cloud-grid and tempo continue where an interrupted run stopped.
    """
    for arguments in commands(output):
        click.echo(f"scripts/bench {' '.join(arguments)}", err=True)
        subprocess.run([sys.executable, "-m", "benchmarks", *arguments], check=True)
    subprocess.run([sys.executable, "scripts/pages"], check=True)


@click.command("tables")
@click.argument("folder", default=RESULTS, type=click.Path(exists=True, file_okay=False, path_type=Path))
def tables_command(folder: Path) -> None:
    """Write the tables in FOLDER and in docs/tempo/results.md again from the stored JSON; fill the pages."""
    for path in write_tables(folder):
        click.echo(path)
    if folder == RESULTS:
        from . import tempo, unknown
        from .readers import command as readers

        readers.write_tables(folder)
        tempo.write_tables()
        unknown.write_tables()
        subprocess.run([sys.executable, "scripts/pages"], check=True)


def write_tables(folder: Path) -> list[Path]:
    """Write the Markdown tables of the results in a folder; return their paths.

    Without cloud.md: the stored table was written from numbers with more digits than cloud.json has.
    """
    from .archive import tables as archive_tables
    from .cloud import first_poses, grid, object_scenes, packets, points_report, speed, summary
    from .motion import command as motion_command
    from .papers import hou2014, lien2006, liu2006

    writers = {
        "liu2006": liu2006.write_tables, "hou2014": hou2014.write_tables, "lien2006": lien2006.write_tables,
        "cloud_grid": grid.write_tables, "first_poses": first_poses.write_tables,
        "cloud_points": points_report.write_tables,
        "cloud_objects": object_scenes.write_tables,
        "cloud_speed": speed.write_tables,
        "cloud_stream": packets.write_tables,
    }  # fmt: skip
    paths = [write(folder) for name, write in writers.items() if (folder / f"{name}.json").is_file()]
    paths.append(summary.write_tables(folder))
    if found := read_json(folder / "archive.json"):
        paths += archive_tables.write(found, folder)
    for results in sorted(folder.glob("*/results.json")):
        paths += motion_command.write_tables(results.parent)
    return paths
