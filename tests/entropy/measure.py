"""Size and speed of the coder: python tests/entropy/measure.py [FOLDER OF RECORDINGS] writes docs/results/entropy.json.

Arrays of the kinds that codecs make, from the recordings of the folder (any suffix that mocodec reads) and from a
walking figure: DCT coefficients of a clip of 280 frames after PCA, key frames and their differences, all coordinates of
120 frames; and noise of known entropy. Times are the processor's, the least of the runs, because others use it too.
"""

from __future__ import annotations

import json
import lzma
import platform
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.fft import dct

import mocodec
from mocodec.entropy import coder
from mocodec.testing import synthetic

RESULT = Path(__file__).parents[2] / "docs" / "results" / "entropy.json"


def arrays(positions: np.ndarray) -> dict[str, np.ndarray]:
    """Integers of the kinds that codecs make, at two steps each."""
    rows = positions.reshape(len(positions), -1)
    rows = rows[:, ~np.isnan(rows).any(axis=0)]
    rows = rows - rows.mean(axis=0)
    components = rows @ np.linalg.eigh(rows.T @ rows)[1][:, ::-1]
    clip = components[: min(280, len(rows))]
    spectrum = np.asarray(dct(clip, axis=0, norm="ortho"))
    made = {f"coefficients {step}": np.rint(spectrum / step).astype(np.int64) for step in (0.005, 0.03)}
    keys = np.rint(components[::10, :12] / 0.005).astype(np.int64)
    made["120 frames in tenths of a millimetre"] = np.rint(rows[:120, :93] / 1e-4).astype(np.int64)
    return {**made, "key frames": keys, "their differences": np.diff(keys, axis=0)}


def measure(values: np.ndarray, runs: int = 9) -> dict[str, Any]:
    data = coder.pack(values)
    packing, unpacking = [], []
    for _ in range(runs):
        begin = time.process_time()
        data = coder.pack(values)
        middle = time.process_time()
        assert np.array_equal(coder.unpack(data, values.shape), values)
        packing.append(middle - begin)
        unpacking.append(time.process_time() - middle)
    filters = [{"id": lzma.FILTER_LZMA2, "preset": 9}]
    small = min(
        (t for t in (np.int8, np.int16, np.int32, np.int64) if np.array_equal(values.astype(t), values)),
        key=lambda t: np.dtype(t).itemsize,
    )
    return {
        "shape": list(values.shape),
        "bytes": len(data),
        "lzma_bytes": min(
            len(lzma.compress(v.astype(small).tobytes(), lzma.FORMAT_RAW, filters=filters)) for v in (values, values.T)
        ),
        "pack_ms": round(1e3 * min(packing), 3),
        "unpack_ms": round(1e3 * min(unpacking), 3),
        "pack_msym_s": round(values.size / min(packing) / 1e6, 2),
        "unpack_msym_s": round(values.size / min(unpacking) / 1e6, 2),
    }


def noise(shape: tuple[int, int], scale: float) -> tuple[np.ndarray, float]:
    """Rounded Laplace noise, and the bytes of its entropy."""
    values = np.rint(np.random.default_rng(0).laplace(size=shape) * scale).astype(np.int64)
    tail = np.exp(-(np.arange(60 * int(scale + 2)) + 0.5) / scale)
    p = np.concatenate([[1 - tail[0]], np.repeat((tail[:-1] - tail[1:]) / 2, 2)])
    p = p[p > 0]
    return values, -float((p * np.log2(p)).sum()) * values.size / 8


def main(folder: Path | None) -> None:
    results: dict[str, Any] = {}
    recordings = {"synthetic walk": synthetic.markers(1200, seed=1).positions}
    for path in sorted(folder.iterdir()) if folder else []:
        recordings[path.name] = mocodec.read(path).positions
    for name, positions in recordings.items():
        for kind, values in arrays(positions).items():
            results[f"{name}: {kind}"] = measure(values)
    positions = synthetic.markers(9000, seed=3).positions
    results["synthetic walk: tenths of a millimetre"] = measure(np.rint(positions.reshape(9000, -1) / 1e-4).astype(int))
    shapes = {(1, 1): 1, (10, 1): 1, (100, 1): 1, (500, 10): 1, (120, 93): 2, (4500, 93): 0.5, (9000, 300): 1}
    for shape, scale in {**shapes, (20_000, 60): 3000}.items():
        values, entropy = noise(shape, scale)
        results[f"noise {shape[0]} × {shape[1]}, scale {scale}"] = {
            **measure(values),
            "entropy_bytes": round(entropy, 1),
        }
    machine = {"python": platform.python_version(), "numpy": np.__version__, "machine": platform.machine()}
    RESULT.parent.mkdir(parents=True, exist_ok=True)
    RESULT.write_text(
        json.dumps({"version": mocodec.__version__, **machine, "results": results}, indent=1, ensure_ascii=False) + "\n"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
