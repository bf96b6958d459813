"""Speed on a single thread: codecs, entropy coder, readers, opening. `scripts/bench speed` runs it."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mocodec as mc
from benchmarks.speed.recordings import path_of
from mocodec.entropy import coder

CODECS: dict[str, dict[str, Any]] = {
    "liu2006": {},
    "liu2006 2mm": {"max_error": 0.002},
    "hou2014": {},
    "tempo": {},
    "tempo 2mm": {"max_error": 0.002},
    "lossless": {},
}


def encode(motion: mc.Motion, codec: str) -> bytes:
    return mc.encode(motion, codec=codec.split()[0], **CODECS[codec])


@pytest.mark.parametrize("codec", CODECS)
def test_encode(benchmark: Any, motion: mc.Motion, codec: str) -> None:
    tracemalloc.start()
    encode(motion, codec)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    benchmark.extra_info |= {"frames": len(motion), "peak_memory_over_input": peak / motion.positions.nbytes}
    benchmark.pedantic(encode, (motion, codec), rounds=3)


@pytest.mark.parametrize("codec", CODECS)
def test_decode(benchmark: Any, motion: mc.Motion, codec: str) -> None:
    blob = encode(motion, codec)
    benchmark.extra_info |= {"frames": len(motion), "bytes": len(blob)}
    benchmark(mc.decode, blob)


@pytest.mark.parametrize("times", [1, 4])
@pytest.mark.parametrize("codec", ["liu2006", "hou2014", "tempo"])
def test_encode_longer(benchmark: Any, codec: str, times: int) -> None:
    """Encoding time grows linearly with the number of frames."""
    once = mc.read(path_of("cmu_01_01")).positions
    motion = mc.Motion(np.concatenate([once, once[::-1]] * times), 120)
    benchmark.extra_info["frames"] = len(motion)
    benchmark.pedantic(encode, (motion, codec), rounds=3)


@pytest.mark.parametrize("part", ["one second", "one second of two points", "header and index"])
def test_open(benchmark: Any, motion: mc.Motion, part: str) -> None:
    blob = encode(motion, "tempo")

    def open_and_read() -> None:
        with mc.open(blob) as f:
            if part == "one second":
                f[1200:1320]
            elif part == "one second of two points":
                f[1200:1320, list(motion.names[:2])]

    benchmark(open_and_read)


@pytest.mark.parametrize("steps", [120, 100_000])
@pytest.mark.parametrize("direction", ["pack", "unpack"])
def test_entropy(benchmark: Any, direction: str, steps: int) -> None:
    values = np.random.default_rng(0).laplace(scale=np.linspace(0.3, 20, 32), size=(steps, 32)).round().astype(np.int64)
    packed = coder.pack(values)
    benchmark.extra_info |= {"symbols": values.size, "bits_per_symbol": 8 * len(packed) / values.size}
    if direction == "pack":
        benchmark.pedantic(coder.pack, (values,), rounds=5)
    else:
        benchmark.pedantic(coder.unpack, (packed, values.shape), rounds=5)


@pytest.mark.parametrize("suffix", [".c3d", ".trc", ".npz"])
def test_read(benchmark: Any, motion: mc.Motion, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"recording{suffix}"
    mc.write(path, mc.Motion(motion.positions, motion.rate, motion.names))
    benchmark.extra_info["frames"] = len(motion)
    benchmark.pedantic(mc.read, (path,), rounds=3)


@pytest.mark.parametrize("name", ["85_12", "01_02", "131_03"])
def test_read_as_published(benchmark: Any, name: str) -> None:
    path = path_of(name)
    benchmark.extra_info["frames"] = len(mc.read(path))
    benchmark.pedantic(mc.read, (path,), rounds=3)


@pytest.mark.parametrize("command", ["-c import mocodec", "-m mocodec --help"])
def test_start(benchmark: Any, command: str) -> None:
    flag, _, rest = command.partition(" ")
    arguments = [rest] if flag == "-c" else rest.split()
    benchmark.pedantic(subprocess.run, ([sys.executable, flag, *arguments],), {"capture_output": True}, rounds=7)
