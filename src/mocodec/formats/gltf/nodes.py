"""The nodes of a glTF: their tree, their transforms at rest, and where animation tracks carry them.

    world transform of a node = world transform of its parent · T · R · S

A node's world transform is kept as its position, the product Q of its rotations, and a matrix where scale or shear
takes part. Mirroring (a negative scale) is moved to the right of Q: Q · σ · R = Q · (σ R σ⁻¹) · σ.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from ...geometry import articulation, rigid
from ...typing import Floats
from .document import MAX_VALUE, Document
from .tracks import Track

Tracks = Mapping[tuple[int, str], Track]
"""Tracks by node and path ("translation", "rotation", "scale")."""


class Local(NamedTuple):
    """A node at rest, against its parent. rotation: w first. stretch (3, 3): scale and shear, applied before it."""

    translation: Floats
    rotation: Floats
    stretch: Floats

    @property
    def scale(self) -> Floats:
        return np.diagonal(self.stretch)


class Pose(NamedTuple):
    """World transforms of one node over frames; arrays of one frame if it does not move.

    position (frames, 3). rotation (frames, 4): Q. mirror (3,): σ, ones and minus ones. linear (frames, 3, 3): rotation,
    scale and shear; None if it is only Q.
    """

    position: Floats
    rotation: Floats
    mirror: Floats
    linear: Floats | None

    def matrices(self) -> Floats:
        """(frames, 3, 3): the linear part."""
        return rigid.to_matrix(self.rotation) if self.linear is None else self.linear


MIN_DETERMINANT = 1e-30
"""A matrix with a smaller determinant scales to nothing."""
MIN_ROTATION = 1e-9
"""Largest component of a rotation; a smaller one is none."""
WORLD = Pose(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]), np.ones(3), None)


def mirrored(mirror: Floats, rotation: Floats) -> Floats:
    """σ R σ⁻¹ for a mirroring σ (3,); quaternions (…, 4)."""
    if (mirror == 1).all():
        return rotation
    return rotation * np.concatenate([[1.0], np.prod(mirror) * mirror])


def child_pose(parent: Pose, translation: Floats, rotation: Floats, stretch: Floats) -> Pose:
    """The pose of a node from its parent's. stretch (frames, 3, 3); all have one frame, or one for each frame."""
    if parent.linear is None:
        position = parent.position + rigid.rotate(parent.rotation, translation)
    else:
        position = parent.position + (parent.linear @ translation[..., None])[..., 0]
    turned = rigid.multiply(parent.rotation, mirrored(parent.mirror, rotation))
    linear = None
    if parent.linear is not None or not (stretch == np.eye(3)).all():
        linear = parent.matrices() @ rigid.to_matrix(rotation) @ stretch
    signs = np.where(np.diagonal(stretch[0]) < 0, -1.0, 1.0)
    return Pose(position, turned, parent.mirror * signs, linear)


class Nodes:
    """The nodes of a document, lengths in metres. Raises BadInput unless they form trees."""

    def __init__(self, document: Document, unit_m: float) -> None:
        self._document = document
        self._unit_m = unit_m
        self.contents = document.items("nodes")
        self.parents = self._parents()
        self.order = self._depth_first()

    def __len__(self) -> int:
        return len(self.contents)

    def name(self, node: int) -> str:
        """The name in the file; "node7" without one."""
        return str(self.contents[node].get("name") or f"node{node}")

    def _parents(self) -> list[int]:
        parents = [-1] * len(self.contents)
        for node, content in enumerate(self.contents):
            for child in content.get("children", ()):
                if not 0 <= child < len(parents) or parents[child] >= 0 or child == node:
                    raise self._document.damaged("its nodes do not form a tree")
                parents[child] = node
        return parents

    def _depth_first(self) -> list[int]:
        """All nodes, parents first. Raises BadInput for cycles."""
        order, waiting = list[int](), [n for n, p in enumerate(self.parents) if p < 0][::-1]
        while waiting:
            order.append(waiting.pop())
            waiting += list(self.contents[order[-1]].get("children", ()))[::-1]
        if len(order) != len(self.contents):
            raise self._document.damaged("its nodes do not form a tree")
        return order

    def parents_first(self) -> list[int]:
        """All nodes in the file's order if that has parents first, else depth first."""
        in_order = all(parent < node for node, parent in enumerate(self.parents))
        return list(range(len(self.contents))) if in_order else self.order

    def with_ancestors(self, chosen: set[int]) -> set[int]:
        """The nodes and all above them."""
        result = set(chosen)
        for node in reversed(self.order):
            if node in result and self.parents[node] >= 0:
                result.add(self.parents[node])
        return result

    def with_descendants(self, chosen: set[int]) -> set[int]:
        """The nodes and all below them."""
        result = set(chosen)
        for node in self.order:
            if self.parents[node] in result:
                result.add(node)
        return result

    def nearest_above(self, chosen: list[int]) -> dict[int, int]:
        """For each chosen node the nearest chosen one above it, or −1."""
        members, above = set(chosen), dict[int, int]()
        for node in self.order:
            parent = self.parents[node]
            above[node] = -1 if parent < 0 else parent if parent in members else above[parent]
        return {node: above[node] for node in chosen}

    def local(self, node: int) -> Local:
        """A node at rest."""
        content = self.contents[node]
        if "matrix" in content:
            return self._decomposed(node, np.array(content["matrix"], float).reshape(4, 4).T)
        translation = np.array(content.get("translation", (0, 0, 0)), float).reshape(3)
        x, y, z, w = (float(v) for v in content.get("rotation", (0, 0, 0, 1)))
        rotation, scale = np.array([w, x, y, z]), np.array(content.get("scale", (1, 1, 1)), float).reshape(3)
        is_usable = (np.abs(np.concatenate([translation, rotation, scale])) < MAX_VALUE).all()
        if not is_usable or np.abs(rotation).max() < MIN_ROTATION:
            raise self._document.damaged(f"node {node} has a transform that is not finite, or a zero rotation")
        return Local(translation * self._unit_m, rotation / np.linalg.norm(rotation), np.diag(scale))

    def _decomposed(self, node: int, matrix: Floats) -> Local:
        """Translation, the nearest rotation, and what remains: scale, and shear if there is one."""
        linear = matrix[:3, :3]
        if not (np.abs(matrix) < MAX_VALUE).all() or abs(np.linalg.det(linear)) < MIN_DETERMINANT:
            raise self._document.damaged(f"node {node} has a matrix that cannot be inverted")
        signs = np.array([np.sign(np.linalg.det(linear)), 1.0, 1.0])
        u, _, vt = np.linalg.svd(linear * signs)
        rotation = u @ vt
        stretch = rotation.T @ linear
        scale = np.diag(np.diagonal(stretch))
        if np.abs(stretch - scale).max() <= 1e-9 * np.abs(scale).max():
            stretch = scale
        return Local(matrix[:3, 3] * self._unit_m, articulation.quaternions(rotation), stretch)

    def poses(
        self, chosen: set[int], tracks: Tracks, at: Floats, rate: float, world: int
    ) -> Iterator[tuple[int, Pose]]:
        """The chosen nodes, which include all above them, each with its pose at the times `at`; depth first.

        world: the node whose frame is the world's, in place of its own transform; −1 for none. A pose is forgotten as
        soon as no node needs it.
        """
        waiting = dict.fromkeys(chosen, 0)
        for node in chosen:
            if self.parents[node] >= 0:
                waiting[self.parents[node]] += 1
        known = dict[int, Pose]()
        for node in self.order:
            if node not in chosen:
                continue
            parent = self.parents[node]
            above = known[parent] if parent >= 0 else WORLD
            pose = WORLD if node == world else child_pose(above, *self._sampled(node, tracks, at, rate))
            if waiting[node]:
                known[node] = pose
            if parent >= 0:
                waiting[parent] -= 1
                if not waiting[parent]:
                    del known[parent]
            yield node, pose

    def _sampled(self, node: int, tracks: Tracks, at: Floats, rate: float) -> tuple[Floats, Floats, Floats]:
        """Translation, rotation and stretch of a node at the times; of one frame without a track."""
        rest = self.local(node)
        translation, rotation, stretch = rest.translation[None], rest.rotation[None], rest.stretch[None]
        if (track := tracks.get((node, "translation"))) is not None:
            translation = track.sample(at, False, rate)
        if (track := tracks.get((node, "rotation"))) is not None:
            rotation = track.sample(at, True, rate)
        if (track := tracks.get((node, "scale"))) is not None:
            stretch = np.eye(3) * track.sample(at, False, rate)[:, :, None]
        return translation, rotation, stretch
