"""What encoder and decoder know of a chunk in advance: which coefficients are coded, and in which order."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np

from ....entropy.lanes import StaticTables
from ....typing import Booleans, Integers
from . import contexts

THRESHOLD_UNIT = 16
"""Thresholds are stored in half octaves."""
LANES = (1, 2, 4, 8, 12, 16, 24, 32)


class Expectations(Protocol):
    """What a model says of coefficients: their expected magnitudes, and the tables that code them."""

    @property
    def rows(self) -> int: ...

    @property
    def points(self) -> int: ...

    @property
    def tables(self) -> StaticTables: ...

    def expected(self, frames: int, step: int) -> Integers:
        """log₂ of magnitudes, in steps, 1/32 octave: (frames, rows)."""
        ...


@dataclass(frozen=True, eq=False)
class ChunkPlan:
    """expected: (frequencies that are coded, rows); coded (rows,): how many frequencies of each row are."""

    frames: int
    step: int
    lanes: int
    expected: Integers
    coded: Integers

    @property
    def frequencies(self) -> int:
        return len(self.expected)

    @cached_property
    def base(self) -> Integers:
        """`contexts.base`, (frequencies, rows)."""
        return contexts.base(self.expected)

    @cached_property
    def inside(self) -> Booleans:
        """Which coefficients are coded, (frequencies, rows)."""
        return np.arange(self.frequencies)[:, None] < self.coded

    @cached_property
    def order(self) -> tuple[Integers, Integers, Integers, Integers, Integers]:
        """For each coded coefficient: frequency, row, group, step within the group, and lane."""
        frequency, row = np.nonzero(self.inside)
        group = contexts.groups(self.frequencies)[1][frequency]
        first = np.searchsorted(group, np.arange(group.max(initial=-1) + 1))
        rank = np.arange(len(frequency)) - first[group]
        return frequency, row, group, rank // self.lanes, rank % self.lanes

    @cached_property
    def places(self) -> Integers:
        """Indices of the coded coefficients in flat (frequencies, rows)."""
        return np.flatnonzero(self.inside)

    @cached_property
    def group_steps(self) -> Integers:
        """How many steps each group of frequencies takes."""
        starts, number = contexts.groups(self.frequencies)
        active = np.bincount(number, self.inside.sum(axis=1), minlength=len(starts)).astype(np.int64)
        return -(-active // self.lanes)


@lru_cache(maxsize=24)
def plan(model: Expectations, frames: int, step: int, threshold: int, lane_code: int) -> ChunkPlan:
    logs = model.expected(frames, step)
    coded = contexts.zone(logs, threshold * THRESHOLD_UNIT)
    return ChunkPlan(frames, step, LANES[lane_code], logs[: coded.max()], coded)
