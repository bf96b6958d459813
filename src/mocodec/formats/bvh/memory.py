"""What `source` remembers of a BVH beside its motion, in few bytes: how each entry is made, and read for writing.

channels       the channels of the joints, equal neighbours as one: ["XYZzxy", "zxy*12"]; End Sites are left out
               where their names tell, else they are "end" ("end*0" first if there are none)
constant       channels that never change: ["", "zy x=12.5*2"]: z and y are 0, x is 12.5, in two joints
first_angles   degrees of the first frame, by joint, where they are not the usual ones (within ±180°, middle ±90°)
offset_digits  decimals of the OFFSETs, and what a .mocz rounds off, so that their digits come back
frame_time     the text after "Frame Time:"
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ...errors import BadInput
from ...geometry import euler_curves, rigid
from ...typing import Floats
from .hierarchy import Joint

CHANNEL_RUN = re.compile(r"(?:([XYZxyz])(?!.*\1)){0,6}(?:\*\d{1,4})?|end(?:\*\d{1,4})?")
CONSTANT_RUN = re.compile(r"(?:[XYZxyz]{0,6})(?: [XYZxyz]=[-+.e\d]{1,24}){0,6}(?:\*\d{1,4})?")
END_NAME = re.compile(r".*_end\d*", re.DOTALL)
STORED_STEP_M = 1e-5
"""Offsets of a .mocz are rounded to this step."""
WRITTEN_DIGIT = 1e-7
"""The last decimal of numbers that are written."""
MAX_DECIMALS = 12
MAX_JOINTS = 1 << 16


def runs(entries: Iterable[str]) -> list[str]:
    """Equal neighbours as one entry: "zyx", "zyx" → "zyx*2"."""
    counted: list[list[Any]] = []
    for entry in entries:
        if counted and counted[-1][0] == entry:
            counted[-1][1] += 1
        else:
            counted.append([entry, 1])
    return [f"{entry}*{count}" if count > 1 else entry for entry, count in counted]


def expanded(stored: Any, pattern: re.Pattern[str], what: str) -> list[str]:
    """The inverse of `runs`. Raises BadInput for anything else."""
    if not isinstance(stored, list) or not all(isinstance(run, str) and pattern.fullmatch(run) for run in stored):
        raise BadInput(f"source[{what!r}] is not a list of BVH channels: {stored!r:.80}")
    entries: list[str] = []
    for run in stored:
        entry, _, count = run.partition("*")
        entries += [entry] * min(int(count or 1), MAX_JOINTS - len(entries))
    return entries


def channels(joints: Sequence[Joint], names: Sequence[str]) -> list[str]:
    """The entry `channels` of a file's joints, whose unique names are `names`."""
    wanted = [None if joint.is_end else joint.channels for joint in joints]
    short = runs(entry for entry in wanted if entry is not None)
    if channels_of(short, names, [joint.parent for joint in joints]) == wanted:
        return short
    explicit = runs("end" if entry is None else entry for entry in wanted)
    return explicit if None in wanted else ["end*0", *explicit]


def channels_of(stored: Any, names: Sequence[str], parents: Sequence[int]) -> list[str | None] | None:
    """The inverse of `channels`: of each joint, None for an End Site; None for a skeleton of other joints.

    Raises BadInput if it is not a list of channels.
    """
    entries = expanded(stored, CHANNEL_RUN, "channels")
    if any(run.startswith("end") for run in stored):
        return [None if entry == "end" else entry for entry in entries] if len(entries) == len(names) else None
    has_child = set(parents)
    is_end = [joint not in has_child and bool(END_NAME.fullmatch(name)) for joint, name in enumerate(names)]
    if len(entries) + sum(is_end) != len(names):
        return None
    rest = iter(entries)
    return [None if end else next(rest) for end in is_end]


def constant(joints: Sequence[Joint], table: Floats) -> list[str]:
    """The entry `constant` of a table of channels (frames, channels); empty if none is constant, or of one frame."""
    still = (table == table[:1]).all(axis=0) if len(table) > 1 else np.zeros(table.shape[1], bool)
    entries: list[str] = []
    at = 0
    for joint in joints:
        zeros, others = "", ""
        for letter in joint.channels:
            if still[at]:
                value = float(table[0, at])
                is_zero = abs(value) < WRITTEN_DIGIT / 2
                zeros += letter if is_zero else ""
                others += "" if is_zero else f" {letter}={value:.12g}"
            at += 1
        entries += [] if joint.is_end else [zeros + others]
    return runs(entries) if any(entries) else []


def constant_of(stored: Any, letters: Sequence[str | None]) -> list[dict[str, float]]:
    """The inverse of `constant`: of each joint, by letter; nothing for a skeleton of other joints."""
    nothing: list[dict[str, float]] = [{} for _ in letters]
    if stored is None:
        return nothing
    entries = expanded(stored, CONSTANT_RUN, "constant")
    if len(entries) != sum(channel is not None for channel in letters):
        return nothing
    rest = iter(entries)
    return [{} if channel is None else _constants(next(rest)) for channel in letters]


def _constants(entry: str) -> dict[str, float]:
    zeros, *others = entry.split(" ")
    try:
        return dict.fromkeys(zeros, 0.0) | {word[0]: float(word[2:]) for word in others}
    except ValueError:
        raise BadInput(f"source['constant'] has a value that is no number: {entry:.80}") from None


def first_angles(joints: Sequence[Joint], names: Sequence[str], table: Floats, rotations: Floats) -> dict[str, Any]:
    """The entry `first_angles`: by joint, where the first frame's angles are others than the usual ones."""
    result: dict[str, Any] = {}
    at = 0
    for joint, name in enumerate(names):
        letters, order = joints[joint].channels, joints[joint].rotation_order
        values = table[0, at : at + len(letters)][[letter.islower() for letter in letters]] if len(table) else None
        at += len(letters)
        if order and values is not None:
            usual = np.degrees(euler_curves.nearest(order, rotations[0, joint]))
            if np.abs(values - usual).max() > 1:
                result[name] = np.rint(np.clip(values, -1e9, 1e9)).astype(int).tolist()
    return result


def first_angles_of(source: Mapping[str, Any], name: str, order: str) -> Floats | None:
    """The inverse of `first_angles`, radians (len(order),); None where the usual angles are meant."""
    stored = source.get("first_angles")
    angles = stored.get(name) if isinstance(stored, Mapping) else None
    is_usable = isinstance(angles, list) and len(angles) == len(order) and all(type(a) is int for a in angles)
    return np.radians(np.array(angles, float)) if is_usable else None


def offset_digits(joints: Sequence[Joint], unit_m: float) -> list[Any] | None:
    """The entry `offset_digits`: [decimals], or [decimals, bits, base 64 of what rounding to 10 µm takes off].

    None for more decimals than doubles hold.
    """
    decimals = max(_decimals(word) for joint in joints for word in joint.offset)
    if decimals > MAX_DECIMALS:
        return None
    values = np.array([[float(word) for word in joint.offset] for joint in joints])
    scale = 10.0**decimals
    if np.abs(values).max() * scale > 2**52:
        return None
    below = np.rint(values * scale) - _rounded(values * unit_m, unit_m, scale)
    zigzag = np.where(below < 0, -2 * below - 1, 2 * below).astype(np.uint64).reshape(-1)
    width = int(zigzag.max()).bit_length()
    bits = (zigzag[:, None] >> np.arange(width, dtype=np.uint64)) & np.uint64(1)
    text = base64.b64encode(np.packbits(bits.astype(np.uint8)).tobytes()).decode()
    return [decimals, width, text] if width else [decimals]


def offset_texts(stored: Any, offsets: Floats, unit_m: float) -> list[str]:
    """OFFSETs (joints, 3), metres, as text in the file's unit: with the digits of the file, else with 7 decimals."""
    decimals, values = 7, offsets / unit_m
    if isinstance(stored, list) and stored and type(stored[0]) is int and 0 <= stored[0] <= MAX_DECIMALS:
        decimals, scale = stored[0], 10.0 ** stored[0]
        below = _below(stored[1:], offsets.size)
        if below is None:
            decimals = max(decimals, 7)
        else:
            values = (_rounded(offsets, unit_m, scale) + below.reshape(offsets.shape)) / scale
    return [" ".join(_fixed(value, decimals) for value in row) for row in values.tolist()]


def _below(stored: list[Any], count: int) -> Floats | None:
    """`count` numbers of bits and text of `offset_digits`; None for those of another skeleton, or damaged ones."""
    if not stored:
        return np.zeros(count)
    try:
        width, data = int(stored[0]), np.frombuffer(base64.b64decode(stored[1], validate=True), np.uint8)
    except (binascii.Error, IndexError, TypeError, ValueError):
        return None
    if not 0 < width <= 52 or len(data) != (width * count + 7) // 8:
        return None
    bits = np.unpackbits(data)[: width * count].reshape(count, width)
    zigzag = bits @ (2.0 ** np.arange(width))
    return np.where(zigzag % 2 == 1, -(zigzag + 1) / 2, zigzag / 2)


def _rounded(offsets: Floats, unit_m: float, scale: float) -> Floats:
    """Offsets as a .mocz keeps them, in units of their last decimal."""
    return np.rint(np.rint(offsets / STORED_STEP_M) * STORED_STEP_M / unit_m * scale)


def _decimals(word: str) -> int:
    """Digits after the point: 2 of "1.25", 4 of "1.25e-2"."""
    digits, _, exponent = word.lower().partition("e")
    return max(0, len(digits.partition(".")[2]) - int(exponent or 0))


def _fixed(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def frame_time(text: str, rate: float) -> str | None:
    """The entry `frame_time`: the file's own digits; None if they are those that are written anyway."""
    return text if text != frame_time_text(rate) and len(text) <= 24 else None


def frame_time_text(rate: float) -> str:
    """Seconds of a frame, with ten digits."""
    return f"{1.0 / rate:.10g}"


def rotation(order: str, degrees: Floats) -> Floats:
    """Quaternions (…, 4) of the rotation channels (…, len(order)) of a joint."""
    return rigid.from_euler(order, np.radians(degrees))
