"""Short recordings in archives: split and packed, and joined again to the byte."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mocodec as mc
from mocodec.container import compact
from mocodec.testing import synthetic

GOLDEN = sorted((Path(__file__).parent.parent / "golden").glob("*.mocz"))


@pytest.mark.parametrize("path", GOLDEN, ids=lambda path: path.stem)
def test_golden_files_are_joined_to_the_byte(path: Path) -> None:
    file = path.read_bytes()
    parts = compact.split(file)
    if parts is None:
        assert len(file) > compact.MOST_BYTES
        return
    for block in (parts.head, parts.head[:20] + b"x" + parts.head[20:], b""):
        packed = compact.pack(parts, block, 300)
        assert compact.block_number(packed) == 300
        assert compact.join(block, packed) == file
    assert bool(parts.tail) == (sum(map(len, mc.open(file).encoded.shared)) >= compact.MOST_SHARED_BYTES)
    assert len(compact.pack(parts, parts.head, 0)) < len(file)


def test_extras_and_signals_stay_as_they_are() -> None:
    motion = synthetic.joints(frames=30, rate=60.0)
    signal = mc.Signal(np.arange(60.0).reshape(30, 2), 60.0, ("a", "b"), ("N", "N"))
    file = mc.encode(replace(motion, rotations=None, extras={"analog": signal, "note": "x"}), max_error=0.01)
    parts = compact.split(file)
    assert parts is not None
    assert parts.sections in file
    assert compact.join(parts.head, compact.pack(parts, parts.head, 0)) == file


def test_what_is_not_split() -> None:
    file = mc.encode(synthetic.joints(frames=30, rate=60.0), max_error=0.005)
    assert compact.split(file + b"x") is None
    assert compact.split(file[:-3]) is None
    assert compact.split(b"mocz") is None
    assert compact.split(file + bytes(compact.MOST_BYTES)) is None
    assert compact.block_number(file) is None


def test_every_damage_is_found() -> None:
    file = mc.encode(synthetic.joints(frames=20, rate=60.0), max_error=0.02)
    parts = compact.split(file)
    assert parts is not None
    for block in (parts.head, parts.head[::-1]):
        packed = compact.pack(parts, block, 0)
        for at in range(len(packed)):
            flipped = bytearray(packed)
            flipped[at] ^= 1 << at % 8
            with pytest.raises(mc.Corrupt):
                compact.join(block, bytes(flipped))
            with pytest.raises(mc.Corrupt):
                compact.join(block, packed[:at])
    with pytest.raises(mc.Corrupt):
        compact.join(parts.head[:-1] + b"?", compact.pack(parts, parts.head, 0))
