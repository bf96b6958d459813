"""Analog channels of a C3D: converter counts as stored, and their physical values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ...motion import Motion, Signal
from ...typing import Floats
from .layout import Layout
from .parameters import Parameters


def read_analog(table: NDArray[Any], layout: Layout, rate: float, parameters: Parameters) -> Signal:
    """Analog samples as the file stores them (counts); table (frames, samples of all channels); rate: of frames."""
    samples = np.ascontiguousarray(table).reshape(-1, layout.channels)
    if layout.item == 4:
        samples = smallest(samples, np.uint16 if is_unsigned(parameters) else np.int16)
    else:
        samples = samples.astype(np.int16)
        samples = samples.view(np.uint16) if is_unsigned(parameters) else samples
    return analog_signal(samples, rate, layout, parameters)


def analog_signal(samples: NDArray[Any], rate: float, layout: Layout, parameters: Parameters) -> Signal:
    """Samples of all channels with their labels and units; rate: of frames."""
    labels, units = (tuple(parameters.texts("ANALOG", name)[: layout.channels]) for name in ("LABELS", "UNITS"))
    return Signal(samples, rate * layout.samples_per_frame, labels, units)


def note_analog_rate(parameters: Parameters, rate: float, layout: Layout, notes: list[str]) -> None:
    """Note that ANALOG:RATE differs from the samples that the file has in a frame. rate: of frames."""
    declared, counted = parameters.number("ANALOG", "RATE"), rate * layout.samples_per_frame
    if declared and not abs(declared - counted) <= 1e-3 * counted:
        notes.append(
            f"ANALOG:RATE is {declared:g} Hz; {layout.samples_per_frame} samples in each frame at {rate:g} Hz give "
            f"{counted:g} Hz, which is used"
        )


def is_unsigned(parameters: Parameters) -> bool:
    """Whether analog samples and offsets are unsigned: ANALOG:FORMAT says so for integer and float files."""
    return "".join(parameters.texts("ANALOG", "FORMAT")).strip().upper() == "UNSIGNED"


def smallest(values: NDArray[Any], dtype: type[np.integer[Any]] = np.int16) -> NDArray[Any]:
    """The values in this 16-bit type if all of them are such whole numbers, otherwise as float32."""
    with np.errstate(invalid="ignore"):
        whole = values.astype(dtype)
    is_exact = np.array_equal(whole, values) and not np.signbit(values[values == 0]).any()
    return whole if is_exact else values.astype(np.float32)


def analog(motion: Motion) -> Floats:
    """Analog samples in physical units (samples, channels): (count − OFFSET) × SCALE × GEN_SCALE.

    SCALE and OFFSET of channels 256 and up are in SCALE2, OFFSET2, …. Raises BadInput if the motion has none.
    """
    signal = motion.extras.get("analog")
    if not isinstance(signal, Signal):
        raise BadInput("this motion has no analog channels")
    channels = signal.values.shape[1]
    return (signal.values - _by_channel(motion.extras, channels, "OFFSET", 0.0)) * scales(motion.extras, channels)


def scales(extras: Mapping[str, Any], channels: int) -> Floats:
    """SCALE × GEN_SCALE of each analog channel (channels,): its physical unit in one count."""
    general = Parameters(dict(extras.get("parameters", {}))).number("ANALOG", "GEN_SCALE")
    return _by_channel(extras, channels, "SCALE", 1.0) * (1.0 if general is None else general)


def _by_channel(extras: Mapping[str, Any], channels: int, name: str, default: float) -> Floats:
    parameters = Parameters(dict(extras.get("parameters", {})))
    values = parameters.numbers("ANALOG", name)[:channels].astype(np.float64)
    if name == "OFFSET" and is_unsigned(parameters):
        values %= 65536  # stored in signed words
    return np.concatenate([values, np.full(channels - len(values), default)])
