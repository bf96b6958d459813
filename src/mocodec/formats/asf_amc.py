"""ASF/AMC: the skeleton and the motion of an Acclaim capture, as in Carnegie Mellon's database.

    ASF  bones: direction and length, an axis frame C, degrees of freedom ─┐
    AMC  per frame and bone: angles ─► M ─► own turn C · M · C⁻¹ ──────────┴─► forward kinematics ─► ends of bones

Points are the root and the END of every bone, in the order of the ASF (31 in CMU's), as the field evaluates them. A
bone's turn therefore moves its own offset: `Skeleton.offsets` are in each bone's own frame here, not in its parent's.
Metres are value / (ASF length unit) × 0.0254. An AMC does not say its rate: 120 Hz, CMU's, unless told.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..geometry import kinematics, rigid
from ..motion import Floats, Limits, Motion, Skeleton
from . import replace_whole
from .conventions import first_frame, unit_of
from .text import decoded, numbers

HOLDS = frozenset({"skeleton", "joint rotations"})  # of what is beside the positions
DEGREES_OF_FREEDOM = ("rx", "ry", "rz")
CMU_RATE = 120.0
FREE = ((-math.inf, math.inf),)


@dataclass(frozen=True)
class Bone:
    """One bone as its ASF has it: the turn C of its axis frame, the order of its turns, and how far they go."""

    name: str
    offset: tuple[float, float, float]  # direction × length, in the file's units
    axis: tuple[float, float, float] = (0.0, 0.0, 0.0)  # degrees or radians, as the file counts
    order: str = "xyz"  # first turn first
    dof: tuple[str, ...] = ()
    limits: tuple[tuple[float, float], ...] = ()  # of each dof, least and greatest, as the file counts; or of none


@dataclass(frozen=True)
class Acclaim:
    """A skeleton file. bones[0] is the root, whose dof are the channels of its line in the AMC ("tx" … "rz")."""

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
        """None where no bone has any. The root, and a dof of which nothing is said, are free."""
        if not any(bone.limits for bone in self.bones):
            return None
        ranges = np.zeros((len(self.bones), 3, 2))
        for bone, its in zip(self.bones, ranges, strict=True):
            for name, allowed in zip(bone.dof, bone.limits or FREE * len(bone.dof), strict=True):
                if name[0] == "r":
                    its[bone.order[::-1].index(name[1])] = allowed
        ranges[0] = FREE
        axes = np.stack([_axis_frame(bone, self) for bone in self.bones])
        return Limits(tuple(bone.order[::-1] for bone in self.bones), axes, self.radians(ranges))

    def radians(self, values: Floats) -> Floats:
        return np.radians(values) if self.degrees else values


def read(path: str | Path, asf: str | Path | None = None, rate: float = CMU_RATE) -> Motion:
    """An AMC with its ASF as a motion, metres, y up, with skeleton and rotations.

    asf: the skeleton's file; otherwise the one beside the AMC whose name its name begins with, or the only one there.
    rate: frames a second, which an AMC does not say. Raises BadInput.
    """
    path = Path(path)
    acclaim = read_asf(_find_asf(path) if asf is None else asf)
    first, values = _channels(path, acclaim)
    frames = len(values[0])
    rotations = np.empty((frames, len(acclaim.bones), 4))
    for joint, (bone, channels) in enumerate(zip(acclaim.bones, values, strict=True)):
        rotations[:, joint] = _own_turn(bone, channels, acclaim)
    root = acclaim.bones[0]
    moved = np.zeros((frames, 3))
    for channel, name in enumerate(root.dof):
        if name[0] == "t":
            moved[:, "xyz".index(name[1])] = values[0][:, channel]
    positions = kinematics.forward(acclaim.skeleton, rotations, moved * acclaim.unit_m, own_frame=True)
    source = {"format": "amc", "units": "ASF", "unit_m": acclaim.unit_m, "first_frame": first}
    skeleton = acclaim.skeleton
    return Motion(positions, rate, skeleton.names, "y", skeleton, rotations, source)


def read_asf(path: str | Path) -> Acclaim:
    """The skeleton of an ASF file. Raises BadInput."""
    path = Path(path)
    if not path.is_file():
        raise BadInput(f"{path}: no such skeleton file")
    sections = _sections(decoded(path))
    try:
        return _acclaim(sections)
    except (IndexError, KeyError, ValueError) as error:
        what = error if isinstance(error, BadInput) else f"not an ASF that can be read ({error!r})"
        raise BadInput(f"{path}: {what}") from None


def _sections(text: str) -> dict[str, list[list[str]]]:
    """The words of each line, by the keyword (":units", ":root", …) that they stand under."""
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


def _acclaim(sections: dict[str, list[list[str]]]) -> Acclaim:
    if ":bonedata" not in sections or ":hierarchy" not in sections:
        raise BadInput("not an ASF: it has no :bonedata or no :hierarchy")
    units = {words[0].lower(): words[1] for words in sections.get(":units", []) if len(words) > 1}
    length = float(units.get("length", 1.0))
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
            raise BadInput(f"bone {bone.name} is there twice")
        bones[bone.name] = bone
    above = _hierarchy(sections[":hierarchy"], bones)
    number = {"root": 0}
    for name in bones:  # as the file has them, each after its parent
        chain: dict[str, None] = {}
        link: str | None = name
        while link not in number:
            if link is None or link in chain:
                raise BadInput(f"bone {name} does not hang on the root")
            chain[link] = None
            link = above.get(link)
        for link in reversed(chain):
            number[link] = len(number)
    parents = (-1, *(number[above[name]] for name in number if name != "root"))
    degrees = not units.get("angle", "deg").lower().startswith("rad")
    return Acclaim(tuple(bones[name] for name in number), parents, length, degrees)


def _bones(lines: list[list[str]]) -> list[Bone]:
    bones: list[Bone] = []
    fields: dict[str, list[str]] | None = None
    key = ""
    for words in lines:
        if key == "limits" and fields is not None and not words[0][0].isalpha():  # a pair a line, as a rule
            fields[key] += words
            continue
        key = words[0].lower()
        if key == "begin":
            fields = {}
        elif key == "end" and fields is not None:
            dof = tuple(word.lower() for word in fields.get("dof", []))
            if not set(dof) <= set(DEGREES_OF_FREEDOM) or len(set(dof)) != len(dof):
                raise BadInput(f"bone {fields['name'][0]}: its dof {' '.join(dof)} are not some of rx ry rz")
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
    """A pair of each dof, the lesser first whichever the file has first; none where it has something else: the motion
    can be read all the same.
    """
    try:
        values = [float(word) for word in re.split(r"[\s(),]+", " ".join(words)) if word]
    except ValueError:
        return ()
    pairs = tuple((min(pair), max(pair)) for pair in zip(values[::2], values[1::2], strict=False))
    is_between = all(low < math.inf and high > -math.inf for low, high in pairs)
    are_numbers = not any(map(math.isnan, values))
    return pairs if is_between and are_numbers and len(values) == 2 * len(dof) else ()


def _hierarchy(lines: list[list[str]], bones: dict[str, Bone]) -> dict[str, str]:
    above: dict[str, str] = {}
    for parent, *children in lines:
        if parent.lower() in ("begin", "end"):
            continue
        for child in children:
            if parent not in bones or child not in bones or child == "root" or child in above:
                raise BadInput(f"its hierarchy puts {child} under {parent}, which cannot be")
            above[child] = parent
    return above


def _triple(words: list[str]) -> tuple[float, float, float]:
    x, y, z = (float(word) for word in words[:3])
    if not math.isfinite(x + y + z):
        raise BadInput(f"{' '.join(words)} are not three numbers")
    return x, y, z


def _order(letters: str) -> str:
    if sorted(letters.lower()) != ["x", "y", "z"]:
        raise BadInput(f"an axis order is made of X, Y and Z, not {letters!r}")
    return letters.lower()


def _find_asf(amc: Path) -> Path:
    """The ASF beside an AMC: of the longest name that the AMC's begins with, or the only one in the folder."""
    there = sorted(p for p in amc.parent.iterdir() if p.suffix.lower() == ".asf")
    named = [p for p in there if amc.stem.lower().startswith(p.stem.lower())]
    if named:
        return max(named, key=lambda p: len(p.stem))
    if len(there) != 1:
        what = "no .asf" if not there else f"{len(there)} .asf files, none with this name,"
        raise BadInput(f"{amc}: {what} beside it; say which skeleton with asf=")
    return there[0]


def _channels(path: Path, acclaim: Acclaim) -> tuple[int, list[Floats]]:
    """The number of the first frame, and for each bone its channels (frames, dof) as written."""
    text = decoded(path)
    start = re.search(r"^[ \t]*\d+[ \t]*$", text, re.MULTILINE)
    if start is None or "root" not in text:
        raise BadInput(f"{path}: not an AMC: it has no line with a frame's number")
    if re.search(r"^\s*:RADIANS", text[: start.start()], re.MULTILINE | re.IGNORECASE) and acclaim.degrees:
        raise BadInput(f"{path}: its angles are radians, its skeleton's degrees")
    body = text[start.start() :]
    names = NAMES.findall(body)
    frames = names.count(names[0]) if names else 0
    if frames == 0:
        raise BadInput(f"{path}: not an AMC: its first frame names no bone")
    layout = names[: len(names) // frames]
    if len(set(layout)) != len(layout) or names != layout * frames:
        raise BadInput(f"{path}: cut off or damaged: its frames do not all name the same bones, each once")
    known = {bone.name: joint for joint, bone in enumerate(acclaim.bones)}
    unknown = [name for name in layout if name not in known]
    if unknown:
        raise BadInput(f"{path}: bone {unknown[0]} is not in its skeleton; is this its ASF?")
    still = [bone.name for bone in acclaim.bones if bone.dof and bone.name not in layout]
    if still:
        raise BadInput(f"{path}: bone {still[0]} can move in the skeleton and has no angles here; is this its ASF?")
    widths = [len(acclaim.bones[known[name]].dof) for name in layout]
    table = numbers(NAMES.sub("", body), path)
    if table.size != frames * (1 + sum(widths)):
        raise BadInput(
            f"{path}: {table.size} numbers in {frames} frames, where the skeleton has {1 + sum(widths)} a frame: "
            f"cut off, or another skeleton's"
        )
    if len(acclaim.bones) > 4 * sum(widths) + 4 or abs(table[0]) >= 2**53:
        raise BadInput(f"{path}: {len(acclaim.bones)} bones with {sum(widths)} channels are not a body")
    table = table.reshape(frames, -1)
    values: list[Floats] = [np.empty((frames, 0)) for _ in acclaim.bones]
    at = 1
    for name, width in zip(layout, widths, strict=True):
        values[known[name]] = table[:, at : at + width]
        at += width
    return int(table[0, 0]), values


NAMES = re.compile(r"^[ \t]*([A-Za-z_]\S*)", re.MULTILINE)


def _own_turn(bone: Bone, channels: Floats, acclaim: Acclaim) -> Floats:
    """C · M · C⁻¹ (frames, 4). The first letter of an order is the first turn: it stands rightmost in the product."""
    angles = np.zeros((len(channels), 3))
    for channel, name in enumerate(bone.dof):
        if name[0] == "r":
            angles[:, bone.order[::-1].index(name[1])] = channels[:, channel]
    frame = _axis_frame(bone, acclaim)
    turn = rigid.from_euler(bone.order[::-1], acclaim.radians(angles))
    return rigid.multiply(rigid.multiply(frame, turn), rigid.inverse(frame))


def _axis_frame(bone: Bone, acclaim: Acclaim) -> Floats:
    """C: the angles of an axis are by letter, x y z, whatever the order of the turns."""
    by_turn = np.array([bone.axis["xyz".index(letter)] for letter in bone.order[::-1]])
    return rigid.from_euler(bone.order[::-1], acclaim.radians(by_turn))


def write(path: str | Path, motion: Motion, asf: str | Path | None = None) -> None:
    """Write an AMC, angles as its ASF counts them.

    asf: the skeleton to write for, by default the one that `read` would find beside the AMC; where there is none a new
    one is written beside it, with every bone free about x, y and z. Angles run on from frame to frame, as CMU's do,
    and begin within ±180° (the middle one ±90°). Raises BadInput for a motion that did not come from an AMC, one
    without rotations, or another skeleton's.
    """
    path = Path(path)
    skeleton, rotations = motion.skeleton, motion.rotations
    if skeleton is None or rotations is None:
        raise BadInput(
            f"{path}: an AMC needs a skeleton and rotations, which this motion does not have; "
            "a .mocz does not store rotations yet: write a .c3d, .trc or .npz"
        )
    if motion.source.get("format") != "amc" or skeleton.names[0] != "root":
        raise BadInput(f"{path}: only what was read from an .amc can be written as one; write a .bvh")
    if motion.gaps.any():
        raise BadInput(f"{path}: an AMC cannot hold gaps")
    if asf is None:
        try:
            asf = _find_asf(path)
        except BadInput:
            asf = path.with_suffix(".asf")
            replace_whole(asf, _asf_text(skeleton, unit_of(motion.source)).encode("utf-8"))
    acclaim = read_asf(asf)
    its = acclaim.skeleton
    if its.names != skeleton.names or not np.allclose(its.offsets, skeleton.offsets, atol=1e-6):
        raise BadInput(f"{path}: {asf} is another skeleton than this motion's; name the right one with asf=")
    moved = motion.positions[:, 0] - skeleton.offsets[0]
    columns = [_angles(bone, rotations[:, j], moved, acclaim) for j, bone in enumerate(acclaim.bones)]
    lines = [":FULLY-SPECIFIED", ":DEGREES" if acclaim.degrees else ":RADIANS"]
    first = first_frame(motion.source)
    form = "\n".join(f"{b.name}{' %.8g' * len(b.dof)}" for b in acclaim.bones if b.dof)
    for frame, row in enumerate(np.concatenate(columns, axis=1).tolist()):
        lines += [str(first + frame), form % tuple(row)]
    replace_whole(path, ("\n".join(lines) + "\n").encode("utf-8"))


def _angles(bone: Bone, own_turn: Floats, moved: Floats, acclaim: Acclaim) -> Floats:
    """The channels (frames, dof) of a bone: the inverse of `_own_turn`. Raises BadInput if its dof do not suffice."""
    frame = _axis_frame(bone, acclaim)
    turn = rigid.multiply(rigid.multiply(rigid.inverse(frame), own_turn), frame)
    order = "".join(axis for axis in bone.order[::-1] if f"r{axis}" in bone.dof)
    try:
        angles = rigid.to_euler_along_time(order, turn)
    except BadInput as error:
        raise BadInput(f"bone {bone.name} cannot turn so in this skeleton: {error}") from None
    values = np.degrees(angles) if acclaim.degrees else angles
    columns = [
        moved[:, "xyz".index(dof[1])] / acclaim.unit_m if dof[0] == "t" else values[:, order.index(dof[1])]
        for dof in bone.dof
    ]
    return np.stack(columns, axis=1) if columns else np.empty((len(own_turn), 0))


def _limits_text(limits: Limits | None, joint: int) -> list[str]:
    """The lines that say how a bone turns. A way in which it does not is one with limits 0 and 0."""
    if limits is None:
        return ["     axis 0 0 0 XYZ", "    dof rx ry rz"]
    order = limits.orders[joint]
    by_turn = np.degrees(rigid.to_euler(order, limits.axes[joint]))
    x, y, z = (by_turn[order.index(letter)] for letter in "xyz")
    lines = [f"     axis {x:.10g} {y:.10g} {z:.10g} {order[::-1].upper()}", "    dof rx ry rz"]
    ranges = np.degrees(limits.ranges[joint][[order.index(letter) for letter in "xyz"]])
    pairs = [f"({low:.10g} {high:.10g})" for low, high in ranges.tolist()] if np.isfinite(ranges).any() else []
    return lines + [f"    {'limits' if i == 0 else '      '} {pair}" for i, pair in enumerate(pairs)]


def _asf_text(skeleton: Skeleton, unit_m: float) -> str:
    """A skeleton file whose bones turn about x, y and z, of their axis frames where there are limits."""
    length = 0.0254 / unit_m
    x, y, z = (skeleton.offsets[0] / unit_m).tolist()
    lines = [":version 1.10", ":name mocodec", ":units", "  mass 1.0", f"  length {length:.10g}", "  angle deg"]
    lines += [":root", "   order TX TY TZ RX RY RZ", "   axis XYZ"]
    lines += [f"   position {x:.10g} {y:.10g} {z:.10g}", "   orientation 0 0 0"]
    lines.append(":bonedata")
    for number, (name, offset) in enumerate(zip(skeleton.names[1:], skeleton.offsets[1:] / unit_m, strict=True), 1):
        size = float(np.linalg.norm(offset))
        x, y, z = (offset / size).tolist() if size else (0.0, 1.0, 0.0)
        lines += ["  begin", f"     id {number}", f"     name {name}", f"     direction {x:.10g} {y:.10g} {z:.10g}"]
        lines += [f"     length {size:.10g}", *_limits_text(skeleton.limits, number), "  end"]
    lines += [":hierarchy", "  begin"]
    for parent, name in enumerate(skeleton.names):
        children = [skeleton.names[j] for j, p in enumerate(skeleton.parents) if p == parent]
        if children:
            lines.append(f"    {name} {' '.join(children)}")
    return "\n".join([*lines, "  end", ""])
