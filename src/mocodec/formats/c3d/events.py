"""Events of a C3D: those of the EVENT group, in every shape that programs write, and up to 18 in the header."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np

from ...errors import BadInput
from ...typing import Floats
from .parameters import EVENT_FIELDS, HEADER_EVENTS, Parameters, counts, encoded, floats, text


def read_events(parameters: Parameters, notes: list[str]) -> list[dict[str, Any]]:
    """Events of the EVENT group; `time_s` counts from frame 1. What is not read is noted.

    EVENT:USED may be missing; TIMES may be a table (minutes, seconds), a list or a single number, and may continue in
    TIMES2, …, as LABELS does.
    """
    group = parameters.groups.get("EVENT", {})
    labels = parameters.texts("EVENT", "LABELS")
    used = parameters.count("EVENT", "USED")
    times = _times(parameters, len(labels) if used is None else used)
    if used is not None and used < len(times) == len(labels) and used == len(times) & 0xFF:
        used = len(times)  # counted in one byte
    if used is not None and used < len(times):
        notes.append(f"EVENT:USED is {used}, EVENT:TIMES has {len(times)} events: the first {used} are read")
    columns: dict[str, Any] = {}
    for name, key in EVENT_FIELDS.items():
        is_number = isinstance(group.get(name), np.ndarray)
        columns[key] = parameters.numbers("EVENT", name).tolist() if is_number else parameters.texts("EVENT", name)
    events: list[dict[str, Any]] = []
    for i, (minutes, seconds) in enumerate(times[: len(times) if used is None else used].tolist()):
        if not math.isfinite(minutes + seconds):
            continue
        event: dict[str, Any] = {"label": "", "time_s": 60.0 * minutes + seconds}
        event |= {key: values[i] for key, values in columns.items() if i < len(values) and values[i]}
        events.append(event | ({"minutes": int(minutes)} if minutes else {}))
    return events


def _times(parameters: Parameters, expected: int) -> Floats:
    """(events, 2): minutes and seconds. expected: the number of events by labels or EVENT:USED."""
    tables = [_table(value, expected) for value in parameters.chain("EVENT", "TIMES")]
    return np.concatenate([np.empty((0, 2)), *tables])


def _table(value: Any, expected: int) -> Floats:
    """One parameter TIMES as (events, 2)."""
    if not isinstance(value, np.ndarray) or not value.size:
        return np.empty((0, 2))
    numbers = value.astype(np.float64)
    while numbers.ndim > 2 and 1 in numbers.shape:
        numbers = numbers.squeeze(axis=numbers.shape.index(1))
    if numbers.ndim > 2:
        return np.empty((0, 2))
    if numbers.shape == (2, 2) and _are_minutes(numbers[:, 0]) and not _are_minutes(numbers[0]):
        return numbers
    if numbers.ndim == 2 and numbers.shape[0] == 2:
        return numbers.T
    if numbers.ndim == 2 and numbers.shape[1] == 2:
        return numbers
    numbers = numbers.ravel()
    if numbers.size == 2 * expected or (numbers.size == 2 and expected != 2):
        return numbers.reshape(-1, 2)
    return np.stack([np.zeros(numbers.size), numbers], axis=1)


def _are_minutes(numbers: Floats) -> bool:
    """Whether the numbers are minutes, which are whole."""
    return bool((numbers == np.rint(numbers)).all())


def read_header_events(data: bytes, words: tuple[int, ...], processor: int) -> list[dict[str, Any]]:
    """Events of the header; `time_s` counts from frame 1."""
    if words[149] != HEADER_EVENTS:
        return []
    times = floats(data[304:376], processor).tolist()
    return [
        {"label": text(data[396 + 4 * i : 400 + 4 * i]), "time_s": times[i], "in_header": data[376 + i]}
        for i in range(min(words[150], 18))
        if math.isfinite(times[i])
    ]


def put_events(parameters: Parameters, events: list[Any], offset_s: float) -> list[Any]:
    """Store events in the EVENT group, 255 to a parameter; returns those of the header. offset_s: added to `time_s`."""
    in_header = [event for event in events if "in_header" in event][:18]
    events = [event for event in events if "in_header" not in event]
    if len(events) > 0xFFFF:
        raise BadInput(f"a C3D holds 65535 events, not {len(events)}")
    if not events:
        return in_header
    group = parameters.groups.setdefault("EVENT", {})
    group["USED"] = counts(len(events))
    minutes = [event.get("minutes", 0) for event in events]
    seconds = [event["time_s"] + offset_s - 60.0 * m for event, m in zip(events, minutes, strict=True)]
    parameters.set_chain("EVENT", "TIMES", np.array([minutes, seconds], np.float32))
    for name, key in EVENT_FIELDS.items():
        if not any(key in event for event in events) and name != "LABELS":
            continue
        if key in ("icon_id", "generic_flag"):
            parameters.set_chain("EVENT", name, np.array([event.get(key, 0) for event in events], np.int16))
        else:
            parameters.set_texts("EVENT", name, [str(event.get(key, "")) for event in events])
    return in_header


def put_header_events(header: bytearray, events: list[Any], offset_s: float) -> None:
    """Store up to 18 events in the header."""
    struct.pack_into("<HH", header, 298, HEADER_EVENTS, len(events))
    for i, event in enumerate(events):
        struct.pack_into("<f", header, 304 + 4 * i, event["time_s"] + offset_s)
        header[376 + i] = event["in_header"]
        header[396 + 4 * i : 400 + 4 * i] = encoded(event["label"], 4).ljust(4)
