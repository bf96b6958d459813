"""The part of a chunk that holds its rotations, in front of the inner stream's payload, and both ways to decode it.

    length (varint) · [kind · steps · numbers] · the inner payload

TRANSFORM   side values as coefficients, and corrections of targets and side values; nothing where there are neither
DIRECT      all rotations, and the positions of roots and placed joints, on a grid: keeps any bound
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....encoded import Chunk
from ....entropy import varint
from ....errors import Corrupt
from ....geometry import rigid
from ....typing import Floats, Integers
from ..chunk import LARGEST_GRID_STEP, grid_size
from ..coding import coefficients, corrections, direct
from . import rules as r
from . import solve
from .choose import continuous
from .rules import Rules, form_angles
from .side import SideModel

TRANSFORM, DIRECT, CORRECTED = 0, 1, 2
"""Kinds, and the flag of a chunk with corrections. Never change them."""
SIDE_SCALE = 3
"""Corrections of side values are metres at SIDE_SCALE times the distance of shell points, since twist errors add up."""


@dataclass(frozen=True, eq=False)
class Layer:
    """What all chunks share: rules, distance of shell points, and statistics of side values."""

    rules: Rules
    reach_m: float
    model: SideModel

    @property
    def joints(self) -> int:
        return len(self.rules.joints)

    @property
    def corrected_points(self) -> int:
        """How many points corrections may name: joints, then side values by threes."""
        return self.joints + -(-self.rules.side_values // 3)


def split(payload: bytes) -> tuple[bytes, bytes]:
    """The rotations' part of a chunk, and the inner payload. Raises Corrupt."""
    (length,), at = varint.read(payload, 1)
    if at + length > len(payload):
        raise Corrupt("tempo: a chunk that ends within its rotations")
    return payload[at : at + length], payload[at + length :]


def join(part: bytes, inner: bytes) -> bytes:
    return varint.write([len(part)]) + part + inner


def pack_transforms(layer: Layer, chunks: Sequence[tuple[coefficients.ChunkNumbers | None, int | None]]) -> list[bytes]:
    """The part of each chunk, from its numbers and the grid step of its corrections."""
    there = [numbers for numbers, _ in chunks if numbers is not None]
    parts = iter(coefficients.pack(layer.model, there) if there else [])
    out: list[bytes] = []
    for numbers, grid in chunks:
        head = bytes([TRANSFORM | CORRECTED * (grid is not None)])
        steps = b"" if grid is None else varint.write([varint.signed(grid)])
        out.append(b"" if numbers is None else head + steps + next(parts))
    return out


def decode(layer: Layer, chunks: Sequence[Chunk], targets: Sequence[Floats]) -> list[tuple[Floats, Floats]]:
    """Local rotations (frames, joints, 4) and positions (frames, joints, 3) of each chunk. Raises Corrupt.

    chunks: whose payloads are the rotations' parts. targets: what the inner stream decodes to.
    """
    plain = [i for i, c in enumerate(chunks) if c.payload and not c.payload[0] & DIRECT]
    sides: dict[int, Floats] = {}
    if plain:
        grids, bodies = zip(*(_head(chunks[i].payload) for i in plain), strict=True)
        frames = [chunks[i].frames for i in plain]
        found = coefficients.unpack(layer.model, frames, bodies, corrections.FIELDS)
        for i, grid, numbers in zip(plain, grids, found, strict=True):
            side = layer.model.dequantised(numbers.values, numbers.step, chunks[i].frames)
            targets_i, sides[i] = corrected(layer, targets[i], side, numbers.lists, grid)
            targets = [*targets[:i], targets_i, *targets[i + 1 :]]
    out: list[tuple[Floats, Floats]] = []
    for i, (chunk, target) in enumerate(zip(chunks, targets, strict=True)):
        if chunk.payload and chunk.payload[0] & DIRECT:
            out.append(unpack_direct(layer, chunk))
        else:
            nominal = np.broadcast_to(layer.rules.nominal, (chunk.frames, layer.rules.side_values))
            out.append(solve.solve(layer.rules, target, sides.get(i, nominal)))
    return out


def _head(part: bytes) -> tuple[int | None, bytes]:
    """The grid step of corrections, and the coefficients. Raises Corrupt."""
    if part[0] & ~(DIRECT | CORRECTED):
        raise Corrupt("tempo: rotations of an unknown kind")
    if not part[0] & CORRECTED:
        return None, part[1:]
    (folded,), at = varint.read(part, 1, 1)
    return _limited(varint.unsigned(folded)), part[at:]


def _limited(step: int) -> int:
    if abs(step) > LARGEST_GRID_STEP:
        raise Corrupt("tempo: rotations whose step is out of range")
    return step


def corrected(layer: Layer, targets: Floats, side: Floats, lists: Integers, grid: int | None) -> tuple[Floats, Floats]:
    """Targets and side values after the corrections of the lists. Raises Corrupt."""
    if not lists.size or grid is None:
        return targets, side
    frames = len(targets)
    moved = corrections.from_numbers(lists, frames, layer.corrected_points)
    both = together(layer, targets, side)
    corrections.apply(both, moved, grid_size(grid))
    values = both[:, layer.joints :].reshape(frames, -1)[:, : side.shape[1]]
    return np.ascontiguousarray(both[:, : layer.joints]), values / (SIDE_SCALE * layer.reach_m)


def together(layer: Layer, targets: Floats, side: Floats) -> Floats:
    """Targets, then side values by threes times a length: (frames, corrected_points, 3)."""
    missing = 3 * (layer.corrected_points - layer.joints) - side.shape[1]
    groups = np.pad(side * (SIDE_SCALE * layer.reach_m), ((0, 0), (0, missing))).reshape(len(side), -1, 3)
    return np.concatenate([targets, groups], axis=1)


def pack_direct(layer: Layer, local: Floats, positions: Floats, grid: int) -> bytes:
    """The part of a chunk in which every rotation is on a grid, of this step. Raises CannotEncode."""
    rules, columns = layer.rules, list[Floats]()
    for joint, (rule, scale) in enumerate(zip(rules.joints, reaches(layer), strict=True)):
        if r.ANGLES[rule.rule] == 3:
            columns.append(scale * continuous(rigid_relative(rule.usual, local[:, joint])))
        elif rule.form is not None:
            columns.append(scale * np.unwrap(form_angles(rule.form, local[:, joint]), axis=0))
        if rule.placed or rules.skeleton.parents[joint] < 0:
            columns.append(positions[:, joint])
    values = direct.quantise(np.concatenate(columns, axis=1), grid_size(grid))
    return bytes([DIRECT]) + varint.write([varint.signed(grid)]) + direct.pack(values)


def rigid_relative(usual: Floats, q: Floats) -> Floats:
    """Rotations (frames, 4) after a usual one."""
    return rigid.multiply(rigid.inverse(usual), q)


def unpack_direct(layer: Layer, chunk: Chunk) -> tuple[Floats, Floats]:
    """The inverse of `pack_direct`. Raises Corrupt."""
    rules, frames = layer.rules, chunk.frames
    if chunk.payload[0] != DIRECT:
        raise Corrupt("tempo: rotations of an unknown kind")
    (folded,), at = varint.read(chunk.payload, 1, 1)
    held = [j for j, rule in enumerate(rules.joints) if rule.placed or rules.skeleton.parents[j] < 0]
    width = sum(_directly_coded(rule.rule) for rule in rules.joints) + 3 * len(held)
    steps = direct.unpack(chunk.payload[at:], (frames, width))
    values = np.asarray(steps * grid_size(_limited(varint.unsigned(folded))), np.float64)
    local = np.empty((frames, layer.joints, 4))
    positions = np.zeros((frames, layer.joints, 3))
    column = 0
    for joint, (rule, scale) in enumerate(zip(rules.joints, reaches(layer), strict=True)):
        count = _directly_coded(rule.rule)
        own = values[:, column : column + count] / scale
        column += count
        if rule.form is not None:
            local[:, joint] = rule.form.rotation(own)
        elif count:
            local[:, joint] = rigid.multiply(rule.usual, solve.unit(own))
        else:
            local[:, joint] = rule.usual
        if joint in held:
            positions[:, joint] = values[:, column : column + 3]
            column += 3
    return local, solve.forward(rules, local, positions)


def _directly_coded(rule: int) -> int:
    """How many numbers a rotation is coded by directly: a quaternion, or its free angles."""
    return 4 if r.ANGLES[rule] == 3 else r.ANGLES[rule]


def reaches(layer: Layer) -> list[float]:
    """How far each joint's rotation moves what hangs on it, metres: the longest chain of offsets and the shell."""
    skeleton = layer.rules.skeleton
    lengths = np.sqrt((skeleton.offsets**2).sum(axis=1))
    below = [layer.reach_m] * len(skeleton)
    for joint in reversed(range(len(skeleton))):
        if layer.rules.own_frame:
            below[joint] += float(lengths[joint])
        parent = skeleton.parents[joint]
        if parent >= 0:
            own = 0.0 if layer.rules.own_frame else float(lengths[joint])
            below[parent] = max(below[parent], below[joint] + own)
    return below
