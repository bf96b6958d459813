"""`mocodec verify`: every checksum of a .mocz file and, beside its source, the promise that it makes."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import click

from .. import api, container, metrics
from ..errors import BadInput
from ..motion import Motion
from . import PROMISE_BROKEN, files, quantities

SLACK = 1 + 1e-9  # a bound met exactly may differ in the last bit of a sum


@click.command("verify")
@click.argument("file", metavar="FILE.mocz")
@click.option("--against", metavar="SOURCE", help="The recording that it was made from, to hold the promise against.")
@click.option("--json", "as_json", is_flag=True, help="As JSON, lengths in metres.")
@files.reader_options
def command(file: str, against: str | None, as_json: bool, **options: Any) -> int | None:
    """Check that every part of FILE is undamaged and decodes and, with --against, that its promise holds.

    A promise is the max-error or mean-error that it was encoded for; names, rate and gaps are promised always.
    """
    reader = container.Reader(files.source_of(file))
    with files.working(f"verifying {file}"), api.File(reader) as opened:
        reader.verify()
        decoded, facts, stored = opened[:], opened.info, opened.encoded
    report: dict[str, Any] = {"file": file, "undamaged": True, "frames": facts.get("frames", len(decoded))}
    report["promise"] = {name: stored.settings[name] for name in api.TARGETS if stored.settings.get(name)}
    broken: list[str] = []
    if against is not None:
        with files.working(f"reading {against}"):
            source = files.read(against, **options)
        comparison, broken = hold(report["promise"], source, decoded, facts.get("bytes"))
        report |= {**comparison, "held": not broken, "broken": broken}
    if as_json:
        click.echo(json.dumps(report, indent=2))
    else:
        click.echo("\n".join(lines(report, against)))
    return PROMISE_BROKEN if broken else None


def hold(
    promise: dict[str, float], source: Any, decoded: Any, stored_bytes: int | None
) -> tuple[dict[str, Any], list[str]]:
    """Measure a decoded motion against its source: the figures, and every promise that is broken, in words."""
    if not (isinstance(source, Motion) and isinstance(decoded, Motion)):
        raise BadInput("--against measures motions, not point clouds")
    if source.positions.shape != decoded.positions.shape:
        return {}, [
            f"the source has {len(source)} frames of {source.points} points, "
            f"the file {len(decoded)} frames of {decoded.points} points"
        ]
    result = metrics.compare(source, decoded, stored_bytes)
    broken = []
    if source.names != decoded.names:
        broken.append("the names of the points differ")
    if source.rate != decoded.rate:
        broken.append(f"the source has {source.rate:g} Hz, the file {decoded.rate:g} Hz")
    if not result.gaps_equal:
        broken.append("the gaps differ")
    for name, measured in (("max_error", result.max_error), ("mean_error", result.mean_error)):
        if name in promise and measured > promise[name] * SLACK:
            broken.append(
                f"{name.replace('_', ' ')} is {quantities.length(measured)}, promised {quantities.bound(promise[name])}"
            )
    return asdict(result), broken


def lines(report: dict[str, Any], against: str | None) -> list[str]:
    """The report for people."""
    promise = ", ".join(f"{name.replace('_', ' ')} {shown(name, value)}" for name, value in report["promise"].items())
    text = [f"{report['file']}: undamaged, all {report['frames']:,} frames decode; promise: {promise or 'no bound'}"]
    if against is None:
        return text
    if "max_error" in report:
        mean, largest = quantities.length(report["mean_error"]), quantities.length(report["max_error"])
        text.append(f"against {against}: mean error {mean}, max {largest}")
    return text + ([f"broken: {what}" for what in report["broken"]] or ["the promise holds"])


def shown(name: str, value: float) -> str:
    """A promised value for people."""
    if name.endswith("error"):
        return quantities.bound(value)
    return quantities.size(int(value)) if name == "size" else f"{value:g}"
