"""What point clouds must show, ours beside the paper's and the rest, on one page, from stored results.

mocodec eval cloud-summary [DIR]      cloud_grid.json, cloud_long.json, lien2006.json, first_poses.json in DIR
                                      ──► DIR/cloud_summary.md
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from . import grid

# cited: bytes a frame, D1 and D2 in centimetres, of 10,000 fresh points a frame (the floor there is 0.78 and 0.12)
GPCC = ((11_600, 0.27, 0.16), (7350, 0.44, 0.26), (2720, 0.83, 0.52))


def markdown(folder: Path) -> str:
    """The page. What has no results yet stands as a dash."""
    found = {name: _load(folder / f"{name}.json") for name in ("cloud_grid", "cloud_long", "lien2006", "first_poses")}
    rows = [grid.Result(**row) for row in (found["cloud_grid"] or {"results": []})["results"]]
    runs = (found["cloud_long"] or {"runs": []})["runs"]
    lines = [
        "# Point clouds of people: what must be shown", "",
        "Made by `mocodec eval cloud-summary` from the results of `mocodec eval cloud-grid`, `cloud-long`, `lien2006` "
        "and `python -m mocodec.evaluation.cloud.first_poses`. Speeds are of processor time on one core of a machine "
        f"that others were using; {len(rows)} of the grid's conditions are measured. Jumping jacks are periodic. "
        "Ratios are of whole files, every byte counted, against 15 bytes a point. The paper's ratios leave out its "
        "model, and are of its own recordings; of its figures no numbers are printed.", "",
        "| | paper | bodycast | lien2006 | must | aim |", "|---|---|---|---|---|---|",
    ]  # fmt: skip
    lines += [f"| {' | '.join(row)} |" for row in table(rows, runs, found["lien2006"])]
    lines += ["", "## Clip by clip: 15 frames/s, points all over, noise of at most 0.5 cm, all or a quarter kept", ""]
    lines += ["| clip | mean cm | max cm | lost frames | longest run | frames/s |", "|---|---|---|---|---|---|"]
    for clip in dict.fromkeys(r.clip for r in rows):
        lines.append(f"| {clip} | {' | '.join(grid.cells([r for r in _asked(rows) if r.clip == clip]))} |")
    lines += ["", "## Bytes at equal error, against G-PCC as cited", "", GPCC_TEXT, ""]
    lines += ["| run | bytes a frame, all counted | D1 cm | G-PCC at that D1 | D2 cm | G-PCC at that D2 |"]
    lines += ["|---|---|---|---|---|---|"]
    for run in runs:
        size, d1, d2 = run["bytes"] / run["frames"], run["quality"]["d1_m"] * 100, run["quality"]["d2_m"] * 100
        by = [_factor(size, error, column) for error, column in ((d1, 1), (d2, 2))]
        lines.append(f"| {_name(run)} | {size:,.0f} | {d1:.2f} | {by[0]} | {d2:.2f} | {by[1]} |")
    lines += ["", "## Long sequences", ""]
    lines += ["| run | bytes | sent once | ratio | without what is sent once | views dB (floor) | D1 cm (floor) "
              "| D2 cm (floor) | encode, decode frames/s |", "|---|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for run in runs:
        q, f = run["quality"], run["floor"]
        lines.append(
            f"| {_name(run)} | {run['bytes']:,} | {run['once_bytes']:,} | {run['ratio']:,.0f} "
            f"| {run['ratio_without_once']:,.0f} | {q['views_psnr_db']:.1f} ({f['views_psnr_db']:.1f}) "
            f"| {q['d1_m'] * 100:.2f} ({f['d1_m'] * 100:.2f}) | {q['d2_m'] * 100:.2f} ({f['d2_m'] * 100:.2f}) "
            f"| {run['encode_fps']:.0f}, {run['decode_fps']:.0f} |"
        )
    if found["first_poses"]:
        lines += ["", "## First poses without a skeleton", "", _first(found["first_poses"]["frames"])]
    return "\n".join(lines) + "\n"


GPCC_TEXT = (
    "How many times as many bytes G-PCC needs, between its cited points by the logarithms of bytes and error; "
    "beyond the last of them, 2,720 bytes at 0.83 and 0.52 cm, by the last two. Another recording of the same "
    "kind: a second perfect sample there scores 0.78 cm D1."
)


def table(rows: Sequence[grid.Result], runs: Sequence[dict[str, Any]], paper: dict[str, Any] | None) -> list[list[str]]:
    """Rows of what must be shown: what, paper, bodycast, lien2006, must, aim."""
    asked, long = _asked(rows), {(r["clip"], r["codec"], r["residual"]): r for r in runs}
    synthetic = (paper or {}).get("synthetic", {}).values()
    articp = [s["with"] for s in synthetic]
    plain = [r for r in rows if (r.rate, r.views, r.noise_cm) == (15, 0, 0)]
    none, some = (long.get(("jumping jacks", "bodycast", r)) for r in (0, 25))
    lien_none, lien_some = (long.get(("jumping jacks", "lien2006", r)) for r in (0, 25))
    fast = [r for r in asked if r.clip == "49_20"]
    ti = (paper or {}).get("tele_immersion", {}).values()
    return [
        ["tracking, 2,500 points, frames/s", "30–61", _span([r.fps for r in plain if r.kept == 25]),
         _span([s["fps"] for s in articp]), "100", "300"],
        ["tracking from raw 10,000 points, frames/s", "11–12", _span([r.fps for r in plain if r.kept == 100]),
         _span([t["lien2006 0"]["encode_fps"] for t in ti]), "120", "300"],
        ["whole encode / decode, 10,000 points, frames/s", "10", _speeds(none), _speeds(lien_none), "45 / 150",
         "120 / 300"],
        ["joint error, 15 frames/s, ≤ 0.5 cm noise, mean / max cm", "figures 6–8", _errors(asked),
         f"{_span([s['mean_cm'] for s in articp], 1)} / {_span([s['max_cm'] for s in articp])}, no noise",
         "≤ 0.8 / ≤ 6 on all eight", "≤ 0.4 / ≤ 4"],
        ["limbs lost, longest run of frames, eight clips", "–", str(max((r.longest_loss for r in asked), default="–")),
         "–", "10", "none"],
        ["the same, fast martial arts (49_20)", "–", str(max((r.longest_loss for r in fast), default="–")), "–", "10",
         "none"],
        ["moving bytes a frame, no residual: poses and what no body explains", "–",
         "–" if none is None else f"{none['bytes_a_frame']:.0f}",
         "–" if lien_none is None else f"{lien_none['bytes_a_frame']:.0f}", "30", "15"],
        ["no residual, 1,000 frames, model counted", "1490–5840 at 23.9–26.3 dB, model not counted", _ratio(none),
         _ratio(lien_none), "3000", "8000"],
        ["25 % residual, 300 frames, model counted", "174–196 at 25.8–28.8 dB, model not counted", _ratio(some),
         _ratio(lien_some), "400 at the floor", "1000"],
        ["against G-PCC at equal D1 / D2, no residual", "–", _against(none), _against(lien_none), "9 ×", "20 ×"],
    ]  # fmt: skip


def _load(path: Path) -> Any:
    return json.loads(path.read_text()) if path.is_file() else None


def _asked(rows: Sequence[grid.Result]) -> list[grid.Result]:
    return [r for r in rows if r.rate == 15 and r.views == 0 and r.noise_cm <= 0.5 and r.kept >= 25]


def _span(values: Sequence[float], digits: int = 0) -> str:
    if not values:
        return "–"
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return low if low == high else f"{low}–{high}"


def _errors(rows: Sequence[grid.Result]) -> str:
    """Spans of the clips' mean of means and of their maxima."""
    if not rows:
        return "–"
    clips = [[r for r in rows if r.clip == clip] for clip in dict.fromkeys(r.clip for r in rows)]
    means = [float(np.mean([r.mean_cm for r in some])) for some in clips]
    worst = [max(r.max_cm for r in some) for some in clips]
    kept = sum(m <= 0.8 and w <= 6 for m, w in zip(means, worst, strict=True))
    return f"{_span(means, 2)} / {_span(worst, 1)}; {kept} of {len(clips)} clips within both"


def _speeds(run: dict[str, Any] | None) -> str:
    return "–" if run is None else f"{run['encode_fps']:.0f} / {run['decode_fps']:.0f}"


def _ratio(run: dict[str, Any] | None) -> str:
    if run is None:
        return "–"
    db, floor = run["quality"]["views_psnr_db"], run["floor"]["views_psnr_db"]
    return f"{run['ratio']:,.0f} at {db:.1f} dB (floor {floor:.1f}), {run['frames']:,} frames"


def _against(run: dict[str, Any] | None) -> str:
    if run is None:
        return "–"
    size, quality = run["bytes"] / run["frames"], run["quality"]
    return f"{_factor(size, quality['d1_m'] * 100, 1)} / {_factor(size, quality['d2_m'] * 100, 2)}"


def _factor(size: float, error: float, column: int) -> str:
    """How many times this size G-PCC needs for an error, in centimetres of D1 (column 1) or D2 (2)."""
    points = np.log([[p[column], p[0]] for p in GPCC])
    i = int(np.clip(np.searchsorted(points[:, 0], np.log(error)), 1, len(points) - 1))
    (x0, y0), (x1, y1) = points[i - 1], points[i]
    needed = np.exp(y0 + (y1 - y0) * (np.log(error) - x0) / (x1 - x0))
    return f"{needed / size:.1f} ×"


def _name(run: dict[str, Any]) -> str:
    return f"{run['clip']}, {run['codec']} {run['residual']} %, {run['frames']:,} frames"


def _first(frames: Sequence[dict[str, Any]]) -> str:
    good = [f for f in frames if not f["problem"]]
    right = sum(f["max_m"] <= 0.12 for f in good)
    mean = float(np.mean([f["mean_m"] for f in good])) * 100 if good else float("nan")
    return (
        f"{right} of {len(frames)} frames found (no joint off by more than 12 cm), mean error {mean:.1f} cm; by pose, "
        "person and way of recording in [first_poses.md](first_poses.md)."
    )
