"""Colours of lattice points: relative to the texture of the body, interpolated along the octree's order, quantised.

    colours, texture ─► YCoCg-R ─► difference / step ─► every 64th point, every 32nd, … every one ─► adaptive bits
                                                        └─ each from the points before and behind it

A step of 1 is lossless. Encoder and decoder run the same function.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ... import native
from ...entropy.bit_arrays import BitCoder
from ...errors import Corrupt
from ...typing import AnyInteger, Booleans, Bytes, Integers, YCoCg

FIRST_STRIDE = 64
UNARY = 24  # magnitudes below are coded bit by bit, larger ones with WIDE_BITS more
WIDE_BITS = 11
MAX_STEP = 64
GREY = np.array([128, 0, 0])  # YCoCg of the prediction without a texture
ZERO_FLAG, SIGN, FIRST_MAGNITUDE = 0, 1, 2  # kinds of bits; then WIDE_KIND for the bits of large magnitudes
WIDE_KIND = FIRST_MAGNITUDE + UNARY
KINDS = WIDE_KIND + WIDE_BITS
CLASS_EDGES = (1, 2, 4, 8, 16)  # of magnitudes
CLASSES = len(CLASS_EDGES) + 1
LEVELS = 7  # strides from 64 to 1
OUT_OF_RANGE = "bodycast: the colour of a point is out of range"


def ycocg_from_rgb(colours: Bytes) -> YCoCg:
    """(n, 3): Y, Co, Cg of YCoCg-R, which integers invert exactly."""
    if (kernel := native.kernel("ycocg_from_rgb")) is not None:
        return np.asarray(kernel(colours))
    red, green, blue = colours.astype(np.int16).T
    co = red - blue
    half = blue + (co >> 1)
    cg = green - half
    return np.stack([half + (cg >> 1), co, cg], axis=1)


def rgb_from_ycocg(values: AnyInteger) -> Bytes:
    """The inverse of `ycocg_from_rgb`, clipped to bytes."""
    if values.dtype == np.int16 and (kernel := native.kernel("rgb_from_ycocg")) is not None:
        return np.asarray(kernel(values))
    y, co, cg = values.T
    half = y - (cg >> 1)
    blue = half - (co >> 1)
    rgb = np.empty((len(blue), 3), np.uint8)
    for column, channel in enumerate((blue + co, cg + half, blue)):
        rgb[:, column] = np.clip(channel, 0, 255)
    return rgb


def quantise(colours: Bytes, predicted: Integers, step: int) -> Integers:
    """(n, 3): differences of colours from predicted YCoCg (n, 3), in steps, rounded to the nearest."""
    difference = ycocg_from_rgb(colours) - predicted
    return np.floor_divide(2 * difference + step, 2 * step)


def dequantise(values: Integers, predicted: Integers, step: int) -> Bytes:
    """The inverse of `quantise`."""
    return rgb_from_ycocg(predicted + values * step)


def code_colours(coder: BitCoder, values: Integers | None, count: int) -> Integers:
    """Code the quantised differences (count, 3) and return them; values: None in the decoder. Raises Corrupt."""
    known = np.zeros((count, 3), np.int64)
    stride, level = FIRST_STRIDE, 0
    while stride:
        rows = np.arange(0, count, stride) if level == 0 else np.arange(stride, count, 2 * stride)
        if len(rows):
            _code_rows(coder, values, known, rows, 0 if level == 0 else stride, level)
        stride //= 2
        level += 1
    return known


def _code_rows(
    coder: BitCoder, values: Integers | None, known: Integers, rows: Integers, reach: int, level: int
) -> None:
    """Code the rows from those at a distance of `reach` before and behind; 0 for no prediction. Changes `known`."""
    before, behind = known[rows - reach], known[np.where(rows + reach < len(known), rows + reach, rows - reach)]
    if not reach:
        before = behind = np.zeros_like(before)
    predicted = (before + behind) >> 1
    apart = _classes(np.abs(before - behind))
    large = _classes(np.abs(before) + np.abs(behind))
    coded = np.zeros(len(rows), np.int64)
    for channel in range(3):
        wanted = None if values is None else values[rows, channel] - predicted[:, channel]
        place = np.stack([np.full(len(rows), channel), apart[:, channel], large[:, channel], coded], axis=1)
        difference = code_integers(coder, wanted, len(rows), partial(_contexts, place, level))
        known[rows, channel] = predicted[:, channel] + difference
        coded = np.maximum(coded, _classes(np.abs(difference)))


def _contexts(place: Integers, level: int, kind: int, rows: Integers) -> tuple[Integers, Integers]:
    """place (n, 4): channel, how far the neighbours are apart, how large they and the channels before are."""
    channel, apart, large, coded = place[rows].T
    base = channel * KINDS + kind
    contexts = (
        base * CLASSES + apart,
        base * CLASSES + coded,
        base * LEVELS + level,
        (base * CLASSES + apart) * CLASSES + coded,
        (base * CLASSES + large) * CLASSES + coded,
    )
    return np.stack(contexts, axis=1), base


def _classes(magnitudes: Integers) -> Integers:
    return np.searchsorted(CLASS_EDGES, magnitudes, side="right")


def code_integers(
    coder: BitCoder, wanted: Integers | None, count: int, contexts: Callable[[int, Integers], tuple[Integers, Integers]]
) -> Integers:
    """Code integers (count,) and return them; wanted: None in the decoder. Raises Corrupt.

    contexts(kind, rows): the contexts (n, 5) and weight sets (n,) of a kind of bits, of the integers `rows` (n,).
    """
    magnitude = None if wanted is None else np.abs(wanted)

    def code(kind: int, rows: Integers, bits: Booleans | None) -> Booleans:
        return coder.code(*contexts(kind, rows), bits)

    rows = np.arange(count)
    found = np.zeros(count, np.int64)
    rows = rows[code(ZERO_FLAG, rows, None if magnitude is None else magnitude > 0)]
    negative = code(SIGN, rows, None if wanted is None else wanted[rows] < 0)
    signs = np.ones(count, np.int64)
    signs[rows[negative]] = -1
    found[rows] = 1
    for size in range(UNARY):
        if not len(rows):
            return found * signs
        rows = rows[code(FIRST_MAGNITUDE + size, rows, None if magnitude is None else magnitude[rows] > size + 1)]
        found[rows] += 1
    for digit in range(WIDE_BITS if len(rows) else 0):
        rest = None if magnitude is None else (magnitude[rows] - (UNARY + 1) >> digit & 1).astype(bool)
        found[rows] += code(WIDE_KIND + digit, rows, rest).astype(np.int64) << digit
    if (found >= 1 << WIDE_BITS).any():
        raise Corrupt(OUT_OF_RANGE)
    return found * signs
