"""`mocodec info`: the contents of a file; a .mocz is not decoded."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

import click

from .. import api, formats
from ..encoded import Encoded, Recording
from ..errors import MocodecError
from ..geometry import joint_tree
from ..motion import Motion, Signal
from . import files, many, quantities, sections

MAX_ITEMS = 60
"""Items of a list that are shown; --json has all."""
OF_MOTIONS = ("names", "skeleton", "rotations")
"""What is not shown of point clouds."""
OF_WRITERS = ("channels", "constant", "first_angles", "offset_digits")
"""What only the writer of a BVH needs from the source; --json has it."""


@click.command("info", cls=sections.Command)
@click.argument("sources", metavar="FILE...", nargs=-1, required=True)
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
@many.jobs_option
@files.reader_options
def command(sources: tuple[str, ...], as_json: bool, jobs: int, **options: Any) -> int | None:
    """Show the contents of FILE: a .mocz (a path, a URL, ARCHIVE/NAME of an archive, or "-"), or any other format.

    Of a .mocz, only header and index are read, and nothing is decoded. Of a local one with rotations, the chunks are
    read too, to tell the bytes of positions from those of rotations.

    Of several files, or of a folder, a table shows the main facts; --json has all of them.
    """
    if many.is_many(sources):
        found = many.find_readable("info", sources, (files.SUFFIX, *formats.FORMATS))
        return many.run("info", found, {}, "", many.Settings(files.given(**options), jobs, as_json=as_json))
    facts = facts_of_source(sources[0], **options)
    files.clear_notes()  # they are among the facts
    if as_json:
        files.echo(json.dumps(facts, indent=2))
    else:
        for text in shown(facts):
            files.line(text)
    return None


def one(source: str, _: str | None, may_replace: bool = True, **options: Any) -> dict[str, Any]:
    """The record of one of many files for the summary, with all of its facts. Nothing is written."""
    facts = facts_of_source(source, **options)
    record: dict[str, Any] = {name: facts.get(name) for name in ("kind", "codec", "frames", "points", "rate")}
    record |= {"duration": facts["seconds"], "raw_bytes": facts.get("raw_bytes_float32")}
    if "bytes" in facts:
        record |= {"bytes": facts["bytes"], "ratio": facts["ratio"]}
    return {**record, "notes": facts.get("notes", []), "facts": facts}


def facts_of_source(source: str, **options: Any) -> dict[str, Any]:
    """The facts of a file, a URL or standard input."""
    if (within := files.in_archive(source)) is not None:
        from ..archive import open_archive

        with open_archive(within[0]) as archive, archive.entry(within[1]).open() as opened:
            return with_motion(opened.info)
    if files.holds_compressed(source, options.get("format_")):
        files.require_no_options(source, files.given(**{**options, "format_": None}))
        with api.open(files.source_of(source)) as opened:
            notes = formats.notes(opened.encoded.about)
            uses = {} if files.is_url(source) else bytes_by_use(opened.encoded)
            facts = {**with_motion(opened.info), **({"bytes_by_use": uses} if uses else {})}
            return {**facts, **({"notes": notes} if notes else {})}
    return facts_of(files.read(source, **options))


def with_motion(facts: Mapping[str, Any]) -> dict[str, Any]:
    """The facts of a .mocz; behind the ratio also that of the motion, where signals and extras take a notable share."""
    parts, raw = facts["bytes_by_part"], facts["raw_bytes_float32"]
    beside = parts["extras"] + parts["signals"]
    if not raw or beside <= facts["bytes"] / 100:
        return dict(facts)
    motion = {"motion_bytes": facts["bytes"] - beside, "motion_ratio": raw / (facts["bytes"] - beside)}
    found: dict[str, Any] = {}
    for name, value in facts.items():
        found |= {name: value} | (motion if name == "ratio" else {})
    return found


def bytes_by_use(encoded: Encoded[Any]) -> dict[str, int]:
    """Coded bytes of positions and of the rotations beside them; empty where there are none, or a chunk is damaged."""
    if encoded.codec != "tempo":
        return {}
    from ..codecs.tempo.rotation_layer import layer

    try:
        return layer.bytes_by_use(encoded)
    except MocodecError:
        return {}


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
        facts["rotations"] = recording.rotations is not None
        facts["gaps"] = int(recording.gaps.sum())
        if listed := dict(signals(recording.extras)):
            facts["signals"] = listed
    else:
        facts["points"] = sum(map(len, recording.positions))
        facts["colours"] = recording.colours is not None
    if notes := formats.notes(recording):
        facts["notes"] = notes
    facts |= {"up": recording.up, "source": dict(recording.source), "raw_bytes_float32": recording.raw_bytes}
    return facts | joint_tree.described(recording) if isinstance(recording, Motion) else facts


def shown(facts: Mapping[str, Any]) -> Iterator[str]:
    """Facts for people: the joints as a tree, in place of the list of names, and long lists cut short."""
    tree: list[dict[str, Any]] = facts.get("tree", [])
    brief = {name: value for name, value in facts.items() if name not in ("tree", "skeleton_name")}
    if tree:
        known = f"{facts['skeleton_name']}, " if facts.get("skeleton_name") else ""
        brief["skeleton"] = f"{known}{len(tree)} joints, bones in cm"
        if [joint["name"] for joint in tree] == facts.get("names"):
            del brief["names"]
    source = {name: value for name, value in brief.get("source", {}).items() if name != "notes" or "notes" not in brief}
    if isinstance(layout := source.get("layout"), list):
        names = [str(entry[0] if isinstance(entry, list | tuple) and entry else entry) for entry in layout]
        source["layout"] = names
    if brief["kind"] == "clouds":
        brief = {name: value for name, value in brief.items() if name not in OF_MOTIONS and value is not None}
        brief["kind"] = "point clouds"
    if "source" in brief:
        brief["source"] = {name: value for name, value in source.items() if name not in OF_WRITERS}
    if isinstance(chunks := brief.get("chunks"), Mapping):
        brief["chunks"] = {name: as_range(value) for name, value in chunks.items()}
    yield from lines(brief)
    yield from joint_tree.lines_of(tree)


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
        elif key == "notes" and isinstance(value, list):
            for note in value:
                yield from wrapped(label, as_text(note))
                label = " " * len(label)
        else:
            yield from wrapped(label, as_text(value), " " if isinstance(value, str) and indent == 0 else ", ")


def wrapped(label: str, text: str, separator: str = " ") -> list[str]:
    """The label and the text in lines of at most joint_tree.WIDTH characters, broken behind separators."""
    rows = [label]
    for part in re.findall(f".+?(?:{separator}|$)", text):
        if len(rows[-1]) + len(part.rstrip()) > joint_tree.WIDTH and rows[-1] != label:
            rows.append(" " * len(label))
        rows[-1] += part
    return [row.rstrip() for row in rows]


def as_range(value: Any) -> Any:
    """A pair of smallest and largest as text, or one number if they are equal; other values as they are."""
    if not isinstance(value, list | tuple) or len(value) != 2:
        return value
    low, high = value
    return low if low == high else f"{low:,} to {high:,}"


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
            texts = [
                as_text(item) if isinstance(item, float) else files.printable(str(item)) for item in value[:MAX_ITEMS]
            ]
            more = f" and {len(value) - MAX_ITEMS:,} more" if len(value) > MAX_ITEMS else ""
            return ", ".join(texts) + more or "none"
        case _:
            return files.printable(str(value))
