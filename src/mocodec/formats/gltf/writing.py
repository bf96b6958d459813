"""Motion to GLB and glTF.

motion ─► node tree, local transforms over time ─► tracks: every frame, or sparse cubic keys ─┐
          rest pose ─► skin and a mesh that shows the bones, or the body's surface ───────────┴─► JSON and one buffer
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BadInput
from ...geometry import bone_frames
from ...motion import Motion
from ...typing import AnyInteger, Bytes, Floats
from .. import replace_whole
from ..conventions import first_frame, start_s
from . import bones, keyed, keys
from .binary import BYTE, FLOAT, INT, SHORT, TO_Y_UP, Surface, pack
from .document import MAX_VALUE
from .local_tracks import Local, local_tracks, node_tree_of, rest_matrices
from .node_tree import NodeTree, world_name

MIN_TRANSLATION_M = 1e-6
"""A joint that moves farther than this against its parent gets a translation track."""
MIN_ROTATION = 1e-7
"""Change of a quaternion's component that is a rotation."""


def write(path: str | Path, motion: Motion, surface: Surface | None = None, keys: float | None = None) -> None:
    """Write a .glb, or for the suffix .gltf text with its buffer inside.

    A motion with rotations gets its joints as a skin with a mesh that shows them; one without becomes nodes that only
    translate. Of a motion from an AMC, joints are at the starts of bones. surface: the body's surface in place of that
    mesh. keys: in place of a key at every frame, few cubic keys that keep every joint, and points 3 cm off it, within
    this distance, metres.
    Raises BadInput for gaps, for positions beyond 10^12 m and for an empty motion, CannotEncode for `keys` that cannot
    be met.
    """
    if motion.gaps.any():
        raise BadInput(f"{path}: a GLB cannot hold gaps; write a .c3d, .trc or .npz")
    if not len(motion) or not motion.points:
        raise BadInput(f"{path}: a GLB needs at least one frame and one point")
    if np.abs(motion.positions).max() > MAX_VALUE:
        raise BadInput(f"{path}: positions beyond {MAX_VALUE:g} m do not fit the 32-bit floats of a GLB")
    if keys is not None and not 0 < keys < float("inf"):
        raise BadInput(f"{path}: keys is a distance in metres above zero, not {keys}")
    description, blob = _Writer(bone_frames.to_starts(motion)).file(surface, keys)
    if Path(path).suffix.lower() == ".gltf":
        description["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
        replace_whole(path, json.dumps(description, separators=(",", ":")).encode())
    else:
        replace_whole(path, pack(description, blob))


class _Writer:
    """Collects accessors and the JSON around them."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.tree: NodeTree = node_tree_of(motion)
        self.rest = rest_matrices(self.tree)
        self.blob = bytearray()
        self.views, self.accessors = list[dict[str, Any]](), list[dict[str, Any]]()
        self.times = dict[bytes, int]()

    def add(
        self,
        values: Floats | Bytes | AnyInteger,
        kind: str,
        bounds: bool = False,
        normalised: bool = False,
        target: int | None = None,
    ) -> int:
        """Append values as a new accessor; returns its index. target: of its buffer view, for a mesh."""
        component = {"f": FLOAT, "u1": BYTE, "u2": SHORT, "u4": INT}[
            "f" if values.dtype.kind == "f" else values.dtype.str[1:]
        ]
        values = values.astype("<f4") if component == FLOAT else values
        self.views.append({"buffer": 0, "byteOffset": len(self.blob), "byteLength": values.nbytes})
        if target is not None:
            self.views[-1]["target"] = target
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

    def file(self, surface: Surface | None, tolerance_m: float | None) -> tuple[dict[str, Any], bytes]:
        """The description, and the bytes of its buffer."""
        motion, tree = self.motion, self.tree
        nodes = self._nodes()
        roots = [node for node, parent in enumerate(tree.parents) if parent < 0]
        has_skin = surface is not None or motion.rotations is not None
        if motion.up in TO_Y_UP or (has_skin and len(roots) > 1):  # a skin's joints need one node above them
            w, x, y, z = TO_Y_UP.get(motion.up, (1.0, 0.0, 0.0, 0.0))
            nodes.append({"name": world_name(motion.up), "rotation": [x, y, z, w], "children": roots})
            roots = [len(nodes) - 1]
        description: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "mocodec", "extras": self._settings()},
            "scene": 0, "nodes": nodes, "animations": [self._animation(tolerance_m)],
        }  # fmt: skip
        if surface is not None:
            self._add_surface(description, surface, roots)
        elif has_skin:
            self._add_bones(description, roots)
        description["scenes"] = [{"nodes": roots}]
        description |= {"accessors": self.accessors, "bufferViews": self.views}
        description["buffers"] = [{"byteLength": len(self.blob)}]
        return description, bytes(self.blob)

    def _settings(self) -> dict[str, Any]:
        """What `read` takes from a file of ours, in asset.extras."""
        motion = self.motion
        numbers = {"first_frame": first_frame(motion.source)} if "first_frame" in motion.source else {}
        return {"up": motion.up, "rate": motion.rate, "rotations": motion.rotations is not None, **numbers}

    def _nodes(self) -> list[dict[str, Any]]:
        tree, nodes = self.tree, list[dict[str, Any]]()
        for node, name in enumerate(tree.names):
            content: dict[str, Any] = {"name": name, "translation": tree.translation[node].tolist()}
            w, x, y, z = tree.rotation[node].tolist()
            content |= {"rotation": [x, y, z, w]} if (x, y, z) != (0, 0, 0) else {}
            content |= {"scale": tree.scale[node].tolist()} if (tree.scale[node] != 1).any() else {}
            nodes.append(content)
            if tree.parents[node] >= 0:
                nodes[tree.parents[node]].setdefault("children", []).append(node)
        return nodes

    def _animation(self, tolerance_m: float | None) -> dict[str, Any]:
        motion = self.motion
        self._start = 0.0
        if motion.source.get("format") == "glb":
            self._start = max(0.0, start_s(motion.source, motion.rate) - (first_frame(motion.source) - 1) / motion.rate)
        locals_ = local_tracks(motion, self.tree)
        channels = self._keyed(locals_, tolerance_m) if tolerance_m is not None else self._sampled(locals_)
        samplers = [sampler for _, _, sampler in channels]
        targets = [{"sampler": i, "target": {"node": node, "path": path}} for i, (node, path, _) in enumerate(channels)]
        name = motion.source.get("animation")
        return {"name": name if isinstance(name, str) and name else "motion", "samplers": samplers, "channels": targets}

    def _time(self, frames: AnyInteger) -> int:
        """The accessor of the times of frames."""
        key = frames.tobytes()
        if key not in self.times:
            seconds = (self._start + frames / self.motion.rate).astype(np.float32)
            self.times[key] = self.add(seconds[:, None], "SCALAR", bounds=True)
        return self.times[key]

    def _sampled(self, locals_: Sequence[Local]) -> list[tuple[int, str, dict[str, Any]]]:
        """A channel for each property that is not as at rest: of every frame, or of one key if it does not change."""
        moving, channels = self._moving(locals_), list[tuple[int, str, dict[str, Any]]]()
        every = np.arange(len(self.motion))
        changes = [
            np.abs(values - values[:1]).max() > (MIN_ROTATION if path == "rotation" else self._min_translation(node))
            for node, path, values in moving
        ]
        for number, (node, path, values) in enumerate(moving):
            frames = every if changes[number] else every[:1]
            if number == 0 and not any(changes):  # one channel has the last frame, too
                frames = np.unique(every[[0, -1]])
            output = self.add(_components(path, values[frames]), KINDS[path])
            channels.append((node, path, {"input": self._time(frames), "output": output, "interpolation": "LINEAR"}))
        return channels

    def _keyed(self, locals_: Sequence[Local], tolerance_m: float) -> list[tuple[int, str, dict[str, Any]]]:
        """A channel of sparse cubic keys for each property that is not as at rest."""
        moving = self._moving(locals_)
        curves = keyed.curves(self.motion, self.tree, locals_, moving, tolerance_m)
        if all(len(curve.keys) == 1 for curve in curves):  # one channel has the last frame, too
            curves[0] = keys.still(curves[0], len(self.motion))
        channels = list[tuple[int, str, dict[str, Any]]]()
        for (node, path, _), curve in zip(moving, curves, strict=True):
            values, interpolation = _components(path, curve.values), "LINEAR"
            if len(curve.keys) > 1:  # a cubic spline needs two keys
                tangents = [_components(path, t * self.motion.rate) for t in (curve.in_tangents, curve.out_tangents)]
                values = np.stack([tangents[0], values, tangents[1]], axis=1).reshape(-1, values.shape[1])
                interpolation = "CUBICSPLINE"
            output = self.add(values, KINDS[path])
            sampler = {"input": self._time(curve.keys), "output": output, "interpolation": interpolation}
            channels.append((node, path, sampler))
        return channels

    def _moving(self, locals_: Sequence[Local]) -> list[tuple[int, str, Floats]]:
        """Properties that are not as at rest in every frame, at least one: node, path and values over time."""
        moving, tree = list[tuple[int, str, Floats]](), self.tree
        is_flat = self.motion.rotations is None  # without a skin, animated nodes are the points
        for node, local in enumerate(locals_):
            rest = (tree.translation[node], tree.rotation[node], tree.scale[node])
            limits = (self._min_translation(node), MIN_ROTATION, 0.0)
            for path, values, still, limit in zip(KINDS, local, rest, limits, strict=True):
                if values is not None and (is_flat or np.abs(values - still).max() > limit):
                    moving.append((node, path, values))
        if not moving:  # an animation needs a channel
            moving.append((0, "translation", np.tile(tree.translation[0], (len(self.motion), 1))))
        return moving

    def _min_translation(self, node: int) -> float:
        """MIN_TRANSLATION_M in the unit of the node's parent, which may be scaled."""
        parent = self.tree.parents[node]
        size = np.abs(np.linalg.det(self.rest[parent, :3, :3])) ** (1 / 3) if parent >= 0 else 1.0
        return MIN_TRANSLATION_M / max(float(size), 1e-9)

    def _add_surface(self, description: dict[str, Any], surface: Surface, roots: list[int]) -> None:
        """Add the surface as a mesh of points with a skin."""
        influences = surface.joints.shape[1]
        joints = np.zeros((len(surface.points), 4), np.uint8 if len(surface.rest) <= 256 else np.uint16)
        weights = np.zeros((len(surface.points), 4))
        joints[:, :influences], weights[:, :influences] = surface.joints, surface.weights
        joints[weights == 0] = 0
        attributes = {
            "POSITION": self.add(surface.points, "VEC3", bounds=True, target=VERTICES),
            "JOINTS_0": self.add(joints, "VEC4", target=VERTICES),
            "WEIGHTS_0": self.add(weights, "VEC4", target=VERTICES),
        }
        if surface.colours is not None:
            rgba = np.concatenate([surface.colours, np.full((len(surface.points), 1), 255, np.uint8)], axis=1)
            attributes["COLOR_0"] = self.add(rgba, "VEC4", normalised=True, target=VERTICES)
        inverse = np.tile(np.eye(4), (len(surface.rest), 1, 1))
        inverse[:, :3, 3] = -surface.rest
        primitive = {"attributes": attributes, "mode": 0}
        self._add_skinned(description, roots, "surface", list(range(len(surface.rest))), inverse, primitive)

    def _add_bones(self, description: dict[str, Any], roots: list[int]) -> None:
        """Add the joints as a skin, with a mesh that shows the bones."""
        tree, skeleton = self.tree, self.motion.skeleton
        assert skeleton is not None
        node_of = {joint: node for node, joint in enumerate(tree.joints) if joint >= 0}
        nodes = [node_of[joint] for joint in range(self.motion.points)]
        rest = self.rest[nodes]
        mesh = bones.mesh(rest[:, :3, 3], skeleton.parents)
        joints = np.zeros((len(mesh.points), 4), np.uint8 if len(nodes) <= 256 else np.uint16)
        joints[:, 0] = mesh.joints
        weights = np.zeros((len(mesh.points), 4), np.uint8)
        weights[:, 0] = 255
        attributes = {
            "POSITION": self.add(mesh.points, "VEC3", bounds=True, target=VERTICES),
            "JOINTS_0": self.add(joints, "VEC4", target=VERTICES),
            "WEIGHTS_0": self.add(weights, "VEC4", normalised=True, target=VERTICES),
        }
        index_type = np.uint16 if len(mesh.points) < 1 << 16 else np.uint32
        indices = self.add(mesh.triangles.reshape(-1, 1).astype(index_type), "SCALAR", target=INDICES)
        self._add_skinned(
            description,
            roots,
            "bones",
            nodes,
            np.asarray(np.linalg.pinv(rest), np.float64),
            {"attributes": attributes, "indices": indices},
        )

    def _add_skinned(
        self,
        description: dict[str, Any],
        roots: list[int],
        name: str,
        joints: list[int],
        inverse: Floats,
        primitive: dict[str, Any],
    ) -> None:
        """Add a mesh with a skin of these nodes; inverse (joints, 4, 4): their inverse bind matrices."""
        inverse[:, 3] = (0.0, 0.0, 0.0, 1.0)
        columns = inverse.transpose(0, 2, 1).reshape(-1, 16)  # matrices are stored column by column
        description["skins"] = [{"joints": joints, "inverseBindMatrices": self.add(columns, "MAT4")}]
        description["materials"] = [{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}]
        description["meshes"] = [{"name": name, "primitives": [primitive | {"material": 0}]}]
        description["nodes"].append({"name": name, "mesh": 0, "skin": 0})
        roots.append(len(description["nodes"]) - 1)


KINDS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3"}
VERTICES, INDICES = 34962, 34963
"""Targets of buffer views."""


def _components(path: str, values: Floats) -> Floats:
    """Values in the order of glTF: w of a quaternion last."""
    return values[:, [1, 2, 3, 0]] if path == "rotation" else values
