"""Measures the page of `mocodec view` in Chromium: seeking in an hour over HTTP, playing, and its size.

    one hour of 31 joints ─tempo─► .mocz ─nginx─► page ─► seconds from click to picture, requests, bytes; frames drawn

Needs Node.js, Chromium, nginx and `npm ci` in web/viewer. Chromium renders in software, as without a graphics card.
"""

from __future__ import annotations

import gzip
import json
import os
import shutil
import statistics
import subprocess
import tempfile
from importlib import resources
from pathlib import Path
from typing import Any

import click
import numpy as np

import mocodec
from mocodec import viewer
from mocodec.codecs.bodycast import Bodycast
from mocodec.codecs.tempo.models import prior
from mocodec.errors import BadInput
from mocodec.motion import Motion
from mocodec.pointcloud import PointClouds
from mocodec.testing import actors, sequences
from tests.container.web_server import NGINX, serving

from .datasets import packaged
from .machine import machine_description, measured_on
from .markdown import table
from .results import write_json

RATE, HOUR = 120, 3600
FRAMES = (100_000, 300_000, 50_000, 431_000, 222_222, 10_000, 350_000, 77_777, 400_000, 150_000, 250_000)
PLAYED_S = 8
CROWD, CLOUD = 100, 10_000
DENSE, DENSE_FRAMES = 150_000, 12
LOADED = {"do": "wait", "for": "mocodecViewer.state().shownFrame >= 0", "seconds": 120}
ROOT = Path(__file__).resolve().parents[1]

SEEK = """(async () => {
  const begin = performance.now();
  mocodecViewer.seek(%d);
  while (mocodecViewer.state().shownFrame !== %d) await new Promise((done) => setTimeout(done, 1));
  return performance.now() - begin;
})()"""


HIDE = "document.getElementById('picture').style.display = 'none'"
"""The page still draws, but the browser does not show the picture."""

DECODE = """(async () => {
  let first = 0;
  let worst = 0;
  for (let last = performance.now(); ; ) {
    await new Promise((done) => setTimeout(done, 1));
    const now = performance.now();
    const { shownFrame, block } = mocodecViewer.state();
    if (first) worst = Math.max(worst, now - last);
    else if (shownFrame >= 0) first = now;
    last = now;
    if (!first) continue;
    mocodecViewer.seek(%d);
    if (shownFrame === %d) return [now - first, worst, block];
  }
})()"""
"""Milliseconds from showing the first frame to showing a frame of the second block; longest pause; frames of a block.

A block is decoded before its first frame is shown, so the page decodes only the second block in between."""


@click.command("viewer")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("docs/results"), show_default=True)
def command(output: Path) -> None:
    """Measure the page of `mocodec view` in Chromium: seeking, playing, sizes."""
    if NGINX is None or shutil.which("node") is None:
        raise BadInput("this benchmark needs Node.js and nginx")
    with tempfile.TemporaryDirectory() as name:
        results = measure(Path(name))
    output.mkdir(parents=True, exist_ok=True)
    write_json(output / "viewer.json", results)
    (output / "viewer.md").write_text(report(results))
    click.echo(report(results))


def an_hour() -> Motion:
    """31 joints of the recording in the package, alternately forwards and backwards for an hour."""
    once = packaged()[:, packaged().names[:31]]
    both = np.concatenate([once.positions, once.positions[::-1]])
    times = -(-RATE * HOUR // len(both))
    return Motion(np.tile(both, (times, 1, 1))[: RATE * HOUR], RATE, once.names, once.up, once.skeleton)


def measure(folder: Path) -> dict[str, Any]:
    """Measures everything."""
    site, logs = folder / "site", folder / "nginx"
    (site / "priors").mkdir(parents=True)
    logs.mkdir()
    page = resources.files(viewer).joinpath("static/viewer.html").read_bytes()
    (site / "viewer.html").write_bytes(page)
    for file in (prior.POINTS_FILE, prior.DIRECTIONS_FILE):
        data = prior.packaged_bytes(file)
        (site / "priors" / f"{prior.read(data).id.hex()}.npz").write_bytes(data)
    hour = mocodec.encode(an_hour(), mean_error=0.003)
    (site / "hour.mocz").write_bytes(hour)
    short = packaged()
    (site / "short.mocz").write_bytes(mocodec.encode(short, mean_error=0.003))
    (site / "crowd.mocz").write_bytes(mocodec.encode(crowd(short), "lossless"))
    viewer.save(site / "cloud.html", viewer.html(cloud()))
    (site / "dense.mocz").write_bytes(dense())
    with serving(site, logs) as server:
        seeks = seeking(f"{server.url}/viewer.html?file=hour.mocz", folder)
        asked = [entry for entry in server.requests() if entry[1] == 206]
        played_by_name = {
            f"{short.points} joints": playing(f"{server.url}/viewer.html?file=short.mocz", folder),
            f"{CROWD} points": playing(f"{server.url}/viewer.html?file=crowd.mocz", folder),
            f"a cloud of {CLOUD:,} points": playing(f"{server.url}/cloud.html", folder),
        }
        decoded = decoding(f"{server.url}/viewer.html?file=dense.mocz", folder)
    return {
        "machine": machine_description(),
        "page_bytes": len(page),
        "page_gzip_bytes": len(gzip.compress(page, 9)),
        "hour_bytes": len(hour),
        "seek_ms": seeks,
        "requests": len(asked),
        "requested_bytes": sum(sent for _, _, sent in asked),
        "played": played_by_name,
        "dense_cloud": decoded,
    }


def seeking(url: str, folder: Path) -> list[float]:
    """Milliseconds from the request of a frame to its drawing, for each of FRAMES."""
    jumps = [{"do": "eval", "code": SEEK % (frame, frame)} for frame in FRAMES]
    return [round(ms, 1) for ms in drive([{"do": "open", "url": url}, LOADED, *jumps], folder)[2:]]


def crowd(once: Motion) -> Motion:
    """Copies of a motion side by side, CROWD points in all."""
    copies = [once.positions + np.array([0.8 * i, 0, 0]) for i in range(-(-CROWD // once.points))]
    positions = np.concatenate(copies, axis=1)[:, :CROWD]
    return Motion(positions, once.rate, tuple(f"point {p}" for p in range(CROWD)), once.up)


def cloud() -> PointClouds:
    """Two seconds of a moving cloud of CLOUD points with random colours."""
    random = np.random.default_rng(1)
    at = random.normal(size=(CLOUD, 3)) * [0.2, 0.4, 0.2] + [0, 1, 0]
    colours = random.integers(0, 256, (CLOUD, 3)).astype(np.uint8)
    return PointClouds([at + np.array([0.01 * t, 0, 0]) for t in range(60)], 30.0, [colours] * 60)


def dense() -> bytes:
    """A file of a person with DENSE points a frame, within a bound."""
    performance = sequences.jumping_jacks(actors.capsules(), DENSE_FRAMES)
    clouds = sequences.record(performance, DENSE, seed=5)
    return mocodec.encode(clouds, Bodycast(skeleton=performance.skeleton(), max_error=0.004, psnr=28))


def decoding(url: str, folder: Path) -> dict[str, float]:
    """Milliseconds of decoding a frame of a dense cloud, and the longest time in which the page does not respond."""
    last = DENSE_FRAMES - 1
    _, (whole, blocked, block) = drive(
        [{"do": "open", "url": url}, {"do": "eval", "code": DECODE % (last, last)}], folder
    )
    if not block < DENSE_FRAMES <= 2 * block:
        raise BadInput(f"the page decodes {block} frames at once: {DENSE_FRAMES} are not two blocks")
    return {
        "points": DENSE,
        "ms_per_frame": round(whole / (DENSE_FRAMES - block), 1),
        "longest_pause_ms": round(blocked, 1),
    }


def playing(url: str, folder: Path) -> dict[str, float]:
    """Pictures drawn and dropped while playing, of 60 a second, and milliseconds of processor time of one: shown, and
    drawn without being shown.
    """
    (drawn, dropped, spent), (_, hidden_dropped, own) = (played(url, before, folder) for before in ("0", HIDE))
    shown = {"seconds": PLAYED_S, "drawn": drawn, "dropped": dropped, "processor_ms": spent}
    return {**shown, "hidden_dropped": hidden_dropped, "hidden_processor_ms": own}


def played(url: str, before: str, folder: Path) -> tuple[int, int, float]:
    """Pictures drawn, pictures dropped, and milliseconds of processor time of one. before: code that runs first."""
    start = {"do": "eval", "code": f"{before}; document.getElementById('play').click()"}
    state = {"do": "eval", "code": "[mocodecViewer.state().drawn, mocodecViewer.state().late]"}
    wait = {"do": "eval", "code": "new Promise((done) => setTimeout(done, %d))"}
    first, whole = ({**wait, "code": wait["code"] % (1000 * seconds)} for seconds in (1, PLAYED_S))
    clock = {"do": "processor"}
    answers = drive([{"do": "open", "url": url}, LOADED, start, first, state, clock, whole, state, clock], folder)[4:]
    (drawn, late), clock_before, _, (drawn_after, late_after), clock_after = answers
    count = drawn_after - drawn
    return count, late_after - late, round((clock_after - clock_before) / max(1, count), 1)


def drive(commands: list[dict[str, Any]], folder: Path) -> list[Any]:
    """Answers of the page to commands (web/viewer/test/browser.mjs). Raises BadInput if the browser fails."""
    script = folder / "commands.json"
    script.write_text(json.dumps(commands))
    made = subprocess.run(
        ["node", str(ROOT / "web/viewer/test/browser.mjs"), str(script)],
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ},
        check=False,
    )
    if made.returncode:
        raise BadInput(f"the browser cannot be driven: {made.stderr.strip().splitlines()[-1:]}")
    result = json.loads(made.stdout)
    if "failed" in result:
        raise BadInput(result["failed"])
    answers: list[Any] = result["answers"]
    return answers


def report(results: dict[str, Any]) -> str:
    """A table of the results."""
    played, seeks = results["played"], results["seek_ms"]
    rows = [
        ["page, compressed", f"{results['page_gzip_bytes']:,} bytes"],
        ["an hour of 31 joints, mean error 3 mm", f"{results['hour_bytes']:,} bytes"],
        [f"seek anywhere in it, median of {len(seeks)}", f"{statistics.median(seeks):.0f} ms"],
        ["slowest seek", f"{max(seeks):.0f} ms"],
        ["range requests for opening and all seeks", f"{results['requests']}, {results['requested_bytes']:,} bytes"],
        *(
            [
                f"{name}, {run['seconds']} s of playing: pictures drawn, dropped of 60 a second, processor time of one",
                f"{run['drawn']}, {run['dropped']}, {run['processor_ms']} ms",
            ]
            for name, run in played.items()
        ),
        *(
            [
                f"{name}, drawn but not shown by the browser: dropped, processor time of one",
                f"{run['hidden_dropped']}, {run['hidden_processor_ms']} ms",
            ]
            for name, run in played.items()
        ),
    ]
    dense_cloud = results["dense_cloud"]
    words = f"a person of {dense_cloud['points']:,} points within 4 mm: decoding a frame, longest pause meanwhile"
    rows.append([words, f"{dense_cloud['ms_per_frame']:.0f} ms, {dense_cloud['longest_pause_ms']:.0f} ms"])
    return (
        f"{table(['what', 'measured'], rows)}\n\n*{measured_on(results['machine'])} Made by `scripts/bench viewer`.*\n"
    )
