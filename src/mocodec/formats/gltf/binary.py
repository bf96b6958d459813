"""The parts of a GLB that reading and writing share: its two chunks, and the turn of the vertical axis to y."""

from __future__ import annotations

import json
import math
import struct
from typing import Any, NamedTuple

from ...errors import BadInput
from ...typing import AnyInteger, Bytes, Floats

MAGIC, VERSION, JSON_CHUNK, BIN_CHUNK = b"glTF", 2, 0x4E4F534A, 0x004E4942
FLOAT, BYTE, SHORT, INT = 5126, 5121, 5123, 5125
"""Component types of accessors: float32, uint8, uint16, uint32."""
TO_Y_UP = {"x": (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)), "z": (math.sqrt(0.5), -math.sqrt(0.5), 0.0, 0.0)}
"""Rotation that makes each vertical axis y; quaternions, w first."""


class Surface(NamedTuple):
    """Points that follow joints.

    points (n, 3): metres, in the rest pose, where the joints stand at `rest` (joints, 3) and are not rotated.
    colours: (n, 3) or None. joints (n, k) and weights (n, k): the joints that each point follows; k ≤ 4.
    """

    points: Floats
    colours: Bytes | None
    joints: AnyInteger
    weights: Floats
    rest: Floats


def pack(description: dict[str, Any], blob: bytes) -> bytes:
    """A GLB of a JSON description and one binary buffer."""
    text = json.dumps(description, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), JSON_CHUNK) + text
    body += struct.pack("<II", len(blob), BIN_CHUNK) + blob
    return MAGIC + struct.pack("<II", VERSION, 12 + len(body)) + body


def unpack(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The inverse of `pack`; other kinds of chunks are skipped. Raises BadInput."""
    if len(data) < 20 or data[:4] != MAGIC:
        raise BadInput("not a GLB")
    version, length = struct.unpack_from("<II", data, 4)
    if version != VERSION:
        raise BadInput(f"glTF version {version} is not supported; export it as glTF 2.0")
    if length > len(data):
        raise BadInput(f"cut off: {len(data)} bytes of {length}")
    chunks, at = dict[int, bytes](), 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > length:
            raise BadInput(f"damaged: the chunk at byte {at} runs past the end of the file")
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if JSON_CHUNK not in chunks:
        raise BadInput("damaged: it has no JSON chunk")
    return json.loads(chunks[JSON_CHUNK]), chunks.get(BIN_CHUNK, b"")
