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
from .conventions import unit_of, unit_option
from .text import numbers, read_text

HOLDS = frozenset({"skeleton", "joint rotations"})
"""What a BVH stores beside the positions."""
UNITS_M = {"cm": 0.01, "m": 1.0, "mm": 0.001, "ASF": 0.0254 / 0.45, "in": 0.0254}  # tried in this order
PLAUSIBLE_HEIGHT_M = (0.8, 2.4)
CHANNELS = {f"{axis}position": axis for axis in "XYZ"} | {f"{axis}rotation": axis.lower() for axis in "XYZ"}

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


def read(path: str | Path, unit: str | float | None = None, rate: float | None = None) -> Motion:
    """A BVH as a motion, metres, y up, with skeleton and rotations.

    unit: "cm", "m", "mm", "in", "ASF" (CMU's) or metres in one unit; None takes the first of cm, m, mm, ASF and inch in
    which the skeleton at rest extends 0.8 to 2.4 m, else cm. rate: hertz, by default 1 / Frame Time. Raises BadInput.
    """
    text = read_text(path)
    head, motion, body = text.partition("MOTION")
    if not head.lstrip().upper().startswith("HIERARCHY"):
        raise BadInput(f"{path}: not a BVH: it does not begin with HIERARCHY")
    if not motion:
        raise BadInput(f"{path}: cut off or not a BVH: it has no MOTION")
    try:
        joints = _hierarchy(head)
    except (ValueError, IndexError) as error:
        message = error if isinstance(error, BadInput) else f"its hierarchy cannot be read ({error})"
        raise BadInput(f"{path}: {message}") from None
    timing = re.match(r"\s*Frames:\s*(\d{1,12})\s+Frame\s+Time:\s*(\S+)", body, re.IGNORECASE)
    if timing is None:
        raise BadInput(f"{path}: its MOTION does not begin with Frames: and Frame Time:")
    frames, file_rate = int(timing[1]), _rate(timing[2], path)
    table = numbers(body[timing.end() :], path)
    width = sum(len(joint.channels) for joint in joints)
    if table.size != frames * width or not width:
        what = "cut off: " if table.size < frames * width else ""
        raise BadInput(
            f"{path}: {what}{frames} frames of {width} channels are {frames * width} numbers, it has {table.size}"
        )
    if len(joints) > 4 * width + 4:
        raise BadInput(f"{path}: {len(joints)} joints share {width} channels, too few for a body")
    offsets = np.array([joint.offset for joint in joints])
    names = _names([joint.name for joint in joints])
    skeleton = Skeleton(names, tuple(joint.parent for joint in joints), offsets)
    units, unit_m = _unit(unit, skeleton, path)
    skeleton = Skeleton(skeleton.names, skeleton.parents, offsets * unit_m)
    rotations, translations = _transforms(joints, table.reshape(frames, width), unit_m)
    positions = kinematics.forward(skeleton, rotations, np.zeros((frames, 3)), translations=translations)
    source: dict[str, Any] = {"format": "bvh", "units": units, "unit_m": unit_m, "channels": _channels(joints)}
    if unit is not None:
        source["unit_given"] = True
    return Motion(positions, rate or file_rate, names, "y", skeleton, rotations, source)


def _hierarchy(text: str) -> list[Joint]:
    """The joints, parents first. A brace may share a line with other words."""
    joints: list[Joint] = []
    stack: list[int] = []
    latest = -1
    lines = text.replace("{", "\n{\n").replace("}", "\n}\n").split("\n")
    for words in filter(None, (line.split() for line in lines)):
        key = words[0].upper()
        if key in ("ROOT", "JOINT", "END"):
            parent = stack[-1] if stack else -1
            if (key == "ROOT") != (parent < 0):
                raise BadInput(f"its hierarchy has a {key} {'inside' if stack else 'outside'} a ROOT")
            name = f"{joints[parent].name}_end" if key == "END" else " ".join(words[1:])
            joints.append(Joint(name or f"joint{len(joints) + 1}", parent))
            latest = len(joints) - 1
        elif key == "{":
            if latest < 0:
                raise BadInput("its hierarchy has a { without a joint")
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
    """1 / frame time; a whole number of hertz where the digits of the file are that number's, rounded (0.0083333)."""
    try:
        seconds = float(frame_time)
        rate = 1.0 / seconds
    except (ValueError, ZeroDivisionError):
        seconds = rate = -1.0
    if not 0 < seconds < float("inf") or rate == float("inf"):
        raise BadInput(f"{path}: Frame Time must be a positive number of seconds, not {frame_time[:40]!r}")
    half_digit = 0.5 * 10.0 ** -len(frame_time.partition(".")[2]) if "e" not in frame_time.lower() else 0.0
    whole = round(rate)
    return float(whole) if whole > 0 and abs(1.0 / whole - seconds) <= 1.2 * half_digit < seconds / 4 else rate


def _unit(unit: str | float | None, rest: Skeleton, path: str | Path) -> tuple[str, float]:
    """The unit's name and its metres: as given, or guessed from the size of the skeleton at rest."""
    if unit is not None:
        try:
            return unit_option(unit, UNITS_M)
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from None
    places = np.array(rest.offsets)
    for joint, parent in enumerate(rest.parents):
        places[joint] += places[parent] if parent >= 0 else -places[joint]
    height = np.ptp(places, axis=0).max()
    low, high = PLAUSIBLE_HEIGHT_M
    name = next((name for name, unit_m in UNITS_M.items() if low <= height * unit_m <= high), "cm")
    return name, UNITS_M[name]


def _transforms(joints: list[Joint], table: Floats, unit_m: float) -> tuple[Floats, dict[int, Floats]]:
    """Rotations (frames, joints, 4), and by joint with position channels its translations (frames, 3) in metres."""
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
            translations[index] = translation * unit_m
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
