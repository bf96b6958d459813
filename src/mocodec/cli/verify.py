"""`mocodec verify`: check every checksum of a .mocz file and, with its source, the promised error."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from .. import api, formats, metrics
from ..channels import signals
from ..errors import BadInput
from ..motion import Motion, Signal
from ..pointcloud import PointClouds
from ..signals import bounds
from . import PROMISE_BROKEN, BrokenPromise, clouds, files, many, quantities, sections

SLACK = 1 + 1e-9  # rounding: a bound that is met exactly may be exceeded by the last bit of a sum


@click.command("verify", cls=sections.Command)
@click.argument("sources", metavar="FILE.mocz...", nargs=-1, required=True)
@click.option(
    "--against",
    metavar="SOURCE",
    help="The recording that the file was encoded from; of many files, the folder with the recordings.",
)
@click.option("--json", "as_json", is_flag=True, help="As JSON, lengths in metres.")
@many.jobs_option
@files.reader_options
def command(sources: tuple[str, ...], against: str | None, as_json: bool, jobs: int, **options: Any) -> int | None:
    """Check that every part of FILE is undamaged and decodes and, with --against, that its promises are kept.

    A promise is the max-error, mean-error, max-rotation, signal-error, ratio or size that FILE was encoded with. If it
    keeps rotations, the errors are those of joints and of shell points (3 cm off each joint). Names, rate, gaps and
    extras (analog channels, events, …) must be equal, except extras that FILE was encoded without (`encode --bare`).

    Several files, or a folder, are checked one by one; --against names the folder that they were encoded from.
    """
    if many.is_many(sources):
        if against is not None and not Path(against).is_dir():
            raise click.UsageError(f"{against}: of many files, --against names the folder that they were encoded from")
        found = many.find_readable("verify", sources, (files.SUFFIX,))
        originals = {} if against is None else original_of(found, against)
        chosen = {"against": against, **files.given(**options)}
        each = {path: {"original": original} for path, original in originals.items()}
        return many.run("verify", found, {}, "", many.Settings(chosen, jobs, as_json=as_json), each)
    report = checked(sources[0], against, **options)
    if as_json:
        files.echo(json.dumps(report, indent=2))
    else:
        for text in lines(report, against):
            files.line(text)
    return PROMISE_BROKEN if report.get("broken") else None


def one(
    source: str,
    _: str | None,
    against: str | None,
    original: str | None = None,
    may_replace: bool = True,
    **options: Any,
) -> dict[str, Any]:
    """Check one of many files; returns its record for the summary. Nothing is written. Raises BrokenPromise."""
    if against is not None and original is None:
        raise BadInput(f"{against} has no recording of this name ({Path(source).stem}, with any suffix), or several")
    report = checked(source, original, **options)
    if report.get("broken"):
        raise BrokenPromise("; ".join(report["broken"]))
    promise = ", ".join(f"{n.replace('_', ' ')} {promise_as_text(n, v)}" for n, v in report["promise"].items())
    record = {"frames": report["frames"], "promise": promise, "kept": report.get("promise_kept")}
    if "mean_error" in report:
        record |= {name: report[name] for name in ("mean_error", "max_error", "samples")}
    return record


def original_of(found: Sequence[many.Source], folder: str) -> dict[str, str]:
    """The recording in a folder that each .mocz was encoded from, by path.

    That is the one that is mirrored to its name, or else the only one of its stem, whatever suffix it has.
    """
    recordings = many.find([folder], formats.FORMATS)
    path_of = {
        name: path
        for path, name in many.output_names(
            recordings, dict.fromkeys((recording.path for recording in recordings), files.SUFFIX)
        ).items()
    }
    exact = {recording.name: [recording.path] for recording in recordings}
    by_stem: dict[str, list[str]] = {}
    for recording in recordings:
        by_stem.setdefault(Path(recording.name).with_suffix("").as_posix(), []).append(recording.path)
    result: dict[str, str] = {}
    for source in found:
        whole = source.name.removesuffix(files.SUFFIX)  # walk, or walk.c3d where other recordings had the same stem
        same = exact.get(whole) or by_stem.get(whole, [])
        if source.name in path_of:
            result[source.path] = path_of[source.name]
        elif len(same) == 1:
            result[source.path] = same[0]
    return result


def checked(file: str, against: str | None, **options: Any) -> dict[str, Any]:
    """What was found about a file: undamaged, frames, promise and, against its source, errors and broken promises."""
    with files.working(f"verifying {file}"), api.open(files.source_of(file)) as opened:
        opened.verify()
        decoded, facts, promise = opened[:], opened.info, dict[str, Any](opened.encoded.promise)
        settings = opened.encoded.settings
    promise |= {name: settings[name] for name in ("max_rotation",) if isinstance(settings.get(name), float | int)}
    promise |= {"signal_error": settings["signal_error"]} if settings.get("signal_error") else {}
    report: dict[str, Any] = {"file": file, "undamaged": True, "frames": facts.get("frames", len(decoded))}
    report["promise"] = promise
    if against is not None:
        with files.working(f"reading {against}"):
            source = files.read(against, **files.with_known_rate(against, options, decoded))
        comparison, broken = check(report["promise"], source, decoded, facts, shell_of(settings))
        samples = {"samples": int((~source.gaps).sum())} if isinstance(source, Motion) else {}
        report |= {**comparison, **samples, "promise_kept": not broken, "broken": broken}
    return report


def check(
    promise: Mapping[str, Any],
    source: Any,
    decoded: Any,
    facts: Mapping[str, Any],
    shell: float = metrics.SHELL_M,
) -> tuple[dict[str, Any], list[str]]:
    """Measure a decoded recording against its source: the measures, and every broken promise in words.

    facts: the `info` of the file. A promised ratio is that of the file without its extras. shell: distance of the
    shell points from their joints, metres.
    """
    if isinstance(source, PointClouds) and isinstance(decoded, PointClouds):
        return clouds.check(promise, source, decoded, facts)
    if not (isinstance(source, Motion) and isinstance(decoded, Motion)):
        raise BadInput(
            "a motion cannot be checked against point clouds: --against names what the file was encoded from"
        )
    if source.positions.shape != decoded.positions.shape:
        return {}, [
            f"the source has {len(source)} frames of {source.points} points, "
            f"the file {len(decoded)} frames of {decoded.points} points"
        ]
    stored_bytes = facts["bytes"]
    result = metrics.compare(source, decoded, stored_bytes, shell)
    broken = []
    if source.names != decoded.names:
        broken.append("the names of the points differ")
    if source.rate != decoded.rate:
        broken.append(f"the source has {source.rate:g} Hz, the file {decoded.rate:g} Hz")
    if not result.gaps_equal:
        broken.append("the gaps differ")
    signal_error = facts.get("settings", {}).get("signal_error")
    left_out = formats.left_out(source, decoded)
    original = {name: value for name, value in source.extras.items() if name not in left_out}
    extras = original if signal_error is None else within_bounds(original, decoded.extras, signal_error)
    broken += [f"extras differ: {name}" for name in differing(extras, decoded.extras)]
    broken += [] if signal_error is None else list(bounds.broken(original, decoded.extras, signal_error))
    broken += broken_errors(promise, result)
    if "size" in promise and stored_bytes > promise["size"]:
        broken.append(f"the file has {quantities.size(stored_bytes)}, promised {quantities.size(int(promise['size']))}")
    ratio = source.raw_bytes / (
        stored_bytes - sum(facts["bytes_by_part"].get(name, 0) for name in ("extras", "signals"))
    )
    if "ratio" in promise and ratio * SLACK < promise["ratio"]:
        broken.append(f"the ratio is {ratio:.3g}, promised {promise['ratio']:g}")
    return asdict(result) | ({"left_out": left_out} if left_out else {}), broken


def broken_errors(promise: Mapping[str, float], result: metrics.Comparison) -> list[str]:
    """Every promised error that is exceeded, in words: of joints and shell points where rotations are kept."""
    pose, where = result.skeletal, ""
    largest, mean, broken = result.max_error, result.mean_error, list[str]()
    if pose is not None:
        where = f" over joints and shell points {quantities.bound(pose.shell_m)} off"
        largest, mean = pose.joints_and_shell.largest, pose.joints_and_shell.mean
        angle = max(pose.world_degrees.largest, pose.local_degrees.largest)
        if angle > promise.get("max_rotation", math.inf) * SLACK:
            broken.append(f"max rotation is {quantities.angle(angle)}, promised {promise['max_rotation']:g}°")
    for name, measured in (("max_error", largest), ("mean_error", mean)):
        if measured > promise.get(name, math.inf) * SLACK:
            words = f"{name.replace('_', ' ')}{where}"
            broken.append(f"{words} is {quantities.length(measured)}, promised {quantities.bound(promise[name])}")
    return broken


def shell_of(settings: Mapping[str, Any]) -> float:
    """The distance of shell points in the settings of a codec, metres."""
    shell = settings.get("shell")
    return float(shell) if isinstance(shell, float | int) and shell > 0 else metrics.SHELL_M


def within_bounds(source: Mapping[str, Any], decoded: Mapping[str, Any], signal_error: str) -> dict[str, Any]:
    """The extras of the source with the decoded samples of the signals that are bounded."""
    bounded, found = bounds.bounds(source, signal_error), dict(signals(decoded))

    def with_decoded(tree: Mapping[str, Any]) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for name, value in tree.items():
            if isinstance(value, Signal) and name in bounded and name in found:
                result[name] = replace(value, values=found[name].values)
            else:
                result[name] = with_decoded(value) if isinstance(value, Mapping) else value
        return result

    return with_decoded(source)


def differing(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    """The names of the extras that differ between two motions."""
    return sorted(name for name in {*a, *b} if name not in a or name not in b or not is_equal(a[name], b[name]))


def is_equal(a: Any, b: Any) -> bool:
    """Whether two values of extras are equal; NaN equals NaN."""
    if isinstance(a, Signal) and isinstance(b, Signal):
        facts = (a.rate, tuple(a.labels), tuple(a.units)) == (b.rate, tuple(b.labels), tuple(b.units))
        return facts and is_equal(a.values, b.values)
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return not differing(a, b)
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(is_equal(x, y) for x, y in zip(a, b, strict=True))
    return type(a) is type(b) and (a == b or a != a)


def lines(report: dict[str, Any], against: str | None) -> list[str]:
    """The report as text."""
    promise = ", ".join(
        f"{name.replace('_', ' ')} {promise_as_text(name, value)}" for name, value in report["promise"].items()
    )
    text = [f"{report['file']}: undamaged, all {report['frames']:,} frames decode; promise: {promise or 'no bound'}"]
    if against is None:
        return text
    if "d1" in report:
        text.append(f"against {against}: {clouds.in_words(report)}")
    elif "max_error" in report:
        mean, largest = quantities.length(report["mean_error"]), quantities.length(report["max_error"])
        text.append(f"against {against}: mean error {mean}, max {largest}")
        if (pose := report["skeletal"]) is not None:
            mean, largest = (quantities.length(pose["shell"][key]) for key in ("mean", "largest"))
            angle = quantities.angle(pose["world_degrees"]["largest"])
            text.append(
                f"shell points {quantities.bound(pose['shell_m'])} off: mean error {mean}, max {largest}; "
                f"rotations: max {angle}"
            )
    left_out = report.get("left_out", [])
    if left_out:
        text.append(f"not in the file, which was encoded without them: {', '.join(left_out)}")
    kept = f"{'the promise is kept' if report['promise'] else 'no bound was promised'}; {equal_parts(report)}"
    return text + ([f"broken: {what}" for what in report["broken"]] or [kept])


def equal_parts(report: Mapping[str, Any]) -> str:
    """What is equal in the file and its source, besides the positions, in words."""
    if "d1" in report:
        return "frames and rate are equal"
    others = "other " * bool(report.get("left_out"))
    bounded = " (signals within their error)" if "signal_error" in report["promise"] else ""
    return f"names, rate, gaps and {others}extras are equal{bounded}"


def promise_as_text(name: str, value: Any) -> str:
    """A promised value as text."""
    if isinstance(value, str):
        return value
    if name.endswith("error"):
        return quantities.bound(value)
    if name == "max_rotation":
        return f"{value:g}°"
    if name == "psnr":
        return f"{value:g} dB"
    return quantities.size(int(value)) if name == "size" else f"{value:g}"
