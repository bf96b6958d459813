"""Retrieval of labelled CMU clips: is the nearest part of other recordings of the same kind of movement?

The query is the middle 2.4 s of each trial. Labels are those of mocap.cs.cmu.edu for these subjects and trials; trials
of one kind only (dance, run) can be found but are no queries. The reference is the nearest neighbour on raw joints:
the same poses, minus their place only.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mocodec import archive
from mocodec.archive import similarity
from mocodec.motion import Motion
from mocodec.typing import Floats

QUERY_S = 2.4
NEAREST = 5
BY_SUBJECT = {1: "climb", 3: "walk", 10: "kick", 16: "jump", 64: "golf", 118: "jump"}
BY_TRIAL = {"01_01": "jump", "02_01": "walk", "02_02": "walk"}
WITH_OTHER_SUBJECTS = ("jump", "walk")


def label(stem: str, subject: int | None) -> str:
    """The kind of movement; "" if no other trial has it."""
    return BY_TRIAL.get(stem) or BY_SUBJECT.get(subject or 0, "")


def measure(vault: Path) -> list[dict[str, Any]]:
    """Share of queries whose nearest hit, and of hits among the nearest five, that have the query's label."""
    with archive.open_archive(vault) as db:
        rows = list(db.rows())
        labels = {row.name: label(row.stem, row.subject) for row in rows}
        subjects = {row.name: row.subject for row in rows}
        motions = {row.name: db[row.name][:] for row in rows}
        raw = {name: raw_windows(motion) for name, motion in motions.items()}
        found: list[dict[str, Any]] = []
        for others in (False, True):
            scores: dict[str, list[list[bool]]] = {"index": [], "raw joints": []}
            for name, motion in motions.items():
                if not labels[name] or (others and labels[name] not in WITH_OTHER_SUBJECTS):
                    continue
                query = middle(motion)
                allowed = db.query(f"subject != {subjects[name]}") if others else db
                hits = archive.search(allowed, query, 40, leave_out=name)
                names = list(dict.fromkeys(hit.name for hit in hits))[:NEAREST]
                scores["index"].append([labels[hit] == labels[name] for hit in names])
                far = {
                    other: nearest(raw_windows(query), raw[other])
                    for other in motions
                    if other != name and not (others and subjects[other] == subjects[name]) and len(raw[other])
                }
                names = sorted(far, key=lambda other: far[other])[:NEAREST]
                scores["raw joints"].append([labels[hit] == labels[name] for hit in names])
            for method, rights in scores.items():
                found.append(
                    {
                        "method": method,
                        "other_subjects": others,
                        "queries": len(rights),
                        "first": float(np.mean([right[0] for right in rights])),
                        "five": float(np.mean([np.mean(right) for right in rights])),
                    }
                )
    return found


def middle(motion: Motion) -> Motion:
    """The middle QUERY_S of a motion."""
    frames = min(len(motion), round(QUERY_S * motion.rate))
    start = (len(motion) - frames) // 2
    return motion[start : start + frames]


def raw_windows(motion: Motion) -> Floats:
    """Windows (windows, values): eight poses of 1.6 s, minus the place of the first."""
    rate = motion.rate
    count = max(0, int((motion.seconds - similarity.WINDOW_S) / similarity.HOP_S) + 1)
    at = np.arange(count)[:, None] * similarity.HOP_S + np.arange(similarity.POSES) * 0.2 + 0.1
    poses = motion.positions[np.clip(np.rint(at * rate).astype(int), 0, len(motion) - 1)]
    poses = poses - poses.mean(axis=(1, 2), keepdims=True)
    return poses.reshape(count, -1)


def nearest(query: Floats, windows: Floats) -> float:
    """The least mean distance of the query's windows from consecutive windows."""
    usable = len(windows) - len(query) + 1
    if usable < 1 or not len(query):
        return np.inf
    far = [((query - windows[k : k + len(query)]) ** 2).sum(axis=1).mean() for k in range(usable)]
    return float(np.sqrt(min(far)))
