"""The parameter section of a C3D: groups of named numbers and texts, parsed to a tree and packed again.

record of a group      name, negative number, description
record of a parameter  name, its group's number, type, shape, values, description
"""

from __future__ import annotations

import math
import struct
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import BadInput
from ...typing import Floats
from ..text import legacy_text

BLOCK = 512
INTEL, DEC, MIPS = 84, 85, 86
"""Processor types, which determine the number format."""
HEADER_EVENTS = 12345
"""Key word of headers whose events have four-character labels."""
MAX_ITEMS = 255
"""Length of a dimension of a parameter; longer lists continue in NAME2, NAME3, …."""

STANDARD_GROUPS = ("POINT", "ANALOG", "EVENT", "TRIAL", "ROTATION", "FORCE_PLATFORM")
"""Groups that readers use: their names are converted to capitals."""

DERIVED = {
    "POINT": ("USED", "FRAMES", "DATA_START", "RATE", "UNITS", "LABELS"),
    "ANALOG": ("USED", "RATE", "LABELS", "UNITS"),
    "EVENT": ("USED", "TIMES", "LABELS", "CONTEXTS", "DESCRIPTIONS", "SUBJECTS", "ICON_IDS", "GENERIC_FLAGS"),
    "ROTATION": ("DATA_START",),
}
"""Parameters that follow from the motion: written from it, and not stored beside it."""

EVENT_FIELDS = {
    "LABELS": "label", "CONTEXTS": "context", "DESCRIPTIONS": "description", "SUBJECTS": "subject",
    "ICON_IDS": "icon_id", "GENERIC_FLAGS": "generic_flag",
}  # fmt: skip


@dataclass
class Parameters:
    """The parameter section: {group: {name: value}}.

    Numbers are arrays of the file's type (int8, int16, float32) and shape; text is a string or nested lists of strings.
    notes: descriptions by "GROUP" or "GROUP:NAME". locked: the same keys of locked groups and parameters.
    """

    groups: dict[str, dict[str, Any]] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    locked: list[str] = field(default_factory=list)

    def number(self, group: str, name: str) -> float | None:
        """The first number of a parameter, or None."""
        value = self.groups.get(group, {}).get(name)
        return float(value.flat[0]) if isinstance(value, np.ndarray) and value.size else None

    def count(self, group: str, name: str) -> int | None:
        """The first number as an unsigned 16-bit count; floats are larger counts."""
        value = self.number(group, name)
        if value is None or not math.isfinite(value):
            return None
        masks = {"int8": 0xFF, "int16": 0xFFFF}
        return int(value) & masks.get(self.groups[group][name].dtype.name, -1)

    def double_word(self, group: str, name: str) -> int | None:
        """Two 16-bit words, the low one first, as one count."""
        value = self.groups.get(group, {}).get(name)
        if not isinstance(value, np.ndarray) or value.dtype != np.int16 or value.size < 2:
            return None
        low, high = value.ravel(order="F").astype(np.int64)[:2] & 0xFFFF
        return int(low | high << 16)

    def texts(self, group: str, name: str) -> list[str]:
        """A text parameter and its continuations (LABELS, LABELS2, …) as one list."""
        result: list[str] = []
        for value in self.chain(group, name):
            texts = [value] if isinstance(value, str) else value if isinstance(value, list) else []
            result += [text for text in texts if isinstance(text, str)]
        return result

    def numbers(self, group: str, name: str) -> Floats:
        """A parameter of numbers and its continuations (SCALE, SCALE2, …) as one list."""
        arrays = [np.ravel(value) for value in self.chain(group, name) if isinstance(value, np.ndarray)]
        return np.concatenate([np.empty(0), *arrays])

    def chain(self, group: str, name: str) -> list[Any]:
        """The values of NAME, NAME2, NAME3, …."""
        values: list[Any] = []
        while (value := self.groups.get(group, {}).get(f"{name}{len(values) + 1}" if values else name)) is not None:
            values.append(value)
        return values

    def set_texts(self, group: str, name: str, texts: list[str]) -> None:
        """Store a list of texts, MAX_ITEMS to a parameter."""
        parts = [texts[at : at + MAX_ITEMS] for at in range(0, max(1, len(texts)), MAX_ITEMS)]
        self._replace_chain(group, name, parts)

    def set_chain(self, group: str, name: str, values: NDArray[Any]) -> None:
        """Store numbers, MAX_ITEMS along the last axis to a parameter."""
        parts = [values[..., at : at + MAX_ITEMS] for at in range(0, max(1, values.shape[-1]), MAX_ITEMS)]
        self._replace_chain(group, name, parts)

    def _replace_chain(self, group: str, name: str, parts: list[Any]) -> None:
        values = self.groups[group]
        for key in [key for key in values if key == name or (key.startswith(name) and key[len(name) :].isdigit())]:
            del values[key]
        for number, part in enumerate(parts, 1):
            values[name if number == 1 else f"{name}{number}"] = part


def parse(data: bytes, section: int, processor: int, data_start: int = 0) -> Parameters:
    """Parse the parameter section at byte `section`: records of groups (negative number) and parameters (positive).

    The offset of the last record may point anywhere, so records end with the section: after the blocks that it
    declares, or at byte `data_start` if it declares none.
    """
    order = ">" if processor == MIPS else "<"
    result = Parameters()
    group_names: dict[int, str] = {}
    records: list[tuple[int, str, Any, str, bool]] = []
    at = section + 4
    parsed_bytes = 0
    declared_end = section + BLOCK * data[section + 2]
    if declared_end == section or declared_end > len(data):
        declared_end = data_start if section < data_start <= len(data) else len(data)
    while at + 2 <= declared_end:
        name_length, number = struct.unpack_from("bb", data, at)
        if number == 0 or name_length == 0:
            break
        name_end = at + 2 + abs(name_length)
        if name_end + 3 > len(data):
            raise BadInput(f"cut off or damaged: a parameter's record runs past the end at byte {at}")
        name = text(data[at + 2 : name_end])
        (step,) = struct.unpack_from(f"{order}H", data, name_end)
        body = name_end + 2
        if number < 0:
            name = name.upper() if name.upper() in STANDARD_GROUPS else name
            note = text(data[body + 1 : body + 1 + data[body]])
            group_names.setdefault(-number, name)
            result.groups.setdefault(name, {})
            if note:
                result.notes[name] = note
            if name_length < 0:
                result.locked.append(name)
        else:
            value, end = _value(data, body, name, processor)
            parsed_bytes += end - body
            if parsed_bytes > 2 * len(data):
                raise BadInput(f"damaged: parameter records overlap at byte {body}")
            body = end
            note = text(data[body + 1 : body + 1 + data[body]]) if body < len(data) else ""
            records.append((number, name, value, note, name_length < 0))
        if step == 0:
            break
        at = name_end + step
    for number, name, value, note, locked in records:
        group = group_names.setdefault(number, f"GROUP{number}")
        name = name.upper() if group in STANDARD_GROUPS else name
        result.groups.setdefault(group, {})[name] = value
        if note:
            result.notes[f"{group}:{name}"] = note
        if locked:
            result.locked.append(f"{group}:{name}")
    return result


def _value(data: bytes, at: int, name: str, processor: int) -> tuple[Any, int]:
    """The value of the parameter whose type is at byte `at`, and the byte where its description begins."""
    if at + 2 > len(data):
        raise BadInput(f"cut off: parameter {name} at byte {at} runs past the end")
    kind, rank = struct.unpack_from("bB", data, at)
    if kind not in (-1, 1, 2, 4) or rank > 7 or at + 2 + rank > len(data):
        raise BadInput(f"damaged: parameter {name} at byte {at} has type {kind} and {rank} dimensions")
    shape = tuple(data[at + 2 : at + 2 + rank])
    at += 2 + rank
    count = math.prod(shape)
    stop = at + count * abs(kind)
    if stop > len(data):
        raise BadInput(f"cut off or damaged: parameter {name} of {count} values runs past the end at byte {at}")
    raw = data[at:stop]
    if kind == -1:
        width, *rest = shape or (1,)
        if math.prod(rest) > max(255, count):
            raise BadInput(f"damaged: parameter {name} has {math.prod(rest)} texts of length 0")
        texts: Any = [text(raw[i * width : (i + 1) * width]) for i in range(math.prod(rest))]
        for length in rest[:-1]:
            texts = [texts[i : i + length] for i in range(0, len(texts), length)] if length else []
        return (texts if rest else texts[0]), stop
    if kind == 4:
        numbers: NDArray[Any] = floats(raw, processor)
    else:
        numbers = np.frombuffer(raw, np.int8 if kind == 1 else (">i2" if processor == MIPS else "<i2"))
        numbers = numbers.astype(np.int8 if kind == 1 else np.int16)
    return numbers.reshape(shape, order="F"), stop


def floats(data: bytes, processor: int) -> NDArray[np.float32]:
    """Four-byte floats in the number format of the processor type."""
    if processor != DEC:
        return np.frombuffer(data, "<f4" if processor == INTEL else ">f4").astype(np.float32)
    pairs = np.frombuffer(data, "<u2").reshape(-1, 2).astype(np.uint32)
    bits = pairs[:, 0] << 16 | pairs[:, 1]
    with np.errstate(invalid="ignore"):
        return np.where(bits & 0x7F800000, bits.view(np.float32) / 4, 0).astype(np.float32)


def text(raw: bytes) -> str:
    """Text without its padding: UTF-8 if it is valid, otherwise `legacy_text`.

    A character that the length of the field cuts in two is left out.
    """
    raw = raw.split(b"\0", 1)[0].rstrip()
    if raw.isascii():
        return raw.decode("ascii")
    for end in range(len(raw), max(0, len(raw) - 4), -1):
        with suppress(UnicodeDecodeError):
            if end == len(raw) or not raw[:end].isascii():
                return raw[:end].decode("utf-8")
    if any(0x80 <= byte < 0xA0 for byte in raw):
        for end in (len(raw), len(raw) - 1):
            with suppress(UnicodeDecodeError):
                return raw[:end].decode("cp932")
    return legacy_text(raw)


def pack(parameters: Parameters) -> bytes:
    """The parameter section, padded to whole blocks. Raises BadInput if it needs more than 255."""
    out = bytearray(4)
    locked = set(parameters.locked)

    def record(name: str, number: int, key: str, body: bytes) -> None:
        label = encoded(name, 127)
        body += bytes([len(note := encoded(parameters.notes.get(key, ""), 255))]) + note
        if len(body) + 2 > 0xFFFF:
            raise BadInput(f"parameter {key} is too long for a C3D")
        out.extend(struct.pack("<bb", -len(label) if key in locked else len(label), number))
        out.extend(label + struct.pack("<H", len(body) + 2) + body)

    if len(parameters.groups) > 127:
        raise BadInput(f"a C3D holds 127 groups of parameters, not {len(parameters.groups)}")
    for number, (group, values) in enumerate(parameters.groups.items(), 1):
        record(group, -number, group, b"")
        for name, value in values.items():
            record(name, number, f"{group}:{name}", _pack_value(f"{group}:{name}", value))
    out.extend(b"\0\0")
    blocks = -(-len(out) // BLOCK)
    if blocks > 255:
        raise BadInput(f"the parameters fill {blocks} blocks of 512 bytes; a C3D holds 255")
    out[:4] = bytes([1, 0x50, blocks, INTEL])
    return padded(bytes(out))


def _pack_value(key: str, value: Any) -> bytes:
    if isinstance(value, np.ndarray):
        if value.dtype not in (np.int8, np.int16, np.float32) or value.ndim > 7 or max(value.shape, default=0) > 255:
            raise BadInput(f"parameter {key}: a C3D holds int8, int16, float32 of up to 255 a side, not {value.dtype}")
        head = struct.pack("bB", value.dtype.itemsize, value.ndim) + bytes(value.shape)
        return head + value.astype(np.dtype(value.dtype).newbyteorder("<")).tobytes(order="F")
    shape: list[int] = []
    texts = [value]
    while (texts and not isinstance(texts[0], str)) or (not texts and not shape):
        shape.append(len(texts[0]) if texts else 0)
        texts = [text for part in texts for text in part]
    raw = [encoded(text, 255) for text in texts]
    width = max(map(len, raw), default=0)
    if max(shape, default=0) > 255 or len(shape) > 6:
        raise BadInput(f"parameter {key}: a C3D holds up to 255 texts a side, not {max(shape)}")
    return struct.pack("bB", -1, 1 + len(shape)) + bytes([width, *shape[::-1]]) + b"".join(t.ljust(width) for t in raw)


def encoded(text: str, limit: int) -> bytes:
    """Text as UTF-8. Raises BadInput above `limit` bytes."""
    raw = text.encode("utf-8")
    if len(raw) > limit:
        raise BadInput(f"{text[:40]!r}… is longer than the {limit} bytes that a C3D has for it")
    return raw


def padded(data: bytes) -> bytes:
    """The data padded with zeros to whole blocks."""
    return data + bytes(-len(data) % BLOCK)


def counts(*values: int) -> NDArray[np.int16]:
    """Unsigned 16-bit counts as the signed words of a C3D."""
    return np.array(values, np.uint16).view(np.int16)


def same(a: Any, b: Any) -> bool:
    """Whether two parameter values are equal in type, shape and content."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and np.array_equal(a, b)
    return type(a) is type(b) and a == b


def _none(dtype: type) -> NDArray[Any]:
    return np.empty(0, dtype)


STANDARD: dict[str, dict[str, Any]] = {
    "ANALOG": {
        "DESCRIPTIONS": [], "GEN_SCALE": np.ones(1, np.float32), "SCALE": _none(np.float32), "OFFSET": _none(np.int16),
    },
    "FORCE_PLATFORM": {
        "USED": np.zeros(1, np.int16), "TYPE": _none(np.int16), "ZERO": np.array([1, 0], np.int16),
        "CORNERS": _none(np.float32), "ORIGIN": _none(np.float32), "CHANNEL": _none(np.int16),
    },
    "EVENT": {
        "CONTEXTS": [], "ICON_IDS": _none(np.int16), "LABELS": [], "DESCRIPTIONS": [], "SUBJECTS": [],
        "TIMES": np.empty((2, 0), np.float32), "GENERIC_FLAGS": _none(np.int16), "USED": np.zeros(1, np.int16),
    },
}  # fmt: skip
"""Parameters that C3D readers expect; values equal to these are not stored beside the motion."""
