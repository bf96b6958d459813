"""What tempo's page states, measured anew: `python -m mocodec.evaluation.tempo`.

    recordings ─► tempo, each with a prior that never saw the person ─► bytes at mean errors and under hard bounds
               ─► SZ3 at the same errors; hou2014 at its own ─► docs/results/tempo.json ─► the tables of docs/tempo.md

Bytes are whole .mocz files, with names and skeleton, against float32 positions. A recording of one of the people in the
prior's data is coded with a prior trained without that person; the markers of subject 85 and the BVH files with one
trained on all nine, none of whom is 85, and whose points the prior does not know.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from .. import metrics, native
from ..codecs.hou2014 import Hou2014
from ..codecs.tempo import Encoder, Tempo
from ..errors import CannotEncode
from ..motion import Motion
from . import datasets, folds, rivals, runner

RESULTS = Path("docs/results/tempo.json")
PARTS = Path("docs/results/tempo_parts.json")
PAGE = Path("docs/tempo.md")
MEANS = (0.001, 0.003, 0.01)
HOU_MEANS = (0.002, 0.004, 0.008)
BOUNDS = (0.001, 0.003, 0.01)
LATENCIES_S = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
CHUNKS_S = (0.5, 1.0, 2.0, 4.0, 10.0)
LONG_FRAMES, CLIP_FRAMES = 2000, (300, 1000)
HOU_FILES = 12
PUBLISHED = "hou2014 as published"


@dataclass(frozen=True)
class Figure:
    """One measurement. Errors and targets in metres, times in seconds."""

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
    """Which of the page's rows a recording belongs to."""
    if recording.path is not None and recording.path.suffix.lower() == ".amc":
        if len(motion) >= LONG_FRAMES:
            return "joints, long"
        return "joints, clips" if CLIP_FRAMES[0] <= len(motion) <= CLIP_FRAMES[1] else "joints, other"
    return "markers" if recording.path is not None and recording.path.suffix.lower() == ".c3d" else "other skeletons"


def person(recording: datasets.Recording) -> str | None:
    """The folder of a recording of one of the prior's people."""
    path = recording.path
    return path.parent.name if path is not None and path.suffix.lower() == ".amc" else None


def figure(
    file: str, kind: str, motion: Motion, codec: str, target: str, wanted: float, outcome: runner.Outcome
) -> Figure:
    error = metrics.distances(motion.positions, outcome.positions)
    return Figure(
        file, kind, len(motion), codec, target, wanted, outcome.data_bytes, motion.raw_bytes / outcome.data_bytes,
        float(np.nanmean(error)), float(np.nanmax(error)), outcome.encode_s, outcome.decode_s,
    )  # fmt: skip


def of_recording(
    recording: datasets.Recording, prior: Path | None, with_hou: bool, known: Sequence[Figure]
) -> list[Figure]:
    """All figures of one recording; those of other codecs that are known already are taken over."""

    def before(codec: str, target: str, wanted: float) -> list[Figure]:
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
            outcome = runner.ours("tempo", motion, **{target: wanted})
            found.append(figure(label, kind, motion, "tempo", target, wanted, outcome))
            if there := before("sz3", target, wanted):
                found += there
                continue
            guess = sz3.knob_of(wanted if target == "mean_error" else wanted / 3)

            def run(knob: float) -> runner.Outcome:
                return runner.theirs(sz3, motion, knob)

            theirs = runner.search(run, motion, target, wanted, guess)
            if theirs is not None:
                found.append(figure(label, kind, motion, "sz3", target, wanted, theirs))
        for wanted in HOU_MEANS if with_hou else ():
            codecs: dict[str, Any] = {"tempo": Tempo(), "hou2014": Hou2014(), PUBLISHED: Hou2014.as_published()}
            for name, codec in codecs.items():
                if name != "tempo" and (there := before(name, "mean_error", wanted)):
                    found += there
                    continue
                with contextlib.suppress(CannotEncode):
                    outcome = runner.ours(codec, motion, mean_error=wanted)
                    found.append(figure(label, kind, motion, name, "mean_error", wanted, outcome))
        if kind == "joints, long" and with_hou:
            found += of_chunks(label, kind, motion)
    return found


def of_chunks(label: str, kind: str, motion: Motion) -> list[Figure]:
    """What shorter chunks and a low latency cost under the default bound; payload bytes."""
    found = []
    for seconds in CHUNKS_S:
        encoded = Tempo(chunk_seconds=seconds).in_chunks(motion)
        size = encoded.payload_bytes
        found.append(
            Figure(
                label, kind, len(motion), "tempo", "chunk", 0.005, size, motion.raw_bytes / size, 0, 0, 0, 0, seconds
            )
        )
    for seconds in LATENCIES_S:
        stream = Encoder(motion[:0], latency_seconds=seconds)
        chunks = [*stream.push(motion.positions), *stream.finish()]
        size = sum(len(c.payload) for c in chunks) + sum(map(len, stream.shared))
        found.append(
            Figure(
                label, kind, len(motion), "tempo", "latency", 0.005, size, motion.raw_bytes / size, 0, 0, 0, 0, seconds
            )
        )
    return found


def speeds(motion: Motion, repeats: int = 5) -> dict[str, Any]:
    """Frames a second, encoding and decoding, and milliseconds for 120 frames of an hour, with and without the compiled
    module. All in processor time of one thread: a machine may have other things to do."""
    from .. import api, container

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
    """Processor time of the fastest of some runs, after one to warm up."""
    run()
    times = []
    for _ in range(repeats):
        started = time.process_time()
        run()
        times.append(time.process_time() - started)
    return min(times)


def speed_table(speed: dict[str, Any]) -> list[str]:
    """Targets down, ways across."""
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
    return float(np.exp(np.mean(np.log(list(values)))))


def pick(
    figures: Sequence[Figure], codec: str, target: str, wanted: float, kind: str | None = None
) -> dict[str, Figure]:
    """Figures of one cell, by file."""
    return {
        f.file: f
        for f in figures
        if f.codec == codec and f.target == target and f.target_m == wanted and kind in (None, f.kind)
    }


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *("| " + " | ".join(r) + " |" for r in rows), ""]


def markdown(figures: Sequence[Figure], speed: dict[str, Any], machine: dict[str, Any]) -> str:
    """The tables of the page."""
    lines = []
    rows = []
    for kind in ("joints, long", "joints, clips", "markers", "other skeletons"):
        cells = [pick(figures, "tempo", "mean_error", e, kind) for e in MEANS]
        if cells[0]:
            theirs = [pick(figures, "sz3", "mean_error", e, kind) for e in MEANS]
            rows.append([
                f"{kind}: median of {len(cells[0])}",
                " / ".join(f"{np.median([f.ratio for f in c.values()]):.0f}" for c in cells),
                " / ".join(f"{np.median([f.ratio for f in c.values()]):.0f}" for c in theirs),
            ])  # fmt: skip
    for file in sorted(
        {f.file for f in figures if f.file.endswith(("85_12.c3d", "03_04.amc", "02_10.amc", "01_02.amc"))}
    ):
        cells = [pick(figures, "tempo", "mean_error", e)[file].ratio for e in MEANS]
        theirs = [pick(figures, "sz3", "mean_error", e)[file].ratio for e in MEANS]
        rows.append([file, " / ".join(f"{c:.0f}" for c in cells), " / ".join(f"{c:.0f}" for c in theirs)])
    lines += ["Ratio at mean error 0.1 / 0.3 / 1.0 cm:", ""]
    lines += table(["recordings", "tempo", "SZ3"], rows)
    rows = []
    for bound in BOUNDS:
        ours, theirs = pick(figures, "tempo", "max_error", bound), pick(figures, "sz3", "max_error", bound)
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
            ours, theirs = (pick(figures, codec, "mean_error", wanted) for codec in ("tempo", name))
            near = [f for f in theirs if abs(theirs[f].mean_error_m / wanted - 1) < 0.05]
            shares = [ours[f].bytes / theirs[f].bytes for f in near]
            if shares:
                share, worst = f"{geometric(shares):.3f}", f"{max(shares):.3f}"
                rows.append([name, f"{100 * wanted:g} cm", str(len(shares)), share, worst])
    lines += ["Bytes as a share of Hou's at the same mean error (`hou2014` is this package's, much improved):", ""]
    lines += table(["against", "mean error", "recordings", "geometric mean", "worst"], rows)
    for target, what in (("chunk", "chunk_seconds"), ("latency", "latency of the stream, seconds")):
        cells = [f for f in figures if f.target == target]
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


def parts_markdown(figures: Sequence[dict[str, Any]]) -> str:
    """What each part is worth, from the records of `tempo_parts`."""
    targets = [("mean_error", 0.001), ("mean_error", 0.003), ("mean_error", 0.01), ("max_error", 0.003)]
    files = list(dict.fromkeys(f["file"] for f in figures))
    ratios = {(f["file"], f["without"], t): f["ratio"] for f in figures for t in targets if f.get(t[0]) == t[1]}
    rows = []
    for name in dict.fromkeys(f["without"] for f in figures):
        cells = [geometric(ratios[f, name, t] / ratios[f, "all of it", t] for f in files) for t in targets]
        rows.append([name, *(f"{100 * (c - 1):+.1f} %" for c in cells)])
    head = ["", "mean 0.1 cm", "mean 0.3 cm", "mean 1 cm", "maximum 0.3 cm"]
    return "\n".join([f"Change of the ratio, geometric mean over {', '.join(files)}:", "", *table(head, rows[1:])])


def write_page(text: str, mark: str = "results", page: Path = PAGE) -> None:
    """Put tables between two marks of the page."""
    before, start, rest = page.read_text().partition(f"<!-- {mark} -->\n")
    end = f"<!-- end of {mark} -->"
    page.write_text(f"{before}{start}{text}\n{end}{rest.partition(end)[2]}")


def read_figures() -> list[Figure]:
    return [Figure(**f) for f in json.loads(RESULTS.read_text())["figures"]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=datasets.SHARED / "cmu")
    parser.add_argument(
        "--priors", type=Path, default=Path("build/priors"), help="where priors without one person are kept"
    )
    parser.add_argument("--quick", action="store_true", help="every fifth recording")
    parser.add_argument("--afresh", action="store_true", help="measure SZ3 and hou2014 again too")
    parser.add_argument("--workers", type=int, default=1, help="how many recordings are measured side by side")
    parser.add_argument("--tables", action="store_true", help="only draw the tables again")
    parser.add_argument("--speed", action="store_true", help="only measure speed again")
    chosen = parser.parse_args()
    if chosen.speed:
        stored = json.loads(RESULTS.read_text())
        long = next(r for r in datasets.recordings(chosen.data) if r.label.endswith("03_04.amc"))
        stored |= {"speed": speeds(long.load()), "speed_machine": runner.machine()}
        RESULTS.write_text(json.dumps(stored, indent=0))
    elif not chosen.tables:
        known = [] if chosen.afresh or not RESULTS.is_file() else read_figures()
        recordings = datasets.recordings(chosen.data)
        every = max(1, len(recordings) // HOU_FILES)
        tasks: list[tuple[datasets.Recording, Path | None, bool, Sequence[Figure]]] = []
        for number, recording in enumerate(recordings[:: 5 if chosen.quick else 1]):
            who = person(recording)
            prior = None if who is None else folds.prior_path(chosen.priors, (who,))
            if who is not None and prior is not None and not prior.is_file():
                folds.train((who,), prior)
            with_hou = number % every == 0 or recording.label.endswith(("85_12.c3d", "03_04.amc"))
            tasks.append((recording, prior, with_hou, [f for f in known if f.file == recording.label]))
        figures: list[Figure] = []
        with ProcessPoolExecutor(chosen.workers, mp_context=get_context("spawn")) as pool:
            for task, found in zip(tasks, pool.map(of_recording, *zip(*tasks, strict=True)), strict=True):
                figures += found
                print(task[0].label, flush=True)
        long = next(r for r in recordings if r.label.endswith("03_04.amc"))
        machine = runner.machine()
        speed = speeds(long.load())
        stored = {"machine": machine, "speed_machine": machine, "speed": speed}
        RESULTS.write_text(json.dumps(stored | {"figures": [asdict(f) for f in figures]}, indent=0))
    stored = json.loads(RESULTS.read_text())
    write_page(markdown(read_figures(), stored["speed"], stored["speed_machine"]))
    if PARTS.is_file():
        write_page(parts_markdown(json.loads(PARTS.read_text())["figures"]), "parts")


if __name__ == "__main__":
    main()
