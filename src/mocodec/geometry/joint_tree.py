"""The joint hierarchy of a skeleton for people to read: a tree in text, and the same facts for programs.

    Hips
    ├─ LeftHip 11.0 · LeftKnee 40.5 (x) · LeftAnkle 41.1 · LeftToe 14.2
    └─ Chest 12.1 · Neck 25.3
       └─ …

Joints without brothers stand behind their parent in one line. A number is the length of the bone from the parent,
centimetres; in brackets are the axes about which a joint rotates, where the file says so and they are not all.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..motion import Motion, Skeleton

MAX_LINES = 60
"""Lines of a tree; what lies deeper is counted."""
MAX_CHAIN = 16
"""Joints of a chain that are named: of longer ones the first and the last."""
WIDTH = 100
CHANNEL_RUN = re.compile(r"([XYZxyz]{0,6})(?:\*(\d{1,6}))?")

KNOWN: tuple[tuple[str, int | None, frozenset[str]], ...] = (
    ("SMPL-X", 55, frozenset({"pelvis", "jaw", "left_collar", "left_index1"})),
    ("SMPL+H", 52, frozenset({"pelvis", "left_collar", "left_index1"})),
    ("SMPL", 24, frozenset({"pelvis", "left_collar", "left_hand"})),
    ("SMPL body", 22, frozenset({"pelvis", "left_collar", "right_wrist"})),
    ("CMU ASF", 31, frozenset({"root", "lhipjoint", "lradius"})),
    ("CMU BVH", None, frozenset({"Hips", "LHipJoint", "RHipJoint"})),
    ("Mixamo", None, frozenset({"mixamorig:Hips", "mixamorig:Spine"})),
)
"""Skeletons that many files share: name, number of joints, and joints that only these have."""


class Freedom(NamedTuple):
    """The axes about which a joint rotates ("" if none), and those along which it moves against its parent."""

    rotates: str
    moves: str


def facts(motion: Motion) -> list[dict[str, Any]]:
    """Name, parent (its number, None for a root), length_m of the bone and freedom of every joint.

    rotates, moves: axes, as "xyz"; only where the file says so (the limits of an ASF, the channels of a BVH). An empty
    list without a skeleton.
    """
    skeleton = motion.skeleton
    if skeleton is None:
        return []
    lengths = np.linalg.norm(skeleton.offsets, axis=1).tolist()
    known = freedoms(skeleton, motion.source)
    result: list[dict[str, Any]] = []
    for joint, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents, strict=True)):
        fact = {"name": name, "parent": parent if parent >= 0 else None, "length_m": lengths[joint]}
        freedom = None if known is None else known[joint]
        result.append(fact if freedom is None else {**fact, **freedom._asdict()})
    return result


def known_name(motion: Motion) -> str | None:
    """The name of a common skeleton by its joints; None for others."""
    if motion.skeleton is None:
        return None
    names = set(motion.skeleton.names)
    found = (name for name, count, marks in KNOWN if marks <= names and count in (None, len(motion.skeleton)))
    return next(found, None)


def described(motion: Motion) -> dict[str, Any]:
    """The entries of `info`: `skeleton_name` and `tree`; {} without a skeleton."""
    if motion.skeleton is None:
        return {}
    return {"skeleton_name": known_name(motion), "tree": facts(motion)}


def freedoms(skeleton: Skeleton, source: Any) -> list[Freedom | None] | None:
    """What a file says about the freedom of each joint: None for joints, or files, of which it says nothing."""
    if (limits := skeleton.limits) is not None:
        free = limits.ranges[..., 0] < limits.ranges[..., 1]
        axes = ["".join(sorted(np.array(list(order))[row])) for order, row in zip(limits.orders, free, strict=True)]
        return [
            Freedom(rotates, "") if parent >= 0 else None
            for rotates, parent in zip(axes, skeleton.parents, strict=True)
        ]
    runs = source.get("channels")
    if not isinstance(runs, list | tuple):
        return None
    matches = [CHANNEL_RUN.fullmatch(run) for run in runs if isinstance(run, str)]
    counts = [int(match[2] or 1) for match in matches if match]
    if len(counts) != len(runs) or sum(counts) > len(skeleton):
        return None
    letters = iter([match[1] for match, n in zip(matches, counts, strict=True) if match for _ in range(n)])
    inner = set(skeleton.parents)
    ends = [joint not in inner and sum(counts) < len(skeleton) for joint in range(len(skeleton))]
    if ends.count(False) != sum(counts):
        return None
    channels = [None if end else next(letters) for end in ends]
    return [None if text is None else Freedom(_axes(text, str.islower), _axes(text, str.isupper)) for text in channels]


def _axes(channels: str, wanted: Callable[[str], bool]) -> str:
    return "".join(sorted({letter.lower() for letter in channels if wanted(letter)}))


def lines_of(tree: list[dict[str, Any]], width: int = WIDTH) -> list[str]:
    """The text of the facts of a tree, at most about MAX_LINES lines of `width` characters."""
    children: list[list[int]] = [[] for _ in tree]
    roots: list[int] = []
    for joint, parent in enumerate(parents := [fact["parent"] for fact in tree]):
        (roots if parent is None else children[parent]).append(joint)
    sizes = [1] * len(tree)
    for joint in reversed(range(len(tree))):
        if (parent := parents[joint]) is not None:
            sizes[parent] += sizes[joint]
    shown = _shown(roots, children)
    result: list[str] = []
    pending = _rows(roots, shown, sizes, "", is_top=True)
    while pending:
        row = pending.pop()
        if row.joint is None:
            result.append(f"{row.first}… {row.hidden} joints more")
            continue
        chain = _chain(row.joint, children)
        texts = [_text(tree[joint]) for joint in chain]
        if len(texts) > MAX_CHAIN:
            texts[MAX_CHAIN // 2 : 1 - MAX_CHAIN // 2] = [f"… {len(texts) - MAX_CHAIN + 1} joints …"]
        below = children[chain[-1]]
        result += _wrapped(row.first, row.following + ("│  " if below else "   "), texts, width)
        pending += _rows(below, shown, sizes, row.following)
    return result


class Row(NamedTuple):
    """The chain from `joint`, or the number of joints that are hidden, behind the strokes of its line and of others."""

    joint: int | None
    first: str
    following: str
    hidden: int = 0


def _rows(joints: list[int], shown: set[int], sizes: list[int], indent: str, is_top: bool = False) -> list[Row]:
    """Brothers as rows, the last one first; those that are not shown are one row at the end."""
    drawn: list[int | None] = [joint for joint in joints if joint in shown]
    hidden = sum(sizes[joint] for joint in joints if joint not in shown)
    drawn += [None] if hidden else []
    rows: list[Row] = []
    for place, joint in enumerate(drawn):
        is_last = place == len(drawn) - 1
        first, following = ("", "") if is_top else ("└─ ", "   ") if is_last else ("├─ ", "│  ")
        rows.append(Row(joint, indent + first, indent + following, hidden))
    return rows[::-1]


def _chain(joint: int, children: list[list[int]]) -> list[int]:
    """The joint and those below it up to the next that has no child, or several."""
    chain = [joint]
    while len(children[chain[-1]]) == 1:
        chain += children[chain[-1]]
    return chain


def _shown(roots: list[int], children: list[list[int]]) -> set[int]:
    """The first joints of the chains that have a line: those nearest to the roots."""
    shown = list(roots[:MAX_LINES])
    for first in shown:  # grows while it is walked: breadth first
        room = MAX_LINES - len(shown)
        shown += children[_chain(first, children)[-1]][: max(0, room)]
    return set(shown)


def _text(fact: dict[str, Any]) -> str:
    """A joint with its bone's length and its freedom, where that is not all."""
    name = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in fact["name"])
    if fact["parent"] is None:
        return name
    name += f" {100 * fact['length_m']:.1f}"
    rotates, moves = fact.get("rotates", "xyz"), fact.get("moves", "")
    words = [] if rotates == "xyz" else [rotates or "locked"]
    words += [f"moves {moves}"] if moves else []
    return f"{name} ({', '.join(words)})" if words else name


def _wrapped(first: str, following: str, texts: list[str], width: int) -> list[str]:
    """A chain in lines of at most `width` characters, if its joints are not longer themselves."""
    rows = [first + texts[0]]
    for text in texts[1:]:
        longer = f"{rows[-1]} · {text}"
        if len(longer) <= width:
            rows[-1] = longer
        else:
            rows.append(f"{following}· {text}")
    return rows
