"""GLB files for tests, built accessor by accessor."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

LEG: list[dict[str, Any]] = [
    {"name": "hip", "translation": [0, 1, 0], "children": [1]},
    {"name": "thigh", "translation": [0.1, -0.05, 0], "children": [2]},
    {"name": "shin", "translation": [0, -0.45, 0], "children": [3]},
    {"name": "foot", "translation": [0, -0.4, 0.1]},
]


def leg(**changes: dict[str, Any]) -> list[dict[str, Any]]:
    """The nodes of a leg; changes: entries of nodes by name."""
    return [{**node, **changes.get(node["name"], {})} for node in LEG]


def about(axis: str, degrees: float | np.ndarray) -> np.ndarray:
    """Quaternions, w last as in glTF, of angles about an axis."""
    half = np.radians(np.atleast_1d(degrees)) / 2
    result = np.zeros((len(half), 4))
    result[:, "xyz".index(axis)], result[:, 3] = np.sin(half), np.cos(half)
    return result


class Build:
    """A glTF that grows: accessors, animations, skins."""

    def __init__(self, nodes: list[dict[str, Any]], skins: list[dict[str, Any]] | None = None) -> None:
        self.blob = b""
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "test"},
            "nodes": nodes,
            "animations": [],
            "accessors": [],
            "bufferViews": [],
            "buffers": [{}],
        }
        if skins is not None:
            self.json["skins"] = skins

    def view(self, data: bytes, **entries: Any) -> int:
        """A buffer view of these bytes."""
        self.blob += bytes(-len(self.blob) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data), **entries})
        self.blob += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values: Any, dtype: str = "<f4", **entries: Any) -> int:
        """An accessor of values (count,) or (count, width)."""
        array = np.asarray(values).astype(dtype)
        component = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}[array.dtype.str[1:]]
        kind = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
        accessor = {"componentType": component, "count": len(array), "type": kind, **entries}
        if "sparse" not in entries and "bufferView" not in entries:
            accessor["bufferView"] = self.view(array.tobytes())
        if array.ndim == 1 and len(array):
            accessor |= {"min": [float(array.min())], "max": [float(array.max())]}
        self.json["accessors"].append(accessor)
        return len(self.json["accessors"]) - 1

    def animation(self, name: str = "") -> Build:
        """Begin an animation."""
        self.json["animations"].append({"channels": [], "samplers": []} | ({"name": name} if name else {}))
        return self

    def move(self, node: int, path: str, times: Any, values: Any, interpolation: str = "LINEAR") -> Build:
        """Animate a node; times and values are arrays, or accessors."""
        animation = self.json["animations"][-1]
        animation["channels"].append({"sampler": len(animation["samplers"]), "target": {"node": node, "path": path}})
        at, output = (x if isinstance(x, int) else self.accessor(x) for x in (times, values))
        animation["samplers"].append({"input": at, "output": output, "interpolation": interpolation})
        return self

    def glb(self, path: Path) -> Path:
        """Write a .glb."""
        self.json["buffers"][0].setdefault("byteLength", len(self.blob))
        path.write_bytes(packed(self.json, self.blob))
        return path


def packed(content: dict[str, Any], blob: bytes | None) -> bytes:
    """A GLB; without a BIN chunk for None."""
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text
    if blob is not None:
        blob += bytes(-len(blob) % 4)
        body += struct.pack("<II", len(blob), 0x004E4942) + blob
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def parts(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON and the BIN chunk of a GLB."""
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]
