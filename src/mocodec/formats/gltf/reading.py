"""GLB to Motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BadInput
from ...geometry import articulation, rigid
from ...motion import Motion, Skeleton
from ...typing import Floats
from ..conventions import unit_option
from .binary import TO_Y_UP, unpack
from .tracks import Track, rate_of

COMPONENT_TYPES: dict[int, Any] = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
MAX_FRAMES = 1 << 24


def read(path: str | Path, rate: float | None = None, unit: str | float | None = None) -> Motion:
    """The first animation of a GLB as a motion of its joints.

    The joints are those of the first skin; without a skin, all animated nodes and the nodes below them.
    rate: sampling rate in hertz; by default that of the key times. unit: of the
    lengths, by default metres as glTF demands. Raises BadInput.
    """
    try:
        motion = _GlbReader(path).motion(rate)
        return motion if unit is None else _scaled(motion, *unit_option(unit))
    except (KeyError, IndexError, TypeError, ValueError, OverflowError, RecursionError, AttributeError) as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(f"{path}: cannot be read as a GLB ({type(error).__name__}: {error})") from None


class _GlbReader:
    """A GLB's JSON and binary part."""

    def __init__(self, path: str | Path) -> None:
        self.path = path
        try:
            self.json, self.blob = unpack(Path(path).read_bytes())
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from None
        self.nodes: list[dict[str, Any]] = self.json.get("nodes", [])
        self.parents = self._parents()

    def _parents(self) -> list[int]:
        parents = [-1] * len(self.nodes)
        for node, content in enumerate(self.nodes):
            for child in content.get("children", ()):
                if not 0 <= child < len(parents) or parents[child] >= 0 or child == node:
                    raise BadInput(f"{self.path}: damaged: its nodes do not form a tree")
                parents[child] = node
        for node in range(len(parents)):
            above, steps = node, 0
            while above >= 0:
                above, steps = parents[above], steps + 1
                if steps > len(parents):
                    raise BadInput(f"{self.path}: damaged: its nodes do not form a tree")
        return parents

    def values(self, number: int) -> Floats:
        """The values (count, width) of an accessor. Raises BadInput."""
        accessor = self.json["accessors"][number]
        dtype, width, count = (
            COMPONENT_TYPES[accessor["componentType"]],
            WIDTHS[accessor["type"]],
            int(accessor["count"]),
        )
        if "sparse" in accessor or "bufferView" not in accessor:
            raise BadInput(
                f"{self.path}: accessor {number} is sparse, which is not supported; export without sparse accessors"
            )
        view = self.json["bufferViews"][accessor["bufferView"]]
        size = np.dtype(dtype).itemsize
        stride = int(view.get("byteStride", size * width))
        start = int(view.get("byteOffset", 0)) + int(accessor.get("byteOffset", 0))
        end = start + (count - 1) * stride + size * width
        if count < 1 or start < 0 or stride < size * width or end > len(self.blob) or view.get("buffer", 0) != 0:
            raise BadInput(f"{self.path}: damaged: accessor {number} lies outside its buffer")
        flat = np.frombuffer(self.blob, np.uint8, end - start, start)
        rows = np.lib.stride_tricks.as_strided(flat, (count, size * width), (stride, 1))
        with np.errstate(invalid="ignore"):
            result = np.ascontiguousarray(rows).view(np.dtype(dtype).newbyteorder("<")).astype(np.float64)
        if accessor.get("normalized") and dtype != np.float32:
            result = np.maximum(result / np.iinfo(dtype).max, -1.0)
        if not np.isfinite(result).all():
            raise BadInput(f"{self.path}: damaged: accessor {number} has values that are not finite")
        return result

    def motion(self, rate: float | None) -> Motion:
        animations = self.json.get("animations") or []
        if not animations:
            raise BadInput(f"{self.path}: has no animation")
        tracks = self._tracks(animations[0])
        if not tracks:
            raise BadInput(f"{self.path}: its first animation animates no node")
        asset = self.json.get("asset", {})
        is_own = asset.get("generator") == "mocodec" and isinstance(asset.get("extras"), dict)
        own: dict[str, Any] = asset["extras"] if is_own else {}
        times = max((track.times for track in tracks.values()), key=len)
        if rate is None:
            rate = float(own["rate"]) if "rate" in own else rate_of(times)
        if not 0 < rate < 1e6:
            raise BadInput(f"{self.path}: its key times do not give a usable rate; give one with rate= (--rate)")
        begin, end = min(t.times[0] for t in tracks.values()), max(t.times[-1] for t in tracks.values())
        count = round((end - begin) * rate) + 1
        if count > MAX_FRAMES:
            raise BadInput(
                f"{self.path}: {count} frames at {rate:g} Hz exceed {MAX_FRAMES}; give a lower rate= (--rate)"
            )
        at = begin + np.arange(count) / rate
        joints = self._joints({node for node, _ in tracks})
        positions, rotations, rest = self._sample(tracks, at, joints)
        parents = self._joint_parents(joints)
        offsets = np.array([rest[i] - (rest[p] if p >= 0 else 0) for i, p in enumerate(parents)])
        names = _unique([str(self.nodes[node].get("name") or f"node{node}") for node in joints])
        up = own.get("up")
        if up in TO_Y_UP:
            back = rigid.inverse(np.array(TO_Y_UP[up]))
            positions, offsets = rigid.rotate(back, positions), rigid.rotate(back, offsets)
            rotations = np.ascontiguousarray(rigid.multiply(rigid.multiply(back, rotations), rigid.inverse(back)))
        local = rotations.copy()
        for joint, parent in enumerate(parents):
            if parent >= 0:
                local[:, joint] = rigid.multiply(rigid.inverse(rotations[:, parent]), rotations[:, joint])
        source = {"format": "glb", "units": "m", "unit_m": 1.0}
        skeleton = Skeleton(names, parents, offsets)
        return Motion(positions, rate, names, up if up in TO_Y_UP else "y", skeleton, local, source)

    def _tracks(self, animation: dict[str, Any]) -> dict[tuple[int, str], Track]:
        tracks = dict[tuple[int, str], Track]()
        for channel in animation["channels"]:
            target, sampler = channel["target"], animation["samplers"][channel["sampler"]]
            if "node" not in target or target["path"] == "weights":
                continue
            if not 0 <= target["node"] < len(self.nodes):
                raise BadInput(f"{self.path}: damaged: an animation of node {target['node']}, which does not exist")
            times, values = self.values(sampler["input"])[:, 0], self.values(sampler["output"])
            interpolation = sampler.get("interpolation", "LINEAR")
            if (np.diff(times) <= 0).any() or len(values) != len(times) * (3 if interpolation == "CUBICSPLINE" else 1):
                raise BadInput(f"{self.path}: damaged: key times that do not increase, or do not fit their values")
            if values.shape[1] != {"translation": 3, "rotation": 4, "scale": 3}[target["path"]]:
                raise BadInput(
                    f"{self.path}: damaged: an animation of {target['path']} with {values.shape[1]} numbers a key"
                )
            tracks[target["node"], target["path"]] = Track(times, values, interpolation)
        return tracks

    def _joints(self, moving: set[int]) -> list[int]:
        """Nodes that become points of the motion, parents before children."""
        skins = self.json.get("skins") or []
        chosen = set[int](skins[0]["joints"]) if skins else set[int]()
        if not chosen <= set(range(len(self.nodes))):
            raise BadInput(f"{self.path}: damaged: a skin of nodes that do not exist")
        if not chosen:
            for node in range(len(self.nodes)):
                above = node
                while above >= 0 and above not in moving:
                    above = self.parents[above]
                if above >= 0 and not self.nodes[node].keys() & {"mesh", "camera"}:
                    chosen.add(node)
            chosen = chosen or set(moving)
        return [node for node in self._order() if node in chosen]

    def _order(self) -> list[int]:
        """All nodes, parents first; in the file's order if that has parents first."""
        if all(parent < node for node, parent in enumerate(self.parents)):
            return list(range(len(self.nodes)))
        order, waiting = list[int](), [n for n, p in enumerate(self.parents) if p < 0][::-1]
        while waiting:
            order.append(waiting.pop())
            waiting += list(self.nodes[order[-1]].get("children", ()))[::-1]
        return order

    def _joint_parents(self, joints: list[int]) -> tuple[int, ...]:
        place = {node: i for i, node in enumerate(joints)}
        result = list[int]()
        for node in joints:
            above = self.parents[node]
            while above >= 0 and above not in place:
                above = self.parents[above]
            result.append(place.get(above, -1))
        return tuple(result)

    def _sample(
        self, tracks: dict[tuple[int, str], Track], at: Floats, joints: list[int]
    ) -> tuple[Floats, Floats, Floats]:
        """Sample the tracks at the times `at`.

        Returns world positions (frames, joints, 3), world rotations against the rest pose (frames, joints, 4), and
        positions at rest (joints, 3).
        """
        world, rest = dict[int, tuple[Floats, Floats, Floats]](), dict[int, tuple[Floats, Floats, Floats]]()
        for node in self._order():
            local = self._local_transform(node)
            sampled = tuple(
                tracks[node, path].sample(at, path == "rotation") if (node, path) in tracks else value[None]
                for path, value in zip(("translation", "rotation", "scale"), local, strict=True)
            )
            parent = self.parents[node]
            world[node] = _compose(world[parent] if parent >= 0 else None, *sampled)
            rest[node] = _compose(rest[parent] if parent >= 0 else None, *(value[None] for value in local))
        frames = len(at)
        positions = np.stack([np.broadcast_to(world[n][0], (frames, 3)) for n in joints], axis=1)
        rotations = [
            np.broadcast_to(rigid.multiply(world[n][1], rigid.inverse(rest[n][1])), (frames, 4)) for n in joints
        ]
        return positions, np.stack(rotations, axis=1), np.array([rest[n][0][0] for n in joints])

    def _local_transform(self, node: int) -> tuple[Floats, Floats, Floats]:
        """Translation, rotation (w first) and scale of a node at rest."""
        content = self.nodes[node]
        if "matrix" in content:
            m = np.array(content["matrix"], float).reshape(4, 4).T
            scale = np.linalg.norm(m[:3, :3], axis=0)
            if (scale < 1e-12).any() or not np.isfinite(m).all():
                raise BadInput(f"{self.path}: node {node} has a matrix that cannot be inverted")
            return m[:3, 3], articulation.quaternions(m[:3, :3] / scale), scale
        translation = np.array(content.get("translation", (0, 0, 0)), float).reshape(3)
        x, y, z, w = (float(v) for v in content.get("rotation", (0, 0, 0, 1)))
        rotation, scale = np.array([w, x, y, z]), np.array(content.get("scale", (1, 1, 1)), float).reshape(3)
        if not np.isfinite(np.concatenate([translation, rotation, scale])).all() or not rotation.any():
            raise BadInput(f"{self.path}: node {node} has a transform that is not finite, or a zero rotation")
        return translation, rotation / np.linalg.norm(rotation), scale


def _compose(
    parent: tuple[Floats, Floats, Floats] | None, translation: Floats, rotation: Floats, scale: Floats
) -> tuple[Floats, Floats, Floats]:
    """A node's world translation, rotation and scale from its local ones and its parent's world ones."""
    if parent is None:
        return translation, rotation, scale
    position = parent[0] + rigid.rotate(parent[1], parent[2] * translation)
    return position, rigid.multiply(parent[1], rotation), parent[2] * scale


def _scaled(motion: Motion, units: str, unit_m: float) -> Motion:
    """The motion with its lengths in another unit than metres."""
    assert motion.skeleton is not None
    skeleton = replace(motion.skeleton, offsets=motion.skeleton.offsets * unit_m)
    source = {**motion.source, "units": units, "unit_m": unit_m}
    return replace(motion, positions=motion.positions * unit_m, skeleton=skeleton, source=source)


def _unique(names: list[str]) -> tuple[str, ...]:
    """Names with "_2", "_3", … after repeated ones."""
    seen = dict[str, int]()
    result = list[str]()
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        result.append(name if seen[name] == 1 else f"{name}_{seen[name]}")
    return tuple(result)
