"""Golden files: what each codec wrote at some version, and what must come out of it for ever.

    python tests/golden/write.py              write those that are missing
    python tests/golden/write.py NAME …       write these afresh, only where the version in the twin is this package's

`NAME.mocz` is the file, `NAME.json` its readable twin: version, codec, settings, and all positions in metres, of point
clouds to a micrometre and with colours. A file of an earlier version is never written again: it is what must decode for
ever. lien2006-lines is of a form that is no longer written; tempo-own-limbs would now be matched to the prior's limbs.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import mocodec
from mocodec.codecs.tempo import prior
from mocodec.motion import Motion, Skeleton
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences, synthetic

HERE = Path(__file__).parent

MARKERS = ["C7", "LSHO", "RSHO", "LFWT", "RFWT", "LKNE", "LHEE", "RTOE"]


def markers() -> Motion:
    """96 frames of eight markers, two of them with gaps."""
    motion = synthetic.markers(frames=96, seed=11).select(MARKERS)
    positions = motion.positions.copy()
    positions[20:31, 5] = positions[90:, 6] = np.nan
    return Motion(positions, motion.rate, motion.names, motion.up, source={"format": "c3d", "unit_m": 0.001})


def joints() -> Motion:
    """80 frames of a skeleton."""
    motion = synthetic.joints(frames=80, rate=60.0, seed=12)
    return Motion(motion.positions, motion.rate, motion.names, motion.up, motion.skeleton)


def limbs() -> Motion:
    """240 frames of a body of the prior's, whose bones do not stretch, with its skeleton."""
    known = prior.of_limbs()
    assert known is not None
    points = known.sets[0]
    assert points.limbs is not None
    rng = np.random.default_rng(13)
    t = np.arange(240)[:, None, None] / 120
    size = (points.limbs.dimensions, 3)
    turns = (rng.normal(0, 0.15, size) * np.sin(2 * np.pi * rng.uniform(0.1, 2.0, size) * t)).sum(axis=2)
    skeleton = Skeleton(points.names, points.limbs.parents, points.limbs.vectors)
    return Motion(points.limbs.inverse(turns) + np.array([0.0, 1.0, 0.0]), 120.0, points.names, "y", skeleton)


def own_limbs() -> Motion:
    """The same body, under names that no prior knows, and without its skeleton."""
    motion = limbs()
    return Motion(motion.positions, motion.rate, (), motion.up)


def matched_limbs() -> Motion:
    """72 frames of the same body, without fingers, thumbs and toes."""
    motion = own_limbs()[:72]
    gone = [i for i, name in enumerate(limbs().names) if name[1:] in ("fingers", "thumb", "toes")]
    return Motion(np.delete(motion.positions, gone, axis=1), motion.rate, (), motion.up)


def on_bones() -> Motion:
    """72 frames of a whole body's markers, too few for a basis of their own."""
    return synthetic.markers(frames=72, seed=14)


def held() -> Motion:
    """96 frames of the body with its skeleton, each sample held for two."""
    motion = limbs()[:96]
    return replace(motion, positions=motion.positions[np.arange(96) // 2 * 2])


def jumper() -> PointClouds:
    """Three frames of 240 points of a jumping body; the middle one has only four."""
    clouds = sequences.record(PERFORMANCE, 240, seed=14)
    assert clouds.colours is not None
    few = [slice(4) if frame == 1 else slice(None) for frame in range(3)]
    positions = [points[some] for points, some in zip(clouds.positions, few, strict=True)]
    return PointClouds(positions, 15.0, [c[some] for c, some in zip(clouds.colours, few, strict=True)])


PERFORMANCE = sequences.jumping_jacks(actors.capsules(), 3)
SKELETON = {"skeleton": PERFORMANCE.skeleton()}

RECIPES: dict[str, tuple[Callable[[], Motion | PointClouds], str, dict[str, Any]]] = {
    "lossless-markers": (markers, "lossless", {}),
    "liu2006-markers": (markers, "liu2006", {}),
    "liu2006-markers-bounded": (markers, "liu2006", {"max_error": 0.002}),
    "hou2014-markers": (markers, "hou2014", {}),
    "hou2014-joints": (joints, "hou2014", {}),
    "hou2014-markers-bounded": (markers, "hou2014", {"max_error": 0.002}),
    "tempo-markers": (markers, "tempo", {"max_error": 0.005}),
    "tempo-joints": (joints, "tempo", {"max_error": 0.005}),
    "tempo-limbs": (limbs, "tempo", {"max_error": 0.005}),
    "tempo-own-limbs": (own_limbs, "tempo", {"max_error": 0.005}),
    "tempo-matched-limbs": (matched_limbs, "tempo", {"max_error": 0.005}),
    "tempo-on-bones": (on_bones, "tempo", {"max_error": 0.01}),
    "tempo-held": (held, "tempo", {"max_error": 0.005}),
    "lien2006-jumper": (jumper, "lien2006", {"residual": 50, **SKELETON}),
    "bodycast-jumper": (jumper, "bodycast", {"residual": 50, **SKELETON}),
}


def write(name: str, folder: Path = HERE) -> None:
    """Write a golden file and its twin. Raises SystemExit where an earlier version's would be lost."""
    twin = folder / f"{name}.json"
    if twin.exists() and (version := json.loads(twin.read_text())["version"]) != mocodec.__version__:
        raise SystemExit(
            f"{name} was written by mocodec {version}, this is {mocodec.__version__}: add a new one beside it"
        )
    recipe, codec, settings = RECIPES[name]
    blob = mocodec.encode(recipe(), codec=codec, **settings)
    (folder / f"{name}.mocz").write_bytes(blob)
    decoded = mocodec.decode(blob)
    about = {
        "version": mocodec.__version__,
        "codec": codec,
        "settings": {key: value for key, value in settings.items() if key != "skeleton"},
        "recipe": recipe.__name__,
        "bytes": len(blob),
        "sha256": hashlib.sha256(blob).hexdigest(),
        "rate": decoded.rate,
        "up": decoded.up,
    }
    if isinstance(decoded, Motion):
        about["names"] = decoded.names
        digits, frames = 10, {"positions": decoded.positions}
    else:
        digits, frames = 6, {"positions": decoded.positions, "colours": decoded.colours or []}
    text = json.dumps(about, indent=2)[:-2]
    for key, values in frames.items():
        lines = [
            json.dumps([None if np.isnan(p[0]) else [round(c, digits) for c in p] for p in f.tolist()]) for f in values
        ]
        text += f',\n  "{key}": [\n    ' + ",\n    ".join(lines) + "\n  ]"
    twin.write_text(text + "\n}\n")


if __name__ == "__main__":
    for chosen in sys.argv[1:] or [name for name in RECIPES if not (HERE / f"{name}.mocz").exists()]:
        write(chosen)
        print(chosen)
