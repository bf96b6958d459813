"""A glTF file as it lies on disk: its JSON, its buffers and its accessors.

.glb   header, JSON chunk, BIN chunk ─┐
.gltf  JSON text ─────────────────────┼─► buffers: BIN chunk, files beside it, data: URIs ─► accessors ─► float64
"""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from ...errors import BadInput
from ...typing import Floats
from . import meshopt
from .binary import MAGIC, unpack

COMPONENT_TYPES: dict[int, Any] = {
    5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32,
}  # fmt: skip
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}

MESHOPT = "EXT_meshopt_compression"
UNDERSTOOD = {MESHOPT, "KHR_mesh_quantization"}
"""Required extensions that change what is read here."""
WITHOUT_MOTION = re.compile(
    r"KHR_(materials|texture)_\w+|(EXT|MSFT)_texture_\w+|KHR_draco_mesh_compression|KHR_lights_punctual|"
    r"EXT_mesh_gpu_instancing|KHR_node_visibility"
)
"""Required extensions of surfaces, pictures and lights: they change no joint."""

MAX_VALUE = 1e12
"""Largest number of a transform or an animation; larger ones are damage."""
FREE_VALUES = 1 << 22
VALUES_PER_BYTE = 4
"""Numbers that accessors may make: FREE_VALUES and VALUES_PER_BYTE for each byte of the file and its buffers."""


class Document:
    """A GLB or glTF file. json: its description. path: for messages. bytes: the size of the file and its buffers."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        data = self.path.read_bytes()
        self.bytes = len(data)
        try:
            self.json, self._bin = unpack(data) if data[:4] == MAGIC else (_text(data), None)
            self._require_version()
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from None
        self._buffers = dict[int, bytes]()
        self._files = dict[str, bytes]()
        self._values = dict[int, Floats]()
        self._spent = 0

    def items(self, name: str) -> list[dict[str, Any]]:
        """One of the lists of the description: "nodes", "animations", "skins"; empty without it. Raises BadInput."""
        found = self.json.get(name) or []
        if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
            raise self.damaged(f"{name} is not a list of objects")
        return found

    def damaged(self, what: str) -> BadInput:
        """The error for a file that contradicts the specification."""
        return BadInput(f"{self.path}: damaged: {what}")

    def _require_version(self) -> None:
        """Raises BadInput for another version of glTF, and for required extensions that are not understood."""
        version = str(self.json.get("asset", {}).get("version", "2.0"))
        if not version.startswith("2."):
            raise BadInput(f"glTF version {version:.20} is not supported; export it as glTF 2.0")
        for name in map(str, self.json.get("extensionsRequired") or []):
            if name not in UNDERSTOOD and not WITHOUT_MOTION.fullmatch(name):
                raise BadInput(f"it requires the extension {name:.80}, which is not supported; export it without")

    def _buffer(self, number: int) -> bytes:
        """The bytes of a buffer. Raises BadInput if they are missing or fewer than declared."""
        if number not in self._buffers:
            declared = self.json["buffers"][number]
            uri, length = declared.get("uri"), int(declared["byteLength"])
            if uri is None and number == 0 and self._bin is not None:
                data = self._bin
            elif isinstance(uri, str):
                data = self._fetched(uri, length)
            else:
                raise self.damaged(f"buffer {number} has no bytes")
            if not 0 <= length <= len(data):
                raise BadInput(f"{self.path}: cut off: buffer {number} has {len(data)} bytes of {length}")
            self._buffers[number] = data
        return self._buffers[number]

    def _fetched(self, uri: str, length: int) -> bytes:
        """The bytes of a data: URI, or of a file in the folder of this one."""
        if uri not in self._files:
            if uri.startswith("data:"):
                head, _, text = uri.partition(",")
                data = base64.b64decode(text) if head.endswith(";base64") else unquote(text).encode("latin-1")
            else:
                name = unquote(uri)
                beside = self.path.parent.resolve()
                file = (beside / name).resolve()
                if re.match(r"[a-z][a-z0-9+.-]*:", name, re.IGNORECASE) or not file.is_relative_to(beside):
                    raise BadInput(f"{self.path}: its buffer {name:.80} is not in its folder: put it there")
                if not file.is_file():
                    raise BadInput(f"{self.path}: its buffer {name:.80} is missing: put it beside the file")
                if file.stat().st_size < length:
                    raise BadInput(f"{self.path}: cut off: {name:.80} has {file.stat().st_size} bytes of {length}")
                data = file.read_bytes()
            self.bytes += len(data)
            self._files[uri] = data
        return self._files[uri]

    def _view(self, number: int) -> tuple[memoryview, int | None]:
        """The bytes of a buffer view, and its stride if it has one."""
        view = self.json["bufferViews"][number]
        if MESHOPT in view.get("extensions", {}):
            packed = view["extensions"][MESHOPT]
            source = self._span(packed, f"buffer view {number}")
            stride, count = int(packed["byteStride"]), int(packed["count"])
            self._spend(stride * count // VALUES_PER_BYTE)
            try:
                data = meshopt.decode(source, count, stride, packed["mode"], packed.get("filter", "NONE"))
            except BadInput as error:
                raise BadInput(f"{self.path}: buffer view {number} ({MESHOPT}): {error}") from None
            return memoryview(data), stride
        stride = view.get("byteStride")
        return self._span(view, f"buffer view {number}"), None if stride is None else int(stride)

    def _span(self, span: dict[str, Any], what: str) -> memoryview:
        """`byteLength` bytes at `byteOffset` of a buffer."""
        data = self._buffer(int(span["buffer"]))
        start, length = int(span.get("byteOffset", 0)), int(span["byteLength"])
        if start < 0 or length < 0 or start + length > len(data):
            raise self.damaged(f"{what} lies outside its buffer")
        return memoryview(data)[start : start + length]

    def _spend(self, values: int) -> None:
        """Raises BadInput once accessors make far more numbers than the file has bytes."""
        self._spent += values
        if self._spent > FREE_VALUES + VALUES_PER_BYTE * self.bytes:
            raise self.damaged(f"its accessors make {self._spent:,} numbers out of {self.bytes:,} bytes")

    def values(self, number: int, width: int, count: int | None = None) -> Floats:
        """The values (count, width) of an accessor. Raises BadInput, also if it has another width or count."""
        accessor = self.json["accessors"][number]
        dtype, declared = np.dtype(COMPONENT_TYPES[accessor["componentType"]]), int(accessor["count"])
        if WIDTHS.get(accessor["type"]) != width or declared < 1 or (count is not None and declared != count):
            expected = f"{'some' if count is None else count} values of {width} numbers"
            raise self.damaged(f"accessor {number} has {declared} of type {accessor['type']:.20}, not {expected}")
        if number not in self._values:
            self._spend(declared * width)
            values = np.zeros((declared, width), dtype)
            if "bufferView" in accessor:
                values = self._array(accessor, dtype, declared, width, f"accessor {number}")
            if "sparse" in accessor:
                values = self._substituted(values, accessor["sparse"], f"accessor {number}")
            with np.errstate(invalid="ignore"):
                result = values.astype(np.float64)
            if accessor.get("normalized") and dtype.kind in "iu":
                result = np.maximum(result / np.iinfo(dtype).max, -1.0)
            if not (np.abs(result) < MAX_VALUE).all():
                raise self.damaged(f"accessor {number} has values that are not finite, or beyond {MAX_VALUE:g}")
            self._values[number] = result
        return self._values[number]

    def _array(self, where: dict[str, Any], dtype: np.dtype[Any], count: int, width: int, what: str) -> np.ndarray:
        """An array (count, width) in a buffer view."""
        data, stride = self._view(int(where["bufferView"]))
        size = dtype.itemsize * width
        stride = size if stride is None else stride
        start = int(where.get("byteOffset", 0))
        end = start + (count - 1) * stride + size
        if count < 1 or start < 0 or stride < size or end > len(data):
            raise self.damaged(f"{what} lies outside its buffer view")
        flat = np.frombuffer(data, np.uint8, end - start, start)
        rows = np.lib.stride_tricks.as_strided(flat, (count, size), (stride, 1))
        return np.ascontiguousarray(rows).view(dtype.newbyteorder("<"))

    def _substituted(self, values: np.ndarray, sparse: dict[str, Any], what: str) -> np.ndarray:
        """The values with those of a sparse accessor in their places."""
        count = int(sparse["count"])
        if not 1 <= count <= len(values):
            raise self.damaged(f"{what} replaces {count} of {len(values)} values")
        indices, dtype = sparse["indices"], np.dtype(COMPONENT_TYPES[sparse["indices"]["componentType"]])
        at = self._array(indices, dtype, count, 1, f"the indices of {what}")[:, 0]
        if dtype.kind != "u" or at.max() >= len(values):
            raise self.damaged(f"{what} replaces values beyond its end")
        values = values.copy()
        values[at] = self._array(sparse["values"], values.dtype, count, values.shape[1], f"the values of {what}")
        return values


def _text(data: bytes) -> dict[str, Any]:
    """The description of a text glTF. Raises BadInput."""
    try:
        description = json.loads(data.decode("utf-8-sig"))
    except ValueError:
        raise BadInput("not a GLB, and not the JSON of a glTF") from None
    if not isinstance(description, dict) or "asset" not in description:
        raise BadInput("not a glTF: its JSON has no asset")
    return description
