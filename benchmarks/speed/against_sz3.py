"""`scripts/bench speed-table`: tempo and SZ3 in one process, on one thread.

    recordings ─each at its bound─► median of runs, in turn ─► docs/results/speed.json ─► docs/results/speed.md

Times are processor times, so that other work on the machine disturbs less. Comparisons of threads use elapsed times,
which need a quiet machine. SZ3's bound is per coordinate: its knob is chosen for about the same largest error.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np

import mocodec as mc
from mocodec import container, native
from mocodec.codecs.tempo import compiled_chunks
from mocodec.codecs.tempo.chunk import TRANSFORM, Payload
from mocodec.codecs.tempo.coding import coefficients, corrections
from mocodec.codecs.tempo.header import StreamHeader
from mocodec.encoded import Chunk

from ..machine import machine_description
from ..markdown import table
from ..motion import rivals
from ..results import read_json, rounded, write_json
from .recordings import DATA

RESULTS, PAGE = Path("docs/results/speed.json"), Path("docs/results/speed.md")
RUNS, ENCODING_RUNS, ENCODING_THREADED_RUNS, WINDOWS, WINDOW_FRAMES = 9, 3, 3, 60, 64
SZ3_OF_BOUND = 1 / 1.9
"""SZ3's bound per coordinate for about the same largest distance."""
LONG_HOURS, THREADED_HOURS = (1, 10), 1 / 6
CASES = (
    ("31 joints", "cmu/asfamc/01/01_01.amc", 0.005, "auto"),
    ("31 joints", "cmu/asfamc/01/01_01.amc", 0.001, "transform"),
    ("41 markers", "cmu/c3d/85_12.c3d", 0.005, "transform"),
    ("41 markers", "cmu/c3d/85_12.c3d", 0.001, "transform"),
)
"""Cases: label, file, maximum error in metres, tempo's model."""


def seconds(work: Callable[[], object], runs: int = RUNS) -> float:
    """Median of processor time."""
    spent = []
    for _ in range(runs):
        begin = time.process_time()
        work()
        spent.append(time.process_time() - begin)
    return statistics.median(spent)


def measure(label: str, path: str, bound: float, model: str) -> dict[str, Any]:
    """Frames a second of both, and of tempo without the compiled module."""
    motion = mc.read(DATA / path, mc.Motion)
    motion = replace(motion, rotations=None, extras={})
    data = mc.encode(motion, "tempo", max_error=bound, model=model)
    sz3, narrow = rivals.Sz3(), motion.positions.astype(np.float32)
    theirs = sz3.encode(narrow, bound * SZ3_OF_BOUND)
    frames, long = len(motion), longer(data, THREADED_HOURS)
    found = {
        "label": label,
        "max_error": bound,
        "model": model,
        "frames": frames,
        "bytes": len(data),
        "sz3_bytes": len(theirs),
        "decode": frames / seconds(lambda: mc.decode(data, threads=1)),
        "sz3_decode": frames / seconds(lambda: sz3.decode(theirs, motion.positions.shape)),
        "encode": frames / seconds(lambda: mc.encode(motion, "tempo", max_error=bound, model=model), ENCODING_RUNS),
        "sz3_encode": frames / seconds(lambda: sz3.encode(narrow, bound * SZ3_OF_BOUND), ENCODING_RUNS),
        "free_share": interpreter_free_share(data),
        "two_threads": two_threads_over_one(lambda threads: mc.decode(long, threads=threads)),
        "encode_two_threads": two_threads_encoding(motion, bound, model),
        "window_s": window_seconds(data),
        "stages": stages(data),
    }
    if model != "auto" or all(Payload.unpack(c.payload).engine == TRANSFORM for c in mc.open(data).encoded.chunks):
        with native.without():
            found["decode_numpy"] = frames / seconds(lambda: mc.decode(data, threads=1), ENCODING_RUNS)
    return found


def interpreter_free_share(data: bytes) -> float:
    """Share of a long recording's decoding time in the compiled module, during which other threads can run."""
    long, inside, decode = longer(data, 0.05), [0.0], compiled_chunks.decode

    def timed(*arguments: Any) -> bool:
        begin = time.process_time()
        done = decode(*arguments)
        inside[0] += time.process_time() - begin
        return done

    compiled_chunks.decode = timed
    try:
        begin = time.process_time()
        mc.decode(long, threads=1)
        return inside[0] / (time.process_time() - begin)
    finally:
        compiled_chunks.decode = decode


def two_threads_encoding(motion: mc.Motion, bound: float, model: str) -> float:
    """`two_threads_over_one` for encoding ten minutes."""
    long = longer_motion(motion, THREADED_HOURS)
    encode = lambda threads: mc.encode(long, "tempo", max_error=bound, model=model, threads=threads)  # noqa: E731
    return two_threads_over_one(encode, ENCODING_THREADED_RUNS)


def longer_motion(motion: mc.Motion, hours: float) -> mc.Motion:
    """A motion of this length: forwards and backwards, repeated."""
    there_and_back = np.concatenate([motion.positions, motion.positions[-2:0:-1]])
    times = -(-round(hours * 3600 * motion.rate) // len(there_and_back))
    return replace(motion, positions=np.tile(there_and_back, (times, 1, 1)))


def two_threads_over_one(work: Callable[[int], object], runs: int = RUNS) -> float:
    """Speed-up of work on ten minutes with two threads over one: medians of elapsed times of alternating runs."""
    elapsed = dict[int, list[float]]({1: [], 2: []})
    for _ in range(runs):
        for threads, times in elapsed.items():
            begin = time.perf_counter()
            work(threads)
            times.append(time.perf_counter() - begin)
    return statistics.median(elapsed[1]) / statistics.median(elapsed[2])


def stages(data: bytes) -> dict[str, float]:
    """Seconds of the stages of a chunk in the compiled module, and their lower limits.

    copy_s: copying its positions, the limit of memory; symbols: coded coefficients and items of lists.
    """
    with mc.open(data, mc.Motion) as f:
        model = StreamHeader.unpack(f.encoded.shared, f.encoded.about.points).read_model(f.encoded.about)
        chunk = f.encoded.chunks[len(f.encoded.chunks) // 2]
        payload = Payload.unpack(chunk.payload)
    if payload.engine != TRANSFORM:
        return {}
    out, numbers = np.empty((chunk.frames, model.points, 3)), payload.numbers

    def decode(data: bytes, into: Any) -> float:
        return seconds(lambda: compiled_chunks.decode(model, chunk.frames, data, 1e-4, into), 30)

    head = coefficients.read_head(model, chunk.frames, numbers, corrections.FIELDS)
    integers, curves, whole = decode(numbers + b"\0\0", out), decode(numbers, out[:0]), decode(numbers, out)
    return {
        "frames": chunk.frames,
        "symbols": int(head.plan.coded.sum()) + len(head.list_tables),
        "integers_s": integers,
        "transform_s": curves - integers,
        "poses_s": whole - curves,
        "copy_s": seconds(lambda: out.copy(), 30),
    }


def window_seconds(data: bytes) -> float:
    """Seconds of reading a random window from an open file with cached chunks."""
    random = np.random.default_rng(0)
    with mc.open(data, mc.Motion) as f:
        starts = random.integers(0, len(f) - WINDOW_FRAMES, WINDOWS).tolist()
        every = lambda: [f[start : start + WINDOW_FRAMES] for start in starts]  # noqa: E731
        every()
        return seconds(every, 3) / WINDOWS


def longer(data: bytes, hours: float) -> bytes:
    """A file of this length that repeats the chunks."""
    with mc.open(data, mc.Motion) as f:
        encoded, chunks, at = f.encoded, list[Chunk](), 0
        while at < hours * 3600 * f.rate:
            chunks += [Chunk(at + c.start, c.frames, c.payload) for c in encoded.chunks]
            at += encoded.frames
        return container.pack(replace(encoded, chunks=chunks))


def openings(folder: Path) -> list[dict[str, Any]]:
    """Seconds of opening long recordings of 31 joints, and of opening them and reading one second."""
    label, path, bound, model = CASES[0]
    motion = replace(mc.read(DATA / path, mc.Motion), rotations=None, extras={})
    data, random, found = mc.encode(motion, "tempo", max_error=bound, model=model), np.random.default_rng(1), []
    for hours in LONG_HOURS:
        file = folder / "long.mocz"
        file.write_bytes(longer(data, hours))

        def read_one_second(file: Path = file) -> None:
            with mc.open(file, mc.Motion) as f:
                start = int(random.integers(len(f) - 120))
                f[start : start + 120]

        opening = seconds(lambda file=file: mc.open(file).close(), 15)
        found.append({"hours": hours, "label": label, "open_s": opening, "one_second_s": seconds(read_one_second, 15)})
    return found


def page(results: dict[str, Any]) -> str:
    """The tables of docs/performance.md."""
    cases = results["cases"]
    by_numpy = [f"{c['decode_numpy']:,.0f}" if "decode_numpy" in c else "–" for c in cases]
    rows = [
        [
            f"{c['label']}, {1000 * c['max_error']:g} mm", f"{c['decode']:,.0f}", f"{c['sz3_decode']:,.0f}",
            f"1/{c['sz3_decode'] / c['decode']:.1f}", numpy, f"{c['encode']:,.0f}", f"{c['sz3_encode']:,.0f}",
            f"{c['sz3_bytes'] / c['bytes']:.1f}",
        ]
        for c, numpy in zip(cases, by_numpy, strict=True)
    ]  # fmt: skip
    head = ["maximum error", "decode", "SZ3", "share", "NumPy alone", "encode", "SZ3", "SZ3's bytes / tempo's"]
    shares = [
        [
            f"{c['label']}, {1000 * c['max_error']:g} mm",
            f"{c['free_share']:.2f}",
            f"{1 / (1 - c['free_share'] / 2):.2f}",
            f"{c['two_threads']:.2f}",
            f"{c['encode_two_threads']:.2f}",
            f"{1000 * c['window_s']:.2f} ms",
        ]
        for c in cases
    ]  # fmt: skip
    parts = [
        [
            f"{c['label']}, {1000 * c['max_error']:g} mm",
            f"{s['frames']}",
            f"{s['symbols']:,}",
            *(f"{1000 * s[key]:.2f} ms" for key in ("integers_s", "transform_s", "poses_s", "copy_s")),
        ]
        for c in cases
        if (s := c["stages"])
    ]
    opened = [
        [f"{o['hours']} h of {o['label']}", f"{1000 * o['open_s']:.2f} ms", f"{1000 * o['one_second_s']:.2f} ms"]
        for o in results["openings"]
    ]
    machine = results["machine"]
    return "\n\n".join(
        [
            "Frames a second on one thread, median of processor time:",
            table(head, rows),
            "One chunk in the compiled module, and copying its positions:",
            table(["maximum error", "frames", "symbols", "integers", "bases, DCT", "poses", "copy"], parts),
            "What threads can gain, and windows of 64 frames from an open file whose chunks have been decoded:",
            table(
                [
                    "maximum error",
                    "decoding: share without the interpreter",
                    "two threads over one, at most",
                    "measured",
                    "encoding: measured",
                    "window",
                ],
                shares,
            ),
            "Opening from a path:",
            table(["recording", "header and index", "and one second anywhere"], opened),
            f"Measured with mocodec {machine['mocodec']}, Python {machine['python']}, NumPy {machine['numpy']}, on "
            f"{machine['cores']} cores with a load of {results['load']:.0f} by other work.",
        ]
    )


@click.command("speed-table")
@click.option("--table-only", is_flag=True, help="Write the table from the stored results.")
def command(table_only: bool) -> None:
    """Measure tempo and SZ3 in one process; write docs/results/speed.json and speed.md."""
    if not table_only:
        cases: list[dict[str, Any]] = []
        for case in CASES:
            if (DATA / case[1]).exists():
                cases.append(measure(*case))
                click.echo(f"{case[0]}, {1000 * case[2]:g} mm: {cases[-1]['decode']:,.0f} frames/s")
        with tempfile.TemporaryDirectory() as folder:
            opened = openings(Path(folder))
        results = {"cases": cases, "openings": opened, "load": os.getloadavg()[0], "machine": machine_description()}
        write_json(RESULTS, rounded(results))
    PAGE.write_text(page(read_json(RESULTS)) + "\n")
    click.echo(f"wrote {RESULTS} and {PAGE}")
