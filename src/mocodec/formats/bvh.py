"""BVH: a skeleton with its channels, then a line of numbers a frame (Biovision; the de-facto standard of animation).

    HIERARCHY   joints: OFFSET, CHANNELS in any order; End Sites ─┐
    MOTION      frames × channels, parsed as one block ───────────┴─► quaternions ─► forward kinematics ─► joints

Points are the joints and, as "<parent>_end", the End Sites: without these the last joints' turns would leave no trace
in the positions. Where a joint has position channels they stand in the place of its OFFSET. y is up.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BadInput
from ..geometry import kinematics, rigid
from ..motion import Floats, Motion, Skeleton
from . import replace_whole
from .conventions import unit_of
from .text import decoded, numbers

HOLDS = frozenset({"skeleton", "joint rotations"})  # of what is beside the positions
UNITS_M = {"cm": 0.01, "m": 1.0, "mm": 0.001, "ASF": 0.0254 / 0.45, "in": 0.0254}  # tried in this order
PLAUSIBLE_HEIGHT_M = (0.8, 2.4)
CHANNELS = {f"{axis}position": axis for axis in "XYZ"} | {f"{axis}rotation": axis.lower() for axis in "XYZ"}

RUN_OF_CHANNELS = re.compile(r"(?:([XYZxyz])(?!.*\1)){0,6}(?:\*\d{1,4})?")


@dataclass
class Joint:
    """One joint of the hierarchy. channels: a letter each, in the file's order: "XYZ" positions, "xyz" rotations."""

    name: str
    parent: int
    offset: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    channels: str = ""

    @property
    def rotation_order(self) -> str:
        return "".join(letter for letter in self.channels if letter.islower())


def read(path: str | Path, unit: str | float | None = None) -> Motion:
    """A BVH as a motion, metres, y up, with skeleton and rotations.

    unit: "cm", "m", "mm", "in", "ASF" (CMU's) or metres in one unit; None takes the first of cm, m, mm, ASF and inch in
    which the skeleton at rest extends 0.8 to 2.4 m, and cm where none does. Raises BadInput.
    """
    text = decoded(path)
    head, motion, body = text.partition("MOTION")
    if not head.lstrip().upper().startswith("HIERARCHY"):
        raise BadInput(f"{path}: not a BVH: it does not begin with HIERARCHY")
    if not motion:
        raise BadInput(f"{path}: cut off or not a BVH: it has no MOTION")
    try:
        joints = _hierarchy(head)
    except (ValueError, IndexError) as error:
        what = error if isinstance(error, BadInput) else f"its hierarchy cannot be read ({error})"
        raise BadInput(f"{path}: {what}") from None
    found = re.match(r"\s*Frames:\s*(\d{1,12})\s+Frame\s+Time:\s*(\S+)", body, re.IGNORECASE)
    if found is None:
        raise BadInput(f"{path}: its MOTION does not begin with Frames: and Frame Time:")
    frames, rate = int(found[1]), _rate(found[2], path)
    table = numbers(body[found.end() :], path)
    width = sum(len(joint.channels) for joint in joints)
    if table.size != frames * width or not width:
        what = "cut off: " if table.size < frames * width else ""
        raise BadInput(
            f"{path}: {what}{frames} frames of {width} channels are {frames * width} numbers, it has {table.size}"
        )
    if len(joints) > 4 * width + 4:
        raise BadInput(f"{path}: {len(joints)} joints with {width} channels between them are not a body")
    offsets = np.array([joint.offset for joint in joints])
    names = _names([joint.name for joint in joints])
    skeleton = Skeleton(names, tuple(joint.parent for joint in joints), offsets)
    units, unit_m = _unit(unit, skeleton, path)
    skeleton = Skeleton(skeleton.names, skeleton.parents, offsets * unit_m)
    rotations, translations = _turns(joints, table.reshape(frames, width), unit_m)
    positions = kinematics.forward(skeleton, rotations, np.zeros((frames, 3)), translations=translations)
    source = {"format": "bvh", "units": units, "unit_m": unit_m, "channels": _channels(joints)}
    return Motion(positions, rate, names, "y", skeleton, rotations, source)


def _hierarchy(text: str) -> list[Joint]:
    """The joints, each after its parent. A line may hold a brace beside other words."""
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
    """Each name once: the second end of a joint is "<name>_end2"."""
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
    """The unit's name and metres in it: as told, or as the size of the skeleton at rest says."""
    if isinstance(unit, str):
        named = {name.lower(): name for name in UNITS_M}
        if unit.lower() in named:
            return named[unit.lower()], UNITS_M[named[unit.lower()]]
        try:
            unit = float(unit)
        except ValueError:
            known = ", ".join(UNITS_M)
            raise BadInput(f"{path}: unit {unit!r} is neither a number of metres nor one of {known}") from None
    if unit is not None:
        if not 0 < unit < float("inf"):
            raise BadInput(f"{path}: a unit is a positive number of metres, not {unit}")
        return f"{unit:g} m", float(unit)
    places = np.array(rest.offsets)
    for joint, parent in enumerate(rest.parents):
        places[joint] += places[parent] if parent >= 0 else -places[joint]
    height = np.ptp(places, axis=0).max()
    low, high = PLAUSIBLE_HEIGHT_M
    name = next((name for name, unit_m in UNITS_M.items() if low <= height * unit_m <= high), "cm")
    return name, UNITS_M[name]


def _turns(joints: list[Joint], table: Floats, unit_m: float) -> tuple[Floats, dict[int, Floats]]:
    """Rotations (frames, joints, 4) and, where joints have position channels, their places against their parents."""
    rotations = np.zeros((len(table), len(joints), 4))
    rotations[..., 0] = 1.0
    translations: dict[int, Floats] = {}
    at = 0
    for index, joint in enumerate(joints):
        values = table[:, at : at + len(joint.channels)]
        at += len(joint.channels)
        turning = [i for i, letter in enumerate(joint.channels) if letter.islower()]
        if turning:
            rotations[:, index] = rigid.from_euler(joint.rotation_order, np.radians(values[:, turning]))
        if len(turning) < len(joint.channels):
            place = np.tile(np.array(joint.offset), (len(table), 1))
            for i, letter in enumerate(joint.channels):
                if letter.isupper():
                    place[:, "XYZ".index(letter)] = values[:, i]
            translations[index] = place * unit_m
    return rotations, translations


def _channels(joints: list[Joint]) -> list[str]:
    """Channels by joint, End Sites (leaves without channels) left out; runs of equal ones as one entry "zyx*17"."""
    runs: list[list[Any]] = []
    with_child = {joint.parent for joint in joints}
    for index, joint in enumerate(joints):
        if not joint.channels and index not in with_child:
            continue
        if runs and runs[-1][0] == joint.channels:
            runs[-1][1] += 1
        else:
            runs.append([joint.channels, 1])
    return [f"{channels}*{count}" if count > 1 else channels for channels, count in runs]


def write(path: str | Path, motion: Motion) -> None:
    """Write a BVH in the source's unit and channel order (cm, z x y, for other sources).

    Numbers have seven decimals; angles are the ones within ±180° (the middle one ±90°) that make the same turns. Raises
    BadInput for a motion without a skeleton or rotations, and for gaps.
    """
    skeleton, rotations = motion.skeleton, motion.rotations
    if skeleton is None or rotations is None:
        raise BadInput(
            f"{path}: a BVH needs a skeleton and rotations, which this motion does not have; "
            "a .mocz does not store rotations yet: write a .c3d, .trc or .npz"
        )
    if motion.source.get("format") == "amc":
        raise BadInput(f"{path}: bones of an ASF turn about their own start, which a BVH cannot say; write an .amc")
    if motion.gaps.any():
        raise BadInput(f"{path}: a BVH cannot hold gaps")
    own = motion.source.get("format") == "bvh"
    unit_m = unit_of(motion.source) if own else 0.01
    has_child = set(skeleton.parents)
    if own:
        specs = _spread(motion.source.get("channels"), skeleton, has_child)
    else:
        specs = ["XYZzxy" if p < 0 else "zxy" if j in has_child else "" for j, p in enumerate(skeleton.parents)]
    turns = kinematics.world_rotations(skeleton, rotations)
    columns: list[Floats] = []
    for joint, (spec, parent) in enumerate(zip(specs, skeleton.parents, strict=True)):
        columns.append(_values(motion, turns, joint, parent, spec, unit_m))
    table = np.concatenate(columns, axis=1)
    lines = ["HIERARCHY", *_tree(skeleton, specs, has_child, unit_m), "MOTION", f"Frames: {len(motion)}"]
    lines.append(f"Frame Time: {1.0 / motion.rate:.10g}")
    form = " ".join(["%.7f"] * table.shape[1])
    lines += [form % tuple(row) for row in table.tolist()]
    replace_whole(path, ("\n".join(lines) + "\n").encode("utf-8"))


def _spread(runs: Any, skeleton: Skeleton, has_child: set[int]) -> list[str]:
    """The inverse of `_channels`. Leaves are End Sites where there are channels for the other joints only."""
    if not isinstance(runs, list) or not all(isinstance(r, str) and RUN_OF_CHANNELS.fullmatch(r) for r in runs):
        raise BadInput(f"the motion's source does not say its channels as a BVH has them: {runs!r:.80}")
    specs: list[str] = []
    for run in runs:
        spec, _, count = run.partition("*")
        specs += [spec] * int(count or 1)
    if len(specs) == len(skeleton):
        return specs
    named_end = [name.rstrip("0123456789").endswith("_end") for name in skeleton.names]
    ends = [named and joint not in has_child for joint, named in enumerate(named_end)]
    if len(specs) + sum(ends) != len(skeleton):
        raise BadInput(f"channels of {len(specs)} joints do not fit a skeleton of {len(skeleton)}")
    given = iter(specs)
    return ["" if end else next(given) for end in ends]


def _values(motion: Motion, turns: Floats, joint: int, parent: int, spec: str, unit_m: float) -> Floats:
    """The channels (frames, len(spec)) of one joint, from its rotation and its place against its parent."""
    assert motion.rotations is not None
    values = np.empty((len(motion), len(spec)))
    place = motion.positions[:, joint]
    if parent >= 0:
        place = rigid.rotate(rigid.inverse(turns[:, parent]), place - motion.positions[:, parent])
    order = "".join(letter for letter in spec if letter.islower())
    angles = np.degrees(rigid.to_euler(order, motion.rotations[:, joint])) if order else None
    for i, letter in enumerate(spec):
        if letter.isupper():
            values[:, i] = place[:, "XYZ".index(letter)] / unit_m
        elif angles is not None:
            values[:, i] = angles[:, order.index(letter)]
    return values


def _tree(skeleton: Skeleton, specs: list[str], has_child: set[int], unit_m: float) -> list[str]:
    """The HIERARCHY's lines; joints stand in the file's order, so each closes what it is not inside of."""
    names = {"X": "Xposition", "Y": "Yposition", "Z": "Zposition", "x": "Xrotation", "y": "Yrotation", "z": "Zrotation"}
    lines: list[str] = []
    open_joints: list[int] = []
    for joint, (name, parent, spec) in enumerate(zip(skeleton.names, skeleton.parents, specs, strict=True)):
        while open_joints and open_joints[-1] != parent:
            open_joints.pop()
            lines.append("\t" * len(open_joints) + "}")
        if parent >= 0 and not open_joints:
            raise BadInput(f"joint {name} does not follow its parent as a BVH needs it")
        indent = "\t" * len(open_joints)
        end = not spec and joint not in has_child and parent >= 0
        lines += [indent + ("End Site" if end else f"ROOT {name}" if parent < 0 else f"JOINT {name}"), indent + "{"]
        x, y, z = (skeleton.offsets[joint] / unit_m).tolist()
        lines.append(f"{indent}\tOFFSET {x:.7f} {y:.7f} {z:.7f}")
        if not end:
            lines.append(f"{indent}\tCHANNELS {' '.join([str(len(spec)), *(names[letter] for letter in spec)])}")
        open_joints.append(joint)
    while open_joints:
        open_joints.pop()
        lines.append("\t" * len(open_joints) + "}")
    return lines
