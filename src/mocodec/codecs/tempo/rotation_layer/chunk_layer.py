"""A chunk's rotations while they are encoded: drafts in some step, their errors, and what keeps a promise.

side values ─draft─► integers, decoded side values ─solved─► rotations, positions ─broken─► where a promise fails
draft ─corrected─► draft with corrections ─pack─► bytes
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ....encoded import Chunk
from ....errors import CannotEncode
from ....typing import Booleans, Floats, Integers
from ..chunk import BOUND_SLOPE, grid_size, grid_step
from ..coding import coefficients, corrections, direct, quantise
from . import payload, shell, solve
from .payload import Layer

ALL = slice(None)
TIGHTER = (0, 16, 40, 72, 112)
"""How much finer the steps are that a chunk beyond a bound is tried with, 1/32 octave, before corrections."""
LEAST_SHARE = 1e-3
"""A chunk that is coded directly keeps its mean error as a bound, or this share of the promise if that is more."""
GRIDS = 60
"""Number of times that the grid of direct coding is halved, at most."""
CORRECTIONS = ((0.6, 1), (0.4, 2), (0.4, 2), (0.2, 3), (0.2, 4), (0.05, 5), (0.05, 6), (0.0125, 8))
"""For each round: corrections bring targets within this share of the bound, and correct the causes at this number of
joints, from the joint itself up its chain. Angles that targets show badly need these more exactly; a joint whose angles
are coded keeps the errors of those above it. A chunk that all rounds leave beyond the bound is coded directly."""

RARE_CORRECTIONS = ((0.8, 1), (0.8, 2), *CORRECTIONS)
"""The same under a mean error, where few samples are beyond the bound; the first rounds are left out where the mean
error then exceeds that of the draft."""


class Promise(NamedTuple):
    """max_error: metres, None without; max_rotation: radians, None without; weights (joints,): of the bound."""

    max_error: float | None
    max_rotation: float | None
    weights: Floats | None

    @property
    def is_hard(self) -> bool:
        return self.max_error is not None or self.max_rotation is not None


@dataclass(frozen=True, eq=False)
class Original:
    """positions (frames, joints, 3), local and world rotations (frames, joints, 4) of the motion."""

    positions: Floats
    local: Floats
    world: Floats

    def between(self, start: int, stop: int) -> Original:
        return Original(self.positions[start:stop], self.local[start:stop], self.world[start:stop])


class Draft(NamedTuple):
    """A chunk in one step: its numbers, decoded side values (frames, n), and the grid of corrections."""

    numbers: coefficients.ChunkNumbers | None
    side: Floats
    grid: int | None = None


class ChunkLayer:
    """The rotations of a chunk while they are encoded."""

    def __init__(self, of: Layer, original: Original, values: Floats, targets: Floats) -> None:
        """values (frames, n): side values less the nominal ones; targets: decoded positions of the inner stream."""
        self.layer, self.original, self.values = of, original, values
        self.targets = np.ascontiguousarray(targets)
        self.spectrum = of.model.analyse(values)

    @property
    def frames(self) -> int:
        return len(self.targets)

    def draft(self, step: int, slope: float = quantise.SLOPE) -> Draft:
        if not self.layer.rules.side_values:
            return Draft(None, np.zeros((self.frames, 0)))
        found = self.layer.model.quantised(self.spectrum, step, slope)
        numbers = coefficients.ChunkNumbers(self.frames, found.values, step, found.threshold)
        return Draft(numbers, self.layer.model.dequantised(found.values, step, self.frames))

    def exact(self) -> Draft:
        """Side values as they are, for a lower limit of the error."""
        return Draft(None, self.values + self.layer.rules.nominal)

    def solved(self, draft: Draft, frames: Integers | slice = ALL) -> tuple[Floats, Floats]:
        """Local rotations and positions that a draft decodes to, of some frames."""
        targets, values = self.targets, draft.side
        if draft.grid is not None and draft.numbers is not None and draft.numbers.lists is not None:
            targets, values = payload.corrected(self.layer, targets, values, draft.numbers.lists, draft.grid)
        return solve.solve(self.layer.rules, targets[frames], values[frames])

    def errors(self, local: Floats, positions: Floats, frames: Integers | slice = ALL) -> shell.Errors:
        """Errors of local rotations and positions in some frames."""
        world, true = shell.world_rotations(self.layer.rules.skeleton, local), self.original
        return shell.errors(true.positions[frames], true.world[frames], positions, world, self.layer.reach_m)

    def sampled_errors(self, draft: Draft, every: int) -> shell.Errors:
        """Errors of a draft without corrections, in one frame of `every`."""
        some = slice(None, None, every)
        return self.errors(*self.solved(draft, some), some)

    def broken(self, local: Floats, positions: Floats, promise: Promise, frames: Integers | slice = ALL) -> Booleans:
        """(frames, joints): where a joint, its shell points or its rotation are beyond the promise, in some frames."""
        beyond = np.zeros(positions.shape[:2], bool)
        if promise.max_error is not None:
            found = self.errors(local, positions, frames)
            bound = promise.max_error * (1 - 1e-9)
            beyond |= found.beyond(bound) if promise.weights is None else found.beyond(bound / promise.weights)
        if promise.max_rotation is not None:
            world, true = shell.world_rotations(self.layer.rules.skeleton, local), self.original
            beyond |= shell.angles(world, true.world[frames]) > promise.max_rotation * (1 - 1e-9)
            beyond |= shell.angles(local, true.local[frames]) > promise.max_rotation * (1 - 1e-9)
        return beyond

    def mended(self, step: int, promise: Promise) -> bytes:
        """The part of a chunk that keeps the promise. Raises CannotEncode."""
        parts: list[bytes] = []
        for finer in TIGHTER:
            draft = self.corrected(self.draft(step - finer, BOUND_SLOPE), promise)
            if draft is not None:
                parts.append(self.pack(draft))
                if len(parts) > 1 and len(parts[-1]) > len(parts[-2]):
                    break
        return min(parts, key=len) if parts else self.directly(promise)

    def capped(self, draft: Draft, promise: Promise) -> bytes:
        """The part of a chunk that keeps the promise, and has at most the mean error of a draft that does not.
        Raises CannotEncode."""
        before = self.errors(*self.solved(draft))
        for first in range(len(RARE_CORRECTIONS)):
            found = self.corrected(draft, promise, RARE_CORRECTIONS[first:])
            if found is not None:
                after = self.errors(*self.solved(found))
                if after.total <= before.total and after.joints.sum() <= before.joints.sum():
                    return self.pack(found)
        mean = min(before.mean, float(before.joints.mean()))
        return self.directly(promise._replace(max_error=max(mean, LEAST_SHARE * (promise.max_error or 1.0))))

    def pack(self, draft: Draft) -> bytes:
        return payload.pack_transforms(self.layer, [(draft.numbers, draft.grid)])[0]

    def corrected(
        self, draft: Draft, promise: Promise, rounds: Sequence[tuple[float, int]] = CORRECTIONS
    ) -> Draft | None:
        """The draft with the corrections that it needs, or None where they do not suffice.

        A correction moves its own frame only, so frames that keep the promise are not solved again.
        """
        bound = promise.max_error if promise.max_error is not None else self.layer.reach_m * (promise.max_rotation or 1)
        broken = self.broken(*self.solved(draft), promise)
        if not broken.any():
            return draft
        truth = payload.together(self.layer, self.original.positions, self.values + self.layer.rules.nominal)
        off = truth - payload.together(self.layer, self.targets, draft.side)
        wrong = np.zeros(off.shape[:2], bool)
        numbers = draft.numbers
        if numbers is None:
            empty = np.zeros((0, self.layer.model.rows), np.int64)
            numbers = coefficients.ChunkNumbers(self.frames, empty, 0, 0)
        for share, levels in rounds:
            wrong |= _causes(self.layer, broken, levels)
            grid = grid_step(direct.cell(share * bound))
            found = corrections.find(np.where(wrong[..., None], off, 0.0), share * bound, grid_size(grid))
            draft = Draft(numbers._replace(lists=corrections.numbers(found)), draft.side, grid)
            moved = np.flatnonzero(wrong.any(axis=1))
            broken[moved] = self.broken(*self.solved(draft, moved), promise, moved)
            if not broken.any():
                return draft
        return None

    def directly(self, promise: Promise) -> bytes:
        """The chunk with every rotation on a grid that keeps the promise. Raises CannotEncode."""
        bound = promise.max_error or self.layer.reach_m * (promise.max_rotation or 1)
        for finer in range(GRIDS):
            grid = grid_step(bound / 2.0**finer)
            part = payload.pack_direct(self.layer, self.original.local, self.original.positions, grid)
            decoded = payload.unpack_direct(self.layer, Chunk(0, self.frames, part))
            if not self.broken(*decoded, promise).any():
                return part
        raise CannotEncode("the positions of this motion do not follow from its skeleton and rotations so exactly")


def _causes(of: Layer, broken: Booleans, levels: int) -> Booleans:
    """What may have moved joints or their frames too far, as corrections name it: (frames, corrected_points).

    The targets of the joint, of its parent and so on (joints in all: `levels`), of the vectors that they carry and of
    hinges that their twists turn; the side values of the joint and of all above it.
    """
    rules = of.rules
    wrong = np.zeros((len(broken), of.corrected_points), bool)
    for joint in np.flatnonzero(broken.any(axis=0)).tolist():
        at, one, level = broken[:, joint], joint, 0
        while one >= 0:
            if level < levels:
                turned = [t for hinge in rules.hinges[one] for t in rules.carried[hinge.child].targets]
                for point in {one, rules.carried[one].anchor, *rules.carried[one].targets, *turned}:
                    wrong[:, point] |= at
            for value in range(rules.starts[one], rules.starts[one + 1]):
                wrong[:, of.joints + value // 3] |= at
            one, level = rules.skeleton.parents[one], level + 1
    return wrong
