"""The nodes that joints hang in, kept beside a motion so that a GLB is written back with the same tree.

A motion has joints whose frames are parallel at rest. Nodes of a glTF are turned and scaled at rest, and there are
nodes above and between the joints. `extras["gltf"]` has them: names, parents, the joint that each is, and translation,
rotation (w first), scale of each node at rest; and the animated scales as a `Signal`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...motion import Motion, Signal
from ...typing import Floats
from .nodes import Nodes, Tracks

PLAIN_ROTATION = 1e-6
"""Largest component of a rotation's vector part that counts as no rotation."""


@dataclass(frozen=True)
class NodeTree:
    """Nodes, parents first.

    names, parents: one for each node; −1 for a root. joints: the point of the motion that a node is, or −1.
    translation (n, 3) metres, rotation (n, 4) w first, scale (n, 3): at rest. scales: by node, its animated scale
    (frames, 3). numbers: of the nodes in the file that was read.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    joints: tuple[int, ...]
    translation: Floats
    rotation: Floats
    scale: Floats
    scales: Mapping[int, Floats] = field(default_factory=dict)
    numbers: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.names)


def world_name(up: str) -> str:
    """The name of the node that turns the vertical axis to y."""
    return f"{up} up"


def of_nodes(nodes: Nodes, chosen: set[int], place: Mapping[int, int], names: Sequence[str], world: int) -> NodeTree:
    """The tree of the chosen nodes; place: the point of each joint."""
    numbers = [node for node in nodes.order if node in chosen]
    index = {node: i for i, node in enumerate(numbers)} | {world: -1}
    rest = [nodes.local(node) for node in numbers]
    return NodeTree(
        tuple(nodes.name(node) for node in numbers),
        tuple(index.get(nodes.parents[node], -1) for node in numbers),
        tuple(place.get(node, -1) for node in numbers),
        np.array([local.translation for local in rest]),
        np.array([local.rotation for local in rest]),
        np.array([local.scale for local in rest]),
        numbers=tuple(numbers),
    )


def is_plain(tree: NodeTree, parents: Sequence[int]) -> bool:
    """Whether names, parents and offsets of the joints say all about the tree."""
    if len(tree) != len(parents) or len(set(tree.names)) != len(tree):
        return False
    same = all(
        (tree.joints[parent] if parent >= 0 else -1) == parents[joint]
        for joint, parent in zip(tree.joints, tree.parents, strict=True)
    )
    is_turned = np.abs(tree.rotation[:, 1:]).max() > PLAIN_ROTATION
    return same and not is_turned and bool((tree.scale == 1).all())


def scale_signal(tree: NodeTree, tracks: Tracks, at: Floats, rate: float) -> dict[str, Any]:
    """The animated scales: entries of `extras["gltf"]`; empty without any."""
    scaled = [i for i, node in enumerate(tree.numbers) if (node, "scale") in tracks]
    if not scaled:
        return {}
    sampled = [tracks[tree.numbers[i], "scale"].sample(at, False, rate) for i in scaled]
    values = np.stack(sampled, axis=1).astype(np.float32)
    return {"scaled": np.array(scaled, np.int32), "scales": Signal(values, rate)}


def pack(tree: NodeTree) -> dict[str, Any]:
    """The tree as an entry of `Motion.extras`."""
    return {
        "names": list(tree.names),
        "parents": np.array(tree.parents, np.int32),
        "joints": np.array(tree.joints, np.int32),
        "translation": tree.translation.astype(np.float32),
        "rotation": tree.rotation.astype(np.float32),
        "scale": tree.scale.astype(np.float32),
    }


def unpack(motion: Motion) -> NodeTree | None:
    """The tree that was read with the motion; None if there is none, or if it does not fit the motion's joints."""
    entry = motion.extras.get("gltf")
    if not isinstance(entry, Mapping):
        return None
    try:
        names, parents, joints = (list(entry[name]) for name in ("names", "parents", "joints"))
        translation, rotation, scale = arrays = [
            np.asarray(entry[name], np.float64) for name in ("translation", "rotation", "scale")
        ]
        indices = tuple(map(int, parents)), tuple(map(int, joints))
        tree = NodeTree(tuple(map(str, names)), *indices, translation, rotation, scale)
        scales = _scales(motion, entry, len(tree))
    except (KeyError, TypeError, ValueError, AttributeError):
        return None
    n = len(tree)
    shapes = tuple(array.shape for array in arrays)
    if (len(parents), len(joints)) != (n, n) or shapes != ((n, 3), (n, 4), (n, 3)):
        return None
    if any(not -1 <= parent < node for node, parent in enumerate(tree.parents)):
        return None
    if sorted(joint for joint in tree.joints if joint >= 0) != list(range(motion.points)):
        return None
    lengths = np.linalg.norm(tree.rotation, axis=1, keepdims=True)
    if not all(np.isfinite(array).all() for array in arrays) or lengths.min() < 0.5:
        return None
    return NodeTree(
        tree.names, tree.parents, tree.joints, tree.translation, tree.rotation / lengths, tree.scale, scales
    )


def _scales(motion: Motion, entry: Mapping[str, Any], nodes: int) -> dict[int, Floats]:
    """The animated scales by node, at the motion's frames: interpolated if the signal has another rate."""
    if "scales" not in entry:
        return {}
    scaled, signal = [int(node) for node in entry["scaled"]], entry["scales"]
    values = np.asarray(signal.values, np.float64)
    if values.shape[1:] != (len(scaled), 3) or not len(values) or not all(0 <= node < nodes for node in scaled):
        return {}
    frames = np.arange(len(motion)) / motion.rate
    if len(values) != len(motion):
        times = np.arange(len(values)) / signal.rate
        flat = values.reshape(len(values), -1)
        flat = np.stack([np.interp(frames, times, column) for column in flat.T], axis=1)
        values = flat.reshape(len(frames), len(scaled), 3)
    return {node: values[:, i] for i, node in enumerate(scaled)}
