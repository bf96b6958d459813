"""The summary of a command on many files: records to totals, and both to a table.

A record describes one file: `file`, `status` ("done", "skipped", "failed"), with `reason` and `code` if it
failed, and measures in metres, bytes and seconds. It is JSON.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from ..selection import counted
from . import quantities

Record = Mapping[str, Any]


def _count(value: Any) -> str:
    return f"{value:,}"


def _ratio(value: Any) -> str:
    return f"{value:.1f} : 1"


def _seconds(value: Any) -> str:
    return f"{value:.1f} s"


FORMATS: dict[str, tuple[str, Callable[[Any], str]]] = {
    "codec": ("codec", str),
    "kind": ("kind", str),
    "output": ("output", str),
    "frames": ("frames", _count),
    "points": ("points", _count),
    "rate": ("Hz", lambda value: f"{value:.6g}"),
    "duration": ("duration", _seconds),
    "bytes": ("bytes", _count),
    "ratio": ("to float32", _ratio),
    "file_ratio": ("to file", _ratio),
    "mean_error": ("mean", quantities.length),
    "max_error": ("max", quantities.length),
    "promise": ("promise", str),
    "kept": ("kept", lambda value: "yes" if value else "NO"),
    "seconds": ("time", _seconds),
}
"""Heading and format of each value of a record."""

IN_WORDS = {
    "bytes": "{} bytes",
    "ratio": "{} to float32",
    "file_ratio": "{} to the file",
    "mean_error": "mean error {}",
    "max_error": "max {}",
    "seconds": "{}",
}
"""The values that the line of a finished file shows, each with its name."""

COLUMNS = {
    "encode": ("bytes", "ratio", "file_ratio", "mean_error", "max_error", "seconds"),
    "decode": ("output", "frames", "seconds"),
    "verify": ("frames", "promise", "mean_error", "max_error", "kept"),
    "info": ("kind", "codec", "frames", "points", "rate", "duration", "bytes", "ratio"),
}
"""The values that each command shows."""


def line(record: Record) -> str:
    """A record in one line."""
    if record["status"] == "failed":
        return f"{record['file']}: failed: {record['reason']}"
    return f"{record['file']}: " + ", ".join(
        words.format(FORMATS[name][1](record[name])) for name, words in IN_WORDS.items() if record.get(name) is not None
    )


def report(command: str, records: Sequence[Record], seconds: float) -> dict[str, Any]:
    """Records and totals, as JSON. seconds: elapsed."""
    good = [record for record in records if record["status"] != "failed"]
    totals: dict[str, Any] = {
        "files": len(records),
        **{status: sum(r["status"] == status for r in records) for status in ("done", "skipped", "failed")},
        "seconds": round(seconds, 3),
    }
    for name in ("frames", "bytes"):
        if any(name in record for record in good):
            totals[name] = sum(record.get(name) or 0 for record in good)
    raw = sum(record.get("raw_bytes") or 0 for record in good if record.get("bytes"))
    if raw and totals.get("bytes"):
        totals["ratio"] = raw / totals["bytes"]
    sized = [record for record in good if record.get("file_ratio")]
    if sized:
        totals["file_ratio"] = sum(r["source_bytes"] for r in sized) / sum(r["bytes"] for r in sized)
    measured = [record for record in good if None not in (record.get("mean_error"), record.get("max_error"))]
    if samples := sum(record["samples"] for record in measured):
        totals["mean_error"] = sum(record["mean_error"] * record["samples"] for record in measured) / samples
        worst = max(measured, key=lambda record: record["max_error"])
        totals |= {"max_error": worst["max_error"], "max_error_in": worst["file"]}
    return {"command": command, "records": [dict(record) for record in records], "totals": totals}


def lines(command: str, report_: Mapping[str, Any]) -> Iterator[str]:
    """The table of a report: a row for each file, the totals, the notes, and the files that failed with the reason."""
    records, totals = report_["records"], report_["totals"]
    good = [record for record in records if record["status"] != "failed"]
    shown = [name for name in COLUMNS[command] if any(record.get(name) is not None for record in good)]
    if good:
        rows = [["file", *(FORMATS[name][0] for name in shown)]]
        rows += [[record["file"], *_cells(record, shown)] for record in good]
        rows += [["total", *_cells(totals, shown)]]
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        for row in rows:
            yield "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip()
        yield ""
    parts = [f"{totals[status]} {status}" for status in ("done", "skipped", "failed") if totals[status]]
    worst = f"; largest error in {totals['max_error_in']}" if "max_error_in" in totals else ""
    yield f"{counted(totals['files'], 'file')}: {', '.join(parts)}{worst}"
    by_note: dict[str, list[str]] = {}
    for record in records:
        for note in record.get("notes") or ():
            by_note.setdefault(note, []).append(record["file"])
    for note, where in by_note.items():
        yield f"note: {where[0] if len(where) == 1 else f'{len(where)} files'}: {note}"
    for record in records:
        if record["status"] == "failed":
            yield f"failed: {record['file']}: {record['reason']}"


def _cells(record: Record, shown: Sequence[str]) -> list[str]:
    return [FORMATS[name][1](record[name]) if record.get(name) is not None else "" for name in shown]
