"""Laboratory recordings: `scripts/bench lab` (whole files) and `scripts/bench signals` (their signals alone).

    C3D ─► .mocz, markers within 0.2 mm, signals exact | within 12 bits ─► bytes of the file and its parts, seconds
        ─► zip
    signals ─► ours | as arrays | pcodec, level 12, by channel | xz −9, by channel | FLAC −8, 16-bit channels

Tables list rivals that are not installed as missing (pcodec; soundfile for FLAC).
"""

from __future__ import annotations

import io
import lzma
import statistics
import time
import zlib
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

import mocodec
from mocodec.channels import signals
from mocodec.container import arrays
from mocodec.errors import MocodecError
from mocodec.motion import Motion, Signal
from mocodec.signals import codec

from .machine import machine_description
from .markdown import table
from .results import read_json, rounded, write_json

LAB, LAB_TABLE = Path("docs/results/lab.json"), Path("docs/results/lab.md")
LAB_SUMMARY = Path("docs/results/lab_summary.md")
SIGNALS = Path("docs/results/signals.json")
MAX_ERROR_M = 0.0002
FOLDERS = ("field-c3d", "cmu/c3d")
SPEED_SAMPLES = 1 << 20
SPEED_ROUNDS = 3

Array = NDArray[Any]


def recordings(data: Path) -> Iterator[tuple[str, Path, Motion]]:
    """Name, path and motion of every readable C3D file."""
    for folder in FOLDERS:
        for path in sorted((data / folder).glob("*.c3d")):
            try:
                motion = mocodec.read(path, Motion)
            except MocodecError as error:
                click.echo(f"left out: {error}", err=True)
                continue
            yield path.name, path, motion


def encoded(motion: Motion, signal_error: str | None) -> dict[str, Any]:
    """Bytes of the file and its parts, and seconds of encoding and decoding."""
    start = time.perf_counter()
    blob = mocodec.encode(motion, max_error=MAX_ERROR_M if motion.points else None, signal_error=signal_error)
    middle = time.perf_counter()
    mocodec.decode(blob)
    end = time.perf_counter()
    with mocodec.open(blob) as f:
        parts = f.info["bytes_by_part"]
    other = parts["extras"] + parts["signals"]
    return {
        "bytes": len(blob),
        "motion": len(blob) - other,
        "signals": parts["signals"],
        "rest": parts["extras"],
        "encode_s": middle - start,
        "decode_s": end - middle,
    }


def measure_lab(data: Path) -> dict[str, Any]:
    rows: dict[str, Any] = {}
    for name, path, motion in recordings(data):
        raw = path.read_bytes()
        row: dict[str, Any] = {
            "bytes": len(raw),
            "frames": len(motion),
            "points": motion.points,
            "zip": len(zlib.compress(raw, 6)),
        }
        try:
            row |= {"exact": encoded(motion, None), "12bit": encoded(motion, "12bit")}
        except MocodecError as error:
            row["error"] = str(error)
        rows[name] = row
        click.echo(f"{name}: {row}", err=True)
    ratios = [row["bytes"] / row["12bit"]["bytes"] for row in rows.values() if "12bit" in row]
    return {"machine": machine_description(), "max_error_m": MAX_ERROR_M, "files": rows,
            "median_ratio_12bit": statistics.median(ratios)}  # fmt: skip


def lab_table(result: dict[str, Any]) -> str:
    rows = []
    for name, row in result["files"].items():
        if "exact" not in row:
            continue
        exact, bounded = row["exact"], row["12bit"]
        cells = [name, f"{row['bytes']:,}", f"{row['zip']:,}"]
        for part in (exact, bounded):
            cells.append(f"{part['bytes']:,} ({row['bytes'] / part['bytes']:.1f} : 1)")
        cells += [f"{exact['motion']:,} + {exact['signals']:,} + {exact['rest']:,}"]
        rows.append([*cells, f"{exact['encode_s']:.1f}", f"{exact['decode_s']:.2f}"])
    head = ["file", "C3D", "zip", ".mocz, signals exact", ".mocz, signals within 12 bits",
            "motion + signals + rest (exact)", "s to encode", "to decode"]  # fmt: skip
    return table(head, rows) + "\n"


def lab_summary(result: dict[str, Any]) -> str:
    """The table of the README: whole files, in kilobytes, and their median ratio."""
    rows = []
    for name, row in result["files"].items():
        if "exact" in row:
            sizes = (row["bytes"], row["zip"], row["exact"]["bytes"], row["12bit"]["bytes"])
            rows.append([name, *(f"{size / 1000:,.0f}" for size in sizes), f"{row['exact']['encode_s']:.1f}"])
    head = ["file", "C3D, kB", "zip", ".mocz, signals exact", ".mocz, signals within 12 bits", "s to encode"]
    count, ratio = len(rows), result["median_ratio_12bit"]
    return f"{table(head, rows)}\n\n*Median of {count} files with signals within 12 bits: {ratio:.1f} : 1.*\n"


@click.command("lab")
@click.option("--data", type=click.Path(path_type=Path), default=Path("../shared/data"), show_default=True)
def command(data: Path) -> None:
    """Whole C3D files with markers within 0.2 mm: docs/results/lab.json, lab.md and lab_summary.md."""
    write_json(LAB, rounded(measure_lab(data)))
    LAB_TABLE.write_text(lab_table(read_json(LAB)))
    LAB_SUMMARY.write_text(lab_summary(read_json(LAB)))


# --- signals alone


def as_channels(values: Array) -> list[Array]:
    """The channels, each (samples,)."""
    return [np.ascontiguousarray(column) for column in values.reshape(len(values), -1).T]


def pcodec(values: Array) -> int | None:
    try:
        standalone, config = import_module("pcodec.standalone"), import_module("pcodec").ChunkConfig
    except ImportError:
        return None
    level = config(compression_level=12)
    return sum(len(standalone.simple_compress(channel, level)) for channel in as_channels(values))


def xz(values: Array) -> int:
    """xz bytes of the samples: interleaved or channel by channel, whichever is shorter."""
    return min(len(lzma.compress(part.tobytes(), preset=9)) for part in (values, np.stack(as_channels(values))))


def flac(values: Array) -> int | None:
    """FLAC bytes of 16-bit channels, one after the other; None for other types."""
    try:
        soundfile = import_module("soundfile")
    except ImportError:
        return None
    if values.dtype != np.int16:
        return None
    total = 0
    for channel in as_channels(values):
        file = io.BytesIO()
        soundfile.write(file, channel, 8000, format="FLAC", subtype="PCM_16", compression_level=1.0)
        total += len(file.getvalue())
    return total


RIVALS: dict[str, Callable[[Array], int | None]] = {
    "arrays": lambda values: len(arrays.pack(values)), "pcodec": pcodec, "xz": xz, "flac": flac
}  # fmt: skip


def stored_bytes(signal: Signal) -> int:
    """Bytes of the samples in a file: coded, or as an array if that is shorter."""
    values, as_array = signal.values, len(arrays.pack(signal.values))
    found = codec.encode(values, signal.rate) if codec.suits(values) else None
    if found is None:
        return as_array
    return min(as_array, len(codec.pack(found[0])) + sum(len(chunk) + 4 for chunk in found[1]))


def speed() -> dict[str, float]:
    """Millions of samples per second of processor time, for 16 channels of counts at 1000 Hz; best of some rounds."""
    random = np.random.default_rng(0)
    time_s = np.arange(SPEED_SAMPLES // 16) / 1000
    values = 2000 * np.sin(time_s[:, None] * np.linspace(0.5, 3, 16)) + random.normal(0, 3, (len(time_s), 16))
    counts = np.rint(values).astype(np.int16)
    rounds = [_seconds_of(counts) for _ in range(SPEED_ROUNDS)]
    encode_s, decode_s = (min(seconds) for seconds in zip(*rounds, strict=True))
    return {"encode": counts.size / encode_s / 1e6, "decode": counts.size / decode_s / 1e6}


def speed_of_files(found: list[Signal]) -> dict[str, float]:
    """`speed` for all signals of files that the codec supports."""
    best = [0.0, 0.0]
    samples = 0
    for signal in found:
        values = np.asarray(signal.values)
        if not codec.suits(values) or codec.encode(values, signal.rate) is None:
            continue
        rounds = [_seconds_of(values, signal.rate) for _ in range(SPEED_ROUNDS)]
        best = [total + min(seconds) for total, seconds in zip(best, zip(*rounds, strict=True), strict=True)]
        samples += values.size
    return {"encode": samples / best[0] / 1e6, "decode": samples / best[1] / 1e6}


def _seconds_of(counts: Array, rate: float = 1000.0) -> tuple[float, float]:
    """Processor time of encoding and of decoding."""
    start = time.process_time()
    found = codec.encode(counts, rate)
    middle = time.process_time()
    assert found is not None
    codec.decode(found[0], found[1].__getitem__)
    return middle - start, time.process_time() - middle


@click.command("signals")
@click.option("--data", type=click.Path(path_type=Path), default=Path("../shared/data"), show_default=True)
def signals_command(data: Path) -> None:
    """Measures exact signals of C3D files, ours and rivals: docs/results/signals.json."""
    rows, all_signals = [], list[Signal]()
    for name, _, motion in recordings(data):
        for path, signal in signals(motion.extras):
            all_signals.append(signal)
            row = {"file": name, "signal": path, "shape": list(signal.shape), "dtype": str(signal.dtype)}
            row |= {"ours": stored_bytes(signal), **{rival: size(signal.values) for rival, size in RIVALS.items()}}
            rows.append(row)
            click.echo(f"{row}", err=True)
    total, before = (sum(row[name] for row in rows) for name in ("ours", "arrays"))
    result = {"machine": machine_description(), "msamples_per_s": speed(),
              "msamples_per_s_of_files": speed_of_files(all_signals), "signals": rows, "ours": total,
              "arrays": before, "smaller_than_arrays": 1 - total / before}  # fmt: skip
    write_json(SIGNALS, rounded(result))
