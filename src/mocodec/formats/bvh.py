"""BVH: a joint hierarchy with channels, then one line of numbers per frame (Biovision).

    HIERARCHY   joints: OFFSET, CHANNELS in any order; End Sites ─┐
    MOTION      frames × channels, parsed as one block ───────────┴─► quaternions ─► forward kinematics ─► joints

Points are the joints and, as "<parent>_end", the End Sites: without these the rotations of the last joints would not
show in the positions. Position channels of a joint replace its OFFSET.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BadInput
from ..geometry import kinematics, rigid
from ..motion import Motion, Skeleton
from ..typing import Floats
from . import replace_whole
from .conventions import USUAL_RATES, guess_up, unit_of, unit_option
from .text import numbers, read_text

HOLDS = frozenset({"skeleton", "joint rotations"})
"""What a BVH stores beside the positions."""
UNITS_M = {"cm": 0.01, "m": 1.0, "mm": 0.001, "ASF": 0.0254 / 0.45, "in": 0.0254}  # tried in this order
PLAUSIBLE_REST_M = (0.8, 2.4)
"""Extent of a skeleton at rest."""
PLAUSIBLE_HEIGHT_M = (1.0, 2.3)
"""Height that a body reaches over the frames."""
CHANNELS = {f"{axis}position": axis for axis in "XYZ"} | {f"{axis}rotation": axis.lower() for axis in "XYZ"}

MAX_FRAME_MISMATCH = 1
"""Frames that may be there beyond or below the declared number."""
MAX_DEPTH = 1000
"""Nested joints; more are taken for damage."""

CHANNEL_RUN = re.compile(r"(?:([XYZxyz])(?!.*\1)){0,6}(?:\*\d{1,4})?")


@dataclass
class Joint:
    """One joint of the hierarchy. channels: one letter each, in file order; "XYZ" positions, "xyz" rotations."""

    name: str
    parent: int
    offset: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    channels: str = ""

    @property
    def rotation_order(self) -> str:
        return "".join(letter for letter in self.channels if letter.islower())


def read(path: str | Path, unit: str | float | None = None, rate: float | None = None, up: str | None = None) -> Motion:
    """A BVH as a motion, metres, with skeleton and rotations.

    unit: "cm", "m", "mm", "in", "ASF" (CMU's) or metres in one unit; by default the first of cm, m, mm, ASF and inch in
    which the body is as tall as a person, else cm. rate: hertz, by default 1 / Frame Time. up: the vertical axis, by
    default y unless body and motion say z. Raises BadInput.
    """
    text = read_text(path)
    head, body = _split(text, path)
    try:
        joints = _hierarchy(head)
    except (ValueError, IndexError) as error:
        message = error if isinstance(error, BadInput) else f"its hierarchy cannot be read ({error})"
        raise BadInput(f"{path}: {message}") from None
    timing = re.match(r"\s*Frames:\s*(\d{1,12})\s+Frame\s+Time:\s*(\S+)", body, re.IGNORECASE)
    if timing is None:
        raise BadInput(f"{path}: its MOTION does not begin with Frames: and Frame Time:")
    file_rate = _rate(timing[2], path)
    notes: list[str] = []
    table = _channel_table(numbers(body[timing.end() :], path), int(timing[1]), joints, path, notes)
    offsets = np.array([joint.offset for joint in joints])
    names = _names([joint.name for joint in joints])
    skeleton = Skeleton(names, tuple(joint.parent for joint in joints), offsets)
    rotations, translations = _transforms(joints, table)
    root = np.zeros((len(table), 3))
    places = kinematics.forward(skeleton, rotations, root, translations=translations)
    chosen_up = up or _guess_up(places, skeleton)
    units, unit_m = _unit(unit, kinematics.forward(skeleton, rotations, root), skeleton, chosen_up, path)
    skeleton = Skeleton(skeleton.names, skeleton.parents, offsets * unit_m)
    source: dict[str, Any] = {"format": "bvh", "units": units, "unit_m": unit_m, "channels": _channels(joints)}
    source |= {"unit_given": True} if unit is not None else {}
    source |= {"up_given": True} if up is not None else {}
    source |= {"notes": notes} if notes else {}
    return Motion(places * unit_m, rate or file_rate, names, chosen_up, skeleton, rotations, source)


def _split(text: str, path: str | Path) -> tuple[str, str]:
    """The text before and after the word MOTION, which may also be part of a joint's name. Raises BadInput."""
    if not text.lstrip().upper().startswith("HIERARCHY"):
        raise BadInput(f"{path}: not a BVH: it does not begin with HIERARCHY")
    patterns = (r"^[ \t]*MOTION[ \t]*$", r"\}[ \t]*MOTION\b", r"^[ \t]*MOTION\b")
    motion = next(filter(None, (re.search(pattern, text, re.MULTILINE) for pattern in patterns)), None)
    if motion is None:
        raise BadInput(f"{path}: cut off or not a BVH: it has no MOTION")
    return text[: motion.end()].removesuffix(motion[0].lstrip("}")), text[motion.end() :]


def _channel_table(values: Floats, declared: int, joints: list[Joint], path: str | Path, notes: list[str]) -> Floats:
    """The channels (frames, channels). A frame more or fewer than declared is noted; other numbers raise BadInput."""
    width = sum(len(joint.channels) for joint in joints)
    frames, rest = divmod(values.size, width) if width else (0, 0)
    if not width or rest or abs(frames - declared) > MAX_FRAME_MISMATCH:
        problem = "cut off: " if values.size < declared * width else ""
        raise BadInput(
            f"{path}: {problem}{declared} frames of {width} channels need {declared * width} numbers, not {values.size}"
        )
    if len(joints) > 4 * width + 4:
        raise BadInput(f"{path}: {len(joints)} joints share {width} channels, too few for a body")
    if frames != declared:
        notes.append(f"the header declares {declared} frames, the file has {frames}: these are read")
    return values.reshape(frames, width)


def _hierarchy(text: str) -> list[Joint]:
    """The joints, parents first. A brace may share a line with other words."""
    joints: list[Joint] = []
    stack: list[int] = []
    latest = -1
    end_sites: set[int] = set()
    lines = text.replace("{", "\n{\n").replace("}", "\n}\n").split("\n")
    for words in filter(None, (line.split() for line in lines)):
        key = words[0].upper()
        if key in ("ROOT", "JOINT", "END"):
            parent = stack[-1] if stack else -1
            if (key == "ROOT") != (parent < 0):
                raise BadInput(f"its hierarchy has a {key} {'inside' if stack else 'outside'} a ROOT")
            if parent in end_sites:
                raise BadInput(f"its hierarchy has a {key} inside the End Site of {joints[joints[parent].parent].name}")
            name = f"{joints[parent].name}_end" if key == "END" else " ".join(words[1:])
            joints.append(Joint(name or f"joint{len(joints) + 1}", parent))
            latest = len(joints) - 1
            if key == "END":
                end_sites.add(latest)
        elif key == "{":
            if latest < 0:
                raise BadInput("its hierarchy has a { without a joint")
            if len(stack) >= MAX_DEPTH:
                raise BadInput(f"its joints are nested more than {MAX_DEPTH} deep")
            stack.append(latest)
        elif key == "}":
            stack.pop()
        elif key == "OFFSET":
            joints[stack[-1]].offset = [float(word) for word in words[1:4]]
            if len(words) < 4 or not np.isfinite(joints[stack[-1]].offset).all():
                raise BadInput(f"joint {joints[stack[-1]].name} needs three numbers after OFFSET")
        elif key == "CHANNELS":
            letters = [CHANNELS.get(word[:1].upper() + word[1:].lower()) for word in words[2:]]
            if None in letters or len(letters) != int(words[1]) or len(set(letters)) != len(letters):
                raise BadInput(f"joint {joints[stack[-1]].name} has unreadable channels: {' '.join(words[1:])[:80]}")
            joints[stack[-1]].channels = "".join(filter(None, letters))
        elif key != "HIERARCHY":
            raise BadInput(f"its hierarchy has the unknown word {words[0][:40]!r}")
    if stack or not joints:
        raise BadInput("its hierarchy is cut off: a brace is not closed" if stack else "its hierarchy has no joint")
    return joints


def _names(names: list[str]) -> tuple[str, ...]:
    """Unique names: the second End Site of a joint is "<name>_end2"."""
    seen: dict[str, int] = {}
    result = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        result.append(name if seen[name] == 1 else f"{name}{seen[name]}")
    return tuple(result)


def _rate(frame_time: str, path: str | Path) -> float:
    """1 / frame time; a usual rate or a whole number of hertz whose frame time has the same digits (0.0083333)."""
    try:
        seconds = float(frame_time)
        rate = 1.0 / seconds
    except (ValueError, ZeroDivisionError):
        seconds = rate = -1.0
    if not 0 < seconds < float("inf") or rate == float("inf"):
        raise BadInput(f"{path}: Frame Time must be a positive number of seconds, not {frame_time[:40]!r}")
    digits, _, exponent = frame_time.lower().partition("e")
    half_digit = 0.5 * 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))
    if not half_digit < seconds / 4:
        return rate
    whole = [float(usual) for usual in USUAL_RATES if usual == round(usual)]
    for candidates in (whole, USUAL_RATES, [float(max(1, round(rate)))]):
        nearest = min(candidates, key=lambda candidate: abs(candidate - rate))
        if abs(1.0 / nearest - seconds) <= 1.0001 * half_digit:
            return float(nearest)
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
            rotations[:, index] = rigid.from_euler(joint.rotation_order, np.radians(values[:, rotating]))
        if len(rotating) < len(joint.channels):
            translation = np.tile(np.array(joint.offset), (len(table), 1))
            for i, letter in enumerate(joint.channels):
                if letter.isupper():
                    translation[:, "XYZ".index(letter)] = values[:, i]
            translations[index] = translation
    return rotations, translations


def _channels(joints: list[Joint]) -> list[str]:
    """Channels of the joints without End Sites (leaves without channels); a run of equal entries is one, "zyx*17"."""
    runs: list[list[Any]] = []
    has_child = {joint.parent for joint in joints}
    for index, joint in enumerate(joints):
        if not joint.channels and index not in has_child:
            continue
        if runs and runs[-1][0] == joint.channels:
            runs[-1][1] += 1
        else:
            runs.append([joint.channels, 1])
    return [f"{channels}*{count}" if count > 1 else channels for channels, count in runs]


def write(path: str | Path, motion: Motion) -> None:
    """Write a BVH in the source's unit and channel order (cm, z x y, for other sources).

    Numbers have seven decimals; angles are within ±180° (the middle one ±90°). Raises BadInput for a motion without
    skeleton or rotations, and for gaps.
    """
    skeleton, rotations = motion.skeleton, motion.rotations
    if skeleton is None or rotations is None:
        raise BadInput(
            f"{path}: a BVH needs a skeleton and rotations, which this motion lacks; "
            "a .mocz does not store rotations yet: write a .c3d, .trc or .npz"
        )
    if motion.source.get("format") == "amc":
        raise BadInput(f"{path}: bones of an ASF rotate about their own start, unlike joints of a BVH; write an .amc")
    if motion.gaps.any():
        raise BadInput(f"{path}: a BVH cannot hold gaps")
    is_bvh = motion.source.get("format") == "bvh"
    unit_m = unit_of(motion.source) if is_bvh else 0.01
    has_child = set(skeleton.parents)
    if is_bvh:
        channels = _channels_of(motion.source.get("channels"), skeleton, has_child)
    else:
        channels = ["XYZzxy" if p < 0 else "zxy" if j in has_child else "" for j, p in enumerate(skeleton.parents)]
    world = kinematics.world_rotations(skeleton, rotations)
    columns: list[Floats] = []
    for joint, (letters, parent) in enumerate(zip(channels, skeleton.parents, strict=True)):
        columns.append(_channel_values(motion, world, joint, parent, letters, unit_m))
    table = np.concatenate(columns, axis=1)
    lines = ["HIERARCHY", *_hierarchy_lines(skeleton, channels, has_child, unit_m), "MOTION", f"Frames: {len(motion)}"]
    lines.append(f"Frame Time: {1.0 / motion.rate:.10g}")
    form = " ".join(["%.7f"] * table.shape[1])
    lines += [form % tuple(row) for row in table.tolist()]
    replace_whole(path, ("\n".join(lines) + "\n").encode("utf-8"))


def _channels_of(runs: Any, skeleton: Skeleton, has_child: set[int]) -> list[str]:
    """The inverse of `_channels`. Leaves named "…_end" are End Sites if only the other joints have channels."""
    if not isinstance(runs, list) or not all(isinstance(r, str) and CHANNEL_RUN.fullmatch(r) for r in runs):
        raise BadInput(f"source['channels'] is not a list of BVH channels: {runs!r:.80}")
    channels: list[str] = []
    for run in runs:
        letters, _, count = run.partition("*")
        channels += [letters] * int(count or 1)
    if len(channels) == len(skeleton):
        return channels
    is_named_end = [name.rstrip("0123456789").endswith("_end") for name in skeleton.names]
    is_end = [named and joint not in has_child for joint, named in enumerate(is_named_end)]
    if len(channels) + sum(is_end) != len(skeleton):
        raise BadInput(f"channels of {len(channels)} joints do not match a skeleton of {len(skeleton)} joints")
    rest = iter(channels)
    return ["" if end else next(rest) for end in is_end]


def _channel_values(motion: Motion, world: Floats, joint: int, parent: int, letters: str, unit_m: float) -> Floats:
    """The channels (frames, len(letters)) of one joint, from its rotation and its position relative to its parent."""
    assert motion.rotations is not None
    values = np.empty((len(motion), len(letters)))
    translation = motion.positions[:, joint]
    if parent >= 0:
        translation = rigid.rotate(rigid.inverse(world[:, parent]), translation - motion.positions[:, parent])
    order = "".join(letter for letter in letters if letter.islower())
    angles = np.degrees(rigid.to_euler(order, motion.rotations[:, joint])) if order else None
    for i, letter in enumerate(letters):
        if letter.isupper():
            values[:, i] = translation[:, "XYZ".index(letter)] / unit_m
        elif angles is not None:
            values[:, i] = angles[:, order.index(letter)]
    return values


def _hierarchy_lines(skeleton: Skeleton, channels: list[str], has_child: set[int], unit_m: float) -> list[str]:
    """The lines of the HIERARCHY. Joints are in file order, so each one closes the joints that do not contain it."""
    names = {"X": "Xposition", "Y": "Yposition", "Z": "Zposition", "x": "Xrotation", "y": "Yrotation", "z": "Zrotation"}
    lines: list[str] = []
    open_joints: list[int] = []
    for joint, (name, parent, letters) in enumerate(zip(skeleton.names, skeleton.parents, channels, strict=True)):
        while open_joints and open_joints[-1] != parent:
            open_joints.pop()
            lines.append("\t" * len(open_joints) + "}")
        if parent >= 0 and not open_joints:
            raise BadInput(f"joint {name} is not in depth-first order, which a BVH needs")
        indent = "\t" * len(open_joints)
        is_end = not letters and joint not in has_child and parent >= 0
        lines += [indent + ("End Site" if is_end else f"ROOT {name}" if parent < 0 else f"JOINT {name}"), indent + "{"]
        x, y, z = (skeleton.offsets[joint] / unit_m).tolist()
        lines.append(f"{indent}\tOFFSET {x:.7f} {y:.7f} {z:.7f}")
        if not is_end:
            lines.append(f"{indent}\tCHANNELS {' '.join([str(len(letters)), *(names[letter] for letter in letters)])}")
        open_joints.append(joint)
    while open_joints:
        open_joints.pop()
        lines.append("\t" * len(open_joints) + "}")
    return lines
