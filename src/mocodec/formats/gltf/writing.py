"""Motion to GLB."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BadInput
from ...geometry import kinematics, rigid
from ...motion import Motion, Skeleton
from ...typing import AnyInteger, Bytes, Floats
from .. import replace_whole
from .binary import BYTE, FLOAT, SHORT, TO_Y_UP, Surface, pack

MIN_TRANSLATION_M = 1e-6
"""A joint that moves farther than this against its parent gets a translation track."""


def write(path: str | Path, motion: Motion, surface: Surface | None = None) -> None:
    """Write a GLB; a motion without rotations becomes nodes that only translate.

    Raises BadInput for gaps and for an empty motion.
    """
    if motion.gaps.any():
        raise BadInput(f"{path}: a GLB cannot hold gaps; write a .c3d, .trc or .npz")
    if not len(motion) or not motion.points:
        raise BadInput(f"{path}: a GLB needs at least one frame and one point")
    replace_whole(path, _GlbWriter(motion).bytes(surface))


class _GlbWriter:
    """Collects accessors and the JSON around them."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.blob = bytearray()
        self.views, self.accessors = list[dict[str, Any]](), list[dict[str, Any]]()

    def add(
        self, values: Floats | Bytes | AnyInteger, kind: str, bounds: bool = False, normalised: bool = False
    ) -> int:
        """Append values as a new accessor; returns its index."""
        component = {"f": FLOAT, "u1": BYTE, "u2": SHORT}["f" if values.dtype.kind == "f" else values.dtype.str[1:]]
        values = values.astype("<f4") if component == FLOAT else values
        self.views.append({"buffer": 0, "byteOffset": len(self.blob), "byteLength": values.nbytes})
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1, "componentType": component, "count": len(values), "type": kind,
        }  # fmt: skip
        if bounds:
            flat = values.reshape(len(values), -1)
            accessor |= {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()}
        if normalised:
            accessor["normalized"] = True
        self.accessors.append(accessor)
        self.blob += values.tobytes() + bytes(-values.nbytes % 4)
        return len(self.accessors) - 1

    def bytes(self, surface: Surface | None) -> bytes:
        """The whole file."""
        motion = self.motion
        parents, offsets, rotations = _node_tree(motion)
        nodes: list[dict[str, Any]] = [
            {"name": name, "translation": offset} for name, offset in zip(motion.names, offsets.tolist(), strict=True)
        ]
        for joint, parent in enumerate(parents):
            if parent >= 0:
                nodes[parent].setdefault("children", []).append(joint)
        roots = [joint for joint, parent in enumerate(parents) if parent < 0]
        if motion.up in TO_Y_UP:
            w, x, y, z = TO_Y_UP[motion.up]
            nodes.append({"name": f"{motion.up} up", "rotation": [x, y, z, w], "children": roots})
            roots = [len(nodes) - 1]
        gltf: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "mocodec", "extras": {"up": motion.up, "rate": motion.rate}},
            "scene": 0, "nodes": nodes, "animations": [self._animation(parents, offsets, rotations)],
        }  # fmt: skip
        if surface is not None:
            self._add_surface(gltf, surface, roots)
        gltf["scenes"] = [{"nodes": roots}]
        gltf |= {"accessors": self.accessors, "bufferViews": self.views, "buffers": [{"byteLength": len(self.blob)}]}
        return pack(gltf, bytes(self.blob))

    def _animation(self, parents: tuple[int, ...], offsets: Floats, rotations: Floats | None) -> dict[str, Any]:
        motion = self.motion
        time = self.add((np.arange(len(motion)) / motion.rate).astype(np.float32)[:, None], "SCALAR", bounds=True)
        samplers, channels = list[dict[str, Any]](), list[dict[str, Any]]()

        def animate(joint: int, path: str, values: Floats, kind: str) -> None:
            channels.append({"sampler": len(samplers), "target": {"node": joint, "path": path}})
            samplers.append({"input": time, "output": self.add(values, kind), "interpolation": "LINEAR"})

        world = None if rotations is None else kinematics.world_rotations(_skeleton(motion), rotations)
        for joint, parent in enumerate(parents):
            translation = motion.positions[:, joint]
            if parent >= 0:
                translation = translation - motion.positions[:, parent]
                if world is not None:
                    translation = rigid.rotate(rigid.inverse(world[:, parent]), translation)
            if np.abs(translation - offsets[joint]).max() > MIN_TRANSLATION_M:
                animate(joint, "translation", translation, "VEC3")
            if rotations is not None:  # in the hemisphere of the first frame: viewers interpolate components
                sign = np.sign(np.sum(rotations[:, joint] * rotations[:1, joint], axis=1))[:, None]
                animate(joint, "rotation", (rotations[:, joint] * sign)[:, [1, 2, 3, 0]], "VEC4")
        if not channels:  # nothing moves, but an animation needs a channel
            animate(0, "translation", np.tile(offsets[0], (len(motion), 1)), "VEC3")
        return {"name": "motion", "samplers": samplers, "channels": channels}

    def _add_surface(self, gltf: dict[str, Any], surface: Surface, roots: list[int]) -> None:
        """Add the surface as a mesh of points with a skin."""
        influences = surface.joints.shape[1]
        joints = np.zeros((len(surface.points), 4), np.uint8 if len(surface.rest) <= 256 else np.uint16)
        weights = np.zeros((len(surface.points), 4))
        joints[:, :influences], weights[:, :influences] = surface.joints, surface.weights
        joints[weights == 0] = 0
        attributes = {
            "POSITION": self.add(surface.points, "VEC3", bounds=True),
            "JOINTS_0": self.add(joints, "VEC4"),
            "WEIGHTS_0": self.add(weights, "VEC4"),
        }
        if surface.colours is not None:
            rgba = np.concatenate([surface.colours, np.full((len(surface.points), 1), 255, np.uint8)], axis=1)
            attributes["COLOR_0"] = self.add(rgba, "VEC4", normalised=True)
        inverse = np.tile(np.eye(4), (len(surface.rest), 1, 1))
        inverse[:, 3, :3] = -surface.rest  # matrices are stored column by column
        gltf["skins"] = [
            {"joints": list(range(len(surface.rest))), "inverseBindMatrices": self.add(inverse.reshape(-1, 16), "MAT4")}
        ]
        gltf["materials"] = [{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}]
        gltf["meshes"] = [{"name": "surface", "primitives": [{"attributes": attributes, "mode": 0, "material": 0}]}]
        gltf["nodes"].append({"name": "surface", "mesh": 0, "skin": 0})
        roots.append(len(gltf["nodes"]) - 1)


def _skeleton(motion: Motion) -> Skeleton:
    assert motion.skeleton is not None
    return motion.skeleton


def _node_tree(motion: Motion) -> tuple[tuple[int, ...], Floats, Floats | None]:
    """Parents, offsets and rotations of the nodes; without rotations every point is a root."""
    if motion.skeleton is None or motion.rotations is None:
        return (-1,) * motion.points, motion.positions[0], None
    parents, rotations = motion.skeleton.parents, motion.rotations
    if motion.source.get("format") == "amc":  # a joint's rotation is that of the bone that ends there
        return (-1,) * motion.points, motion.positions[0], None
    offsets = motion.skeleton.offsets.copy()
    roots = [joint for joint, parent in enumerate(parents) if parent < 0]
    offsets[roots] = motion.positions[0, roots]
    return parents, offsets, rotations
