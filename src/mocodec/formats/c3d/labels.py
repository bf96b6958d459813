"""Labels of a C3D: unique names inside, the originals in the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def unique_names(labels: Sequence[str], points: int) -> tuple[tuple[str, ...], dict[str, str]]:
    """A unique name for each point, and the original label of each name that differs from it.

    Empty labels become P1, P2, … by their number, repeated ones get a suffix: LASI, LASI_2.
    """
    labels = [*labels[:points], *[""] * (points - len(labels))]
    taken = set(labels)
    seen: set[str] = set()
    names: list[str] = []
    originals: dict[str, str] = {}
    for number, label in enumerate(labels, 1):
        name = label
        if not label or label in seen:
            stem, suffix = (label, 2) if label else (f"P{number}", 1)
            name = f"{stem}_{suffix}" if label else stem
            while name in taken or name in seen:
                suffix += 1
                name = f"{stem}_{suffix}"
            originals[name] = label
        seen.add(name)
        names.append(name)
    return tuple(names), originals


def original_labels(names: Sequence[str], source: Mapping[str, Any]) -> list[str]:
    """The inverse of `unique_names`: labels as the source had them."""
    originals = source.get("labels")
    if not isinstance(originals, Mapping):
        return list(names)
    return [str(originals.get(name, name)) for name in names]
