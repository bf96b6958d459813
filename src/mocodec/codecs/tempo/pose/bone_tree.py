"""A tree of bones of constant length, and the order in which its directions and frames are computed.

A bone of constant length points somewhere on a sphere: two numbers, the tilt from its rest direction. Bones that start
in one joint and keep their angles to each other rotate together: a *hub*, three numbers, a rotation vector. A bone's
direction is expressed in the frame of the body, or, if it is *relative*, in the frame of the bone before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ....typing import Booleans, Floats, Integers
from . import rotations

ZERO_LENGTH_M = 1e-7
"""A bone up to this length has no direction: its end coincides with its start."""
BODY = -1
"""Reference of the bones whose direction is expressed in the frame of the body."""

Slots = slice | Integers
"""Indices of frames: a slice where they are consecutive, so that nothing is copied."""


@dataclass(frozen=True, eq=False)
class BoneTree:
    """A bone for each point that has a parent: from the parent to the point. Arrays are (points,) or (points, 3).

    parents: a parent stands before its children, −1 for the root. vectors: the rest vector of each bone, metres, in
    the frame that its direction is expressed in. hub: the bone rotates with the other hub bones of its parent.
    relative: its direction is expressed in the frame of the bone that ends in its parent.
    """

    parents: tuple[int, ...]
    vectors: Floats
    hub: Booleans
    relative: Booleans

    @cached_property
    def lengths(self) -> Floats:
        return np.sqrt((self.vectors**2).sum(axis=1))

    @cached_property
    def zero_length(self) -> Booleans:
        return self.lengths <= ZERO_LENGTH_M

    @cached_property
    def schedule(self) -> BoneSchedule:
        return _schedule(self)

    @cached_property
    def position_sums(self) -> Floats:
        """(points, bones in schedule order): positions about their mean are this times the unit directions."""
        along = np.eye(len(self.parents))
        for j, p in enumerate(self.parents):
            if p >= 0:
                along[j] += along[p]
        return ((along - along.mean(axis=0)) * self.lengths)[:, self.schedule.points]

    @property
    def dimensions(self) -> int:
        """Numbers that describe a pose: two a bone, three a hub."""
        return 2 * len(self.schedule.bones) + 3 * len(self.schedule.hubs)

    @property
    def has_rotations(self) -> bool:
        """Whether there are bones, and every hub has the two or more that determine its rotation."""
        return self.dimensions > 0 and all(len(bones) > 1 for bones in self.schedule.hub_bones.values())

    def with_offsets(self, offsets: Floats) -> BoneTree:
        """The same tree on a body of other proportions: offsets (points, 3) from parent to point in any pose."""
        size = np.sqrt((offsets**2).sum(axis=1))
        vectors = self.vectors / np.maximum(self.lengths, 1e-30)[:, None] * size[:, None]
        for children in self.schedule.hub_bones.values():
            vectors[children] = rotations.rotated_onto(offsets[children], self.vectors[children])
        return replace(self, vectors=vectors)


@dataclass(frozen=True, eq=False)
class Hub:
    """A hub in the schedule.

    number: among the hubs. slot: of its frame. reference: slot of the frame that it is expressed in, None for the
    body's. home (3, 3, 1, 1): the axes of the body in that frame at rest. pair: its two bones that are farthest from
    collinear, which determine its rotation; pair_frame (3, 3): their frame at rest.
    """

    number: int
    slot: int
    reference: slice | None
    home: Floats
    pair: list[int]
    pair_frame: Floats

    def to_body(self, frames: Floats) -> None:
        """Its frame, of frames (3, 3, slots, frames), from its reference into the body's, in place."""
        if self.reference is not None:
            own = slice(self.slot, self.slot + 1)
            frames[:, :, own] = rotations.out_of(
                frames[:, :, self.reference], rotations.out_of(self.home, frames[:, :, own])
            )


@dataclass(frozen=True, eq=False)
class Level:
    """Hubs and bones whose references are all known once the levels before are done.

    A bone that others refer to is *framed*: its whole frame is computed. Of any other bone, only the direction is.

    hubs
    points                  the bones of the level, framed ones first
    numbers                 index of each bone's coordinates
    slots                   where the frames of the framed bones are stored
    references              slot of the frame that each bone is expressed in; None if all refer to the body
    references_of_framed    the same of the framed bones alone
    rest (3, 3, bones, 1)   the bones' frames at rest, in their references
    """

    hubs: tuple[Hub, ...]
    points: list[int]
    numbers: list[int]
    slots: slice
    references: Slots | None
    references_of_framed: Slots | None
    rest: Floats

    def to_body(self, frames: Floats) -> None:
        """The frames of its bones from their references into the body's, in place."""
        if self.references_of_framed is not None:
            frames[:, :, self.slots] = rotations.out_of(
                frames[:, :, self.references_of_framed], frames[:, :, self.slots]
            )


@dataclass(frozen=True, eq=False)
class BoneSchedule:
    """The order of computation.

    A reference is a bone, −2 − joint for the hub at a joint, or BODY. Schedule order is: framed bones (others refer to
    them), free bones (they refer to the body), all other bones, and last the bones of hubs.

    bones                   in the order of their coordinates
    hubs                    their joints, in the order of their coordinates
    hub_bones               the bones of each hub
    reference               of each bone
    slot                    where the frame of each reference is stored; hubs last
    axes                    frame (3, 3) at rest of each reference, axes as columns
    levels
    order                   index into `bones` of each bone in schedule order, without those of hubs
    framed, free            how many bones are framed, and free
    points                  all bones in schedule order
    references              slot of the reference of each of these
    rest (3, 3, bones, 1)   frames at rest in schedule order, in their references
    hub_directions (3, n, 1)    rest directions of the bones of hubs
    """

    bones: tuple[int, ...]
    hubs: tuple[int, ...]
    hub_bones: dict[int, list[int]]
    reference: dict[int, int]
    slot: dict[int, int]
    axes: dict[int, Floats]
    levels: tuple[Level, ...]
    order: Integers
    framed: int
    free: int
    points: Integers
    references: Integers
    rest: Floats
    hub_directions: Floats

    @property
    def slots(self) -> int:
        return self.framed + len(self.hubs)

    def split(self, coordinates: Floats) -> tuple[Floats, Floats]:
        """Coordinates (dimensions, frames) as tilts (2, bones, frames) and hub rotations (3, hubs, frames): views."""
        edge, frames = 2 * len(self.bones), coordinates.shape[1]
        tilts = coordinates[:edge].reshape(len(self.bones), 2, frames)
        hubs = coordinates[edge : edge + 3 * len(self.hubs)].reshape(len(self.hubs), 3, frames)
        return tilts.swapaxes(0, 1), hubs.swapaxes(0, 1)

    @cached_property
    def program(self) -> tuple[Integers, Floats, Floats, Floats]:
        """The schedule for the compiled module.

        (steps, 6): whether it is a hub, its number among bones or hubs, slot of its reference's frame and of its own
        (−1: none), first of its directions and the one past its last; then `rest` of bones and `home` of hubs,
        (n, 3, 3), and `hub_directions`, (n, 3).
        """
        rows: list[tuple[int, ...]] = []
        homes = np.zeros((len(self.hubs), 3, 3))
        for level in self.levels:
            rows += ((0, b, self.references[b], b, b, b + 1) for b in range(level.slots.start, level.slots.stop))
            for hub in level.hubs:
                own = np.flatnonzero(self.references[len(self.bones) :] == hub.slot) + len(self.bones)
                reference = -1 if hub.reference is None else hub.reference.start
                rows.append((1, hub.number, reference, hub.slot, int(own[0]), int(own[-1]) + 1))
                homes[hub.number] = hub.home[..., 0, 0]
        rows += ((0, b, self.references[b], -1, b, b + 1) for b in range(self.framed, len(self.bones)))
        rest = np.ascontiguousarray(self.rest[..., 0].transpose(2, 0, 1))
        return np.array(rows, np.int64).reshape(-1, 6), rest, homes, np.ascontiguousarray(self.hub_directions[..., 0].T)

    @cached_property
    def hub_pairs(self) -> tuple[Integers, Floats]:
        """`pair` (hubs, 2) and `pair_frame` (hubs, 3, 3) of the hubs by number, for the compiled module."""
        pairs, frames = np.zeros((len(self.hubs), 2), np.int64), np.zeros((len(self.hubs), 3, 3))
        for level in self.levels:
            for hub in level.hubs:
                pairs[hub.number], frames[hub.number] = hub.pair, hub.pair_frame
        return pairs, frames


def _schedule(tree: BoneTree) -> BoneSchedule:
    hub_bones = _hub_bones(tree)
    bones = [j for j, p in enumerate(tree.parents) if p >= 0 and not tree.hub[j] and not tree.zero_length[j]]
    hubs = list(hub_bones)
    reference, level_of = _references(tree, hub_bones)
    referred = set(reference.values())
    framed = sorted((b for b in bones if b in referred), key=level_of.__getitem__)
    leaves = sorted((b for b in bones if b not in referred), key=level_of.__getitem__)
    slot = {BODY: -1} | {b: i for i, b in enumerate(framed)} | {-2 - h: len(framed) + i for i, h in enumerate(hubs)}
    axes = {b: rotations.frame_along(tree.vectors[b] / tree.lengths[b]) for b in bones}
    axes |= {c: np.eye(3) for c in (BODY, *(-2 - h for h in hubs))}
    rest = {b: (axes[reference[b]].T @ axes[b]).T for b in bones}

    def stacked(of: Sequence[int]) -> Floats:
        return np.array([rest[b] for b in of]).reshape(-1, 3, 3).transpose(1, 2, 0)[..., None]

    def slots_of(of: Sequence[int]) -> Slots | None:
        places = np.array([slot[reference[b]] for b in of], np.int64)
        return None if (places < 0).any() or not len(of) else _as_slice(places)

    def hub(joint: int) -> Hub:
        own = hub_bones[joint]
        pair = _least_collinear(tree.vectors, own)
        pair_frame = rotations.frame_of_pair(tree.vectors[pair].T[..., None])[0]
        at = slot[reference[own[0]]]
        home = axes[reference[own[0]]][..., None, None]
        return Hub(hubs.index(joint), slot[-2 - joint], None if at < 0 else slice(at, at + 1), home, pair, pair_frame)

    def level(at: int) -> Level:
        here = [b for b in framed if level_of[b] == at]
        start = sum(level_of[b] < at for b in framed)
        every = [*here, *(b for b in leaves if level_of[b] == at)]
        return Level(
            tuple(hub(h) for h in hubs if level_of[-2 - h] == at),
            every,
            [bones.index(b) for b in every],
            slice(start, start + len(here)),
            slots_of(every),
            slots_of(here),
            stacked(every),
        )

    points, in_hubs = [*framed, *leaves], [j for h in hubs for j in hub_bones[h]]
    references = [*(slot[reference[b]] for b in points), *(slot[-2 - tree.parents[j]] for j in in_hubs)]
    return BoneSchedule(
        tuple(bones),
        tuple(hubs),
        hub_bones,
        reference,
        slot,
        axes,
        tuple(level(at) for at in range(max(level_of.values(), default=-1) + 1)),
        np.array([bones.index(b) for b in points], np.int64),
        len(framed),
        sum(reference[b] == BODY for b in leaves),
        np.array([*points, *in_hubs], np.int64),
        np.array(references, int),
        stacked(points),
        (tree.vectors[in_hubs] / tree.lengths[in_hubs, None]).T[..., None],
    )


def _hub_bones(tree: BoneTree) -> dict[int, list[int]]:
    """The bones of each hub, by the joint that they start in."""
    out: dict[int, list[int]] = {}
    for j, p in enumerate(tree.parents):
        if p >= 0 and tree.hub[j] and not tree.zero_length[j]:
            out.setdefault(p, []).append(j)
    return out


def _references(tree: BoneTree, hub_bones: dict[int, list[int]]) -> tuple[dict[int, int], dict[int, int]]:
    """The reference of each bone, and the level of each bone and hub."""
    frame_at: dict[int, int] = {}  # the frame that the bones after a joint may be relative to
    reference: dict[int, int] = {}
    depth = {BODY: 0}
    level_of: dict[int, int] = {}
    for j, p in enumerate(tree.parents):
        before = frame_at.get(p, BODY)
        frame_at[j] = before
        if p < 0 or tree.zero_length[j]:
            continue
        if tree.hub[j]:
            first = hub_bones[p][0]
            reference[j] = reference[first] if j != first else (before if tree.relative[j] else BODY)
            frame_at[j] = -2 - p
            depth[frame_at[j]] = depth[reference[j]] + 1
            level_of[frame_at[j]] = depth[reference[j]]
        else:
            parent_frame = -2 - p if p in hub_bones and -2 - p in depth else before
            reference[j] = parent_frame if tree.relative[j] else BODY
            frame_at[j] = j
            depth[j] = depth[reference[j]] + 1
            level_of[j] = depth[reference[j]]
    return reference, level_of


def levels(tree: BoneTree) -> dict[int, int]:
    """The level of each bone that has one: the number of frames that its own depends on."""
    _, level_of = _references(tree, _hub_bones(tree))
    ends = (j for j, p in enumerate(tree.parents) if p >= 0 and not tree.zero_length[j])
    return {j: level_of[-2 - tree.parents[j] if tree.hub[j] else j] for j in ends}


def _as_slice(places: Integers) -> Slots:
    """The same indices as a slice, if they are consecutive."""
    first = int(places[0])
    return slice(first, first + len(places)) if (np.diff(places) == 1).all() else places


def _least_collinear(vectors: Floats, bones: Sequence[int]) -> list[int]:
    """The two of these bones that span the largest parallelogram."""
    pairs = [[a, b] for i, a in enumerate(bones) for b in bones[i + 1 :]]
    return max(pairs, key=lambda pair: float((rotations.cross(*vectors[pair]) ** 2).sum())) if pairs else [bones[0]] * 2
