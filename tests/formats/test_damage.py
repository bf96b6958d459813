"""Every reader with truncated and modified files: BadInput or a motion, nothing else."""

from __future__ import annotations

import random

import pytest

from mocodec import MocodecError, Motion, formats

from .samples import AMC, ASF, BVH, capture, markers


@pytest.fixture(params=["c3d", "trc", "bvh", "amc", "asf", "npz"])
def kind(request):
    return request.param


def original(kind: str, folder) -> bytes:
    if kind in ("bvh", "amc", "asf"):
        return {"bvh": BVH, "amc": AMC, "asf": ASF}[kind].encode()
    formats.write(folder / f"good.{kind}", capture() if kind == "c3d" else markers())
    return (folder / f"good.{kind}").read_bytes()


def reads(kind: str, data: bytes, folder) -> bool:
    (folder / "x.asf").write_bytes(data if kind == "asf" else ASF.encode())
    (folder / "x.amc").write_bytes(data if kind == "amc" else AMC.encode())
    path = folder / ("x.amc" if kind == "asf" else f"x.{kind}")
    if kind not in ("asf", "amc"):
        path.write_bytes(data)
    try:
        motion = formats.read(path)
    except MocodecError as error:
        message = str(error)
    else:
        assert isinstance(motion, Motion)
        return True
    assert "\n" not in message
    return False


def test_cut_anywhere(kind, tmp_path):
    data = original(kind, tmp_path)
    assert reads(kind, data, tmp_path)
    cuts = range(0, len(data), max(1, len(data) // 150))
    assert sum(reads(kind, data[:cut], tmp_path) for cut in cuts) <= len(list(cuts)) // 4


def test_bytes_replaced_anywhere(kind, tmp_path):
    data = original(kind, tmp_path)
    chance = random.Random(7)
    for _ in range(250):
        damaged = bytearray(data)
        for _ in range(chance.choice([1, 1, 3, 12])):
            damaged[chance.randrange(min(len(data), chance.choice([64, 1200, len(data)])))] = chance.choice(
                [chance.randrange(256), 0, 255, ord("9"), ord("-"), ord(" "), ord("\n")]
            )
        reads(kind, bytes(damaged), tmp_path)
