"""Errors of point clouds on the command line: measured, checked against a promise, and in words."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..metrics import point_clouds
from ..motion import Motion
from ..pointcloud import PointClouds
from . import files, quantities

MEASURED_FRAMES = 12
"""How many frames of point clouds are measured where normals or views are needed."""
SLACK = 1 + 1e-9
FLOOR_SHARE = 0.5  # of the resampling floor, above which an error is shown beside the floor


def spread_frames(clouds: PointClouds, count: int = MEASURED_FRAMES) -> list[int]:
    """At most `count` frames with points, evenly spaced."""
    chosen = np.unique(np.linspace(0, len(clouds) - 1, count).round().astype(int)).tolist() if len(clouds) else []
    return [frame for frame in chosen if point_clouds.has_points(clouds, frame)]


def measures(original: PointClouds, decoded: PointClouds) -> dict[str, Any]:
    """The errors of decoded point clouds, metres and dB, as JSON values. Raises BadInput for other frame counts."""
    found = point_clouds.errors(original, decoded)
    floor = point_clouds.resampling_floor(original, spread_frames(original, 3))
    record = {"mean_error": found.mean_error, "max_error": found.max_error, "d1": found.d1, "psnr": found.psnr}
    finite = {name: value if math.isfinite(value) else None for name, value in (record | {"floor": floor}).items()}
    return finite | {"samples": found.points}


def in_words(record: Mapping[str, Any]) -> str:
    """The errors of `measures` in a line."""
    words = f"mean error {quantities.length(record['mean_error'])}, "
    largest = record["max_error"]
    words += "a frame lost all its points" if largest is None else f"max {quantities.length(largest)}"
    words += f", D1 {quantities.length(record['d1'])}"
    if record["floor"] is not None and record["d1"] > FLOOR_SHARE * record["floor"]:
        words += f" (another sample of the same surface: about {quantities.length(record['floor'])})"
    return words + (f", colours {record['psnr']:.1f} dB" if record["psnr"] is not None else "")


def check(
    promise: Mapping[str, Any], source: PointClouds, decoded: PointClouds, facts: Mapping[str, Any]
) -> tuple[dict[str, Any], list[str]]:
    """Measure decoded point clouds against their source: the measures, and every broken promise in words.

    facts: the `info` of the file. A promised ratio is that of the file without its extras.
    """
    if len(source) != len(decoded):
        return {}, [f"the source has {len(source)} frames, the file {len(decoded)}"]
    record, broken = measures(source, decoded), list[str]()
    if source.rate != decoded.rate:
        broken.append(f"the source has {source.rate:g} Hz, the file {decoded.rate:g} Hz")
    if (source.colours is None) != (decoded.colours is None):
        broken.append("only one of the source and the file has colours")
    for name in ("max_error", "mean_error"):
        measured = math.inf if record[name] is None else record[name]
        if measured > promise.get(name, math.inf) * SLACK:
            words = "infinite: a frame lost all its points" if measured == math.inf else quantities.length(measured)
            broken.append(f"{name.replace('_', ' ')} is {words}, promised {quantities.bound(promise[name])}")
    if "psnr" in promise and record["psnr"] is not None and record["psnr"] * SLACK < promise["psnr"]:
        broken.append(f"the colours have {record['psnr']:.2f} dB, promised {promise['psnr']:g} dB")
    stored = facts["bytes"]
    if "size" in promise and stored > promise["size"]:
        broken.append(f"the file has {quantities.size(stored)}, promised {quantities.size(int(promise['size']))}")
    parts = facts["bytes_by_part"]
    ratio = source.raw_bytes / (stored - parts.get("extras", 0) - parts.get("signals", 0))
    if "ratio" in promise and ratio * SLACK < promise["ratio"]:
        broken.append(f"the ratio is {ratio:.3g}, promised {promise['ratio']:g}")
    return record, broken


def comparison(a: PointClouds, b: PointClouds, stored: int | None, body: Motion | None) -> dict[str, Any]:
    """Errors of point clouds against others: between nearest points in all frames, as `measures`; other measures in
    MEASURED_FRAMES of them.

    stored: bytes of the .mocz. body: the tracked body of one of them. Raises BadInput for other numbers of frames.
    """
    found = point_clouds.errors(a, b)
    frames = [frame for frame in spread_frames(a) if point_clouds.has_points(b, frame)]
    result: dict[str, Any] = {"frames": len(a), "mean_error_m": found.mean_error, "max_error_m": found.max_error}
    if frames:
        result |= {"d1_m": found.d1, "d1_db": point_clouds.psnr(found.d1**2, point_clouds.PEAK_M)}
        result |= {"y_psnr_db": found.psnr, "measured_frames": len(frames)}
        others = point_clouds.compare(a, b, frames)
        result |= {name: value for name, value in others.items() if name not in result}
        result["floor_m"] = point_clouds.resampling_floor(a, frames[:3])
    if stored:
        result["ratio"] = a.raw_bytes / stored
    if body is not None and frames:
        result["parts_m"] = point_clouds.errors_by_joint(a, b, body, frames)
    return result


LABELS = {
    "measured_frames": "frames measured below",
    "d1_m": "D1",
    "d2_m": "D2",
    "d1_db": "D1, PSNR",
    "d2_db": "D2, PSNR",
    "y_psnr_db": "luma, PSNR",
    "views_psnr_db": "views, PSNR",
    "floor_m": "resampling floor of D1",
}
"""Names of measures in lines of text; others are named as in JSON."""


def as_text(result: Mapping[str, Any], as_json: bool) -> str:
    """A comparison as JSON or as lines; a measure that does not apply (NaN) is null or left out."""
    if as_json:
        plain = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in result.items()}
        return json.dumps(plain, indent=2)
    lines = list[str]()
    for name, value in result.items():
        if isinstance(value, Mapping):
            parts = sorted(value.items(), key=lambda part: -part[1])
            lines += ["mean distance from the points nearest to each joint:"]
            lines += [f"  {files.printable(part):18}{quantities.length(metres)}" for part, metres in parts]
        elif name == "measured_frames" and value == result["frames"]:
            continue
        elif not (isinstance(value, float) and math.isnan(value)):  # without colours, luma has no error
            text = f"{value:.2f} dB" if name.endswith("_db") else f"{value:.6g}"
            text = quantities.length(value) if name.endswith("_m") and math.isfinite(value) else text
            lines.append(f"{LABELS.get(name, name.removesuffix('_m').replace('_', ' ')):24}{text}")
    return "\n".join(lines)
