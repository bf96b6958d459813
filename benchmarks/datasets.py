"""Recordings for measurements, by name of a data set or by folder; a hash of the content identifies each.

    package      the recording inside the package
    synthetic    motion from `mocodec.testing.synthetic`, always the same
    shared       a sample of each kind of the development recordings in `../shared/data`
    shared-all   all development recordings
    FOLDER       every file below it that mocodec reads as motion

An unreadable file stays in the list, with the reason.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mocodec import api, data, formats
from mocodec.errors import BadInput, MocodecError
from mocodec.motion import Motion
from mocodec.stages import gaps
from mocodec.testing.synthetic import markers
from mocodec.typing import Floats

SHARED = Path("../shared/data")

SAMPLE = (
    "cmu/c3d/85_12.c3d", "cmu/c3d/85_02.c3d",
    "cmu/asfamc/01/01_01.amc", "cmu/asfamc/01/01_06.amc", "cmu/asfamc/02/02_05.amc", "cmu/asfamc/02/02_10.amc",
    "cmu/asfamc/03/03_02.amc", "cmu/asfamc/03/03_04.amc", "cmu/asfamc/16/16_03.amc",
    "cmu/asfamc/49/49_18.amc", "cmu/asfamc/49/49_20.amc", "cmu/asfamc/64/64_03.amc", "cmu/asfamc/118/118_10.amc",
    "cmu/asfamc/118/118_20.amc", "cmu/asfamc/131/131_04.amc", "cmu/bvh/131_03.bvh", "cmu/bvh/salsa_09.bvh",
    "field-c3d/Movement_trial.c3d", "field-c3d/Qualisys.c3d", "field-c3d/Vicon.c3d", "field-trc/Gait.trc",
)  # fmt: skip
QUICK = (
    "cmu/c3d/85_02.c3d", "cmu/asfamc/01/01_01.amc", "cmu/asfamc/16/16_03.amc", "cmu/asfamc/118/118_20.amc",
    "field-trc/Gait.trc",
)  # fmt: skip


@dataclass(frozen=True)
class Recording:
    """One recording: label in tables, file (None: synthetic or inside the package), group within a data set."""

    label: str
    path: Path | None = None
    group: str = ""

    def load(self) -> Motion:
        """The motion. Raises MocodecError if the file is unreadable or has point clouds."""
        if self.path is None:
            return synthetic_walk() if self.group == "synthetic" else packaged()
        motion = api.read(self.path)
        if not isinstance(motion, Motion):
            raise BadInput(f"{self.path} holds point clouds, not motion")
        return motion


def synthetic_walk() -> Motion:
    """1,200 frames of a walking figure with 41 markers, always the same."""
    return markers(frames=1200, seed=1)


def packaged() -> Motion:
    """The recording inside the package."""
    return api.decode(data.RECORDING, Motion)


def content_hash(motion: Motion) -> str:
    """Sixteen hex digits of a hash of positions, rate and names."""
    digest = hashlib.sha256(np.ascontiguousarray(motion.positions).tobytes())
    digest.update(repr((motion.positions.shape, motion.rate, motion.names)).encode())
    return digest.hexdigest()[:16]


def recordings(name: str | Path, quick: bool = False) -> list[Recording]:
    """The recordings of a data set, a folder or a file. quick: fewer. Raises BadInput if there are none."""
    if name == "package":
        return [Recording("package: CMU 01_01", group="package")]
    if name == "synthetic":
        return [Recording("synthetic walk", group="synthetic")]
    if name in ("shared", "shared-all"):
        if not SHARED.is_dir():
            raise BadInput(
                f"the data set {name!r} needs the folder {SHARED}, which does not exist; name a folder of recordings"
            )
        if name == "shared-all":
            return list(of_folder(SHARED))
        return [labelled(SHARED / path, SHARED) for path in (QUICK if quick else SAMPLE) if (SHARED / path).is_file()]
    path = Path(name)
    if path.is_file():
        return [labelled(path, path.parent)]
    if not path.is_dir():
        raise BadInput(f"no data set named {str(name)!r} (package, synthetic, shared, shared-all) and no such folder")
    found = list(of_folder(path))
    if not found:
        raise BadInput(f"{path} holds no file of a kind that mocodec reads: {', '.join(sorted(formats.FORMATS))}")
    return found[:: max(1, len(found) // 5)][:5] if quick else found


def of_folder(folder: Path) -> Iterator[Recording]:
    """All files in a folder and its subfolders with the suffix of a motion format, sorted by name."""
    motion_suffixes = {s for s in formats.FORMATS if s not in (".asf", ".ply", ".pcd")} | {".mocz"}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix.lower() in motion_suffixes:
            yield labelled(path, folder)


def labelled(path: Path, folder: Path) -> Recording:
    """The recording of a file; its label is the file and, below `folder`, its parent folder."""
    parts = path.relative_to(folder).parts
    return Recording(
        label="/".join(parts[-2:]) if len(parts) > 1 else path.name, path=path, group=path.suffix[1:].lower()
    )


def loaded(recording: Recording) -> tuple[Motion | None, str]:
    """The motion, or None and the reason."""
    try:
        motion = recording.load()
    except MocodecError as problem:
        return None, str(problem)
    if len(motion) == 0 or np.isnan(motion.positions).all():
        return None, "holds no samples"
    return motion, ""


def filled(motion: Motion) -> tuple[Floats, bytes]:
    """Positions with filled gaps, and the deflated gap mask, which a codec without gaps must also store."""
    if not motion.gaps.any():
        return motion.positions, b""
    positions, mask = gaps.fill(motion.positions)
    return positions, zlib.compress(np.packbits(mask).tobytes(), 9)
