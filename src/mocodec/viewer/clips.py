"""The recordings of an archive, for the list beside the picture: which match, and a pose of each."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np

from .. import api
from ..archive import Archive
from ..geometry import links, views
from ..motion import Motion
from . import film

MOST_LISTED = 500
"""Recordings in one answer; the page says how many more match."""
MOST_POINTS = 200


def found(archive: Archive, text: str, query: str) -> dict[str, Any]:
    """The recordings whose names contain a text and that meet a condition (`Recordings.query`). Raises BadInput."""
    chosen = archive.query(query) if query.strip() else archive
    if text.strip():
        chosen = chosen.query(f"{text.strip()!r} in name")
    rows = [
        {
            "name": row.name,
            "frames": row.frames,
            "seconds": row.seconds,
            "points": row.points,
            "rate": row.rate,
            "ratio": row.ratio,
            "maxError": row.max_error,
        }
        for row in islice(chosen.rows(), MOST_LISTED)
    ]
    sums = chosen.sums()
    return {"total": sums["recordings"], "seconds": sums["seconds"], "bytes": sums["bytes"], "clips": rows}


def pose(opened: api.File[Any]) -> dict[str, Any]:
    """The pose in the middle of a recording as a small drawing: points (x, y) in 0 … 1, y downwards, and links."""
    about = opened.encoded.about
    if not isinstance(about, Motion) or not len(opened) or not about.points:
        return {"points": [], "links": []}
    positions = opened[len(opened) // 2].positions[0][:: max(1, -(-about.points // MOST_POINTS))]
    flat = positions @ views.directions(positions[None], about.up, film.TILT)[:2].T
    present = ~np.isnan(flat[:, 0])
    if not present.any():
        return {"points": [], "links": []}
    low, high = flat[present].min(axis=0), flat[present].max(axis=0)
    extent = max(float((high - low).max()), 1e-6)
    placed = (flat - (low + high) / 2) / extent + 0.5
    joined = links.links(about) if about.skeleton is not None and len(positions) == about.points else []
    return {
        "points": [
            [round(x, 3), round(1 - y, 3)] if here else None for (x, y), here in zip(placed, present, strict=True)
        ],
        "links": [list(pair) for pair in joined],
    }
