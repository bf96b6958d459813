"""ASF: the skeleton file of an Acclaim capture, read and written.

Bones have a direction and a length, an axis frame C, degrees of freedom and limits. A bone's rotation moves its own
end, so `Skeleton.offsets` are in each bone's own frame here, not in its parent's. Metres are value / (length unit) ×
0.0254.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..geometry import rigid
from ..motion import Limits, Skeleton
from ..typing import Floats
from .conventions import metres_in
from .text import read_text

DEGREES_OF_UNLIMITEDDOM = ("rx", "ry", "rz")
UNLIMITED = ((-math.inf, math.inf),)


@dataclass(frozen=True)
class Bone:
    """One bone of an ASF: axis frame, order of rotations, degrees of freedom and their limits, in the file's units."""

    name: str
    offset: tuple[float, float, float]  # direction × length
    axis: tuple[float, float, float] = (0.0, 0.0, 0.0)  # angles of the frame C
    order: str = "xyz"  # first rotation first
    dof: tuple[str, ...] = ()
    limits: tuple[tuple[float, float], ...] = ()  # (least, greatest) of each dof, or empty


@dataclass(frozen=True)
class Acclaim:
    """A skeleton file. bones[0] is the root; its dof are the channels of its line in the AMC ("tx" … "rz")."""

    bones: tuple[Bone, ...]
    parents: tuple[int, ...]
    length: float = 1.0  # the ASF's length unit
    degrees: bool = True

    @property
    def unit_m(self) -> float:
        """Metres in one unit."""
        return 0.0254 / self.length

    @property
    def skeleton(self) -> Skeleton:
        offsets = np.array([bone.offset for bone in self.bones]) * self.unit_m
        return Skeleton(tuple(bone.name for bone in self.bones), self.parents, offsets, self._limits)

    @property
    def _limits(self) -> Limits | None:
        """None if no bone has limits. The root, and bones without limits, are unlimited."""
        if not any(bone.limits for bone in self.bones):
            return None
        ranges = np.zeros((len(self.bones), 3, 2))
        for bone, bone_ranges in zip(self.bones, ranges, strict=True):
            for name, allowed in zip(bone.dof, bone.limits or UNLIMITED * len(bone.dof), strict=True):
                if name[0] == "r":
                    bone_ranges[bone.order[::-1].index(name[1])] = allowed
        ranges[0] = UNLIMITED
        axes = np.stack([axis_frame(bone, self) for bone in self.bones])
        return Limits(tuple(bone.order[::-1] for bone in self.bones), axes, self.radians(ranges))

    def radians(self, values: Floats) -> Floats:
        """Angles of the file in radians."""
        return np.radians(values) if self.degrees else values


def read_asf(path: str | Path) -> Acclaim:
    """The skeleton of an ASF file. Raises BadInput."""
    path = Path(path)
    if not path.is_file():
        raise BadInput(f"{path}: no such skeleton file")
    return parse_asf(read_text(path), path)


def parse_asf(text: str, path: Path) -> Acclaim:
    """As `read_asf`, of the text of a file; path: for messages."""
    try:
        return _acclaim(_sections(text))
    except (IndexError, KeyError, ValueError) as error:
        what = error if isinstance(error, BadInput) else f"not an ASF that can be read ({error!r})"
        raise BadInput(f"{path}: {what}") from None


def _sections(text: str) -> dict[str, list[list[str]]]:
    """The words of each line, by the keyword (":units", ":root", …) above them."""
    sections: dict[str, list[list[str]]] = {}
    lines: list[list[str]] = []
    for line in text.splitlines():
        words = line.split("#", 1)[0].split()
        if words and words[0].startswith(":"):
            lines = sections.setdefault(words[0].lower(), [])
            words = words[1:]
        if words:
            lines.append(words)
    return sections


def _length_unit(text: str) -> float:
    """ASF's units of length in an inch, as a number or by the name of a unit. Raises BadInput."""
    unit_m = metres_in(text)
    if unit_m is not None:
        return 0.0254 / unit_m
    try:
        return float(text)
    except ValueError:
        raise BadInput(f"its length unit {text!r:.40} is neither a number nor the name of a unit") from None


def _acclaim(sections: dict[str, list[list[str]]]) -> Acclaim:
    if ":bonedata" not in sections or ":hierarchy" not in sections:
        raise BadInput("not an ASF: it has no :bonedata or no :hierarchy")
    units = {words[0].lower(): words[1] for words in sections.get(":units", []) if len(words) > 1}
    length = _length_unit(units.get("length", "1.0"))
    if not (math.isfinite(length) and length > 0):
        raise BadInput(f"its length unit must be positive, not {length}")
    root = {words[0].lower(): words[1:] for words in sections.get(":root", [])}
    position, orientation = (_triple(root.get(key, ["0", "0", "0"])) for key in ("position", "orientation"))
    channels = tuple(channel.lower() for channel in root.get("order", ["TX", "TY", "TZ", "RX", "RY", "RZ"]))
    if sorted(set(channels)) != sorted(channels) or not set(channels) <= {"tx", "ty", "tz", "rx", "ry", "rz"}:
        raise BadInput(f"the root's order {' '.join(channels)} has a channel that is not one of TX TY TZ RX RY RZ")
    bones = {"root": Bone("root", position, orientation, _order(root.get("axis", ["XYZ"])[0]), channels)}
    for bone in _bones(sections[":bonedata"]):
        if bone.name in bones:
            raise BadInput(f"bone {bone.name} is defined twice")
        bones[bone.name] = bone
    parent_of = _hierarchy(sections[":hierarchy"], bones)
    number = {"root": 0}
    for name in bones:  # in file order, but parents first
        chain: dict[str, None] = {}
        link: str | None = name
        while link not in number:
            if link is None or link in chain:
                raise BadInput(f"bone {name} is not connected to the root")
            chain[link] = None
            link = parent_of.get(link)
        for link in reversed(chain):
            number[link] = len(number)
    parents = (-1, *(number[parent_of[name]] for name in number if name != "root"))
    degrees = not units.get("angle", "deg").lower().startswith("rad")
    return Acclaim(tuple(bones[name] for name in number), parents, length, degrees)


def _bones(lines: list[list[str]]) -> list[Bone]:
    bones: list[Bone] = []
    fields: dict[str, list[str]] | None = None
    key = ""
    for words in lines:
        if key == "limits" and fields is not None and not words[0][0].isalpha():  # usually one pair a line
            fields[key] += words
            continue
        key = words[0].lower()
        if key == "begin":
            fields = {}
        elif key == "end" and fields is not None:
            dof = tuple(word.lower() for word in fields.get("dof", []))
            if not set(dof) <= set(DEGREES_OF_UNLIMITEDDOM) or len(set(dof)) != len(dof):
                raise BadInput(f"bone {fields['name'][0]}: its dof {' '.join(dof)} are not distinct ones of rx ry rz")
            along, length = np.array(_triple(fields["direction"])), float(fields["length"][0])
            if not math.isfinite(length):
                raise BadInput(f"bone {fields['name'][0]}: its length is {length}")
            axis = fields.get("axis", ["0", "0", "0", "XYZ"])
            order = _order(axis[3] if len(axis) > 3 else "XYZ")
            x, y, z = (along * length).tolist()
            limits = _limits(dof, fields.get("limits", []))
            bones.append(Bone(fields["name"][0], (x, y, z), _triple(axis), order, dof, limits))
            fields = None
        elif fields is not None and key not in fields:
            fields[key] = words[1:]
    return bones


def _limits(dof: tuple[str, ...], words: list[str]) -> tuple[tuple[float, float], ...]:
    """(least, greatest) of each dof; a pair in the wrong order is exchanged. Limits that cannot be read are ignored:
    the motion does not depend on them.
    """
    try:
        values = [float(word) for word in re.split(r"[\s(),]+", " ".join(words)) if word]
    except ValueError:
        return ()
    pairs = tuple((min(pair), max(pair)) for pair in zip(values[::2], values[1::2], strict=False))
    are_ranges = all(low < math.inf and high > -math.inf for low, high in pairs)
    are_numbers = not any(map(math.isnan, values))
    return pairs if are_ranges and are_numbers and len(values) == 2 * len(dof) else ()


def _hierarchy(lines: list[list[str]], bones: dict[str, Bone]) -> dict[str, str]:
    parent_of: dict[str, str] = {}
    for parent, *children in lines:
        if parent.lower() in ("begin", "end"):
            continue
        for child in children:
            if parent not in bones or child not in bones or child == "root" or child in parent_of:
                raise BadInput(f"its hierarchy puts {child} under {parent}, which is impossible")
            parent_of[child] = parent
    return parent_of


def _triple(words: list[str]) -> tuple[float, float, float]:
    x, y, z = (float(word) for word in words[:3])
    if not math.isfinite(x + y + z):
        raise BadInput(f"{' '.join(words)} are not three numbers")
    return x, y, z


def _order(letters: str) -> str:
    if sorted(letters.lower()) != ["x", "y", "z"]:
        raise BadInput(f"an axis order consists of X, Y and Z, not {letters!r}")
    return letters.lower()


def axis_frame(bone: Bone, acclaim: Acclaim) -> Floats:
    """The axis frame C (4,). Its angles are listed as x y z, whatever the order of rotations."""
    by_order = np.array([bone.axis["xyz".index(letter)] for letter in bone.order[::-1]])
    return rigid.from_euler(bone.order[::-1], acclaim.radians(by_order))


def acclaim_axes(order: str, frame: Floats, degrees: bool, digits: int) -> tuple[float, float, float]:
    """The inverse of `axis_frame`: x, y and z of a frame C (4,), rounded to `digits` decimals."""
    angles = rigid.to_euler(order, frame)
    angles = np.degrees(angles) if degrees else angles
    x, y, z = (round(float(angles[order.index(letter)]), digits) + 0.0 for letter in "xyz")
    return x, y, z


def asf_text(acclaim: Acclaim) -> str:
    """The text of a skeleton file, the inverse of `read_asf`."""
    root = acclaim.bones[0]
    lines = [":version 1.10", ":name mocodec", ":units", "  mass 1.0", f"  length {acclaim.length:.10g}"]
    lines += [f"  angle {'deg' if acclaim.degrees else 'rad'}", ":root", f"   order {' '.join(root.dof).upper()}"]
    lines += [f"   axis {root.order.upper()}", f"   position {_numbers(root.offset)}"]
    lines += [f"   orientation {_numbers(root.axis)}", ":bonedata"]
    for number, bone in enumerate(acclaim.bones[1:], 1):
        size = float(np.linalg.norm(bone.offset))
        x, y, z = (np.array(bone.offset) / size).tolist() if size else (0.0, 1.0, 0.0)
        lines += ["  begin", f"     id {number}", f"     name {bone.name}", f"     direction {_numbers((x, y, z))}"]
        lines += [f"     length {size:.10g}", f"     axis {_numbers(bone.axis)} {bone.order.upper()}"]
        lines += [f"    dof {' '.join(bone.dof)}"] if bone.dof else []
        pairs = [f"({_numbers(pair)})" for pair in bone.limits]
        lines += [f"    {'limits' if i == 0 else '      '} {pair}" for i, pair in enumerate(pairs)] + ["  end"]
    lines += [":hierarchy", "  begin"]
    for parent, bone in enumerate(acclaim.bones):
        children = [acclaim.bones[j].name for j, p in enumerate(acclaim.parents) if p == parent]
        if children:
            lines.append(f"    {bone.name} {' '.join(children)}")
    return "\n".join([*lines, "  end", ""])


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.10g}" for value in values)
