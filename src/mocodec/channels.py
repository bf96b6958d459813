"""Signals by label: one channel of a recording's signals, read for the samples that are asked for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .errors import BadInput
from .motion import Signal
from .selection import counted

Array = NDArray[Any]


class Channel:
    """One channel of a signal: `channel[a:b]` are its samples as an array; of a file, only these are read.

    signal: it and its rate; number: of the channel, over all axes of the signal but the first.
    """

    def __init__(self, signal: Signal, number: int, label: str) -> None:
        self.signal = signal
        self.number = number
        self.label = label

    @property
    def rate(self) -> float:
        """Samples per second."""
        return self.signal.rate

    @property
    def unit(self) -> str:
        """The unit of its values, as the recording names it, or ""."""
        return self.signal.units[self.number] if self.number < len(self.signal.units) else ""

    def __len__(self) -> int:
        """The number of samples."""
        return self.signal.shape[0]

    def __repr__(self) -> str:
        unit = f", {self.unit}" if self.unit else ""
        return f"<Channel {self.label!r}: {counted(len(self), 'sample')} at {self.rate:g} Hz{unit}>"

    def __getitem__(self, key: int | slice) -> Any:
        """A sample, or an array of samples (samples,). Raises IndexError; from a file also Corrupt and Truncated."""
        if isinstance(key, slice):
            start, stop, step = key.indices(len(self))
            if step < 0:
                return self[: start + 1][::-1][: max(0, start - stop)][::-step]
            return self.signal.channel(self.number, start, max(start, stop))[::step]
        place = range(len(self))[key]
        return self.signal.channel(self.number, place, place + 1)[0]

    def at(self, seconds: slice) -> Array:
        """The samples whose time (sample / rate) is in [start, stop) seconds. Raises BadInput for a step or below 0."""
        if not isinstance(cast(object, seconds), slice) or seconds.step is not None:
            raise BadInput("times are chosen by a slice without a step, such as channel.at(seconds=slice(10.0, 11.0))")
        return self[self._sample(seconds.start) : self._sample(seconds.stop)]

    def _sample(self, second: float | None) -> int | None:
        if second is None:
            return None
        if not second >= 0:
            raise BadInput(f"times count from the first frame and start at 0, not {second}")
        return min(math.ceil(second * self.rate - 1e-6), len(self))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.asarray(self[:], dtype)


def channels(extras: Mapping[str, Any]) -> dict[str, Channel]:
    """All channels of the signals in extras, by label.

    A channel without a label has the name of its signal and its number ("residuals 3"); a label that occurs more than
    once has a number from the second time on ("Voltage (2)").
    """
    result: dict[str, Channel] = {}
    for name, signal in signals(extras):
        for number in range(math.prod(signal.shape[1:])):
            label = signal.labels[number] if number < len(signal.labels) else ""
            label = label or f"{name} {number + 1}"
            times = 2
            unique = label
            while unique in result:
                unique, times = f"{label} ({times})", times + 1
            result[unique] = Channel(signal, number, unique)
    return result


def signals(extras: Mapping[str, Any]) -> Iterator[tuple[str, Signal]]:
    """All signals in extras with their names, also in nested mappings."""
    for name, value in extras.items():
        if isinstance(value, Signal):
            yield name, value
        elif isinstance(value, Mapping):
            yield from signals(cast("Mapping[str, Any]", value))
