"""Size and speed of the coder: python tests/entropy/measure.py [FOLDER OF RECORDINGS] writes docs/results/entropy.json.

Arrays of the kinds that codecs make, from the recordings of the folder (any suffix that mocodec reads) and from a
walking figure: DCT coefficients of a clip of 280 frames after PCA, key frames and their differences; and noise of known
entropy.
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
    spectrum = dct(clip, axis=0, norm="ortho")
    made = {f"coefficients {step}": np.rint(spectrum / step).astype(np.int64) for step in (0.005, 0.03)}
    keys = np.rint(components[::10, :12] / 0.005).astype(np.int64)
    return {**made, "key frames": keys, "their differences": np.diff(keys, axis=0)}


def measure(values: np.ndarray, runs: int = 5) -> dict[str, Any]:
    coder.pack(values)
    packing, unpacking = [], []
    for _ in range(runs):
        begin = time.perf_counter()
        data = coder.pack(values)
        middle = time.perf_counter()
        assert np.array_equal(coder.unpack(data, values.shape), values)
        packing.append(middle - begin)
        unpacking.append(time.perf_counter() - middle)
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
        "pack_ms": round(1e3 * float(np.median(packing)), 3),
        "unpack_ms": round(1e3 * float(np.median(unpacking)), 3),
        "unpack_msym_s": round(values.size / float(np.median(unpacking)) / 1e6, 2),
    }


def noise(shape: tuple[int, int], scale: float) -> tuple[np.ndarray, float]:
    """Rounded Laplace noise, and the bytes of its entropy."""
    values = np.rint(np.random.default_rng(0).laplace(size=shape) * scale).astype(np.int64)
    tail = np.exp(-(np.arange(4000) + 0.5) / scale)
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
    for shape, scale in (((1, 1), 1), ((10, 1), 1), ((100, 1), 1), ((500, 10), 1), ((4500, 93), 0.5), ((9000, 300), 1)):
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
