"""`mocodec info`: the contents of a file; a .mocz is not decoded."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import click

from .. import api, formats
from ..encoded import Recording
from ..motion import Motion, Signal
from . import files, quantities


@click.command("info")
@click.argument("source", metavar="FILE")
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@files.reader_options
def command(source: str, as_json: bool, **options: Any) -> None:
    """Show the contents of FILE. Of a .mocz (a path, a URL or "-") only header and index are read."""
    if files.is_mocz(source) or files.is_url(source) or (source == "-" and not options["format_"]):
        files.require_no_options(source, files.given(**{**options, "format_": None}))
        with api.open(files.source_of(source)) as opened:
            facts = opened.info
            if notes := formats.notes(opened.encoded.about):
                facts = {**facts, "notes": notes}
    else:
        facts = facts_of(files.read(source, **options))
    click.echo(json.dumps(facts, indent=2) if as_json else "\n".join(lines(facts)))


def facts_of(recording: Recording) -> dict[str, Any]:
    """The contents of a file that is not a .mocz, under the same keys as those of a .mocz."""
    facts: dict[str, Any] = {
        "kind": "motion" if isinstance(recording, Motion) else "clouds",
        "frames": len(recording),
        "rate": recording.rate,
        "seconds": len(recording) / recording.rate,
    }
    if isinstance(recording, Motion):
        facts["points"] = recording.points
        facts["names"] = list(recording.names)
        facts["skeleton"] = recording.skeleton is not None
        facts["gaps"] = int(recording.gaps.sum())
        if listed := dict(signals(recording.extras)):
            facts["signals"] = listed
    else:
        facts["points"] = sum(map(len, recording.positions))
        facts["colours"] = recording.colours is not None
    if notes := formats.notes(recording):
        facts["notes"] = notes
    return {**facts, "up": recording.up, "source": dict(recording.source), "raw_bytes_float32": recording.raw_bytes}


def signals(extras: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    """The path and a description of each signal in extras: "analog", "38 at 1000 Hz (N)"."""
    for key, value in extras.items():
        name = f"{path}/{key}" if path else key
        if isinstance(value, Signal):
            channels = value.values.shape[1] if value.values.ndim > 1 else 1
            units = ", ".join(dict.fromkeys(unit for unit in value.units if unit))
            labels = f": {', '.join(value.labels)}" if value.labels else ""
            yield name, f"{channels} at {value.rate:g} Hz{f' ({units})' if units else ''}{labels}"
        elif isinstance(value, Mapping):
            yield from signals(value, name)


def lines(facts: Mapping[str, Any], indent: int = 0) -> Iterator[str]:
    """Facts as aligned lines; nested ones are indented."""
    width = max((len(key) for key in facts), default=0) + 2
    for key, value in facts.items():
        label = " " * indent + f"{files.printable(key).replace('_', ' '):{width}}"
        if key.endswith("_error") and isinstance(value, float):
            yield label + quantities.bound(value)
        elif isinstance(value, Mapping) and value:
            yield label.rstrip()
            yield from lines(value, indent + 2)
        elif isinstance(value, list) and any(isinstance(item, Mapping) for item in value):
            yield label + f"{len(value)}"
        else:
            yield label + as_text(value)


def as_text(value: Any) -> str:
    """A value as text."""
    match value:
        case bool():
            return "yes" if value else "no"
        case None:
            return "none"
        case int():
            return f"{value:,}"
        case float():
            return f"{value:.6g}"
        case Mapping():
            return "none"
        case list() | tuple():
            texts = (as_text(item) if isinstance(item, float) else files.printable(str(item)) for item in value)
            return ", ".join(texts) or "none"
        case _:
            return files.printable(str(value))
