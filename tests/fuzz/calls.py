"""One call of each kind, from bytes: what a worker runs. Only MocodecErrors are expected; AssertionErrors are findings.

read     a damaged file, by its reader
decode   a re-signed container: opened, verified, decoded as a whole and in part
code     a strange motion by one codec to one target: the promise is kept, or CannotEncode
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import mocodec as mc
from mocodec import formats, metrics
from mocodec.errors import CannotEncode
from mocodec.motion import Motion

from . import motions

ROUNDING = 1e-12
"""How far a bound may be exceeded, relative to the largest coordinate: rounding of float64 in the measurement."""


def read(name: str, data: bytes, beside: dict[str, bytes]) -> None:
    """Read a file of this name, whose companions lie beside it."""
    with tempfile.TemporaryDirectory() as folder:
        for other, content in beside.items():
            (Path(folder) / other).write_bytes(content)
        path = Path(folder) / name
        path.write_bytes(data)
        if path.suffix == ".asf":
            path = next(Path(folder) / other for other in beside)
        salvage = len(data) % 4 == 0
        recording = mc.read(path, salvage=True) if salvage else mc.read(path)
        formats.notes(recording)
        assert len(repr(recording)) < 10_000


def decode(name: str, data: bytes, beside: dict[str, bytes]) -> None:
    """Open a container, and decode all of it and two of its frames."""
    with mc.open(data, salvage=len(data) % 4 == 0) as file:
        json.dumps(file.info)
        part = file[len(file) // 2 : len(file) // 2 + 2]
        whole = file[:]
        assert len(whole) == len(file)
        if isinstance(whole, Motion) and isinstance(part, Motion):
            assert np.isfinite(whole.positions[~whole.gaps]).all()
            dict(whole.extras)
        file.verify()


def code(name: str, data: bytes, beside: dict[str, bytes]) -> None:
    """Code the motion of a number; the data are the number in decimal."""
    number = int(data or b"0")
    motion = motions.motion(number)
    codec = motions.CODECS[number % len(motions.CODECS)]
    target = motions.target(number, codec, motion)
    try:
        blob = mc.encode(motion, codec=codec, **target)
    except CannotEncode:
        bound = target.get("max_error", 0.0)
        usual = bool(np.nanmax(np.abs(motion.positions)) <= 1e12)
        assert not (codec == "tempo" and usual and bound), "tempo refuses a hard bound on a motion of usual lengths"
        assert codec != "lossless", "lossless refuses a motion"
        raise
    check_promise(motion, blob, codec, target)


def check_promise(motion: Motion, blob: bytes, codec: str, target: dict[str, float]) -> None:
    """Raises AssertionError if what is decoded is not what was promised."""
    decoded = mc.decode(blob, Motion)
    assert decoded.positions.shape == motion.positions.shape, "another shape"
    assert np.array_equal(decoded.gaps, motion.gaps), "other gaps"
    assert (decoded.names, decoded.up) == (motion.names, motion.up), "other names or axes"
    assert np.isclose(decoded.rate, motion.rate, rtol=1e-12), "another rate"
    with np.errstate(all="ignore"):
        errors = metrics.distances(motion.positions, decoded.positions)[~motion.gaps]
        rounding = ROUNDING * float(np.nanmax(np.abs(motion.positions)))
    if codec == "lossless":
        rank = np.abs(motion.positions[~motion.gaps])
        assert (np.abs(motion.positions - decoded.positions)[~motion.gaps] <= 1.2e-7 * rank + 1e-44).all(), (
            "not lossless"
        )
    largest, mean = errors.max(), errors.mean()
    bound = target.get("max_error") or (0.005 if codec == "tempo" and not target else np.inf)
    assert largest <= bound + rounding, f"max error {largest} > {bound}"
    assert mean <= target.get("mean_error", np.inf) + rounding, f"mean error {mean} > {target}"
    assert len(blob) <= target.get("size", np.inf), f"{len(blob)} bytes > {target}"
    assert len(blob) <= motion.raw_bytes / target.get("ratio", 1e-9) + 1, f"{len(blob)} bytes miss {target}"


CALLS: dict[str, Callable[[str, bytes, dict[str, bytes]], None]] = {"read": read, "decode": decode, "code": code}
