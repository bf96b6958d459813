"""The recording inside the package: small, real, undamaged, with its acknowledgement beside it."""

from __future__ import annotations

import mocodec as mc
from mocodec import data

from .conftest import Command


def test_it_is_as_documented(command: Command) -> None:
    assert data.RECORDING.stat().st_size < 60_000
    assert command("verify", data.RECORDING).code == 0
    with mc.open(data.RECORDING) as f:
        assert f.shape == (2752, 38, 3)
        assert f.rate == 120
        assert {"Hips", "LeftFoot", "Head"} <= set(f.names)
        assert f[:1].skeleton is not None
    beside = (data.RECORDING.parent / "README.md").read_text()
    assert " ".join(beside.split()).count(data.ACKNOWLEDGEMENT) == 1
