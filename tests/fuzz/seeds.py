"""Small valid files of every format, and containers of every codec, to mutate."""

from __future__ import annotations

import io
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

import mocodec as mc
from mocodec import codecs
from mocodec.container import Reader
from mocodec.motion import Motion
from mocodec.testing import edge_cases, synthetic
from tests.formats import samples

SHARED = (samples.SHARED, samples.SHARED.parent / "cases")
LARGEST_SEED = 100_000
"""Bytes of the largest file that is taken from ../shared."""


class Seed(NamedTuple):
    """A file to mutate, and the files that must lie beside it, by name."""

    name: str
    data: bytes
    beside: dict[str, bytes]


@cache
def files() -> tuple[Seed, ...]:
    """Every writer's output, small files in text, and those of ../shared if it is there."""
    walk = synthetic.joints(frames=8, seed=1)
    markers = synthetic.markers(frames=12, seed=2).select(["C7", "LSHO", "RSHO", "LKNE"])
    motions = {"joints": walk, "markers": markers, "capture": samples.capture()}
    seeds: list[Seed] = []
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".c3d", ".trc", ".bvh", ".npz", ".glb", ".sto", ".csv", ".mot"):
            for name, motion in motions.items():
                path = Path(folder) / f"{name}{suffix}"
                try:
                    mc.write(path, motion)
                except mc.MocodecError:
                    continue
                seeds.append(Seed(path.name, path.read_bytes(), {}))
    seeds += [Seed("tiny.bvh", samples.BVH.encode(), {})]
    seeds += [Seed("walk.amc", samples.AMC.encode(), {"tiny.asf": samples.ASF.encode()})]
    seeds += [Seed("tiny.asf", samples.ASF.encode(), {"walk.amc": samples.AMC.encode()})]
    array = io.BytesIO()
    np.save(array, walk.positions)
    seeds += [Seed("joints.npy", array.getvalue(), {}), Seed("cloud.ply", _ply(), {})]
    seeds += [Seed(f"{encoding}.pcd", _pcd(encoding), {}) for encoding in ("ascii", "binary", "binary_compressed")]
    return (*seeds, *_shared())


def _ply() -> bytes:
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 5\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "property uchar red\nproperty uchar green\n"
    row = np.dtype([("p", "<f4", 3), ("c", "u1", 3)])
    return (head + "property uchar blue\nend_header\n").encode() + np.zeros(5, row).tobytes()


def _pcd(encoding: str) -> bytes:
    """Five points, all numbers zero."""
    head = "VERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH 5\nHEIGHT 1\nPOINTS 5\n"
    packed = b"\x00\x00" + b"\xe0\x46\x00"  # LZF: a zero, and 79 from one byte back
    sizes = np.array([len(packed), 80], "<u4").tobytes()
    data = {"ascii": b"0 0 0 0\n" * 5, "binary": bytes(80), "binary_compressed": sizes + packed}
    return f"{head}DATA {encoding}\n".encode() + data[encoding]


def _shared() -> list[Seed]:
    found: list[Seed] = []
    suffixes = {".c3d", ".trc", ".bvh", ".npz", ".npy", ".glb", ".gltf", ".ply", ".pcd"}
    for folder in SHARED:
        for path in sorted(folder.rglob("*")) if folder.is_dir() else ():
            if path.suffix in suffixes and path.stat().st_size <= LARGEST_SEED:
                beside = {p.name: p.read_bytes() for p in path.parent.glob("*.bin")} if path.suffix == ".gltf" else {}
                found.append(Seed(path.name, path.read_bytes(), beside))
    return found


@cache
def containers() -> dict[str, bytes]:
    """A `.mocz` of each codec and each kind of stream, by name."""
    small = synthetic.markers(frames=60, seed=4).select(["C7", "LSHO", "RSHO", "LKNE", "LHEE"])
    joints = replace(synthetic.joints(frames=40, seed=3), rotations=None)
    parked = edge_cases.motion("parked").select(["C7", "RFWT", "LKNE", "LHEE", "LTOE"])
    made = {
        f"tempo-{model}": mc.encode(small, codec="tempo", model=model)
        for model in ("points-stored", "points-prior", "direct", "hou2014")
    }
    made["tempo-joints"] = mc.encode(joints, codec="tempo")
    made["tempo-directions"] = mc.encode(joints, codec="tempo", model="directions-stored")
    slow = Motion(np.repeat(small.positions[:20], 3, axis=0), 90.0)
    made["tempo-repeats"] = mc.encode(slow, codec="tempo", chunk_seconds=0.5)
    for codec in ("tempo", "hou2014", "liu2006", "lossless"):
        made[f"{codec}-parked"] = mc.encode(parked, codec=codec)
        made[codec] = mc.encode(samples.capture(), codec=codec)
    made["lossless-float64"] = mc.encode(small, codec="lossless", float64=True)
    made["hou2014-bounded"] = mc.encode(small, codec="hou2014", max_error=0.002)
    made["liu2006-bounded"] = mc.encode(small, codec="liu2006", max_error=0.002)
    golden = Path(__file__).parents[1] / "golden"
    made |= {f"golden-{path.stem}": path.read_bytes() for path in sorted(golden.glob("*.mocz"))}
    known = {Reader(data).encoded.codec for data in made.values()}
    assert known == set(codecs.CODECS), f"no seed for {set(codecs.CODECS) - known}"
    return made
