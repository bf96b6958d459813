"""Signals within a bound: how large the error of each channel may be, and values that take few bits within it.

    "12bit"                 half a step of 4096 steps over the channel's range
    "0.1%"                  a share of the channel's range
    "Fz*=0.5N, EMG*=12bit"  by label, the first pattern that fits; other channels stay exact

A bound holds for every sample. Bounded are floats, and integers with labels; masks and residuals stay exact.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..channels import signals
from ..errors import BadInput
from ..formats.c3d.analog import scales
from ..motion import Signal
from ..typing import Floats
from . import codec, form_choice, forms, steps
from .forms import Form

Array = NDArray[Any]

AMOUNT = re.compile(r"(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)\s*(\S*)")
PREFIXES = {"k": 1e3, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "n": 1e-9}
BASES = ("N", "V", "m", "Nm", "g", "W", "Pa", "Hz", "s", "A")
UNITS = {"Nmm": ("Nm", 1e-3), "deg": ("deg", 1.0), "rad": ("rad", 1.0), "cm": ("m", 1e-2)}
MOST_BITS = 24
STEP_BITS = 6
"""Bits of a step for floats."""
MOST_OWN_STEPS = 8
"""A bound of more steps of the channel's own does not follow them: it gains little."""
MIX_ROUNDS = 3
"""How often a mix of exact and bounded channels is measured and mended."""


@dataclass(frozen=True)
class Rule:
    """The error of the channels whose label fits a pattern. unit: "bit", "%" or that of the channel."""

    pattern: str
    amount: float
    unit: str


def parse(text: str) -> list[Rule]:
    """The rules of a description. Raises BadInput."""
    rules = []
    for part in text.split(","):
        pattern, equals, amount = part.strip().rpartition("=")
        match = AMOUNT.fullmatch(amount.strip())
        if match is None or (equals and not pattern.strip()):
            raise BadInput(f"signal error {part.strip()!r}: write 12bit, 0.1% or, by label, Fz*=0.5N")
        number, unit = float(match[1]), match[2].removesuffix("s") if match[2] == "bits" else match[2]
        if not number > 0 or (unit == "bit" and not (number == int(number) and number <= MOST_BITS)):
            raise BadInput(
                f"signal error {part.strip()!r}: must be above zero, and bits whole numbers up to {MOST_BITS}"
            )
        if not equals and unit not in ("bit", "%"):
            raise BadInput(
                f"signal error {part.strip()!r}: give all channels bits or a percentage of their range, or name the "
                f"channels that have this unit, such as Fz*={part.strip()}"
            )
        rules.append(Rule(pattern.strip() or "*", number, unit))
    return rules


def is_relative(text: str) -> bool:
    """Whether a description refers to the range of channels."""
    return bool(text) and any(rule.unit in ("bit", "%") for rule in parse(text))


def bounds(extras: Mapping[str, Any], text: str) -> dict[str, list[float | None]]:
    """The largest error of each channel of each signal, in the unit of its samples; None for exact ones.

    Raises BadInput for a pattern that fits no channel, and a unit that is not that of the channel.
    """
    rules = parse(text)
    used: set[int] = set()
    result: dict[str, list[float | None]] = {}
    for name, signal in signals(extras):
        if (
            (signal.dtype.kind in "iu" and not signal.labels)
            or signal.dtype.kind not in "iuf"
            or signal.dtype.itemsize < 2
        ):
            continue
        table = np.asarray(signal.values).reshape(signal.shape[0], -1)
        factors = scales(extras, table.shape[1]) if name == "analog" else np.ones(table.shape[1])
        result[name] = []
        for number in range(table.shape[1]):
            label = signal.labels[number] if number < len(signal.labels) else name
            unit = signal.units[number] if number < len(signal.units) else ""
            rule = next((i for i, rule in enumerate(rules) if fnmatchcase(label, rule.pattern)), None)
            used |= set() if rule is None else {rule}
            bound = None if rule is None else _bound(rules[rule], table[:, number], label, unit, abs(factors[number]))
            result[name].append(bound)
    for i, rule in enumerate(rules):
        if i not in used and rule.pattern != "*":
            raise BadInput(f"signal error: no channel has a label like {rule.pattern!r}")
    return result


def _bound(rule: Rule, values: Array, label: str, unit: str, factor: float) -> float | None:
    """The bound of one channel, in the unit of its samples; factor: their physical unit in one of theirs."""
    if rule.unit not in ("bit", "%"):
        return rule.amount * _in_unit(rule.unit, unit, label) / factor if factor else None
    finite = values[np.isfinite(values)].astype(np.float64)
    extent = float(np.ptp(finite)) if len(finite) else 0.0
    bound = extent / 2 ** (rule.amount + 1) if rule.unit == "bit" else extent * rule.amount / 100
    return bound or None


def _in_unit(given: str, unit: str, label: str) -> float:
    """The factor from a given unit to that of a channel."""
    if not given or given.lower() == unit.strip().lower():
        return 1.0
    (base, size), (of_channel, unit_size) = _base(given), _base(unit.strip())
    if base != of_channel or not base:
        has = f"the unit {unit.strip()!r}, not" if unit.strip() else "no unit, so its error cannot be in"
        raise BadInput(f"signal error: channel {label!r} has {has} {given!r}; choose channels by a longer label")
    return size / unit_size


def _base(unit: str) -> tuple[str, float]:
    """The base unit of a unit, and its size in it: kN is 1000 N."""
    if unit in UNITS:
        return UNITS[unit]
    if unit in BASES:
        return unit, 1.0
    if unit[:1] in PREFIXES and unit[1:] in BASES:
        return unit[1:], PREFIXES[unit[0]]
    return unit, 1.0


def bounded(extras: Mapping[str, Any], text: str) -> dict[str, Any]:
    """Extras with each bounded channel at multiples of a step: its samples are within the bound. Raises BadInput."""
    allowed = bounds(extras, text)

    def changed(tree: Mapping[str, Any]) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for name, value in tree.items():
            if isinstance(value, Signal) and name in allowed:
                result[name] = _on_steps(value, allowed[name])
            else:
                result[name] = changed(cast("Mapping[str, Any]", value)) if isinstance(value, Mapping) else value
        return result

    return changed(extras)


def _on_steps(signal: Signal, allowed: list[float | None]) -> Signal:
    """The signal with the bounded channels on steps, but for those that take fewer bytes as they are: counts with large
    steps, and what follows from other channels exactly."""
    exact = np.array(signal.values).reshape(signal.shape[0], -1)
    table = exact.copy()
    for number, bound in enumerate(allowed):
        if bound is not None:
            steps = _integers_on_steps if table.dtype.kind in "iu" else _floats_on_steps
            table[:, number] = steps(np.ascontiguousarray(table[:, number]), bound)
    if codec.suits(exact):
        table = _shortest_mix(exact, table, float(signal.rate))
    return replace(signal, values=table.reshape(signal.shape))


def _shortest_mix(exact: Array, bounded: Array, rate: float) -> Array:
    """Channels (samples, channels) of `exact` where they are shorter, otherwise of `bounded`.

    A channel may be short only beside others that are exact, so the mix is measured again and mended.
    """
    sizes = [codec.channel_sizes(values, rate) for values in (exact, bounded)]
    if sizes[0] is None or sizes[1] is None:
        return bounded
    of_exact, of_bounded = (np.array(size) for size in sizes)
    best, least = (exact, of_exact.sum()) if of_exact.sum() <= of_bounded.sum() else (bounded, of_bounded.sum())
    keep = of_exact <= of_bounded
    for _ in range(MIX_ROUNDS):
        if keep.all() or not keep.any():
            break
        mix = np.where(keep, exact, bounded)
        found = codec.channel_sizes(mix, rate)
        if found is None:
            break
        of_mix = np.array(found)
        if of_mix.sum() < least:
            best, least = mix, of_mix.sum()
        longer = keep & (of_mix > of_bounded)
        if not longer.any():
            break
        keep &= ~longer
    return best


def _integers_on_steps(values: Array, bound: float) -> Array:
    """Multiples of the largest odd step that keeps all values in the range of their type."""
    limits = np.iinfo(values.dtype)
    whole = values.astype(object if values.dtype.itemsize == 8 else np.int64)
    for step in range(2 * int(bound) + 1, 0, -2):
        rounded = (whole + step // 2) // step * step
        if rounded.min() >= limits.min and rounded.max() <= limits.max:
            return rounded.astype(values.dtype)
    return values


def _floats_on_steps(values: Array, bound: float) -> Array:
    """Multiples of the largest step that keeps the error below the bound after rounding to the type."""
    exact = values.astype(np.float64)
    finite = exact[np.isfinite(exact)]
    rounding = float(np.spacing(np.abs(finite).max(initial=0.0).astype(values.dtype)))
    step = _step_of_few_bits(2 * bound - 2 * rounding, rounding)
    own = _own_steps(values, bound, rounding)
    if own is not None and own.step > step:
        on_own = _within(forms.rounded(own, values), values, bound)
        if np.array_equal(on_own, values, equal_nan=True):
            return values
        found = form_choice.fit(on_own, [])
        if found is not None and found.kind == forms.COUNTS:
            return on_own
    if not step > rounding:
        return values
    return _within(forms.rounded(Form(forms.COUNTS, step), values), values, bound)


def _step_of_few_bits(step: float, rounding: float) -> float:
    """The next lower step of up to STEP_BITS bits whose multiples are exact in the type of the values, so that decoders
    find the step from them. rounding: the last bit of the largest value.
    """
    mantissa, exponent = np.frexp(step)
    bits = int(np.clip(exponent - np.frexp(rounding)[1], 1, STEP_BITS))
    return float(np.ldexp(np.floor(np.ldexp(mantissa, bits)), int(exponent) - bits))


def _own_steps(values: Array, bound: float, rounding: float) -> Form | None:
    """Counts, or odd multiples of them, that are within the bound everywhere; None if the values are no counts."""
    usual = values[np.isfinite(values) & (values != 0)]
    best, least = None, np.inf
    for form in form_choice.count_forms(values, steps.binary(values, forms.MANTISSA_BITS[values.dtype.itemsize])):
        deviation = float(np.abs(forms.rounded(form, usual).astype(np.float64) - usual).max(initial=0.0))
        spare = bound - deviation - rounding
        are_counts = spare >= 0 and deviation < form.step / 8 and bound < MOST_OWN_STEPS * form.step
        if are_counts and deviation < least:
            least = deviation
            best = Form(forms.COUNTS, form.step * (2 * int(spare / form.step) + 1), form.offset)
    return best


def _within(rounded: Array, values: Array, bound: float) -> Array:
    """Rounded values where they are within the bound, otherwise the values."""
    with np.errstate(all="ignore"):
        within = np.abs(rounded.astype(np.float64) - values.astype(np.float64)) <= bound
    return np.where(within, rounded, values)


def broken(source: Mapping[str, Any], decoded: Mapping[str, Any], text: str) -> Iterator[str]:
    """In words, each bounded signal of the source that is not decoded within its bounds."""
    found = dict(signals(decoded))
    for name, allowed in bounds(source, text).items():
        signal = dict(signals(source))[name]
        other = found.get(name)
        if other is None or (other.shape, other.dtype, other.rate) != (signal.shape, signal.dtype, signal.rate):
            yield f"the signal {name} is missing or has another shape"
            continue
        wanted, got = (np.asarray(s.values).reshape(s.shape[0], -1) for s in (signal, other))
        for number, bound in enumerate(allowed):
            label = signal.labels[number] if number < len(signal.labels) else name
            error = largest_error(wanted[:, number], got[:, number])
            if error > (bound or 0.0):
                yield f"{label} is off by {error:.4g}, allowed are {bound or 0.0:.4g}"


def largest_error(wanted: Array, got: Array) -> float:
    """The largest difference; infinite where only one is a number."""
    with np.errstate(all="ignore"):
        difference: Floats = np.abs(wanted.astype(np.float64) - got.astype(np.float64))
    same = (wanted == got) | (np.isnan(wanted) & np.isnan(got))
    difference = np.where(same, 0.0, np.where(np.isnan(difference), np.inf, difference))
    return float(difference.max(initial=0.0))
