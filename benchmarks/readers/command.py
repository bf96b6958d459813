"""Comparison with independent readers: `scripts/bench readers` → docs/results/readers*.json, .md.

    C3D ──► mocodec, ezc3d, py-c3d ─────────────┐
    TRC ──► mocodec, lines split at tabs (here) ┴─► quantity by quantity: equal, or the difference and its cause

Model outputs, which mocodec separates from the markers, return to their columns first. Rules look up every difference
in the bytes of the file (`evidence.py`); an unexplained difference fails the command.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from mocodec import formats
from mocodec.errors import MocodecError

from .. import datasets, results
from ..machine import machine_description
from ..markdown import table
from ..packages import installed_version
from . import outputs
from .comparison import QUANTITIES, compare
from .evidence import UNEXPLAINED, explanation
from .witnesses import READERS, Reading, with_mocodec

RESULTS = Path("docs/results/readers.json")
PACKAGES = {"ezc3d": "ezc3d", "py-c3d": "c3d"}


def files(root: Path) -> list[Path]:
    """The C3D and TRC files of the development recordings."""
    folders = (root / "field-c3d", root / "cmu" / "c3d", root / "field-trc")
    return [path for folder in folders for path in sorted(folder.iterdir()) if path.suffix in READERS]


def read_all(path: Path) -> dict[str, Reading | str]:
    """The reading of each reader, or its error message; mocodec first."""
    found: dict[str, Reading | str] = {}
    for name, read in READERS[path.suffix].items():
        try:
            found[name] = read(path)
        except (MocodecError, ArithmeticError, AttributeError, LookupError, OSError, TypeError, ValueError) as error:
            found[name] = f"{type(error).__name__}: {error}".replace(f"{path}: ", "")
    return found


def measure(path: Path) -> list[dict[str, Any]]:
    """A record for each other reader and quantity of a file; if a reader refuses the file, one record for "file"."""
    found = read_all(path)
    ours = found.pop("mocodec")
    records: list[dict[str, Any]] = []
    for name, theirs in found.items():
        differences: dict[str, str] = {}
        salvaged = ours
        if isinstance(ours, str) or isinstance(theirs, str):
            told = [f"{who}: {what}" for who, what in (("mocodec", ours), (name, theirs)) if isinstance(what, str)]
            differences["file"] = "; ".join(told)
            if isinstance(ours, str) and "--salvage" in ours and not isinstance(theirs, str):
                salvaged = with_mocodec(path, salvage=True)
        if not isinstance(salvaged, str) and not isinstance(theirs, str):
            differences |= compare(salvaged, theirs)
        for quantity, difference in differences.items():
            record = {"file": path.name, "reader": name, "quantity": quantity, "difference": difference}
            if difference:
                record["why"] = explanation(path, name, quantity, ours, theirs)
            records.append(record)
    return records


def write_tables(folder: Path) -> Path:
    """Write the tables of the stored results: readers.md."""
    stored = results.read_json(folder / RESULTS.name)
    of_files: dict[str, list[dict[str, Any]]] = {}
    for record in stored["comparisons"]:
        of_files.setdefault(record["file"], []).append(record)
    readers = list(dict.fromkeys(record["reader"] for record in stored["comparisons"]))
    rows: list[list[str]] = []
    for name, records in of_files.items():
        rows.append([name, *(_summary([r for r in records if r["reader"] == reader]) for reader in readers)])
    differing = [r for r in stored["comparisons"] if r["difference"]]
    reasons = [[r["file"], r["reader"], r["quantity"], r["difference"], r["why"]] for r in differing]
    versions = ", ".join(f"{name} {version}" for name, version in stored["versions"].items())
    lines = [
        f"Compared: {', '.join(QUANTITIES)} ({versions}).", "",
        table(["file", *readers], rows), "",
        table(["file", "reader", "quantity", "difference", "who is right, by the bytes"], reasons),
    ]  # fmt: skip
    path = folder / RESULTS.with_suffix(".md").name
    formats.replace_whole(path, ("\n".join(lines) + "\n").encode())
    head = [
        "file",
        "points before",
        "bytes before",
        "markers",
        "bytes",
        "",
        "model outputs",
        "bytes, exactly",
        f"within {outputs.SIGNAL_ERROR}",
    ]
    text = table(head, outputs.rows(stored["outputs"]))
    formats.replace_whole(folder / "readers_outputs.md", (text + "\n").encode())
    return path


def _summary(records: list[dict[str, Any]]) -> str:
    """Table cell of a file and a reader: equal, or the quantities that differ."""
    if not records:
        return "–"
    differing = [record["quantity"] for record in records if record["difference"]]
    if "file" in differing and len(records) == 1:
        return "refused"
    if differing == ["file"]:
        return "equal with `--salvage`"
    return f"all but {', '.join(differing)} equal" if differing else "equal"


@click.command("readers")
@click.option("--data", type=click.Path(path_type=Path), default=datasets.SHARED, help="Folder of the recordings.")
@click.option(
    "--before",
    type=click.Path(exists=True, path_type=Path),
    help="A built checkout that stores model outputs as positions; by default its stored bytes are kept.",
)
@click.option("--no-bytes", is_flag=True, help="Compare only; keep the stored bytes of model outputs.")
@click.option("--tables", is_flag=True, help="Only write the tables from the stored results.")
def command(data: Path, before: Path | None, no_bytes: bool, tables: bool) -> None:
    """Compare readings of mocodec, ezc3d and py-c3d; measure bytes of model outputs: docs/results/readers.json."""
    if not tables:
        stored = (results.read_json(RESULTS) or {}).get("outputs", [])
        comparisons: list[dict[str, Any]] = []
        for path in files(data):
            comparisons += measure(path)
        content = {
            "machine": machine_description(),
            "versions": {name: installed_version(package) for name, package in PACKAGES.items()},
            "comparisons": comparisons,
            "outputs": stored if no_bytes else results.rounded(outputs.measure(data, before, stored)),
        }
        results.write_json(RESULTS, content)
        for record in comparisons:
            if record["difference"]:
                click.echo(": ".join(record[key] for key in ("file", "reader", "quantity", "difference", "why")))
        if any(record.get("why") == UNEXPLAINED for record in comparisons):
            raise click.ClickException("a difference is unexplained: look it up in the bytes, and add a rule")
    click.echo(write_tables(RESULTS.parent))
