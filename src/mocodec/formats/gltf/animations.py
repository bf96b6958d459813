"""The animations and skins of a glTF: which one is read, its tracks, and the notes about the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...errors import BadInput
from .document import Document
from .nodes import Nodes
from .tracks import INTERPOLATIONS, Track

PATH_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}
MAX_NAMES = 8
"""Names that a message lists."""

Channels = dict[tuple[int, str], dict[str, Any]]
"""Samplers by node and path."""


def channels_of(document: Document, animation: dict[str, Any], nodes: Nodes) -> tuple[Channels, int]:
    """The samplers of an animation's channels that move nodes, and how many other channels it has. Raises BadInput."""
    channels, others = Channels(), 0
    for channel in animation.get("channels", ()):
        node, path = channel["target"].get("node"), channel["target"]["path"]
        if node is None or path not in PATH_WIDTHS:
            others += 1
            continue
        if not 0 <= node < len(nodes):
            raise document.damaged(f"an animation of node {node}, which does not exist")
        if channel["sampler"] < 0:
            raise document.damaged(f"an animation with sampler {channel['sampler']}")
        channels[node, path] = animation["samplers"][channel["sampler"]]
    return channels, others


def duration(document: Document, channels: Channels) -> float:
    """Seconds from the first to the last key of the channels."""
    times = [document.values(sampler["input"], 1)[:, 0] for sampler in channels.values()]
    return max(t[-1] for t in times) - min(t[0] for t in times) if times else -1.0


def track(document: Document, sampler: dict[str, Any], path: str, unit_m: float) -> Track:
    """The track of a channel; translations in metres. Raises BadInput."""
    interpolation = sampler.get("interpolation", "LINEAR")
    if interpolation not in INTERPOLATIONS:
        raise document.damaged(f"the interpolation {interpolation!s:.20} does not exist")
    times = document.values(sampler["input"], 1)[:, 0]
    values = document.values(sampler["output"], PATH_WIDTHS[path], len(times) * INTERPOLATIONS[interpolation])
    if (np.diff(times) <= 0).any():
        raise document.damaged("its key times do not increase")
    return Track(times, values * unit_m if path == "translation" else values, interpolation)


def chosen(kind: str, wanted: str | int | None, names: Sequence[str], path: object) -> int | None:
    """The number of the animation or skin that an option names; None without the option. Raises BadInput."""
    if wanted is None:
        return None
    if wanted in names:
        return names.index(str(wanted))
    number = int(wanted) if isinstance(wanted, int) or (wanted.isascii() and wanted.isdecimal()) else -1
    if not 0 <= number < len(names):
        listed = ", ".join(f"{i} {quoted(name)}" for i, name in enumerate(names[:MAX_NAMES]))
        listed += ", …" if len(names) > MAX_NAMES else ""
        raise BadInput(f"{path}: it has no {kind} {quoted(str(wanted))}; it has: {listed or 'none'}")
    return number


def names_of(items: Sequence[dict[str, Any]]) -> list[str]:
    """The names of animations or skins; "" without one."""
    return [str(item.get("name") or "") for item in items]


def others_note(kind: str, reason: str, read: int, names: Sequence[str], others: Sequence[int]) -> str:
    """The note that names the animations or skins that are not read."""
    listed = ", ".join(quoted(names[i]) if names[i] else str(i) for i in others[:MAX_NAMES])
    listed += ", …" if len(others) > MAX_NAMES else ""
    name = f"{read} {quoted(names[read])}" if names[read] else f"{read}"
    return f"{kind} {name} is read, {reason}; not read: {listed} (--{kind})"


def quoted(name: str) -> str:
    """A name for a message, at most 40 characters."""
    return f'"{name:.40}"'
