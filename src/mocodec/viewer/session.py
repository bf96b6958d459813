"""The session of a page: facts about each recording, and where its frames come from.

recordings ─► facts ─► + frames inside ("packed", a file to mail)
                       + frames of a server ("frames", `mocodec view`)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

from ..errors import BadInput
from ..motion import Motion
from ..pointcloud import PointClouds
from . import packed
from .facts import facts
from .recording import Shown

Pair = tuple[Shown, Shown | None]
"""A recording and its original, if there is one."""


@dataclass(frozen=True)
class Limit:
    """How much may be inside a page: samples (frames × points of all recordings), and the finest step, metres."""

    samples: int = 6_000_000
    finest_m: float = packed.FINEST_M


def matched(shown: Shown, original: Shown | None) -> Pair:
    """The pair with the original's points in the order of the recording's. Raises BadInput if they differ in shape."""
    if original is None:
        return shown, None
    about, before = shown.about, original.about
    if isinstance(about, Motion) != isinstance(before, Motion):
        raise BadInput(f"{shown.name} and {original.name}: one is a motion, the other point clouds")
    if 0 < shown.frames < original.frames and shown.is_truncated:
        original = dataclasses.replace(original, recording=original.in_memory[: shown.frames])
        note = f"only the first {shown.frames:,} frames are left of the file; the original has more"
        shown = dataclasses.replace(shown, notes=[*shown.notes, note])
    if shown.frames != original.frames:
        raise BadInput(f"{shown.name} has {shown.frames:,} frames, {original.name} has {original.frames:,}")
    if not isinstance(about, Motion) or not isinstance(before, Motion):
        return shown, original
    if about.points != before.points:
        raise BadInput(f"{shown.name} has {about.points} points, {original.name} has {before.points}")
    unique = len(set(about.names)) == about.points
    if about.names == before.names or not unique or sorted(about.names) != sorted(before.names):
        return shown, original
    place = {name: column for column, name in enumerate(before.names)}
    return shown, dataclasses.replace(original, columns=[place[name] for name in about.names])


def of_server(pairs: Sequence[Pair], title: str, base: str = "") -> dict[str, Any]:
    """A session whose frames a server decodes: r/0/decoded and r/0/original of the first recording, and so on, below
    the place `base`."""
    recordings = [
        {
            **facts(shown, original),
            "decoded": {"type": "frames", "url": f"{base}r/{number}/decoded"},
            "original": None if original is None else {"type": "frames", "url": f"{base}r/{number}/original"},
        }
        for number, (shown, original) in enumerate(pairs)
    ]
    return {"version": 1, "title": title, "recordings": recordings}


def of_page(pairs: Sequence[Pair], title: str, limit: Limit | None = None) -> dict[str, Any]:
    """A session with all frames inside. Recordings over the limit are thinned out to every second, third, … frame."""
    limit = limit or Limit()
    share = limit.samples // max(1, len(pairs))
    return {"version": 1, "title": title, "recordings": [inside(pair, share, limit.finest_m) for pair in pairs]}


def inside(pair: Pair, samples: int, finest_m: float) -> dict[str, Any]:
    """One recording with its frames: motion with a step of at least `finest_m`, original points as differences."""
    shown, original = pair
    whole, before = shown.in_memory, None if original is None else original.in_memory
    size = sum(map(len, whole.positions)) if isinstance(whole, PointClouds) else len(whole) * whole.points
    thinning = max(1, -(-size * (1 if original is None else 2) // max(1, samples)))
    described = facts(shown, original)
    if thinning > 1:
        described = {**described, **thinned(described, thinning)}
        whole, before = whole[::thinning], None if before is None else before[::thinning]
    if isinstance(whole, PointClouds):
        return {
            **described,
            "decoded": packed.pack_clouds(whole.positions, whole.colours),
            "original": packed.pack_clouds(before.positions, before.colours)
            if isinstance(before, PointClouds)
            else None,
        }
    columns = list(shown.columns) if shown.columns is not None else slice(None)
    positions = whole.positions[:, columns]
    arrays = [positions]
    if original is not None:
        order = slice(None) if original.columns is None else list(original.columns)
        arrays.append(cast("Motion", before).positions[:, order])
    origin, step = packed.scale(arrays, finest_m)
    packed_original = None if original is None else packed.pack_original(arrays[1], positions, origin, step)
    return {**described, "decoded": packed.pack_motion(positions, origin, step), "original": packed_original}


def thinned(described: dict[str, Any], step: int) -> dict[str, Any]:
    """The facts that change if only every `step`-th frame is inside."""
    frames = -(-described["frames"] // step)
    errors = described["errors"]
    if errors is not None:
        per_bin = max(1, round(errors["binFrames"] / step))
        at = errors["maxAt"]
        errors = {**errors, "maxAt": at and [min(frames - 1, at[0] // step), at[1]]}
        errors |= rebinned(errors, described["frames"], step, per_bin)
    return {
        "frames": frames,
        "rate": described["rate"] / step,
        "chunks": [[start // step, size] for start, size in described["chunks"]],
        "damage": [[a // step, -(-b // step)] for a, b in described["damage"]],
        "errors": errors,
        "notes": [*described["notes"], f"one of {step} frames is shown; all numbers are of all frames"],
    }


def rebinned(errors: dict[str, Any], frames: int, step: int, per_bin: int) -> dict[str, Any]:
    """The curves of errors over bins of `per_bin` shown frames, each the largest or mean of the bins it covers."""
    shown = -(-frames // step)
    old = errors["binFrames"]
    mean, largest, worst = list[float](), list[float](), list[int]()
    for first in range(0, shown, per_bin):
        a = min(len(errors["binMax"]) - 1, first * step // old)
        b = max(a + 1, min(len(errors["binMax"]), -(-(first + per_bin) * step // old)))
        mean.append(sum(errors["binMean"][a:b]) / (b - a))
        largest.append(max(errors["binMax"][a:b]))
        best = max(range(a, b), key=lambda i: errors["binMax"][i])
        worst.append(min(shown - 1, errors["binWorst"][best] // step))
    return {"binFrames": per_bin, "binMean": mean, "binMax": largest, "binWorst": worst}
