"""EXT_meshopt_compression of attributes, as animations use it: decoding of a buffer view.

    header 0xa0 ─► blocks: each byte of the elements on its own, in groups of 16 deltas ─► bytes ─► filter ─► elements

Source: the extension's appendix A (mode 0) and appendix B (filters 2 and 3).
"""

from __future__ import annotations

import numpy as np

from ...errors import BadInput
from ...typing import Bytes

HEADER = 0xA0
GROUP = 16
"""Deltas in a group, all stored with the same number of bits."""
MAX_BLOCK_BYTES, MAX_BLOCK_ELEMENTS = 8192, 256
BASELINE_BYTES = 32
"""The first element follows the blocks, padded to this."""
CUT_OFF = "its compressed bytes end too early"


def decode(data: memoryview | bytes, count: int, stride: int, mode: str, filter_: str = "NONE") -> bytes:
    """The bytes of `count` elements of `stride` bytes. Raises BadInput for other modes and filters, and for damage."""
    if mode != "ATTRIBUTES":
        raise BadInput(f"mode {mode:.20} stores no animation")
    if not 1 <= stride <= 256 or stride % 4 or count < 1:
        raise BadInput(f"{count} elements of {stride} bytes")
    stored = np.frombuffer(data, np.uint8)
    if len(stored) < 1 + max(stride, BASELINE_BYTES) or stored[0] != HEADER:
        raise BadInput(f"it does not begin with 0x{HEADER:02x}, or is too short")
    elements = np.empty((count, stride), np.uint8)
    before = stored[len(stored) - stride :]
    stored = stored[: len(stored) - max(stride, BASELINE_BYTES)]
    at = 1
    block = min((MAX_BLOCK_BYTES // stride) & ~(GROUP - 1), MAX_BLOCK_ELEMENTS)
    for start in range(0, count, block):
        rows = elements[start : start + block]
        for column in range(stride):
            deltas, at = _deltas(stored, at, len(rows))
            rows[:, column] = before[column] + np.cumsum(deltas, dtype=np.uint8)
        before = rows[-1]
    if at != len(stored):
        raise BadInput("its compressed bytes are more than its elements need")
    return _filtered(elements, filter_).tobytes()


def _deltas(stored: Bytes, at: int, count: int) -> tuple[Bytes, int]:
    """The deltas (count,) of one byte of a block's elements, and where the next ones begin."""
    groups = -(-count // GROUP)
    head = stored[at : at + -(-groups // 4)]
    at += len(head)
    if len(head) < -(-groups // 4):
        raise BadInput(CUT_OFF)
    modes = ((head[:, None] >> np.array([0, 2, 4, 6], np.uint8)) & 3).reshape(-1)
    codes = np.zeros((groups, GROUP), np.uint8)
    for group, mode in enumerate(modes[:groups].tolist()):
        if mode:
            codes[group], at = _group(stored, at, mode)
    flat = codes.reshape(-1)[:count]
    return np.where(flat & 1, ~(flat >> 1), flat >> 1).astype(np.uint8), at


def _group(stored: Bytes, at: int, mode: int) -> tuple[Bytes, int]:
    """The 16 zigzag codes of a group; codes of 2 or 4 bits with all bits set are followed by a whole byte."""
    size = (0, 4, 8, 16)[mode]
    packed = stored[at : at + size]
    at += size
    if len(packed) < size:
        raise BadInput(CUT_OFF)
    if mode == 3:
        return packed, at
    shifts, sentinel = (np.array([6, 4, 2, 0], np.uint8), 3) if mode == 1 else (np.array([4, 0], np.uint8), 15)
    codes = ((packed[:, None] >> shifts) & np.uint8(sentinel)).reshape(-1).astype(np.uint8)
    escaped = np.flatnonzero(codes == sentinel)
    whole = stored[at : at + len(escaped)]
    if len(whole) < len(escaped):
        raise BadInput(CUT_OFF)
    codes[escaped] = whole
    return codes, at + len(escaped)


def _filtered(elements: Bytes, filter_: str) -> np.ndarray:
    """The inverse of the filter that the elements (count, stride) went through."""
    if filter_ == "NONE":
        return elements
    if filter_ == "EXPONENTIAL":
        words = np.ascontiguousarray(elements).view("<i4")
        return np.ldexp(((words << 8) >> 8).astype(np.float64), words >> 24).astype("<f4")
    if filter_ == "QUATERNION" and elements.shape[1] == 8:
        words = np.ascontiguousarray(elements).view("<i2").astype(np.int64)
        three = words[:, :3] / (words[:, 3:] | 3) * np.sqrt(0.5)
        largest = np.sqrt(np.maximum(0.0, 1.0 - np.sum(three**2, axis=1)))
        result = np.empty((len(words), 4))
        rows, place = np.arange(len(words)), words[:, 3] & 3
        for step, component in enumerate((largest, *three.T)):
            result[rows, (place + step) % 4] = component
        return np.clip(np.rint(result * 32767), -32767, 32767).astype("<i2")
    raise BadInput(f"filter {filter_:.20} with elements of {elements.shape[1]} bytes is not supported")
