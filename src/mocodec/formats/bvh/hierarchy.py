"""The HIERARCHY of a BVH, parsed and written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...errors import BadInput

CHANNELS = {f"{axis}position": axis for axis in "XYZ"} | {f"{axis}rotation": axis.lower() for axis in "XYZ"}
MAX_DEPTH = 1000
"""Nested joints; more are taken for damage."""


@dataclass
class Joint:
    """One joint of the hierarchy. channels: one letter each, in file order; "XYZ" positions, "xyz" rotations."""

    name: str
    parent: int
    is_end: bool = False
    offset: list[str] = field(default_factory=lambda: ["0", "0", "0"])
    channels: str = ""

    @property
    def rotation_order(self) -> str:
        """The axes of its rotation channels, in file order."""
        return "".join(letter for letter in self.channels if letter.islower())


def parse(text: str) -> list[Joint]:
    """The joints, parents first. A brace may share a line with other words. Raises BadInput, ValueError, IndexError."""
    joints: list[Joint] = []
    stack: list[int] = []
    latest = -1
    lines = text.replace("{", "\n{\n").replace("}", "\n}\n").split("\n")
    for words in filter(None, (line.split() for line in lines)):
        key = words[0].upper()
        key = "END" if key in ("ENDSITE", "END_SITE") else key
        if key in ("ROOT", "JOINT", "END"):
            joints.append(_joint(key, " ".join(words[1:]), joints, stack))
            latest = len(joints) - 1
        elif key == "{":
            if latest < 0:
                raise BadInput("its hierarchy has a { without a joint")
            if len(stack) >= MAX_DEPTH:
                raise BadInput(f"its joints are nested more than {MAX_DEPTH} deep")
            stack.append(latest)
        elif key == "}":
            if not stack:
                raise BadInput("its hierarchy has a } without a {")
            stack.pop()
        elif key == "OFFSET":
            joints[stack[-1]].offset = words[1:4]
            if len(words) < 4 or not np.isfinite([float(word) for word in words[1:4]]).all():
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


def _joint(key: str, name: str, joints: list[Joint], stack: list[int]) -> Joint:
    """A joint under the innermost open one. Raises BadInput where its kind has no place there."""
    parent = stack[-1] if stack else -1
    if (key == "ROOT") != (parent < 0):
        raise BadInput(f"its hierarchy has a {key} {'inside' if stack else 'outside'} a ROOT")
    if parent >= 0 and joints[parent].is_end:
        raise BadInput(f"its hierarchy has a {key} inside the End Site of {joints[joints[parent].parent].name}")
    if key == "END":
        return Joint(f"{joints[parent].name}_end", parent, True)
    return Joint(name or f"joint{len(joints) + 1}", parent)


def unique_names(joints: Sequence[Joint]) -> tuple[tuple[str, ...], dict[str, str]]:
    """A unique name for each joint, and the original of each joint's name that differs from it.

    The second "Arm" is "Arm2", the second End Site of a joint "<name>_end2".
    """
    taken = {joint.name for joint in joints}
    seen: set[str] = set()
    names: list[str] = []
    originals: dict[str, str] = {}
    for joint in joints:
        name, number = joint.name, 1
        while name in seen or (number > 1 and name in taken):
            number += 1
            name = f"{joint.name}{number}"
        if name != joint.name and not joint.is_end:
            originals[name] = joint.name
        seen.add(name)
        names.append(name)
    return tuple(names), originals


def lines(
    names: Sequence[str], parents: Sequence[int], offsets: Sequence[str], channels: Sequence[str | None]
) -> list[str]:
    """The lines of the HIERARCHY. offsets: three numbers each, as text. channels: None for an End Site.

    Joints are in depth-first order, so each one closes the joints that do not contain it. Raises BadInput for names
    that cannot be read again.
    """
    words = {letter: word for word, letter in CHANNELS.items()}
    result = ["HIERARCHY"]
    open_joints: list[int] = []
    for joint, (name, parent, offset, letters) in enumerate(zip(names, parents, offsets, channels, strict=True)):
        while open_joints and open_joints[-1] != parent:
            open_joints.pop()
            result.append("\t" * len(open_joints) + "}")
        if letters is not None and (not name or name != " ".join(name.split()) or set(name) & set("{}")):
            raise BadInput(f"a BVH cannot hold the joint name {name!r:.60}")
        indent = "\t" * len(open_joints)
        head = "End Site" if letters is None else f"{'ROOT' if parent < 0 else 'JOINT'} {name}"
        result += [indent + head, indent + "{", f"{indent}\tOFFSET {offset}"]
        if letters is not None:
            result.append(f"{indent}\tCHANNELS {' '.join([str(len(letters)), *(words[letter] for letter in letters)])}")
        open_joints.append(joint)
    while open_joints:
        open_joints.pop()
        result.append("\t" * len(open_joints) + "}")
    return result
