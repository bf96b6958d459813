"""The tables of docs/tempo/results.md: `scripts/bench tempo`.

    recordings ──► tempo, with a prior trained without the person ──► bytes at mean errors and under hard maxima
               ──► SZ3 at the same errors, hou2014 at its own ──► docs/results/tempo.json ──► docs/tempo/results.md

Bytes are whole .mocz files with names and skeleton; ratios are against float32 positions. A recording of a person in
the prior's training data uses a prior trained without that person. The markers of subject 85 and the BVH files use the
prior of the package: its training data do not contain subject 85, and it does not have the points of these BVH files.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocodec import api, container, metrics, native
from mocodec.codecs.hou2014 import Hou2014
from mocodec.codecs.tempo import Encoder, Tempo
from mocodec.errors import CannotEncode
from mocodec.motion import Motion

from . import datasets, folds
from . import markdown as md
from .machine import machine_description
from .motion import rivals, runner

RESULTS = Path("docs/results/tempo.json")
PARTS = Path("docs/results/tempo_parts.json")
PAGE = Path("docs/tempo/results.md")
MEANS = (0.001, 0.003, 0.01)
HOU_MEANS = (0.002, 0.004, 0.008)
BOUNDS = (0.001, 0.003, 0.01)
LATENCIES_S = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
CHUNKS_S = (0.5, 1.0, 2.0, 4.0, 10.0)
LONG_FRAMES, CLIP_FRAMES = 2000, (300, 1000)
HOU_FILES = 12
PUBLISHED = "hou2014 as published"


@dataclass(frozen=True)
class Measurement:
    """One codec at one target on one recording. Errors and targets in metres, times in seconds."""

    file: str
    kind: str
    frames: int
    codec: str
    target: str
    target_m: float
    bytes: int
    ratio: float
    mean_error_m: float
    max_error_m: float
    encode_s: float
    decode_s: float
    setting: float = 0.0


def kind_of(recording: datasets.Recording, motion: Motion) -> str:
    """The row of a recording on the page."""
    if recording.path is not None and recording.path.suffix.lower() == ".amc":
        if len(motion) >= LONG_FRAMES:
            return "joints, long"
        return "joints, clips" if CLIP_FRAMES[0] <= len(motion) <= CLIP_FRAMES[1] else "joints, other"
    return "markers" if recording.path is not None and recording.path.suffix.lower() == ".c3d" else "other skeletons"


def person(recording: datasets.Recording) -> str | None:
    """The subject of a joint recording, by its folder; None for other files."""
    path = recording.path
    return path.parent.name if path is not None and path.suffix.lower() == ".amc" else None


def measurement(
    file: str, kind: str, motion: Motion, codec: str, target: str, wanted: float, outcome: runner.Outcome
) -> Measurement:
    """The measurement of an outcome."""
    error = metrics.distances(motion.positions, outcome.positions)
    return Measurement(
        file, kind, len(motion), codec, target, wanted, outcome.data_bytes, motion.raw_bytes / outcome.data_bytes,
        float(np.nanmean(error)), float(np.nanmax(error)), outcome.encode_s, outcome.decode_s,
    )  # fmt: skip


def of_recording(
    recording: datasets.Recording, prior: Path | None, with_hou: bool, known: Sequence[Measurement]
) -> list[Measurement]:
    """All measurements of one recording; reuses those of other codecs in `known`."""

    def known_measurement(codec: str, target: str, wanted: float) -> list[Measurement]:
        return [f for f in known if (f.file, f.codec, f.target, f.target_m) == (label, codec, target, wanted)][:1]

    motion, problem = datasets.loaded(recording)
    if motion is None or problem:
        return []
    motion = replace(motion, extras={}, rotations=None)
    kind, label = kind_of(recording, motion), recording.label
    found = []
    sz3 = rivals.Sz3()
    with folds.unseen(prior):
        for target, wanted in [("mean_error", e) for e in MEANS] + [("max_error", e) for e in BOUNDS]:
            outcome = runner.run_codec("tempo", motion, **{target: wanted})
            found.append(measurement(label, kind, motion, "tempo", target, wanted, outcome))
            if reused := known_measurement("sz3", target, wanted):
                found += reused
                continue
            guess = sz3.knob_of(wanted if target == "mean_error" else wanted / 3)

            def run(knob: float) -> runner.Outcome:
                return runner.run_rival(sz3, motion, knob)

            theirs = runner.search(run, motion, target, wanted, guess)
            if theirs is not None:
                found.append(measurement(label, kind, motion, "sz3", target, wanted, theirs))
        for wanted in HOU_MEANS if with_hou else ():
            codecs: dict[str, Any] = {"tempo": Tempo(), "hou2014": Hou2014(), PUBLISHED: Hou2014.as_published()}
            for name, codec in codecs.items():
                if name != "tempo" and (reused := known_measurement(name, "mean_error", wanted)):
                    found += reused
                    continue
                with contextlib.suppress(CannotEncode):
                    outcome = runner.run_codec(codec, motion, mean_error=wanted)
                    found.append(measurement(label, kind, motion, name, "mean_error", wanted, outcome))
        if kind == "joints, long" and with_hou:
            found += of_chunks(label, kind, motion)
    return found


def of_chunks(label: str, kind: str, motion: Motion) -> list[Measurement]:
    """Payload bytes with shorter chunks and with low latency, under the default bound."""
    found = []
    for seconds in CHUNKS_S:
        encoded = Tempo(chunk_seconds=seconds).encode_chunks(motion)
        size = encoded.payload_bytes
        found.append(
            Measurement(
                label, kind, len(motion), "tempo", "chunk", 0.005, size, motion.raw_bytes / size, 0, 0, 0, 0, seconds
            )
        )
    for seconds in LATENCIES_S:
        stream = Encoder(motion[:0], latency_seconds=seconds)
        chunks = [*stream.push(motion.positions), *stream.finish()]
        size = sum(len(c.payload) for c in chunks) + sum(map(len, stream.shared))
        found.append(
            Measurement(
                label, kind, len(motion), "tempo", "latency", 0.005, size, motion.raw_bytes / size, 0, 0, 0, 0, seconds
            )
        )
    return found


def speeds(motion: Motion, repeats: int = 5) -> dict[str, Any]:
    """Frames encoded and decoded per second, and milliseconds for reading 120 frames of an hour, with and without the
    compiled module: processor time of one thread, which other load does not change."""
    motion = replace(motion[:5000], extras={}, rotations=None)
    rows: list[dict[str, Any]] = []
    targets = [("mean_error", e) for e in MEANS] + [("max_error", e) for e in SPEED_BOUNDS]
    hour = int(3600 * motion.rate)
    tiled = np.tile(motion.positions, (-(-hour // len(motion)), 1, 1))[:hour]
    blob = container.pack(Tempo(mean_error=0.003).encode(replace(motion, positions=tiled)))
    opening: dict[str, float] = {}

    def open_and_read() -> None:
        with api.open(blob) as f:
            _ = f[hour // 2 : hour // 2 + 120]

    for way in ("compiled", "NumPy") if native.available() else ("NumPy",):
        with contextlib.nullcontext() if way == "compiled" else native.without():
            for target, wanted in targets:
                codec = replace(Tempo(), **{target: wanted})
                encoded = codec.encode(motion)
                encode_s = fastest_s(lambda c=codec: c.encode(motion), 3)
                decode_s = fastest_s(lambda e=encoded: Tempo.decode(e), 2 * repeats)
                rows.append({
                    "way": way, "target": target, "target_m": wanted, "bytes": encoded.payload_bytes,
                    "encode_fps": len(motion) / encode_s, "decode_fps": len(motion) / decode_s,
                })  # fmt: skip
            opening[way] = 1000 * fastest_s(open_and_read, 4 * repeats)
    return {
        "frames": len(motion), "points": motion.points, "rows": rows, "hour_bytes": len(blob),
        "hour_120_frames_ms": opening,
    }  # fmt: skip


SPEED_BOUNDS = (0.001, 0.003, 0.005, 0.01)


def fastest_s(run: Callable[[], Any], repeats: int) -> float:
    """Processor time of the fastest of some runs, after a warm-up run."""
    run()
    times = []
    for _ in range(repeats):
        started = time.process_time()
        run()
        times.append(time.process_time() - started)
    return min(times)


def speed_table(speed: dict[str, Any]) -> list[str]:
    """A row for each target; columns with and without the compiled module."""
    ways = list(dict.fromkeys(r["way"] for r in speed["rows"]))
    rows = []
    for target, wanted in dict.fromkeys((r["target"], r["target_m"]) for r in speed["rows"]):
        cells = [
            r for w in ways for r in speed["rows"] if (r["way"], r["target"], r["target_m"]) == (w, target, wanted)
        ]
        name = f"{'mean' if target == 'mean_error' else 'maximum'} {100 * wanted:g} cm"
        rows.append([name, *(f"{c['encode_fps']:,.0f} / {c['decode_fps']:,.0f}" for c in cells)])
    rows.append(["opening an hour, 120 frames", *(f"{speed['hour_120_frames_ms'][w]:.1f} ms" for w in ways)])
    return table(["frames a second: encoding / decoding", *ways], rows)


def geometric(values: Iterable[float]) -> float:
    """The geometric mean."""
    return float(np.exp(np.mean(np.log(list(values)))))


def pick(
    measurements: Sequence[Measurement], codec: str, target: str, wanted: float, kind: str | None = None
) -> dict[str, Measurement]:
    """The measurements of one cell, by file."""
    return {
        f.file: f
        for f in measurements
        if f.codec == codec and f.target == target and f.target_m == wanted and kind in (None, f.kind)
    }


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """The lines of a Markdown table with an empty line after it."""
    return [*md.table(head, rows).split("\n"), ""]


def markdown(measurements: Sequence[Measurement], speed: dict[str, Any], machine: dict[str, Any]) -> str:
    """The tables of the page."""
    lines = []
    rows = []
    for kind in ("joints, long", "joints, clips", "markers", "other skeletons"):
        cells = [pick(measurements, "tempo", "mean_error", e, kind) for e in MEANS]
        if cells[0]:
            theirs = [pick(measurements, "sz3", "mean_error", e, kind) for e in MEANS]
            rows.append([
                f"{kind}: median of {len(cells[0])}",
                " / ".join(f"{np.median([f.ratio for f in c.values()]):.0f}" for c in cells),
                " / ".join(f"{np.median([f.ratio for f in c.values()]):.0f}" for c in theirs),
            ])  # fmt: skip
    for file in sorted(
        {f.file for f in measurements if f.file.endswith(("85_12.c3d", "03_04.amc", "02_10.amc", "01_02.amc"))}
    ):
        cells = [pick(measurements, "tempo", "mean_error", e)[file].ratio for e in MEANS]
        theirs = [pick(measurements, "sz3", "mean_error", e)[file].ratio for e in MEANS]
        rows.append([file, " / ".join(f"{c:.0f}" for c in cells), " / ".join(f"{c:.0f}" for c in theirs)])
    lines += ["Ratio at mean error 0.1 / 0.3 / 1.0 cm:", ""]
    lines += table(["recordings", "tempo", "SZ3"], rows)
    rows = []
    for bound in BOUNDS:
        ours, theirs = pick(measurements, "tempo", "max_error", bound), pick(measurements, "sz3", "max_error", bound)
        times = {f: ours[f].ratio / theirs[f].ratio for f in ours if f in theirs}
        worst = min(times, key=lambda f: times[f])
        rows.append([
            f"{100 * bound:g} cm", str(len(times)), f"{geometric(ours[f].ratio for f in times):.1f}",
            f"{geometric(theirs[f].ratio for f in times):.1f}", f"{geometric(times.values()):.2f}",
            f"{times[worst]:.2f} ({worst})", f"{max(o.max_error_m for o in ours.values()) * 100:.4f} cm",
        ])  # fmt: skip
    lines += ["Under a hard maximum, geometric means over every recording:", ""]
    lines += table(["maximum", "recordings", "tempo", "SZ3", "times SZ3", "worst", "largest error found"], rows)
    rows = []
    for name in (PUBLISHED, "hou2014"):
        for wanted in HOU_MEANS:
            ours, theirs = (pick(measurements, codec, "mean_error", wanted) for codec in ("tempo", name))
            near = [f for f in theirs if abs(theirs[f].mean_error_m / wanted - 1) < 0.05]
            shares = [ours[f].bytes / theirs[f].bytes for f in near]
            if shares:
                share, worst = f"{geometric(shares):.3f}", f"{max(shares):.3f}"
                rows.append([name, f"{100 * wanted:g} cm", str(len(shares)), share, worst])
    lines += ["Bytes as a share of Hou's at the same mean error (`hou2014` is this package's, much improved):", ""]
    lines += table(["against", "mean error", "recordings", "geometric mean", "worst"], rows)
    for target, what in (("chunk", "chunk_seconds"), ("latency", "latency of the stream, seconds")):
        cells = [f for f in measurements if f.target == target]
        files = sorted({f.file for f in cells})
        settings = sorted({f.setting for f in cells})
        rows = [
            [f"{s:g}", *(f"{f.ratio:.1f}" for name in files for f in cells if (f.file, f.setting) == (name, s))]
            for s in settings
        ]
        lines += [
            f"Ratio of the payload under the default bound of 0.5 cm, by {what}:",
            "",
            *table([what, *files], rows),
        ]
    if speed:
        what = f"{speed['frames']:,} frames of {speed['points']} joints"
        lines += [f"Speed on {what}, one thread, processor time of {machine['cores']} shared cores:", ""]
        lines += speed_table(speed)
    return "\n".join(lines)


def parts_markdown(measurements: Sequence[dict[str, Any]]) -> str:
    """Change of the ratio without each part, from the results of `tempo_parts`.

    If some recordings cannot be coded without a part, the comparison uses the others.
    """
    targets = [("mean_error", 0.001), ("mean_error", 0.003), ("mean_error", 0.01), ("max_error", 0.003)]
    files = list(dict.fromkeys(f["file"] for f in measurements))
    ratios = {(f["file"], f["without"], t): f["ratio"] for f in measurements for t in targets if f.get(t[0]) == t[1]}
    rows = []
    for name, against in dict.fromkeys((f["without"], f.get("against", "all of it")) for f in measurements):
        if name == against:
            continue
        cells = []
        for target in targets:
            common = [f for f in files if (f, name, target) in ratios and (f, against, target) in ratios]
            changes = [ratios[f, name, target] / ratios[f, against, target] for f in common]
            few = f" ({len(common)} of {len(files)})" if len(common) < len(files) else ""
            cells.append(f"{100 * (geometric(changes) - 1):+.1f} %{few}" if common else "–")
        rows.append([name, *cells])
    head = ["", "mean 0.1 cm", "mean 0.3 cm", "mean 1 cm", "maximum 0.3 cm"]
    return "\n".join([f"Change of the ratio, geometric mean over {', '.join(files)}:", "", *table(head, rows)])


def write_page(text: str, mark: str = "results", page: Path = PAGE) -> None:
    """Replace the text between two marks on the page."""
    before, start, rest = page.read_text().partition(f"<!-- {mark} -->\n")
    end = f"<!-- end of {mark} -->"
    page.write_text(f"{before}{start}{text}\n{end}{rest.partition(end)[2]}")


def read_measurements() -> list[Measurement]:
    """The stored measurements."""
    return [Measurement(**f) for f in json.loads(RESULTS.read_text())["figures"]]


@click.command("tempo")
@click.option("--data", default=datasets.SHARED / "cmu", show_default=True, type=click.Path(path_type=Path))
@click.option(
    "--priors", default="build/priors", show_default=True, type=click.Path(path_type=Path), help="Their folder."
)
@click.option("--quick", is_flag=True, help="Every fifth recording.")
@click.option("--afresh", is_flag=True, help="Measure SZ3 and hou2014 again as well.")
@click.option(
    "--workers", default=1, show_default=True, type=click.IntRange(1), help="Recordings measured in parallel."
)
@click.option("--tables", is_flag=True, help="Only draw the tables again.")
@click.option("--speed", is_flag=True, help="Only measure speed again.")
def command(data: Path, priors: Path, quick: bool, afresh: bool, workers: int, tables: bool, speed: bool) -> None:
    """Measure tempo, SZ3 and hou2014 on all CMU recordings; write docs/results/tempo.json and docs/tempo/results.md."""
    if speed:
        stored = json.loads(RESULTS.read_text())
        stored |= {"speed": speeds(long_recording(data).load()), "speed_machine": machine_description()}
        RESULTS.write_text(json.dumps(stored, indent=0))
    elif not tables:
        known = [] if afresh or not RESULTS.is_file() else read_measurements()
        tasks = recording_tasks(data, priors, quick, known)
        measurements: list[Measurement] = []
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            for task, found in zip(tasks, pool.map(of_recording, *zip(*tasks, strict=True)), strict=True):
                measurements += found
                click.echo(task[0].label)
        machine = machine_description()
        stored = {"machine": machine, "speed_machine": machine, "speed": speeds(long_recording(data).load())}
        RESULTS.write_text(json.dumps(stored | {"figures": [asdict(m) for m in measurements]}, indent=0))
    write_tables()


Task = tuple[datasets.Recording, Path | None, bool, Sequence[Measurement]]
"""The arguments of `of_recording`."""


def recording_tasks(data: Path, priors: Path, quick: bool, known: Sequence[Measurement]) -> list[Task]:
    """The recordings to measure, each with the folder of its priors; trains missing priors."""
    recordings = datasets.recordings(data)
    every = max(1, len(recordings) // HOU_FILES)
    tasks: list[Task] = []
    for number, recording in enumerate(recordings[:: 5 if quick else 1]):
        subject = person(recording)
        prior = None if subject is None else folds.trained(priors, (subject,))
        with_hou = number % every == 0 or recording.label.endswith(("85_12.c3d", "03_04.amc"))
        tasks.append((recording, prior, with_hou, [m for m in known if m.file == recording.label]))
    return tasks


def long_recording(data: Path) -> datasets.Recording:
    """The recording for the measurement of speed."""
    return next(r for r in datasets.recordings(data) if r.label.endswith("03_04.amc"))


def write_tables() -> None:
    """Write the tables of the page from the stored results."""
    stored = json.loads(RESULTS.read_text())
    write_page(markdown(read_measurements(), stored["speed"], stored["speed_machine"]))
    if PARTS.is_file():
        write_page(parts_markdown(json.loads(PARTS.read_text())["figures"]), "parts")
