"""ASF/AMC: the skeleton and the motion of an Acclaim capture, as in Carnegie Mellon's database.

    ASF  bones: direction and length, an axis frame C, degrees of freedom ─┐
    AMC  angles per frame and bone ─► M ─► rotation C · M · C⁻¹ ───────────┴─► forward kinematics ─► ends of bones

Points are the root and the END of every bone, in the order of the ASF (31 in CMU's files), as the literature evaluates
them; `asf.py` reads and writes the skeleton, `asf_memory.py` keeps in `source` what the skeleton does not hold.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import BadInput
from ..geometry import bone_frames, euler_curves, kinematics, rigid
from ..motion import Motion
from ..typing import Floats
from . import replace_whole
from .asf import Acclaim, Bone, asf_text, axis_frame, parse_asf, read_asf
from .asf_memory import acclaim_of, remembered
from .conventions import first_frame, unit_of, unit_option
from .text import numbers, plain, read_text

HOLDS = frozenset({"skeleton", "joint rotations"})
"""What an AMC stores beside the positions."""
CMU_RATE = 120.0
CMU_UNIT_M = 0.0254 / 0.45
SAME_OFFSET_M = 2e-5
"""Offsets within this are the same: a .mocz rounds them to 10 µm."""
MAX_RADIANS = 50.0
"""Angles of continuous rotation, eight turns."""
MAX_OFF_DEGREES = 5.0
"""How far rotations may be on average from those that a bone's degrees of freedom can make: coding errors, not more."""
RATE_WORD = re.compile(r":((SAMPLES|FRAMES)[-_]PER[-_]SECOND|(SAMPLE|FRAME)[-_]?(RATE|TIME)|FPS)")
ROOT_LINE = re.compile(r"^[ \t]*root[ \t]+[-+.\d]", re.MULTILINE)
BONE_NAMES = re.compile(r"^[ \t]*([A-Za-z_]\S*)", re.MULTILINE)


def read(
    path: str | Path,
    asf: str | Path | None = None,
    rate: float | None = None,
    unit: str | float | None = None,
    salvage: bool = False,
) -> Motion:
    """An AMC with its ASF as a motion, metres, y up, with skeleton and rotations.

    asf: the skeleton file; by default the ASF in the same folder whose name the AMC's name begins with, or the only one
    there. rate: hertz, by default that of the header, else 120, CMU's. unit: by default the ASF's.
    salvage: read the complete frames of a truncated file. Raises BadInput.
    """
    path = Path(path)
    return motion_of(read_text(path), path, acclaim_for(path, asf, unit), rate, salvage)


def acclaim_for(path: Path, asf: str | Path | None, unit: str | float | None) -> Acclaim:
    """The skeleton of an AMC; the arguments are those of `read`. Raises BadInput."""
    acclaim = read_asf(find_asf(path) if asf is None else asf)
    return acclaim if unit is None else replace(acclaim, length=0.0254 / unit_option(unit)[1])


def motion_of(text: str, path: Path, acclaim: Acclaim, rate: float | None, salvage: bool = False) -> Motion:
    """As `read`, of the text of an AMC; path: for messages."""
    header = _header(text, path)
    is_degrees = acclaim.degrees if header.is_degrees is None else header.is_degrees
    notes: list[str] = []
    body = plain(text[header.size :])
    body = _salvaged(body, notes) if salvage else body
    numbering, values = _channels(body, path, acclaim)
    _check_numbering(numbering, path, salvage, notes)
    _require_angles(path, acclaim, values, is_degrees)
    frames = len(values[0])
    rotations = np.empty((frames, len(acclaim.bones), 4))
    for joint, (bone, channels) in enumerate(zip(acclaim.bones, values, strict=True)):
        rotations[:, joint] = _rotation(bone, channels, acclaim, is_degrees)
    root = acclaim.bones[0]
    translation = np.zeros((frames, 3))
    for channel, name in enumerate(root.dof):
        if name[0] == "t":
            translation[:, "xyz".index(name[1])] = values[0][:, channel]
    positions = kinematics.forward(acclaim.skeleton, rotations, translation * acclaim.unit_m, own_frame=True)
    source: dict[str, Any] = {
        "format": "amc",
        "units": "ASF",
        "unit_m": acclaim.unit_m,
        "first_frame": int(numbering[0]),
    }
    if rate is not None:
        source["rate_given"] = True
    elif header.rate is not None:
        source |= {"rate_given": True} if header.rate == CMU_RATE else {}
        rate = header.rate
    source |= remembered(acclaim)
    source |= {} if is_degrees == acclaim.degrees else {"amc_angle": "deg" if is_degrees else "rad"}
    source |= {"notes": notes} if notes else {}
    skeleton = acclaim.skeleton
    return Motion(positions, rate or CMU_RATE, skeleton.names, "y", skeleton, rotations, source)


class _Header(NamedTuple):
    """What stands before the first frame. size: its characters; is_degrees, rate: None if it does not say."""

    size: int
    is_degrees: bool | None
    rate: float | None


def _header(text: str, path: Path) -> _Header:
    start = re.search(r"^[ \t]*\d+[ \t]*$", text, re.MULTILINE)
    if start is None or "root" not in text:
        raise BadInput(f"{path}: not an AMC: it has no line with a frame's number")
    head = text[: start.start()]
    if ROOT_LINE.search(head):
        raise BadInput(f"{path}: a frame before frame {start[0].strip():.20} has no whole number above it")
    words = {line.split()[0].upper(): line.split()[1:] for line in head.split("\n") if line.lstrip().startswith(":")}
    is_degrees = True if ":DEGREES" in words else False if ":RADIANS" in words else None
    rate = None
    for word, values in words.items():
        if RATE_WORD.fullmatch(word) and values:
            with suppress(ValueError, ZeroDivisionError):
                rate = float(values[0]) if "TIME" not in word else 1 / float(values[0])
    return _Header(start.start(), is_degrees, rate if rate is not None and 0 < rate < 1e6 else None)


def _require_angles(path: Path, acclaim: Acclaim, values: list[Floats], is_degrees: bool) -> None:
    """Raises BadInput for radians of many turns: those are degrees under the wrong keyword."""
    if is_degrees:
        return
    for bone, channels in zip(acclaim.bones, values, strict=True):
        angles = channels[:, [i for i, name in enumerate(bone.dof) if name[0] == "r"]]
        if angles.size and np.abs(angles).max() > MAX_RADIANS:
            raise BadInput(
                f"{path}: bone {bone.name} has an angle of {np.abs(angles).max():g}, and the file says radians: "
                "write :DEGREES in its header if these are degrees"
            )


def find_asf(amc: Path) -> Path:
    """The ASF in the folder of an AMC: the one with the longest name that the AMC's begins with, or the only one."""
    candidates = sorted(p for p in amc.parent.iterdir() if p.suffix.lower() == ".asf")
    matching = [p for p in candidates if amc.stem.lower().startswith(p.stem.lower())]
    if matching:
        return max(matching, key=lambda p: len(p.stem))
    if len(candidates) != 1:
        found = "no .asf" if not candidates else f"{len(candidates)} .asf files, none with this name,"
        raise BadInput(f"{amc}: {found} beside it; name its skeleton with asf= (--asf)")
    return candidates[0]


def _salvaged(body: str, notes: list[str]) -> str:
    """The frames of an AMC without the last one if the end of the file cuts it off; noted."""
    starts = [match.start() for match in re.finditer(r"^[ \t]*\d+[ \t]*$", body, re.MULTILINE)]
    if len(starts) < 2:
        return body
    shapes = [[len(line.split()) for line in body[a:b].split("\n") if line.strip()]
              for a, b in ((starts[0], starts[1]), (starts[-1], len(body)))]  # fmt: skip
    if shapes[0] == shapes[1] and body[-1].isspace():
        return body
    notes.append(f"cut off: the last frame is left out, {len(starts) - 1} frames are read")
    return body[: starts[-1]]


def _check_numbering(numbering: Floats, path: Path, salvage: bool, notes: list[str]) -> None:
    """Note frame numbers that are not consecutive; missing frames raise BadInput unless they are salvaged.

    Numbers that all step by the same amount are those of a decimated recording.
    """
    steps = np.diff(numbering)
    if (steps == 1).all():
        return
    if not (steps >= 1).all():
        notes.append("the frame numbers do not increase by whole numbers: frames are counted as they stand")
    elif (steps == steps[0]).all():
        notes.append(f"the frame numbers step by {steps[0]:g}: the rate is that of the frames that are there (--rate)")
    else:
        missing, last = int(steps.sum()) - len(steps), int(numbering[np.argmax(steps > 1)])
        if not salvage:
            raise BadInput(
                f"{path}: {missing} frames are missing from its numbering, the first of them after frame {last}; "
                "--salvage (salvage=True) reads the others as consecutive frames"
            )
        notes.append(f"{missing} frames are missing from the numbering: the others are read as consecutive frames")


def _channels(body: str, path: Path, acclaim: Acclaim) -> tuple[Floats, list[Floats]]:
    """The numbers of the frames, and for each bone its channels (frames, dof) in the file's units."""
    names = BONE_NAMES.findall(body)
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
    missing = [bone.name for bone in acclaim.bones if bone.dof and bone.name not in layout]
    if missing:
        raise BadInput(f"{path}: bone {missing[0]} can rotate in the skeleton and has no angles here; is this its ASF?")
    widths = [len(acclaim.bones[known[name]].dof) for name in layout]
    table = numbers(BONE_NAMES.sub("", body), path)
    if table.size != frames * (1 + sum(widths)):
        raise BadInput(
            f"{path}: {table.size} numbers in {frames} frames, where the skeleton has {1 + sum(widths)} a frame: "
            f"cut off, or another skeleton's"
        )
    if len(acclaim.bones) > 4 * sum(widths) + 4 or abs(table[0]) >= 2**53:
        raise BadInput(f"{path}: {len(acclaim.bones)} bones share {sum(widths)} channels, too few for a body")
    table = table.reshape(frames, -1)
    values: list[Floats] = [np.empty((frames, 0)) for _ in acclaim.bones]
    at = 1
    for name, width in zip(layout, widths, strict=True):
        values[known[name]] = table[:, at : at + width]
        at += width
    return table[:, 0], values


def _rotation(bone: Bone, channels: Floats, acclaim: Acclaim, is_degrees: bool) -> Floats:
    """C · M · C⁻¹ (frames, 4). The first letter of an order is the first rotation, the rightmost factor."""
    angles = np.zeros((len(channels), 3))
    for channel, name in enumerate(bone.dof):
        if name[0] == "r":
            angles[:, bone.order[::-1].index(name[1])] = channels[:, channel]
    frame = axis_frame(bone, acclaim)
    m = rigid.from_euler(bone.order[::-1], np.radians(angles) if is_degrees else angles)
    return rigid.multiply(rigid.multiply(frame, m), rigid.inverse(frame))


def write(path: str | Path, motion: Motion, asf: str | Path | None = None, unit: str | float | None = None) -> None:
    """Write an AMC, with angles in the units of its ASF.

    asf: the skeleton file, by default one in the same folder that `read` would find and that has the same bones; if
    there is none, a new one is written beside the AMC: units, axes, limits and degrees of freedom of the source, or
    bones of a skeleton from elsewhere (`geometry.bone_frames.to_ends`), each of which rotates about x, y and z. unit:
    of the lengths of a new ASF, by default the source's, else CMU's. Angles start within ±180° (the middle one ±90°)
    and are continuous over frames, as in CMU's files. Raises BadInput for a motion without a skeleton and rotations,
    with another skeleton than `asf`, and for rotations that its bones' degrees of freedom cannot make.
    """
    path = Path(path)
    own = _own_frames(path, motion)
    unit_m = unit_of(own.source) if "unit_m" in own.source else CMU_UNIT_M
    acclaim = read_asf(asf) if asf is not None else _asf_beside(path, own)
    if unit is not None:
        unit_m = unit_option(unit, {"ASF": CMU_UNIT_M})[1]
        acclaim = acclaim if acclaim is not None and math.isclose(acclaim.unit_m, unit_m) else None
    new_asf = ""
    if acclaim is None:
        asf = path.with_suffix(".asf")
        if asf.exists():
            raise BadInput(f"{path}: {asf} is another skeleton's or in another unit; remove it, or write elsewhere")
        new_asf = asf_text(acclaim_of(own, unit_m))
        acclaim = parse_asf(new_asf, asf)
    elif not _has_bones(acclaim, own):
        raise BadInput(f"{path}: {asf} differs from this motion's skeleton; name the right one with asf= (--asf)")
    is_degrees = {"deg": True, "rad": False}.get(str(own.source.get("amc_angle")), acclaim.degrees)
    lines = [":FULLY-SPECIFIED", ":DEGREES" if is_degrees else ":RADIANS"]
    if own.rate != CMU_RATE or own.source.get("rate_given"):
        lines.append(f":SAMPLES-PER-SECOND {own.rate:.10g}")
    lines += _frame_lines(path, own, acclaim, is_degrees)
    if new_asf:
        replace_whole(path.with_suffix(".asf"), new_asf.encode("utf-8"))
    try:
        replace_whole(path, ("\n".join(lines) + "\n").encode("utf-8"))
    except BaseException:
        if new_asf:
            path.with_suffix(".asf").unlink(missing_ok=True)
        raise


def _own_frames(path: Path, motion: Motion) -> Motion:
    """The motion as bones of an ASF, which has words as names. Raises BadInput for what has no such bones."""
    if motion.skeleton is None or motion.rotations is None:
        has = "positions on a skeleton" if motion.skeleton is not None else "positions of points"
        raise BadInput(
            f"{path}: an AMC needs a skeleton and rotations, and this motion has only {has}; "
            "write a .c3d, .trc, .npz or .glb"
        )
    if motion.gaps.any():
        raise BadInput(f"{path}: an AMC cannot hold gaps")
    try:
        own = bone_frames.to_ends(motion)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None
    assert own.skeleton is not None
    if own.skeleton.parents.count(-1) != 1:
        raise BadInput(f"{path}: an ASF has one root, this skeleton has {own.skeleton.parents.count(-1)}")
    names = ["root"]
    for name in own.skeleton.names[1:]:
        word = re.sub(r"[\s#:]+", "_", name)
        word = word if re.match(r"(?!(?:begin|end|root)$)[A-Za-z_]", word) else f"_{word}"
        while word in names:
            word += "_"
        names.append(word)
    return replace(own, names=tuple(names), skeleton=replace(own.skeleton, names=tuple(names)))


def _asf_beside(path: Path, own: Motion) -> Acclaim | None:
    """The ASF in the folder that `read` would find, if it has the bones of this motion."""
    try:
        acclaim = read_asf(find_asf(path))
    except BadInput:
        return None
    return acclaim if _has_bones(acclaim, own) else None


def _has_bones(acclaim: Acclaim, own: Motion) -> bool:
    """Whether an ASF has the bones of a motion, whose offsets a .mocz may have rounded."""
    target, skeleton = acclaim.skeleton, own.skeleton
    assert skeleton is not None
    same_tree = target.names == skeleton.names and target.parents == skeleton.parents
    return same_tree and bool(np.allclose(target.offsets, skeleton.offsets, rtol=0, atol=SAME_OFFSET_M))


def _frame_lines(path: Path, own: Motion, acclaim: Acclaim, is_degrees: bool) -> list[str]:
    """The lines of all frames: a number, then each bone that has degrees of freedom."""
    assert own.rotations is not None
    translation = own.positions[:, 0] - acclaim.skeleton.offsets[0]
    fixed = [axis for axis in "xyz" if f"t{axis}" not in acclaim.bones[0].dof]
    if np.abs(translation[:, ["xyz".index(axis) for axis in fixed]]).max(initial=0.0) > SAME_OFFSET_M:
        raise BadInput(f"{path}: the root moves along {' and '.join(fixed)}, for which its ASF has no channel")
    try:
        columns = [
            _angles(bone, own.rotations[:, j], translation, acclaim, is_degrees) for j, bone in enumerate(acclaim.bones)
        ]
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None
    first = first_frame(own.source)
    form = "\n".join(f"{b.name}{' %.8g' * len(b.dof)}" for b in acclaim.bones if b.dof)
    lines: list[str] = []
    for frame, row in enumerate((np.concatenate(columns, axis=1) + 0.0).tolist()):
        lines += [str(first + frame), form % tuple(row)]
    return lines


def _angles(bone: Bone, rotation: Floats, translation: Floats, acclaim: Acclaim, is_degrees: bool) -> Floats:
    """The channels (frames, dof) of a bone: the inverse of `_rotation`. Raises BadInput if its dof do not suffice."""
    frame = axis_frame(bone, acclaim)
    m = rigid.multiply(rigid.multiply(rigid.inverse(frame), rotation), frame)
    order = "".join(axis for axis in bone.order[::-1] if f"r{axis}" in bone.dof)
    angles = euler_curves.along_time(order, m)
    off = float(np.degrees(euler_curves.distance(order, angles, m).mean())) if len(m) else 0.0
    if off > MAX_OFF_DEGREES:
        raise BadInput(f"bone {bone.name} lacks the degrees of freedom for its rotations, which are {off:.3g}° off")
    values = np.degrees(angles) if is_degrees else angles
    columns = [
        translation[:, "xyz".index(dof[1])] / acclaim.unit_m if dof[0] == "t" else values[:, order.index(dof[1])]
        for dof in bone.dof
    ]
    return np.stack(columns, axis=1) if columns else np.empty((len(rotation), 0))
