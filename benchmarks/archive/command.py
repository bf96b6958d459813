"""Archives: `scripts/bench archive` → docs/results/archive.json.

    ../shared/data/cmu/asfamc ─build─► archives of positions, and with rotations ─► bytes, errors, frames a second
                                        ├─ windows against .npz and memory-mapped .npy
                                        ├─ training from the archive and from the originals
                                        ├─ catalogue and index of a million frames: opening, queries
                                        ├─ retrieval of labelled clips
                                        ├─ simulation of an inverted index
                                        ├─ priors of a studio's own people
                                        └─ two workers against one

Times are processor times of one process, so that other work on the machine changes them little. The part `parallel`
measures wall-clock time and needs an idle machine.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import click

from mocodec import archive
from mocodec.errors import BadInput

from .. import datasets, results
from ..machine import machine_description
from . import clusters, large, parallel, priors, retrieval, tables, training, windows

RESULTS = Path("docs/results/archive.json")
PEOPLE = datasets.SHARED / "cmu" / "asfamc"
MEAN_ERROR_M = 0.003
PARTS = ("sizes", "windows", "training", "large", "retrieval", "clusters", "priors", "parallel")


@click.command("archive")
@click.option("--part", "parts", multiple=True, type=click.Choice(PARTS), help="Only this part; can be repeated.")
@click.option("--work", type=click.Path(path_type=Path), help="Keep the archives in this folder, and reuse them.")
@click.option("--tables-only", is_flag=True, help="Write the tables again from the stored results.")
def command(parts: tuple[str, ...], work: Path | None, tables_only: bool) -> None:
    """Archives of the CMU recordings: sizes, windows for learning, queries, retrieval."""
    if tables_only:
        tables.write(results.read_json(RESULTS))
        return
    if not PEOPLE.is_dir():
        raise BadInput(f"{PEOPLE}: this measurement needs the CMU recordings")
    found: dict[str, Any] = results.read_json(RESULTS) or {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = work or Path(temporary)
        for part in parts or PARTS:
            click.echo(f"{part} …")
            found[part] = measured(part, folder)
            found["machine"] = machine_description()
            results.write_json(RESULTS, results.rounded(found))
    tables.write(results.read_json(RESULTS))


def measured(part: str, folder: Path) -> Any:
    """The results of one part."""
    if part == "sizes":
        return [sizes(folder, kind) for kind in ("positions", "rotations")]
    if part == "priors":
        return priors.measure(built(folder, "rotations"))
    if part == "parallel":
        return parallel.measure(PEOPLE, built(folder, "rotations"), folder, options("positions"))
    vault = built(folder, "positions")
    if part == "windows":
        return windows.measure(vault, folder)
    if part == "training":
        return training.measure(vault, folder, PEOPLE)
    archive.index(vault)
    if part == "clusters":
        return clusters.measure(vault)
    return large.measure(vault, folder) if part == "large" else retrieval.measure(vault)


def options(kind: str) -> archive.Options:
    """Options: a mean error of 3 mm, with or without the rotations of joints."""
    return archive.Options(targets={"mean_error": MEAN_ERROR_M}, rotations=kind == "rotations")


def built(folder: Path, kind: str) -> Path:
    """Builds the archive of positions, or with rotations; returns its folder."""
    archive.build(PEOPLE, folder / kind, options(kind))
    return folder / kind


def sizes(folder: Path, kind: str) -> dict[str, Any]:
    """Bytes and errors of an archive, and its build speed if it was built now."""
    begun = time.process_time()
    report = archive.build(PEOPLE, folder / kind, options(kind))
    seconds = time.process_time() - begun
    with archive.open_archive(folder / kind) as db:
        sums = db.sums()
        damaged = len(list(archive.damage(db)))
    return {
        "kind": kind,
        **sums,
        "catalogue_bytes": (folder / kind / "catalogue.sqlite").stat().st_size,
        "shard_bytes": sum(path.stat().st_size for path in (folder / kind / "shards").iterdir()),
        "percent": 100 * (sums["stored_bytes"] - sums["side_bytes"]) / sums["raw_bytes"],
        "frames_per_second": report.frames / seconds if report.frames else None,
        "failed": len(report.failed),
        "damaged": damaged,
    }
