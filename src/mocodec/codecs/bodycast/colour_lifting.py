"""Colours of lattice points, predicted from what earlier frames showed there and from the nearest known points.

    every 64th point, every 32nd, … every one:
        expected colour + share · (mean error of the expectations around) ─► predicted
        colour − predicted ─► / step, with a dead zone ─► adaptive bits

The expectation is the body's surface as `surface_memory` knows it. Points without one are predicted from their
neighbours alone. Each point is predicted from decoded colours, so errors do not add up; steps of 1 are lossless.
Encoder and decoder run the same functions.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ... import native
from ...entropy.bit_arrays import CUT_OFF, BitCoder
from ...errors import Corrupt
from ...typing import Booleans, Integers, YCoCg
from .point_colours import CLASS_EDGES, CLASSES, FIRST_STRIDE, GREY, KINDS, LEVELS, OUT_OF_RANGE, code_integers

WINDOW = 16  # known points along the octree's order among which the nearest are searched
AVERAGED = 4  # nearest known points
WEIGHT_UNIT = 1 << 20
SOFTENING = 2  # added to squared distances, lattice units
SHARE_BITS = 4  # shares of the neighbours' error are in 1/16
FIRST_SHARE = 8
ROUNDING = 96  # of 256: magnitudes are rounded up from 1 − 96/256 of a step on, so zeros are frequent
LARGEST = 511  # of a decoded Y, Co or Cg; lossless ones are within 255
ACTIVITY_EDGES = (1, 2, 3, 5, 8, 12, 18, 28)
ACTIVITIES = len(ACTIVITY_EDGES) + 1


class ColourSteps(NamedTuple):
    """Quantisation steps of luma Y, and of Co and Cg. 1 and 1 are lossless."""

    luma: int
    chroma: int

    @staticmethod
    def of_luma(step: int) -> ColourSteps:
        """Chroma in twice the step: an error of Co or Cg moves red, green and blue about half as far as one of Y."""
        return ColourSteps(step, 2 * step if step > 1 else 1)

    @property
    def of_channels(self) -> tuple[int, int, int]:
        """The steps of Y, Co and Cg."""
        return self.luma, self.chroma, self.chroma


class Neighbourhood(NamedTuple):
    """The surroundings of points before they are coded, each (n, 3): base: the expected colour, or the mean colour of
    the neighbours. correction: mean error of the bases around, zero without a neighbour. activity: mean magnitude of
    these errors. spread: of the neighbours' colours.
    """

    base: Integers
    correction: Integers
    activity: Integers
    spread: Integers


class ColourLifting:
    """Codes the colours of frames, one after the other. The share of the neighbours' error is learned from each frame
    for the next one.
    """

    def __init__(self, steps: ColourSteps) -> None:
        self.steps = steps
        self._share = np.full(3, FIRST_SHARE)
        self._product, self._square = np.zeros(3, np.int64), np.zeros(3, np.int64)

    def code_frame(
        self, coder: BitCoder, wanted: YCoCg | None, cells: Integers, expected: YCoCg, is_expected: Booleans
    ) -> YCoCg:
        """The decoded YCoCg (n, 3) of a frame's points; wanted: those of the data, None in the decoder. Raises Corrupt.

        cells (n, 3): lattice coordinates in the octree's order. expected (n, 3): YCoCg; is_expected (n,): where it is
        known.
        """
        encode, decode = native.kernel("colour_frame_encode"), native.kernel("colour_frame_decode")
        if coder.compiled is not None and encode is not None and decode is not None:
            data = cells, expected, is_expected.view(np.uint8), self._share, np.array(self.steps.of_channels)
            found = decode(coder.compiled, *data) if wanted is None else encode(coder.compiled, wanted, *data)
            known = self._compiled_result(*found)
        else:
            known = self._code_passes(coder, wanted, cells, expected, is_expected).astype(np.int16)
        self._learn()
        return known

    def _compiled_result(self, known: Any, product: Any, square: Any, failure: int) -> YCoCg:
        if failure:
            raise Corrupt(CUT_OFF if failure == 1 else OUT_OF_RANGE)
        self._product, self._square = self._product + product, self._square + square
        return np.asarray(known)

    def _code_passes(
        self, coder: BitCoder, wanted: YCoCg | None, cells: Integers, expected: YCoCg, is_expected: Booleans
    ) -> Integers:
        known, bases = np.zeros((len(cells), 3), np.int64), np.zeros((len(cells), 3), np.int64)
        stride, level = FIRST_STRIDE, 0
        while stride:
            first = level == 0
            rows = np.arange(0 if first else stride, len(cells), stride if first else 2 * stride)
            if len(rows):
                around = _around(known, bases, cells, rows, 0 if first else 2 * stride, expected, is_expected)
                bases[rows] = around.base
                own = is_expected[rows]
                share = np.where(own[:, None], self._share, 0)
                predicted = around.base + (around.correction * share >> SHARE_BITS)
                colours = None if wanted is None else wanted[rows]
                known[rows] = self._code_rows(coder, colours, predicted, around, level)
                self._observe(known[rows][own] - around.base[own], around.correction[own])
            stride //= 2
            level += 1
        return known

    def _code_rows(
        self, coder: BitCoder, wanted: YCoCg | None, predicted: Integers, around: Neighbourhood, level: int
    ) -> Integers:
        """The decoded colours (n, 3): Y of all points, then Co, then Cg."""
        result = np.zeros_like(predicted)
        coded = np.zeros(len(predicted), np.int64)
        for channel, step in enumerate(self.steps.of_channels):
            difference = None
            if wanted is not None:
                difference = wanted[:, channel] - predicted[:, channel]
                rounding = step * ROUNDING >> 8 if step > 1 else 0
                difference = np.sign(difference) * ((np.abs(difference) + rounding) // step)
            activity = np.searchsorted(ACTIVITY_EDGES, 2 * around.activity[:, channel] // step, side="right")
            spread = np.searchsorted(ACTIVITY_EDGES, around.spread[:, channel] // step, side="right")
            place = np.stack([np.full(len(predicted), channel), activity, spread, coded], axis=1)
            difference = code_integers(coder, difference, len(place), partial(_contexts, place, level))
            result[:, channel] = np.clip(predicted[:, channel] + difference * step, -LARGEST - 1, LARGEST)
            coded = np.maximum(coded, np.searchsorted(CLASS_EDGES, np.abs(difference), side="right"))
        return result

    def _observe(self, errors: Integers, corrections: Integers) -> None:
        """errors, corrections (n, 3): of the expected colours, and what was known of them from the neighbours."""
        self._product += (errors * corrections).sum(axis=0)
        self._square += (corrections**2).sum(axis=0)

    def _learn(self) -> None:
        """The shares of the next frame: least squares over this frame, and half as much over those before."""
        unit = 1 << SHARE_BITS
        share = (unit * self._product + self._square // 2) // np.maximum(self._square, 1)
        self._share = np.where(self._square > 0, np.clip(share, 0, unit), self._share)
        self._product, self._square = self._product // 2, self._square // 2


def _around(
    known: Integers,
    bases: Integers,
    cells: Integers,
    rows: Integers,
    stride: int,
    expected: YCoCg,
    is_expected: Booleans,
) -> Neighbourhood:
    """The neighbourhood of each of the `rows`. Points 0, stride, 2 · stride, … are known; stride: 0 if none are."""
    own = is_expected[rows, None]
    nothing = np.zeros((len(rows), 3), np.int64)
    if not stride:
        return Neighbourhood(np.where(own, expected[rows], GREY), nothing, nothing, nothing)
    count = -(-len(cells) // stride)
    width = min(WINDOW, count)
    first = np.clip(rows // stride + 1 - WINDOW // 2, 0, count - width)
    candidates = (first[:, None] + np.arange(width)) * stride
    square = ((cells[candidates] - cells[rows][:, None]) ** 2).sum(axis=2)
    chosen = np.argsort(square, axis=1, kind="stable")[:, :AVERAGED]
    near = np.take_along_axis(candidates, chosen, axis=1)
    weight = WEIGHT_UNIT // (np.take_along_axis(square, chosen, axis=1) + SOFTENING)
    weight = np.maximum(weight, 1)[..., None]
    total = weight.sum(axis=1)
    colours, errors = known[near], known[near] - bases[near]
    mean = (colours * weight).sum(axis=1) // total
    return Neighbourhood(
        np.where(own, expected[rows], mean),
        (errors * weight).sum(axis=1) // total,
        (np.abs(errors) * weight).sum(axis=1) // total,
        np.abs(colours - mean[:, None]).max(axis=1),
    )


def _contexts(place: Integers, level: int, kind: int, rows: Integers) -> tuple[Integers, Integers]:
    """place (n, 4): channel, classes of activity and spread, how large the channels before were."""
    channel, activity, spread, coded = place[rows].T
    base = channel * KINDS + kind
    contexts = (
        base * ACTIVITIES + activity,
        base * CLASSES + coded,
        (base * ACTIVITIES + spread) * LEVELS + level,
        (base * ACTIVITIES + activity) * CLASSES + coded,
        (base * ACTIVITIES + spread) * ACTIVITIES + activity,
    )
    return np.stack(contexts, axis=1), base * CLASSES + coded
