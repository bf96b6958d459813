"""`python bare.py METRES FILE…`: bytes of each recording without extras as JSON, with the mocodec on the path."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import mocodec

bound_m, *paths = sys.argv[1:]
motions = {path: mocodec.read(path) for path in paths}
sizes = {
    path: {"points": motion.points, "bytes": len(mocodec.encode(replace(motion, extras={}), max_error=float(bound_m)))}
    for path, motion in motions.items()
    if isinstance(motion, mocodec.Motion)
}
json.dump(sizes, sys.stdout)
