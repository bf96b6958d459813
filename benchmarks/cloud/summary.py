"""A page about point clouds with requirements, the paper's results and ours, from stored results.

cloud_grid.json, cloud_long.json, lien2006.json, first_poses.json ──► cloud_summary.md
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocodec import formats

from .. import markdown as md
from ..results import read_json
from . import grid
from .cited import GPCC_BYTES


def markdown(folder: Path) -> str:
    """The page; dashes for missing results."""
    stored = {name: read_json(folder / f"{name}.json") for name in ("cloud_long", "lien2006", "first_poses")}
    results = grid.load(folder / "cloud_grid.json")
    runs = (stored["cloud_long"] or {"runs": []})["runs"]
    parts = [
        "# Point clouds of people: requirements and results",
        "Made by `scripts/bench cloud-summary` from the results of `scripts/bench cloud-grid`, `cloud-long`, "
        "`lien2006` and `first-poses`. Speeds count processor time on one core of a machine with other load; "
        f"{len(results)} conditions of the grid are measured. Jumping jacks are periodic. Ratios are those of whole "
        "files, all bytes counted, against 15 bytes a point. The ratios of the paper leave out its model and are of "
        "its own recordings; the paper prints no numbers for its figures.",
        md.table(["", "paper", "bodycast", "lien2006", "required", "goal"], table(results, runs, stored["lien2006"])),
        "## By clip: 15 frames/s, points of the whole surface, noise of at most 0.5 cm, all or a quarter of the points",
        md.table(
            ["clip", "mean cm", "max cm", "lost frames", "longest run", "frames/s"],
            [
                [clip, *grid.cells([r for r in _required(results) if r.clip == clip])]
                for clip in dict.fromkeys(r.clip for r in results)
            ],
        ),
        "## Bytes at equal error, against G-PCC as cited",
        GPCC_TEXT,
        md.table(
            ["run", "bytes a frame, all counted", "D1 cm", "G-PCC at that D1", "D2 cm", "G-PCC at that D2"],
            [_gpcc_row(run) for run in runs],
        ),
        "## Long sequences",
        md.table(
            ["run", "bytes", "sent once", "ratio", "ratio without what is sent once", "views dB (floor)",
             "D1 cm (floor)", "D2 cm (floor)", "encode, decode frames/s"],
            [_long_row(run) for run in runs],
        ),
    ]  # fmt: skip
    if stored["first_poses"]:
        parts += ["## First poses without a skeleton", _first_poses(stored["first_poses"]["frames"])]
    return "\n\n".join(parts) + "\n"


def _gpcc_row(run: dict[str, Any]) -> list[str]:
    """Table cells: a run, and the bytes that G-PCC needs for the same D1 and D2."""
    size, d1, d2 = run["bytes"] / run["frames"], run["quality"]["d1_m"] * 100, run["quality"]["d2_m"] * 100
    return [
        _name(run), f"{size:,.0f}", f"{d1:.2f}", _gpcc_factor(size, d1, 1), f"{d2:.2f}", _gpcc_factor(size, d2, 2),
    ]  # fmt: skip


def _long_row(run: dict[str, Any]) -> list[str]:
    """Table cells: bytes, ratios, errors with their floor, and speed of a run."""
    quality, floor = run["quality"], run["floor"]
    return [
        _name(run), f"{run['bytes']:,}", f"{run['once_bytes']:,}", f"{run['ratio']:,.0f}",
        f"{run['ratio_without_once']:,.0f}", f"{quality['views_psnr_db']:.1f} ({floor['views_psnr_db']:.1f})",
        f"{quality['d1_m'] * 100:.2f} ({floor['d1_m'] * 100:.2f})",
        f"{quality['d2_m'] * 100:.2f} ({floor['d2_m'] * 100:.2f})",
        f"{run['encode_fps']:.0f}, {run['decode_fps']:.0f}",
    ]  # fmt: skip


GPCC_TEXT = (
    "How many times as many bytes G-PCC needs. Its bytes at our error are interpolated between its cited results, in "
    "the logarithms of bytes and error; beyond its coarsest result (2,720 bytes at 0.83 and 0.52 cm) they are "
    "extrapolated, and finer errors than its finest result have a dash. Its recording is another one of the same kind; "
    "a second perfect sample there scores 0.78 cm D1."
)


def table(
    results: Sequence[grid.GridResult], runs: Sequence[dict[str, Any]], paper: dict[str, Any] | None
) -> list[list[str]]:
    """Rows of the requirements: measure, paper, bodycast, lien2006, required, goal."""
    required, by_run = _required(results), {(r["clip"], r["codec"], r["residual"]): r for r in runs}
    synthetic = (paper or {}).get("synthetic", {}).values()
    articp = [s["with"] for s in synthetic]
    plain = [r for r in results if (r.rate, r.views, r.noise_cm) == (15, 0, 0)]
    none, some = (by_run.get(("jumping jacks", "bodycast", r)) for r in (0, 25))
    lien_none, lien_some = (by_run.get(("jumping jacks", "lien2006", r)) for r in (0, 25))
    fast = [r for r in required if r.clip == "49_20"]
    ti = (paper or {}).get("tele_immersion", {}).values()
    return [
        ["tracking, 2,500 points, frames/s", "30–61", _span([r.fps for r in plain if r.kept == 25]),
         _span([s["fps"] for s in articp]), "100", "300"],
        ["tracking from raw 10,000 points, frames/s", "11–12", _span([r.fps for r in plain if r.kept == 100]),
         _span([t["lien2006 0"]["encode_fps"] for t in ti]), "120", "300"],
        ["whole encode / decode, 10,000 points, frames/s", "10", _speeds(none), _speeds(lien_none), "45 / 150",
         "120 / 300"],
        ["joint error, 15 frames/s, ≤ 0.5 cm noise, mean / max cm", "figures 6–8", _errors(required),
         f"{_span([s['mean_cm'] for s in articp], 1)} / {_span([s['max_cm'] for s in articp])}, no noise",
         "≤ 0.8 / ≤ 6 on all eight", "≤ 0.4 / ≤ 4"],
        ["limbs lost, longest run of frames, eight clips", "–",
         str(max((r.longest_loss for r in required), default="–")), "–", "10", "none"],
        ["the same, fast martial arts (49_20)", "–", str(max((r.longest_loss for r in fast), default="–")), "–", "10",
         "none"],
        ["bytes a frame that grow with the frames, no residual: poses and points of no body", "–",
         "–" if none is None else f"{none['bytes_a_frame']:.0f}",
         "–" if lien_none is None else f"{lien_none['bytes_a_frame']:.0f}", "30", "15"],
        ["no residual, 1,000 frames, model counted", "1490–5840 at 23.9–26.3 dB, model not counted", _ratio(none),
         _ratio(lien_none), "3000", "8000"],
        ["25 % residual, 300 frames, model counted", "174–196 at 25.8–28.8 dB, model not counted", _ratio(some),
         _ratio(lien_some), "400 at the floor", "1000"],
        ["against G-PCC at equal D1 / D2, no residual", "–", _against_gpcc(none), _against_gpcc(lien_none), "9 ×",
         "20 ×"],
    ]  # fmt: skip


def _required(rows: Sequence[grid.GridResult]) -> list[grid.GridResult]:
    """Results under the conditions of the requirements."""
    return [r for r in rows if r.rate == 15 and grid.is_mild(r)]


def _span(values: Sequence[float], digits: int = 0) -> str:
    """Smallest and largest value; a dash without values."""
    if not values:
        return "–"
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return low if low == high else f"{low}–{high}"


def _errors(rows: Sequence[grid.GridResult]) -> str:
    """Ranges of the clips' mean errors and of their largest errors, and number of clips that meet both requirements."""
    if not rows:
        return "–"
    clips = [[r for r in rows if r.clip == clip] for clip in dict.fromkeys(r.clip for r in rows)]
    means = [float(np.mean([r.mean_cm for r in results])) for results in clips]
    worst = [max(r.max_cm for r in results) for results in clips]
    kept = sum(m <= 0.8 and w <= 6 for m, w in zip(means, worst, strict=True))
    return f"{_span(means, 2)} / {_span(worst, 1)}; {kept} of {len(clips)} clips within both"


def _speeds(run: dict[str, Any] | None) -> str:
    return "–" if run is None else f"{run['encode_fps']:.0f} / {run['decode_fps']:.0f}"


def _ratio(run: dict[str, Any] | None) -> str:
    if run is None:
        return "–"
    db, floor = run["quality"]["views_psnr_db"], run["floor"]["views_psnr_db"]
    return f"{run['ratio']:,.0f} at {db:.1f} dB (floor {floor:.1f}), {run['frames']:,} frames"


def _against_gpcc(run: dict[str, Any] | None) -> str:
    if run is None:
        return "–"
    size, quality = run["bytes"] / run["frames"], run["quality"]
    return f"{_gpcc_factor(size, quality['d1_m'] * 100, 1)} / {_gpcc_factor(size, quality['d2_m'] * 100, 2)}"


def _gpcc_factor(size: float, error: float, column: int) -> str:
    """G-PCC's bytes over `size` at an error in centimetres: D1 (column 1) or D2 (column 2).

    A dash for finer errors than are cited.
    """
    if error < GPCC_BYTES[0][column]:
        return "–"
    points = np.log([[p[column], p[0]] for p in GPCC_BYTES])
    i = int(np.clip(np.searchsorted(points[:, 0], np.log(error)), 1, len(points) - 1))
    (x0, y0), (x1, y1) = points[i - 1], points[i]
    needed = np.exp(y0 + (y1 - y0) * (np.log(error) - x0) / (x1 - x0))
    return f"{needed / size:.1f} ×"


def _name(run: dict[str, Any]) -> str:
    return f"{run['clip']}, {run['codec']} {run['residual']} %, {run['frames']:,} frames"


def _first_poses(frames: Sequence[dict[str, Any]]) -> str:
    good = [f for f in frames if not f["problem"]]
    right = sum(f["max_m"] <= 0.12 for f in good)
    mean = float(np.mean([f["mean_m"] for f in good])) * 100 if good else float("nan")
    return (
        f"{right} of {len(frames)} frames found (no joint off by more than 12 cm), mean error {mean:.1f} cm; by pose, "
        "person and way of recording in [first_poses.md](first_poses.md)."
    )


def write_tables(folder: Path) -> Path:
    """Write cloud_summary.md; return its path."""
    formats.replace_whole(folder / "cloud_summary.md", markdown(folder).encode())
    return folder / "cloud_summary.md"


@click.command("cloud-summary")
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
def command(folder: Path) -> None:
    """Write FOLDER/cloud_summary.md from the results of cloud-grid, cloud-long, lien2006 and first-poses in FOLDER."""
    click.echo(write_tables(folder))
