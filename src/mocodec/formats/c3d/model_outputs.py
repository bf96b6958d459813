"""Model outputs of a C3D: joint angles, forces, moments, powers and scalars in the columns of points.

    columns of points ─► listed in POINT:ANGLES, MOMENTS, …? ── no ──► markers, coded as positions
                                                             └─ yes ─► `extras["model_outputs"]`, stored exactly

Vicon's models store three values a frame of each output as if they were the coordinates of a point, in their own unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ...motion import Motion, Signal
from ...typing import Floats
from ..conventions import metres_in
from .parameters import Parameters

KINDS = {
    "ANGLES": ("ANGLE", "deg"),
    "FORCES": ("FORCE", "N"),
    "MOMENTS": ("MOMENT", "Nmm"),
    "POWERS": ("POWER", "W"),
    "SCALARS": ("SCALAR", ""),
    "REACTIONS": ("REACTION", "N"),
}
"""Parameters of POINT that list the labels of outputs: the prefix of the parameter with their unit (ANGLE_UNITS), and
the unit if there is none."""


def find_columns(parameters: Parameters, labels: Sequence[str]) -> dict[str, list[int]]:
    """The columns of points that are outputs, by the name of the parameter that lists their labels.

    Lists that POINT:TYPE_GROUPS names count too, unless their unit is one of length: those are positions.
    """
    by_label: dict[str, list[int]] = {}
    for column, label in enumerate(labels):
        if label:
            by_label.setdefault(label, []).append(column)
    without_subject: dict[str, list[int]] = {}
    for label, columns in by_label.items():
        if label.rpartition(":")[2] != label:
            without_subject.setdefault(label.rpartition(":")[2], []).extend(columns)
    found: dict[str, list[int]] = {}
    taken: set[int] = set()
    for kind in _kinds(parameters):
        columns = [
            column
            for label in parameters.texts("POINT", kind)
            for column in by_label.get(label, without_subject.get(label, ()))
        ]
        if columns := sorted(set(columns) - taken):
            found[kind] = columns
            taken.update(columns)
    return found


def _kinds(parameters: Parameters) -> list[str]:
    """The parameters of POINT that list outputs."""
    kinds = list(KINDS)
    for kind in _type_groups(parameters):
        unit = _unit(parameters, kind)
        if kind not in KINDS and unit and metres_in(unit) is None:
            kinds.append(kind)
    return kinds


def _type_groups(parameters: Parameters) -> dict[str, str]:
    """POINT:TYPE_GROUPS, pairs of a parameter and the prefix of its unit, as a dict."""
    groups: dict[str, str] = {}
    for value in parameters.chain("POINT", "TYPE_GROUPS"):
        if not isinstance(value, list):
            continue
        rows = [row for row in value if isinstance(row, list)]
        if not rows:
            rows = [list(pair) for pair in zip(value[::2], value[1::2], strict=False)]
        elif len(rows) == 2 and len(rows[0]) != 2:
            rows = [list(pair) for pair in zip(*rows, strict=False)]
        for row in rows:
            if len(row) >= 2 and isinstance(row[0], str) and isinstance(row[1], str) and row[0]:
                groups[row[0].upper()] = row[1].upper()
    return groups


def _unit(parameters: Parameters, kind: str) -> str:
    """The unit of a kind of outputs: POINT:ANGLE_UNITS for ANGLES, or the usual one, or ""."""
    prefix, usual = KINDS.get(kind, ("", ""))
    prefix = _type_groups(parameters).get(kind, prefix)
    return next(iter(parameters.texts("POINT", f"{prefix}_UNITS")), "") or usual


def output_values(samples: NDArray[Any], columns: Sequence[int], scale: float) -> NDArray[np.float32]:
    """(frames, outputs, 3): the coordinates of some columns. samples (frames, points, 4); scale: of coordinates."""
    values = samples[:, columns, :3]
    with np.errstate(invalid="ignore", over="ignore"):
        return (values if scale == 1.0 else values * np.float64(scale)).astype(np.float32)


def keep(
    parameters: Parameters,
    found: Mapping[str, Sequence[int]],
    labels: Sequence[str],
    values: Mapping[str, NDArray[np.float32]],
    words: NDArray[Any],
    rate: float,
    source: dict[str, Any],
    extras: dict[str, Any],
) -> None:
    """Store the outputs in `extras["model_outputs"]`, bit for bit.

    found: from `find_columns`. values: from `output_values` for each kind; words (frames, outputs): the fourth words of
    all, kind after kind.
    signals: a `Signal` (frames, outputs, 3) for each kind. columns: of all outputs, in the order of the signals.
    words: if any differs from 0, negative in gaps.
    """
    columns = [column for kind in found for column in found[kind]]
    if not columns:
        return
    signals: dict[str, Signal] = {}
    for kind, of_kind in found.items():
        texts = tuple(labels[column] for column in of_kind)
        signals[kind] = Signal(values[kind], rate, texts, (_unit(parameters, kind),) * len(texts))
    outputs: dict[str, Any] = {"signals": signals, "columns": np.array(columns, np.uint16)}
    if any(column.any() or np.signbit(column).any() for column in words.T):
        outputs["words"] = Signal(words, rate)
    extras["model_outputs"] = outputs
    source["model_outputs"] = {
        f"{kind.lower()} ({signal.units[0]})" if signal.units[0] else kind.lower(): signal.shape[1]
        for kind, signal in signals.items()
    }


def model_outputs(motion: Motion) -> dict[str, Floats]:
    """Joint angles, forces, moments, powers and scalars of a motion by label, each (frames, 3), NaN where missing.

    Their units are those of the signals in `motion.extras["model_outputs"]["signals"]`. Empty for a motion without.
    """
    kept = _kept(motion)
    if kept is None:
        return {}
    signals, _, words = kept
    labels = [label for signal in signals.values() for label in signal.labels]
    values = np.concatenate([signal.values for signal in signals.values()], axis=1).astype(np.float64)
    values[words < 0] = np.nan
    return {label: values[:, at] for at, label in enumerate(labels)}


def _kept(motion: Motion) -> tuple[dict[str, Signal], list[int], NDArray[Any]] | None:
    """Signals by kind, columns and words (frames, outputs) of the outputs; None for a motion without."""
    kept = motion.extras.get("model_outputs")
    if not isinstance(kept, Mapping):
        return None
    signals: dict[str, Signal] = dict(kept["signals"])
    columns = [int(column) for column in kept["columns"]]
    frames = len(motion)
    words = kept["words"].values if "words" in kept else np.zeros((frames, len(columns)), np.int16)
    counts = [signal.values.shape[1] for signal in signals.values()]
    fits = all(signal.values.shape == (frames, len(signal.labels), 3) for signal in signals.values())
    if not fits or words.shape != (frames, len(columns)) or sum(counts) != len(columns) or not columns:
        raise BadInput(f"the model outputs of this motion do not fit its {frames} frames")
    return signals, columns, words


def merge(
    motion: Motion, block: NDArray[np.float32], labels: list[str], parameters: Parameters
) -> tuple[NDArray[np.float32], list[str]]:
    """Samples (frames, markers, 4) and labels of markers with the outputs put back into their columns.

    Lists of labels and units that the parameters lack are added. Raises BadInput for outputs that do not fit.
    """
    kept = _kept(motion)
    if kept is None:
        return block, labels
    signals, columns, words = kept
    total = block.shape[1] + len(columns)
    taken = set(columns)
    free = [column for column in range(total) if column not in taken]
    spare = free[block.shape[1] :]  # where markers were left out, the last columns are for outputs beyond the end
    at = [column if column < total else spare.pop(0) for column in columns]
    merged = np.empty((len(block), total, 4), "<f4")
    merged[:, free[: block.shape[1]]] = block
    merged[:, at, :3] = np.concatenate([signal.values for signal in signals.values()], axis=1)
    merged[:, at, 3] = words
    texts = [label for signal in signals.values() for label in signal.labels]
    all_labels = [""] * total
    for column, label in zip([*free[: block.shape[1]], *at], [*labels, *texts], strict=True):
        all_labels[column] = label
    found = find_columns(parameters, all_labels)
    of_kind = iter(at)
    for kind, signal in signals.items():
        if found.get(kind) != sorted(islice(of_kind, len(signal.labels))):
            _list_labels(parameters, kind, signal)
    return merged, all_labels


def _list_labels(parameters: Parameters, kind: str, signal: Signal) -> None:
    """Set in the parameters what `find_columns` needs to find these outputs again."""
    parameters.set_texts("POINT", kind, list(signal.labels))
    prefix = KINDS.get(kind, (kind, ""))[0]
    unit = signal.units[0] if signal.units else ""
    if kind not in KINDS:
        pairs = [[*pair] for pair in _type_groups(parameters).items()]
        parameters.groups["POINT"]["TYPE_GROUPS"] = [*pairs, [kind, prefix]]
    if unit:
        parameters.groups["POINT"].setdefault(f"{prefix}_UNITS", unit)
