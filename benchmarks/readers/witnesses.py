"""Readings of one file by mocodec and by independent readers, in a common form (`READERS`)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mocodec import formats
from mocodec.errors import BadInput
from mocodec.formats import c3d
from mocodec.formats.c3d.labels import original_labels
from mocodec.formats.c3d.model_outputs import merge
from mocodec.formats.c3d.parameters import Parameters
from mocodec.formats.conventions import first_frame, start_s, unit_of
from mocodec.motion import Motion, Signal
from mocodec.typing import Floats

from ..packages import needs


class Reading(NamedTuple):
    """One reader's view of a file.

    positions (frames, points, 3): in the file's unit, NaN in gaps. rates: hertz, of frames and of analog samples (0:
    none). analog (samples, channels): physical values. events: label and time, seconds from frame 1. start: time of
    the first frame, seconds; NaN if the format has none. frames: number of the first frame.
    """

    labels: list[str]
    first_frame: int
    start: float
    rates: tuple[float, float]
    positions: Floats
    analog: Floats
    events: list[tuple[str, float]]


def with_mocodec(path: Path, **options: Any) -> Reading:
    """The reading of mocodec, with the model outputs of a C3D back in their columns. options: of `formats.read`."""
    motion = formats.read(path, **options)
    if not isinstance(motion, Motion):
        raise BadInput("holds point clouds")
    block = np.zeros((len(motion), motion.points, 4))
    block[:, :, :3] = motion.positions / unit_of(motion.source)
    labels = original_labels(motion.names, motion.source)
    if "model_outputs" in motion.extras:
        block, labels = merged(motion, block, labels)
    signal = motion.extras.get("analog")
    analog = c3d.analog(motion) if isinstance(signal, Signal) else np.empty((0, 0))
    analog_rate = signal.rate if isinstance(signal, Signal) else 0.0
    first = first_frame(motion.source)
    events = [
        (str(event["label"]), event["time_s"] + (first - 1) / motion.rate) for event in motion.extras.get("events", ())
    ]
    start = start_s(motion.source, motion.rate) if path.suffix == ".trc" else math.nan
    return Reading(labels, first, start, (motion.rate, analog_rate), block[:, :, :3], analog, events)


def merged(motion: Motion, block: Floats, labels: list[str]) -> tuple[Floats, list[str]]:
    """Samples (frames, points, 4) and labels, with the model outputs in their original columns."""
    columns = motion.extras["model_outputs"]["columns"].tolist()
    narrow, all_labels = merge(motion, block.astype("<f4"), labels, Parameters({"POINT": {}}))
    wide = narrow.astype(np.float64)
    wide[wide[:, :, 3] < 0] = np.nan
    markers = [column for column in range(wide.shape[1]) if column not in set(columns)]
    wide[:, markers] = block  # 64-bit, as read
    return wide, all_labels


def with_ezc3d(path: Path) -> Reading:
    """The reading of ezc3d (https://github.com/pyomeca/ezc3d)."""
    file = needs("ezc3d").c3d(str(path))
    header, parameters = file["header"], file["parameters"]
    points = file["data"]["points"][:3].transpose(2, 1, 0)
    analog = file["data"]["analogs"][0].T
    rates = float(header["points"]["frame_rate"]), float(header["analogs"]["frame_rate"]) if analog.size else 0.0
    group = parameters.get("EVENT", {})
    times = np.asarray(group.get("TIMES", {}).get("value", np.empty((2, 0)))).reshape(2, -1)
    labels = group.get("LABELS", {}).get("value", [])
    events = [(label, 60.0 * m + s) for label, m, s in zip(labels, *times.tolist(), strict=False)]
    first = int(header["points"]["first_frame"]) + 1
    names = [*parameters["POINT"].get("LABELS", {}).get("value", [])]
    return Reading(names, first, math.nan, rates, points, analog if analog.size else np.empty((0, 0)), events)


def with_py_c3d(path: Path) -> Reading:
    """The reading of py-c3d (https://github.com/EmbodiedCognition/py-c3d)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with path.open("rb") as stream:
            reader = needs("c3d").Reader(stream)
            frames = [(points.copy(), analog.copy()) for _, points, analog in reader.read_frames(copy=True)]
            named = reader.get("POINT:LABELS")
            names = [] if named is None else [str(label).strip() for label in reader.point_labels]
            events = _py_events(reader)
    samples = np.array([points for points, _ in frames], np.float64)
    positions = samples[:, :, :3]
    positions[samples[:, :, 3] < 0] = np.nan
    has_analog = frames and frames[0][1].size
    analog = np.concatenate([values.T for _, values in frames]) if has_analog else np.empty((0, 0))
    rates = float(reader.point_rate), float(reader.analog_rate) if has_analog else 0.0
    return Reading(names, int(reader.first_frame), math.nan, rates, positions, analog.astype(np.float64), events)


def _py_events(reader: Any) -> list[tuple[str, float]]:
    times, labels = reader.get("EVENT:TIMES"), reader.get("EVENT:LABELS")
    if times is None or labels is None or not times.total_bytes:
        return []
    pairs = np.asarray(times.float_array).reshape(-1, 2).tolist()
    texts = np.ravel(labels.string_array).tolist()
    return [(str(label).strip(), 60.0 * m + s) for label, (m, s) in zip(texts, pairs, strict=False)]


def by_splitting(path: Path) -> Reading:
    """Reads a TRC by splitting lines at tabs: every third column has a name; a cell without a number is a gap."""
    lines = path.read_text("latin-1").splitlines()
    keys = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    names = [cell.strip() for cell in lines[3].split("\t")[2::3]]
    rows = [line.split("\t") for line in lines[5:] if line.strip()]
    columns = max((at for row in rows for at, cell in enumerate(row) if cell.strip()), default=1) - 1
    names = [*names, *[""] * columns][: max(len([name for name in names if name]), -(-columns // 3))]
    positions = np.full((len(rows), len(names), 3), np.nan)
    for row, cells in enumerate(rows):
        for at in range(len(names)):
            texts = [text.strip() for text in cells[2 + 3 * at : 5 + 3 * at]]
            if len(texts) == 3 and all(texts):
                positions[row, at] = [float(text) for text in texts]
    declared = int(keys["NumFrames"])
    if declared != len(rows):
        raise BadInput(f"declares {declared} frames, has {len(rows)} rows")
    rates = float(keys["DataRate"]), 0.0
    return Reading(names, int(rows[0][0]), float(rows[0][1]), rates, positions, np.empty((0, 0)), [])


READERS: Mapping[str, Mapping[str, Callable[[Path], Reading]]] = {
    ".c3d": {"mocodec": with_mocodec, "ezc3d": with_ezc3d, "py-c3d": with_py_c3d},
    ".trc": {"mocodec": with_mocodec, "splitting": by_splitting},
}
"""The readers of each suffix; mocodec first."""
