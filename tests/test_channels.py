"""Channels of signals by label, from memory and from a file, where a slice reads only what it needs."""

from __future__ import annotations

import io
import pickle

import numpy as np
import pytest

import mocodec as mc
from mocodec.channels import channels
from mocodec.errors import BadInput, Corrupt
from mocodec.motion import Motion, Signal
from mocodec.testing.signals import noise, slow


def recording() -> Motion:
    table = np.rint(slow(40_000, 900)[:, None] + noise(80_000, 4).reshape(-1, 2)).astype(np.int16)
    extras = {
        "analog": Signal(table, 1000.0, ("Fz1", "Fz1"), ("N", "N")),
        "angles": {"knee": Signal(noise(4000, 1).reshape(-1, 1).astype(np.float32), 100.0)},
    }
    return Motion(np.cumsum(np.ones((4000, 1, 3)), 0) / 1000, 100.0, extras=extras)


class Counting(io.BytesIO):
    """A file that counts the bytes that are read."""

    count = 0

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        self.count += len(data)
        return data


def test_by_label_sample_and_second() -> None:
    motion = recording()
    with mc.open(mc.encode(motion)) as f:
        assert list(f.signals) == ["Fz1", "Fz1 (2)", "knee 1"]
        channel, wanted = f.signals["Fz1 (2)"], motion.extras["analog"].values[:, 1]
        assert (len(channel), channel.rate, channel.unit) == (40_000, 1000.0, "N")
        for key in (slice(5000, 5100), slice(-5, None), slice(None, 30, 7), slice(30, 10, -3), slice(9, 9)):
            np.testing.assert_array_equal(channel[key], wanted[key])
        assert channel[-1] == wanted[-1]
        np.testing.assert_array_equal(channel.at(seconds=slice(1.0, 1.01)), wanted[1000:1010])
        np.testing.assert_array_equal(np.asarray(f.signals["knee 1"])[:, None], motion.extras["angles"]["knee"].values)
        with pytest.raises(IndexError):
            channel[40_000]
        with pytest.raises(BadInput):
            channel.at(seconds=slice(-1, 2))
    assert list(channels(motion.extras)) == ["Fz1", "Fz1 (2)", "knee 1"]


def test_a_slice_reads_only_the_chunks_it_needs() -> None:
    blob = mc.encode(recording())
    source = Counting(blob)
    with mc.open(source) as f:
        sizes = f.info["bytes_by_part"]
        assert f.signals["Fz1"].unit == "N"
        before = source.count
        assert len(f.signals["Fz1"][100:200]) == 100
        assert source.count - before < sizes["signals"] / 3
        before = source.count
        part = f[1000:1100].extras["analog"]
        assert part.shape == (1000, 2)
        np.testing.assert_array_equal(part.values, recording().extras["analog"].values[10_000:11_000])
        assert source.count - before < sizes["signals"] / 2


def test_the_head_of_a_signal_counts_as_signal() -> None:
    values = np.random.default_rng(3).normal(size=(3000, 4)).astype(np.float32)
    signal = mc.Signal(values, 1000.0, ("a", "b", "c", "d"), ("N",) * 4)
    positions = np.zeros((100, 1, 3))
    tree = {"note": "x" * 500}
    with mc.open(mc.encode(mc.Motion(positions, 100.0, ("P",), extras={**tree, "analog": signal}))) as f:
        extras = f.info["bytes_by_part"]["extras"]
    with mc.open(mc.encode(mc.Motion(positions, 100.0, ("P",), extras={**tree, "analog": 1}))) as f:
        assert abs(extras - f.info["bytes_by_part"]["extras"]) < 60


def test_damage_to_a_chunk_leaves_the_others() -> None:
    blob = bytearray(mc.encode(recording()))
    with mc.open(bytes(blob)) as f:
        at = f._reader.layout.signals + 50
    blob[at] ^= 1
    with mc.open(bytes(blob)) as f:
        assert f.signals["Fz1"][-1] == recording().extras["analog"].values[-1, 0]
        assert len(f[:]) == 4000
        with pytest.raises(Corrupt, match="samples 0 to"):
            f.signals["Fz1"][0]
        with pytest.raises(Corrupt, match="samples 0 to"):
            f.verify()
    with pytest.raises(Corrupt):
        mc.decode(bytes(blob))


def test_signals_of_a_file_are_signals() -> None:
    with mc.open(mc.encode(recording())) as f:
        whole = f[:]
        stored = whole.extras["analog"]
        assert isinstance(stored, Signal)
        assert "int16" in repr(stored)
        assert pickle.loads(pickle.dumps(stored)).values.tobytes() == recording().extras["analog"].values.tobytes()
        thinned = whole[::10]
        assert thinned.extras["angles"]["knee"].shape == (400, 1)
        assert mc.decode(mc.encode(whole)).extras["analog"].values.tobytes() == stored.values.tobytes()
