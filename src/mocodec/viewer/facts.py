"""Facts that a page shows about a recording: numbers, chunks, events, signals, gaps and errors, as JSON values.

web/viewer/src/session.ts lists the fields. Lengths are metres, times seconds, frames count from 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from .. import metrics
from ..channels import channels
from ..geometry import links
from ..metrics import point_clouds
from ..motion import Motion
from ..pointcloud import PointClouds
from ..typing import Floats
from .marks import marks
from .recording import Shown

BINS = 1024
MOST_CHANNELS = 64
MOST_SIGNAL_SAMPLES = 30_000_000
MOST_GAP_SAMPLES = 8_000_000
MEASURED_FRAMES = 1 << 20
"""Samples (frames × points) that are compared at once."""
MOST_SORTED = 1 << 26
"""Errors that the 99th percentile is computed from, at most; of longer recordings every second, third, … frame."""


def facts(shown: Shown, original: Shown | None) -> dict[str, Any]:
    """The facts about one recording, but for where its frames come from."""
    about = shown.about
    is_motion = isinstance(about, Motion)
    return {
        "name": shown.name,
        "kind": "motion" if is_motion else "clouds",
        "frames": shown.frames,
        "points": about.points if is_motion else first_points(shown),
        "rate": about.rate,
        "up": about.up,
        "names": list(about.names) if is_motion else [],
        "links": motion_links(shown, about) if is_motion else [],
        "codec": shown.codec,
        "bytes": shown.bytes,
        "originalBytes": None if original is None else original.file_bytes,
        "ratio": ratio(shown, original),
        "promise": dict(shown.promise),
        "chunks": chunks(shown),
        "marks": marks(shown),
        "events": events(about),
        "signals": signals(about.extras),
        "gaps": gaps(shown) if is_motion else [],
        "errors": None if original is None else errors(shown, original),
        "damage": [list(run) for run in shown.damage],
        "notes": [*shown.notes, *damage_notes(shown)],
    }


def first_points(shown: Shown) -> int:
    """Points of the first frame of point clouds: how much the page asks for at once depends on it."""
    return len(shown.frame_or_nothing(0).positions[0]) if shown.frames else 0


def damage_notes(shown: Shown) -> list[str]:
    """The missing parts of a damaged or truncated file, in words."""
    lost = sum(stop - start for start, stop in shown.damage)
    notes = [f"{lost:,} of {shown.frames:,} frames are damaged and left out"] if lost else []
    return notes + (["the file was cut short: these are the frames that are left"] if shown.is_truncated else [])


def motion_links(shown: Shown, about: Motion) -> list[list[int]]:
    """Links between points, from forty frames of the recording where there is no skeleton."""
    sample = None
    if about.skeleton is None and 2 <= about.points <= links.MOST_POINTS and shown.frames:
        sample = np.concatenate([shown.positions(f, f + 1) for f in links.sample_frames(shown.frames).tolist()])
    return [list(pair) for pair in links.links(about, sample)]


def ratio(shown: Shown, original: Shown | None) -> float | None:
    """Size as float32 positions (and 8-bit colours) over the size of the file."""
    if not shown.bytes:
        return None
    if isinstance(shown.about, Motion):
        return shown.frames * shown.about.points * 12 / shown.bytes
    whole = original.in_memory if original is not None else None
    return whole.raw_bytes / shown.bytes if isinstance(whole, PointClouds) else None


def chunks(shown: Shown) -> list[list[int]]:
    """First frame and bytes of each chunk; of runs of chunks where there are more than 2·BINS."""
    per_run = max(1, -(-len(shown.chunks) // (2 * BINS)))
    runs = [shown.chunks[i : i + per_run] for i in range(0, len(shown.chunks), per_run)]
    return [[run[0][0], sum(size for _, size in run)] for run in runs]


def events(about: Motion | PointClouds) -> list[dict[str, Any]]:
    """Labels and times of the events."""
    found = cast("list[Mapping[str, Any]]", about.extras.get("events", []))
    return [{"label": str(event.get("label", "")), "seconds": float(event["time_s"])} for event in found]


def signals(extras: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Smallest and largest value of each channel in up to BINS equal parts; channels of numbers only."""
    result: list[dict[str, Any]] = []
    left = MOST_SIGNAL_SAMPLES
    for label, channel in channels(extras).items():
        if len(result) >= MOST_CHANNELS or len(channel) > left:
            break
        values = np.asarray(channel[:])
        if not len(values) or values.dtype.kind not in "iufb":
            continue
        left -= len(values)
        result.append({"label": label, "unit": channel.unit, **envelope(values.astype(np.float64))})
    return sorted(result, key=lambda strip: label_rank(strip["label"]))


def label_rank(label: str) -> int:
    """Force before other channels, residuals last."""
    lowered = label.lower()
    return 0 if lowered.startswith(("fz", "force.fz", "fy", "fx")) else 2 if "residual" in lowered else 1


def envelope(values: Floats) -> dict[str, list[float]]:
    """Smallest and largest of values (samples,) in up to BINS equal parts; values that are not finite count as 0."""
    values = np.where(np.isfinite(values), values, 0.0)
    starts = np.unique(np.linspace(0, len(values), min(BINS, len(values)), endpoint=False).astype(int))
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    return {"low": [float(f"{v:.5g}") for v in low], "high": [float(f"{v:.5g}") for v in high]}


def gaps(shown: Shown) -> list[float]:
    """Share of points that are missing in up to BINS equal parts; [] for recordings too long to look through."""
    about = cast("Motion", shown.about)
    if not shown.frames or not about.points or shown.frames * about.points > MOST_GAP_SAMPLES:
        return []
    step = max(1, MEASURED_FRAMES // about.points)
    shares = [
        np.isnan(shown.positions(a, min(shown.frames, a + step))[:, :, 0]).mean(axis=1)
        for a in range(0, shown.frames, step)
    ]
    missing = np.concatenate(shares)
    starts = np.unique(np.linspace(0, len(missing), min(BINS, len(missing)), endpoint=False).astype(int))
    counts = np.diff(np.append(starts, len(missing)))
    return [float(f"{v:.3g}") for v in np.add.reduceat(missing, starts) / counts]


def errors(shown: Shown, original: Shown) -> dict[str, Any] | None:
    """Errors of a recording against its original over all frames: the fields of ErrorFacts in session.ts."""
    if isinstance(shown.about, Motion):
        return motion_errors(shown, original)
    whole, before = shown.in_memory, original.in_memory
    if not isinstance(whole, PointClouds) or not isinstance(before, PointClouds):
        return None
    return cloud_errors(before, whole)


def motion_errors(shown: Shown, original: Shown) -> dict[str, Any]:
    """Distances between decoded and original points, a part of the recording at a time."""
    about = cast("Motion", shown.about)
    per_bin = max(1, -(-shown.frames // (2 * BINS)))
    step = max(per_bin, MEASURED_FRAMES // max(1, about.points) // per_bin * per_bin)
    thinning = max(1, -(-shown.frames * about.points // MOST_SORTED))
    kept: list[Floats] = []
    per_frame: list[Floats] = []
    point_sum, point_count = np.zeros(about.points), np.zeros(about.points, int)
    point_max = np.zeros(about.points)
    largest, largest_at = -1.0, None
    for a in range(0, shown.frames, step):
        b = min(shown.frames, a + step)
        error = metrics.distances(original.positions(a, b), shown.positions(a, b))
        present = ~np.isnan(error)
        filled = np.where(present, error, 0.0)
        kept.append(error[::thinning][present[::thinning]])
        counts = present.sum(axis=1)
        per_frame.append(np.stack([filled.sum(axis=1), counts, filled.max(axis=1, initial=0.0)], axis=1))
        point_sum += filled.sum(axis=0)
        point_count += present.sum(axis=0)
        point_max = np.maximum(point_max, filled.max(axis=0, initial=0.0))
        if present.any() and filled.max() > largest:
            place = np.unravel_index(int(np.where(present, error, -1.0).argmax()), error.shape)
            largest, largest_at = float(filled.max()), [a + int(place[0]), int(place[1])]
    values = np.concatenate(kept) if kept else np.zeros(0)
    total, count, worst = np.concatenate(per_frame).T if per_frame else np.zeros((3, 0))
    return {
        "mean": float(total.sum() / max(1, count.sum())),
        "p99": float(np.percentile(values, 99)) if len(values) else 0.0,
        "max": max(0.0, largest),
        "maxAt": largest_at,
        **binned(total, count, worst, per_bin),
        "pointMean": _rounded(point_sum / np.maximum(1, point_count)),
        "pointMax": _rounded(point_max),
    }


def cloud_errors(original: PointClouds, decoded: PointClouds) -> dict[str, Any]:
    """Distances to the nearest point, in both directions. Mean of a frame: its D1; p99: of the frames' maxima."""
    measured = point_clouds.errors(original, decoded)
    curve, worst = np.zeros(len(original)), np.zeros(len(original))
    curve[measured.frames], worst[measured.frames] = measured.d1_of_frame, measured.max_of_frame
    counts = np.isin(np.arange(len(original)), measured.frames).astype(float)
    return {
        "mean": measured.mean_error,
        "p99": float(np.percentile(worst, 99)) if len(worst) else 0.0,
        "max": float(worst.max(initial=0.0)),
        "maxAt": [int(worst.argmax()), -1] if len(worst) else None,
        **binned(curve, counts, worst, max(1, -(-len(curve) // (2 * BINS)))),
        "pointMean": [],
        "pointMax": [],
    }


def binned(total: Floats, count: Floats, worst: Floats, per_bin: int) -> dict[str, Any]:
    """Mean, largest and frame of the largest error in runs of `per_bin` frames, from sums, counts, maxima (frames,).

    Mean and largest are −1 in runs where nothing was measured.
    """
    starts = np.arange(0, len(total), per_bin)
    if not len(starts):
        return {"binFrames": 1, "binMean": [], "binMax": [], "binWorst": []}
    counts = np.add.reduceat(count, starts)
    mean = np.where(counts > 0, np.add.reduceat(total, starts) / np.maximum(1, counts), -1.0)
    places = [int(s + worst[s : s + per_bin].argmax()) for s in starts]
    return {
        "binFrames": per_bin,
        "binMean": _rounded(mean),
        "binMax": _rounded(np.where(counts > 0, np.maximum.reduceat(worst, starts), -1.0)),
        "binWorst": places,
    }


def _rounded(values: Floats) -> list[float]:
    return [float(f"{v:.4g}") for v in values]
