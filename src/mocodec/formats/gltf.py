"""GLB: animated skeletons as binary glTF 2.0, metres, y up.

    header ─► JSON: nodes, animations, accessors ─► BIN: key times and values ─► sampled at one rate ─► Motion

Written: a node for each joint, its turns and the root's path as one animation, and, where it is given, the body's
surface as coloured points that follow the joints.
"""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..geometry import articulation, kinematics, rigid
from ..motion import Floats, Motion, Skeleton
from . import replace_whole

HOLDS = frozenset({"skeleton", "joint rotations"})  # of what is beside the positions

MAGIC, VERSION, JSON_CHUNK, BIN_CHUNK = b"glTF", 2, 0x4E4F534A, 0x004E4942
FLOAT, BYTE, SHORT = 5126, 5121, 5123
TYPES: dict[int, Any] = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
SLIDES = 1e-6  # metres: a joint that moves more than this against its parent gets a path of its own
MOST_FRAMES = 1 << 24
TO_Y_UP = {"x": (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)), "z": (math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0)}  # w first


class Surface(NamedTuple):
    """Points that follow joints: points (n, 3) metres where the joints stand at `rest` (joints, 3) and none is turned;
    joints (n, k) and weights (n, k) of those that each follows, k at most 4; colours (n, 3), or none.
    """

    points: Floats
    colours: NDArray[np.uint8] | None
    joints: NDArray[Any]
    weights: Floats
    rest: Floats


# --- writing --------------------------------------------------------------------------------------------------------


def write(path: str | Path, motion: Motion, surface: Surface | None = None) -> None:
    """Write a GLB. Motions without rotations become nodes that slide. Raises BadInput for gaps."""
    if motion.gaps.any():
        raise BadInput(f"{path}: a GLB cannot hold gaps")
    if not len(motion) or not motion.points:
        raise BadInput(f"{path}: a GLB of nothing has nothing to show")
    file = _Writer(motion)
    replace_whole(path, file.bytes(surface))


class _Writer:
    """Collects accessors and the JSON around them."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.blob = bytearray()
        self.views, self.accessors = list[dict[str, Any]](), list[dict[str, Any]]()

    def add(self, values: NDArray[Any], kind: str, bounds: bool = False, normalised: bool = False) -> int:
        """The number of a new accessor of these values."""
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
        motion = self.motion
        parents, offsets, rotations = _tree(motion)
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
            self._show(gltf, surface, roots)
        gltf["scenes"] = [{"nodes": roots}]
        gltf |= {"accessors": self.accessors, "bufferViews": self.views, "buffers": [{"byteLength": len(self.blob)}]}
        text = json.dumps(gltf, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        body = struct.pack("<II", len(text), JSON_CHUNK) + text
        body += struct.pack("<II", len(self.blob), BIN_CHUNK) + bytes(self.blob)
        return MAGIC + struct.pack("<II", VERSION, 12 + len(body)) + body

    def _animation(self, parents: tuple[int, ...], offsets: Floats, rotations: Floats | None) -> dict[str, Any]:
        motion = self.motion
        time = self.add((np.arange(len(motion)) / motion.rate).astype(np.float32)[:, None], "SCALAR", bounds=True)
        samplers, channels = list[dict[str, Any]](), list[dict[str, Any]]()

        def animate(joint: int, path: str, values: Floats, kind: str) -> None:
            channels.append({"sampler": len(samplers), "target": {"node": joint, "path": path}})
            samplers.append({"input": time, "output": self.add(values, kind), "interpolation": "LINEAR"})

        world = None if rotations is None else kinematics.world_rotations(_skeleton(motion), rotations)
        for joint, parent in enumerate(parents):
            place = motion.positions[:, joint]
            if parent >= 0:
                place = place - motion.positions[:, parent]
                if world is not None:
                    place = rigid.rotate(rigid.inverse(world[:, parent]), place)
            if np.abs(place - offsets[joint]).max() > SLIDES:
                animate(joint, "translation", place, "VEC3")
            if rotations is not None:
                turns = (
                    rotations[:, joint] * np.sign(np.sum(rotations[:, joint] * rotations[:1, joint], axis=1))[:, None]
                )
                animate(joint, "rotation", turns[:, [1, 2, 3, 0]], "VEC4")
        if not channels:  # all stands still
            animate(0, "translation", np.tile(offsets[0], (len(motion), 1)), "VEC3")
        return {"name": "motion", "samplers": samplers, "channels": channels}

    def _show(self, gltf: dict[str, Any], surface: Surface, roots: list[int]) -> None:
        """The surface as points under a skin."""
        few = surface.joints.shape[1]
        joints = np.zeros((len(surface.points), 4), np.uint8 if len(surface.rest) <= 256 else np.uint16)
        weights = np.zeros((len(surface.points), 4))
        joints[:, :few], weights[:, :few] = surface.joints, surface.weights
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
        inverse[:, 3, :3] = -surface.rest  # columns follow one another
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


def _tree(motion: Motion) -> tuple[tuple[int, ...], Floats, Floats | None]:
    """Parents, offsets and turns of the nodes; without rotations every point is a node of its own."""
    if motion.skeleton is None or motion.rotations is None:
        return (-1,) * motion.points, motion.positions[0], None
    parents, rotations = motion.skeleton.parents, motion.rotations
    if motion.source.get("format") == "amc":  # a joint's turn is that of the bone that ends there
        return (-1,) * motion.points, motion.positions[0], None
    offsets = motion.skeleton.offsets.copy()
    roots = [joint for joint, parent in enumerate(parents) if parent < 0]
    offsets[roots] = motion.positions[0, roots]
    return parents, offsets, rotations


# --- reading --------------------------------------------------------------------------------------------------------


def read(path: str | Path, rate: float | None = None) -> Motion:
    """The first animation of a GLB as a motion of its joints: those of its skin, or else all nodes that move.

    rate: frames a second to sample at; that of the key times unless given. Raises BadInput.
    """
    try:
        return _Reader(path).motion(rate)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError, RecursionError, AttributeError) as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(f"{path}: not a GLB that can be read ({type(error).__name__}: {error})") from None


class _Reader:
    """A GLB's JSON and binary part."""

    def __init__(self, path: str | Path) -> None:
        self.path = path
        data = Path(path).read_bytes()
        if len(data) < 20 or data[:4] != MAGIC:
            raise BadInput(f"{path}: not a GLB")
        version, length = struct.unpack_from("<II", data, 4)
        if version != VERSION:
            raise BadInput(f"{path}: glTF version {version}; version 2 can be read")
        if length > len(data):
            raise BadInput(f"{path}: cut off: {len(data)} bytes of {length}")
        parts, at = dict[int, bytes](), 12
        while at + 8 <= length:
            size, kind = struct.unpack_from("<II", data, at)
            if at + 8 + size > length:
                raise BadInput(f"{path}: a part runs past its end")
            parts.setdefault(kind, data[at + 8 : at + 8 + size])
            at += 8 + size
        if JSON_CHUNK not in parts:
            raise BadInput(f"{path}: has no description")
        self.json: dict[str, Any] = json.loads(parts[JSON_CHUNK])
        self.blob = parts.get(BIN_CHUNK, b"")
        self.nodes: list[dict[str, Any]] = self.json.get("nodes", [])
        self.parents = self._parents()

    def _parents(self) -> list[int]:
        parents = [-1] * len(self.nodes)
        for node, content in enumerate(self.nodes):
            for child in content.get("children", ()):
                if not 0 <= child < len(parents) or parents[child] >= 0 or child == node:
                    raise BadInput(f"{self.path}: its nodes are not a tree")
                parents[child] = node
        for node in range(len(parents)):
            above, steps = node, 0
            while above >= 0:
                above, steps = parents[above], steps + 1
                if steps > len(parents):
                    raise BadInput(f"{self.path}: its nodes are not a tree")
        return parents

    def values(self, number: int) -> Floats:
        """(count, width) of an accessor. Raises BadInput."""
        accessor = self.json["accessors"][number]
        dtype, width, count = TYPES[accessor["componentType"]], WIDTHS[accessor["type"]], int(accessor["count"])
        if "sparse" in accessor or "bufferView" not in accessor:
            raise BadInput(f"{self.path}: sparse accessors are not read")
        view = self.json["bufferViews"][accessor["bufferView"]]
        size = np.dtype(dtype).itemsize
        stride = int(view.get("byteStride", size * width))
        start = int(view.get("byteOffset", 0)) + int(accessor.get("byteOffset", 0))
        end = start + (count - 1) * stride + size * width
        if count < 1 or start < 0 or stride < size * width or end > len(self.blob) or view.get("buffer", 0) != 0:
            raise BadInput(f"{self.path}: an accessor lies outside its buffer")
        flat = np.frombuffer(self.blob, np.uint8, end - start, start)
        rows = np.lib.stride_tricks.as_strided(flat, (count, size * width), (stride, 1))
        with np.errstate(invalid="ignore"):
            result = np.ascontiguousarray(rows).view(np.dtype(dtype).newbyteorder("<")).astype(np.float64)
        if accessor.get("normalized") and dtype != np.float32:
            result = np.maximum(result / np.iinfo(dtype).max, -1.0)
        if not np.isfinite(result).all():
            raise BadInput(f"{self.path}: values that are no numbers")
        return result

    def motion(self, rate: float | None) -> Motion:
        animations = self.json.get("animations") or []
        if not animations:
            raise BadInput(f"{self.path}: has no animation")
        tracks = self._tracks(animations[0])
        if not tracks:
            raise BadInput(f"{self.path}: its animation moves no node")
        told = self.json.get("asset", {}).get("extras", {})
        told = told if isinstance(told, dict) else {}
        ours = self.json.get("asset", {}).get("generator") == "mocodec"
        times = max((track.times for track in tracks.values()), key=len)
        if rate is None:
            rate = float(told["rate"]) if ours and "rate" in told else _rate_of(times)
        if not 0 < rate < 1e6:
            raise BadInput(f"{self.path}: its key times do not say its rate; say it with rate=")
        begin, end = min(t.times[0] for t in tracks.values()), max(t.times[-1] for t in tracks.values())
        count = round((end - begin) * rate) + 1
        if count > MOST_FRAMES:
            raise BadInput(f"{self.path}: {count} frames are more than can be")
        at = begin + np.arange(count) / rate
        joints = self._joints({node for node, _ in tracks})
        positions, rotations, rest = self._play(tracks, at, joints)
        parents = self._joint_parents(joints)
        offsets = np.array([rest[i] - (rest[p] if p >= 0 else 0) for i, p in enumerate(parents)])
        names = _unique([str(self.nodes[node].get("name") or f"node{node}") for node in joints])
        up = told.get("up") if ours else "y"
        if up in TO_Y_UP:
            back = rigid.inverse(np.array(TO_Y_UP[up]))
            positions, offsets = rigid.rotate(back, positions), rigid.rotate(back, offsets)
            turns = rigid.multiply(rigid.multiply(back, rotations), rigid.inverse(back))
            rotations = np.ascontiguousarray(turns)
        local = rotations.copy()
        for joint, parent in enumerate(parents):
            if parent >= 0:
                local[:, joint] = rigid.multiply(rigid.inverse(rotations[:, parent]), rotations[:, joint])
        source = {"format": "glb", "units": "m", "unit_m": 1.0}
        skeleton = Skeleton(names, parents, offsets)
        return Motion(positions, rate, names, up if up in TO_Y_UP else "y", skeleton, local, source)

    def _tracks(self, animation: dict[str, Any]) -> dict[tuple[int, str], _Track]:
        tracks = dict[tuple[int, str], _Track]()
        for channel in animation["channels"]:
            target, sampler = channel["target"], animation["samplers"][channel["sampler"]]
            if "node" not in target or target["path"] == "weights":
                continue
            if not 0 <= target["node"] < len(self.nodes):
                raise BadInput(f"{self.path}: an animation of a node that is not there")
            times, values = self.values(sampler["input"])[:, 0], self.values(sampler["output"])
            how = sampler.get("interpolation", "LINEAR")
            if (np.diff(times) <= 0).any() or len(values) != len(times) * (3 if how == "CUBICSPLINE" else 1):
                raise BadInput(f"{self.path}: an animation's key times do not fit its values")
            if values.shape[1] != {"translation": 3, "rotation": 4, "scale": 3}[target["path"]]:
                raise BadInput(f"{self.path}: an animation of the wrong width")
            tracks[target["node"], target["path"]] = _Track(times, values, how)
        return tracks

    def _joints(self, moving: set[int]) -> list[int]:
        """Nodes that are points of the motion, parents before children."""
        skins = self.json.get("skins") or []
        chosen = set[int](skins[0]["joints"]) if skins else set[int]()
        if not chosen <= set(range(len(self.nodes))):
            raise BadInput(f"{self.path}: a skin of nodes that are not there")
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
        """All nodes, each after its parent; in the file's order where that is one."""
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

    def _play(
        self, tracks: dict[tuple[int, str], _Track], at: Floats, joints: list[int]
    ) -> tuple[Floats, Floats, Floats]:
        """Places (frames, joints, 3), turns in the world against the rest pose (frames, joints, 4), places at rest."""
        world, still = dict[int, tuple[Floats, Floats, Floats]](), dict[int, tuple[Floats, Floats, Floats]]()
        for node in self._order():
            own = self._own(node)
            moved = tuple(
                tracks[node, path].sample(at, path == "rotation") if (node, path) in tracks else value[None]
                for path, value in zip(("translation", "rotation", "scale"), own, strict=True)
            )
            parent = self.parents[node]
            world[node] = _under(world[parent] if parent >= 0 else None, *moved)
            still[node] = _under(still[parent] if parent >= 0 else None, *(value[None] for value in own))
        frames = len(at)
        places = np.stack([np.broadcast_to(world[n][0], (frames, 3)) for n in joints], axis=1)
        turns = [np.broadcast_to(rigid.multiply(world[n][1], rigid.inverse(still[n][1])), (frames, 4)) for n in joints]
        return places, np.stack(turns, axis=1), np.array([still[n][0][0] for n in joints])

    def _own(self, node: int) -> tuple[Floats, Floats, Floats]:
        """Translation, rotation (w first) and scale of a node at rest."""
        content = self.nodes[node]
        if "matrix" in content:
            m = np.array(content["matrix"], float).reshape(4, 4).T
            scale = np.linalg.norm(m[:3, :3], axis=0)
            if (scale < 1e-12).any() or not np.isfinite(m).all():
                raise BadInput(f"{self.path}: node {node} has no size")
            return m[:3, 3], articulation.quaternions(m[:3, :3] / scale), scale
        place = np.array(content.get("translation", (0, 0, 0)), float).reshape(3)
        x, y, z, w = (float(v) for v in content.get("rotation", (0, 0, 0, 1)))
        turn, scale = np.array([w, x, y, z]), np.array(content.get("scale", (1, 1, 1)), float).reshape(3)
        if not np.isfinite(np.concatenate([place, turn, scale])).all() or not turn.any():
            raise BadInput(f"{self.path}: node {node} stands nowhere")
        return place, turn / np.linalg.norm(turn), scale


def _under(
    above: tuple[Floats, Floats, Floats] | None, place: Floats, turn: Floats, scale: Floats
) -> tuple[Floats, Floats, Floats]:
    """A node's place, turn and scale in the world, from its own and its parent's."""
    if above is None:
        return place, turn, scale
    return above[0] + rigid.rotate(above[1], above[2] * place), rigid.multiply(above[1], turn), above[2] * scale


class _Track(NamedTuple):
    """Key times (keys,) and values of one path of one node."""

    times: Floats
    values: Floats
    how: str

    def sample(self, at: Floats, turns: bool) -> Floats:
        """Values at these times; turns as unit quaternions, w first."""
        last = len(self.times) - 1
        key = np.clip(np.searchsorted(self.times, at + 1e-9, side="right") - 1, 0, max(last - 1, 0))
        after = np.minimum(key + 1, last)
        span = np.maximum(self.times[after] - self.times[key], 1e-12)
        share = np.clip((at - self.times[key]) / span, 0, 1)[:, None]
        if self.how == "CUBICSPLINE":
            a, v, b = self.values[0::3], self.values[1::3], self.values[2::3]
            t = share
            values = (
                (2 * t**3 - 3 * t**2 + 1) * v[key] + span[:, None] * (t**3 - 2 * t**2 + t) * b[key]
                + (3 * t**2 - 2 * t**3) * v[after] + span[:, None] * (t**3 - t**2) * a[after]
            )  # fmt: skip
        elif self.how == "STEP":
            values = np.where(share < 1, self.values[key], self.values[after])
        elif turns:
            values = _slerp(self.values[key], self.values[after], share)
        else:
            values = self.values[key] + share * (self.values[after] - self.values[key])
        if not turns:
            return values
        values = values[:, [3, 0, 1, 2]]
        return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)


def _slerp(a: Floats, b: Floats, share: Floats) -> Floats:
    """Between quaternions, along the shorter way."""
    dot = np.sum(a * b, axis=1, keepdims=True)
    b, dot = np.where(dot < 0, -b, b), np.minimum(np.abs(dot), 1.0)
    angle = np.arccos(dot)
    near = angle < 1e-4
    sine = np.where(near, 1.0, np.sin(angle))
    first = np.where(near, 1 - share, np.sin((1 - share) * angle) / sine)
    return first * a + np.where(near, share, np.sin(share * angle) / sine) * b


def _rate_of(times: Floats) -> float:
    """Frames a second of key times: a whole number where they nearly say one."""
    if len(times) < 2:
        return 30.0
    rate = 1 / float(np.median(np.diff(times)))
    return float(round(rate)) if abs(rate - round(rate)) < 0.005 * rate else rate


def _unique(names: list[str]) -> tuple[str, ...]:
    seen = dict[str, int]()
    result = list[str]()
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        result.append(name if seen[name] == 1 else f"{name}_{seen[name]}")
    return tuple(result)
