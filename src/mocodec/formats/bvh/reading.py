"""BVH to motion, and what a BVH leaves open: unit, vertical axis, usual rates."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BadInput
from ...geometry import kinematics
from ...motion import Motion, Skeleton
from ...typing import Floats
from ..conventions import USUAL_RATES, guess_up, unit_option
from ..text import numbers, plain, read_text
from . import memory
from .hierarchy import Joint, parse, unique_names

UNITS_M = {"cm": 0.01, "m": 1.0, "mm": 0.001, "ASF": 0.0254 / 0.45, "in": 0.0254}  # tried in this order
PLAUSIBLE_REST_M = (0.8, 2.4)
"""Extent of a skeleton at rest."""
PLAUSIBLE_HEIGHT_M = (1.0, 2.3)
"""Height that a body reaches over the frames."""
TIMING = re.compile(
    r"\s*(?:Frames[ \t]*:?[ \t]*(?P<frames>\d{1,12})(?:\.0*)?|Frame[ \t]*Time[ \t]*:?[ \t]*(?P<time>\S+))(?=\s|\Z)",
    re.IGNORECASE,
)
FLAGS = (re.MULTILINE, re.MULTILINE | re.IGNORECASE)
"""The word MOTION is searched in capitals first."""
MIN_USUAL_RATE = 1.0
"""Hertz; slower motion is noted, since programs write frames a second or milliseconds for seconds."""
MAX_FRAME_MISMATCH = 1
"""Frames that may be there beyond or below the declared number."""


def read(
    path: str | Path,
    unit: str | float | None = None,
    rate: float | None = None,
    up: str | None = None,
    salvage: bool = False,
) -> Motion:
    """A BVH as a motion, metres, with skeleton and rotations.

    unit: "cm", "m", "mm", "in", "ASF" (CMU's) or metres in one unit; by default the first of cm, m, mm, ASF and inch in
    which the body is as tall as a person, else cm. rate: hertz, by default 1 / Frame Time. up: the vertical axis, by
    default y unless body and motion say z. salvage: read the complete frames of a truncated file. Raises BadInput.
    """
    return motion_of(read_text(path), path, unit, rate, up, salvage)


def motion_of(
    text: str, path: str | Path, unit: str | float | None, rate: float | None, up: str | None, salvage: bool = False
) -> Motion:
    """As `read`, of the text of a file; path: for messages."""
    text = plain(text)
    head, body = _split(text, path)
    try:
        joints = parse(head)
    except (ValueError, IndexError) as error:
        message = error if isinstance(error, BadInput) else f"its hierarchy cannot be read ({error})"
        raise BadInput(f"{path}: {message}") from None
    declared, time_text, samples = _timing(body, path)
    if "," in samples and "." not in samples:
        samples = samples.replace(",", ".")
    file_rate = rate or rate_of(time_text, path)
    notes: list[str] = []
    if file_rate < MIN_USUAL_RATE and rate is None:
        notes.append(f"Frame Time is {time_text} seconds, which is {file_rate:g} frames a second (--rate)")
    if salvage:
        declared, samples = _salvaged(declared, samples, sum(len(joint.channels) for joint in joints), notes)
    table = _channel_table(numbers(samples, path), declared, joints, path, notes)
    offsets = np.array([[float(word) for word in joint.offset] for joint in joints])
    names, originals = unique_names(joints)
    skeleton = Skeleton(names, tuple(joint.parent for joint in joints), offsets)
    rotations, translations = _transforms(joints, table)
    root = np.zeros((len(table), 3))
    places = kinematics.forward(skeleton, rotations, root, translations=translations)
    chosen_up = up or _guess_up(places, skeleton)
    units, unit_m = _unit(unit, kinematics.forward(skeleton, rotations, root), skeleton, chosen_up, path)
    skeleton = Skeleton(skeleton.names, skeleton.parents, offsets * unit_m)
    source: dict[str, Any] = {"format": "bvh", "units": units, "unit_m": unit_m}
    source |= _remembered(joints, names, table, rotations, unit_m)
    source |= {"labels": originals} if originals else {}
    time_text = memory.frame_time(time_text, file_rate) if rate is None else None
    source |= {"frame_time": time_text} if time_text else {}
    source |= {"unit_given": True} if unit is not None else {}
    source |= {"up_given": True} if up is not None else {}
    source |= {"notes": notes} if notes else {}
    return Motion(places * unit_m, file_rate, names, chosen_up, skeleton, rotations, source)


def _remembered(
    joints: list[Joint], names: tuple[str, ...], table: Floats, rotations: Floats, unit_m: float
) -> dict[str, Any]:
    """The entries of `source` that writing the same file needs (see `memory`), without empty ones but channels."""
    entries = {
        "constant": memory.constant(joints, table),
        "first_angles": memory.first_angles(joints, names, table, rotations),
        "offset_digits": memory.offset_digits(joints, unit_m),
    }
    return {"channels": memory.channels(joints, names)} | {name: entry for name, entry in entries.items() if entry}


def _timing(body: str, path: str | Path) -> tuple[int, str, str]:
    """The declared number of frames, the Frame Time as text, and the samples behind these two lines."""
    found: dict[str, str] = {}
    end = 0
    while len(found) < 2 and (match := TIMING.match(body, end)):
        found["frames" if match["frames"] else "time"] = match["frames"] or match["time"].replace(",", ".")
        end = match.end()
    if len(found) < 2:
        raise BadInput(f"{path}: its MOTION does not begin with Frames: and Frame Time:")
    return int(found["frames"]), found["time"], body[end:]


def _split(text: str, path: str | Path) -> tuple[str, str]:
    """The text before and after the word MOTION, which may also be part of a joint's name. Raises BadInput."""
    if not text.lstrip().upper().startswith("HIERARCHY"):
        raise BadInput(f"{path}: not a BVH: it does not begin with HIERARCHY")
    patterns = (r"^[ \t]*MOTION[ \t]*$", r"\}[ \t]*MOTION\b", r"^[ \t]*MOTION\b")
    motion = next(filter(None, (re.search(pattern, text, flags) for flags in FLAGS for pattern in patterns)), None)
    if motion is None:
        raise BadInput(f"{path}: cut off or not a BVH: it has no MOTION")
    return text[: motion.end()].removesuffix(motion[0].lstrip("}")), text[motion.end() :]


def _salvaged(declared: int, samples: str, width: int, notes: list[str]) -> tuple[int, str]:
    """The frames and text of a truncated motion, without the frame that the end of the file cuts off; noted."""
    words = samples.split()
    if not width or len(words) == declared * width:
        return declared, samples
    if len(words) > declared * width and len(words) % width == 0:
        notes.append(f"the header declares {declared} frames, the file has {len(words) // width}: these are read")
        return len(words) // width, samples
    if len(words) > declared * width:
        return declared, samples
    is_cut_in_number = bool(samples) and not samples[-1].isspace()
    complete = (len(words) - is_cut_in_number) // width
    if not complete:
        return declared, samples
    notes.append(f"cut off: {complete} of {declared} declared frames are read")
    return complete, " ".join(words[: complete * width])


def _channel_table(values: Floats, declared: int, joints: list[Joint], path: str | Path, notes: list[str]) -> Floats:
    """The channels (frames, channels). A frame more or fewer than declared is noted; other numbers raise BadInput."""
    width = sum(len(joint.channels) for joint in joints)
    if not width:
        raise BadInput(f"{path}: its joints have no channels, so there is no motion")
    frames, rest = divmod(values.size, width)
    if not frames and not declared:
        raise BadInput(f"{path}: has no frames")
    if rest or abs(frames - declared) > MAX_FRAME_MISMATCH:
        problem = "cut off: " if values.size < declared * width else ""
        hint = "; --salvage (salvage=True) reads what is there" if frames and (problem or not rest) else ""
        raise BadInput(
            f"{path}: {problem}{declared} frames of {width} channels need {declared * width} numbers, not "
            f"{values.size}{hint}"
        )
    if len(joints) > 4 * width + 4:
        raise BadInput(f"{path}: {len(joints)} joints share {width} channels, too few for a body")
    if frames != declared:
        notes.append(f"the header declares {declared} frames, the file has {frames}: these are read")
    return values.reshape(frames, width)


def rate_of(frame_time: str, path: str | Path) -> float:
    """1 / frame time; a usual rate or a whole number of hertz whose frame time has the same digits (0.0083333)."""
    try:
        seconds = float(frame_time)
        rate = 1.0 / seconds
    except (ValueError, ZeroDivisionError):
        seconds = rate = -1.0
    if not 0 < seconds < float("inf") or rate == float("inf"):
        raise BadInput(
            f"{path}: Frame Time must be a positive number of seconds, not {frame_time[:40]!r}; use rate= (--rate)"
        )
    digits, _, exponent = frame_time.lower().partition("e")
    half_digit = 0.5 * 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))
    if not half_digit < seconds / 4:
        return rate
    whole = [float(usual) for usual in USUAL_RATES if usual == round(usual)]
    for candidates in (whole, USUAL_RATES):
        nearest = min(candidates, key=lambda candidate: abs(candidate - rate))
        if abs(1.0 / nearest - seconds) <= 1.0001 * half_digit:
            return float(nearest)
    cut = [usual for usual in whole if 0 <= 1.0 / usual - seconds < 2 * half_digit]
    if cut:
        return cut[-1]  # digits cut off, not rounded: 0.0166
    nearest = float(max(1, round(rate)))
    if abs(1.0 / nearest - seconds) <= 1.0001 * half_digit:
        return nearest
    return rate


def _guess_up(places: Floats, skeleton: Skeleton) -> str:
    """The vertical axis, "y" or "z", from the motion; places (frames, joints, 3) in the file's unit.

    y is the convention. z needs a motion that keeps its lowest point along z, and either a skeleton at rest that is
    tall along z and flat along y, or a root that travels along y more than along z.
    """
    rest = np.ptp(_rest_positions(skeleton), axis=0)
    size = float(rest.max())
    if not size or not len(places) or guess_up(places * (1.7 / size)) == "y":
        return "y"
    travel = np.ptp(places[:, 0], axis=0)
    return "z" if rest[2] > 2 * rest[1] or (travel[1] > size and travel[1] > 3 * travel[2]) else "y"


def _rest_positions(skeleton: Skeleton) -> Floats:
    """Joint positions (joints, 3) at rest, the root at the origin."""
    positions = np.array(skeleton.offsets)
    for joint, parent in enumerate(skeleton.parents):
        positions[joint] += positions[parent] if parent >= 0 else -positions[joint]
    return positions


def _unit(unit: str | float | None, poses: Floats, skeleton: Skeleton, up: str, path: str | Path) -> tuple[str, float]:
    """The unit's name and its metres: as given, or guessed from the height that the body reaches over the frames.

    poses (frames, joints, 3): the body without its position channels, in the file's unit.
    """
    if unit is not None:
        try:
            return unit_option(unit, UNITS_M)
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from None
    rest = float(np.ptp(_rest_positions(skeleton), axis=0).max())
    heights = np.ptp(poses[:, :, "xyz".index(up)], axis=1)
    reached = float(np.quantile(heights, 0.9, method="higher")) if len(poses) else rest
    for size, (low, high) in ((reached, PLAUSIBLE_HEIGHT_M), (rest, PLAUSIBLE_REST_M)):
        name = next((name for name, unit_m in UNITS_M.items() if low <= size * unit_m <= high), None)
        if name is not None:
            return name, UNITS_M[name]
    return "cm", UNITS_M["cm"]


def _transforms(joints: list[Joint], table: Floats) -> tuple[Floats, dict[int, Floats]]:
    """Rotations (frames, joints, 4), and by joint with position channels its translations (frames, 3)."""
    rotations = np.zeros((len(table), len(joints), 4))
    rotations[..., 0] = 1.0
    translations: dict[int, Floats] = {}
    at = 0
    for index, joint in enumerate(joints):
        values = table[:, at : at + len(joint.channels)]
        at += len(joint.channels)
        rotating = [i for i, letter in enumerate(joint.channels) if letter.islower()]
        if rotating:
            rotations[:, index] = memory.rotation(joint.rotation_order, values[:, rotating])
        if len(rotating) < len(joint.channels):
            translation = np.tile(np.array(joint.offset, np.float64), (len(table), 1))
            for i, letter in enumerate(joint.channels):
                if letter.isupper():
                    translation[:, "XYZ".index(letter)] = values[:, i]
            translations[index] = translation
    return rotations, translations
