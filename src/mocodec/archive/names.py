# pyright: strict
"""Subject, trial and labels of a recording, from the words of its name.

"cmu/86/86_02"                 subject 86, trial 2, labels cmu
"sub-07/FastWalk_003"          subject 7, trial 3, labels fast walk
"""

from __future__ import annotations

import re
from dataclasses import dataclass

WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
"""A word of a name: letters of one kind ("FastWalk" has two), or digits."""
SUBJECT = re.compile(r"(?:^|[^a-z])(?:subject|subj|sub|actor|person|s|p)[-_ ]?(\d{1,9})(?![0-9a-z])", re.IGNORECASE)
NUMBERED = re.compile(r"^(\d{1,9})_(\d{1,9})$")
"""Carnegie Mellon's names: subject and trial."""
NO_LABELS = frozenset(
    "subject subj sub actor person s p trial take t c3d trc bvh amc npz npy glb gltf ply pcd mot sto csv mocz "  # noqa: SIM905
    "the of and a data poses stageii files file motion mocap".split()
)
"""Words of names that say nothing about the movement."""


@dataclass(frozen=True)
class Parsed:
    """subject, trial: numbers, or None if the name shows none. labels: words, in lower case, each once."""

    subject: int | None
    trial: int | None
    labels: tuple[str, ...]


def parse(name: str) -> Parsed:
    """What a name with folders ("lab/sub-07/walk_03") says. The last folder or file that shows a subject decides."""
    parts = name.split("/")
    stem = parts[-1]
    subject, trial = None, None
    if both := NUMBERED.match(stem):
        subject, trial = int(both[1]), int(both[2])
    else:
        for part in parts:
            if found := SUBJECT.search(part):
                subject = int(found[1])
        rest = SUBJECT.sub(" ", stem)
        if last := re.search(r"(\d{1,9})\D*$", rest):
            trial = int(last[1])
        if subject is None and len(parts) > 1 and parts[-2].isdecimal() and len(parts[-2]) < 10:
            subject = int(parts[-2])
    words = [word.lower() for part in parts for word in WORD.findall(part) if not word.isdigit()]
    return Parsed(subject, trial, tuple(dict.fromkeys(w for w in words if w not in NO_LABELS and len(w) > 1)))
