"""Tables and figure of `scripts/bench cloud-points`, from its JSON."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mocodec import formats, plots
from mocodec.errors import MissingExtra

from .. import markdown as md
from ..machine import measured_on
from ..results import read_json
from .cited import GPCC_BYTES
from .records import LONG

if TYPE_CHECKING:
    from matplotlib.figure import Figure

D1_MM = (5.0, 2.0, 1.0, 0.5)


@dataclass
class DracoPoint:
    """Draco at one number of bits: bytes of a frame without and with colours, frames a second with colours."""

    bits: float
    d1_mm: float
    bytes: float
    coloured_bytes: float
    encode_fps: float
    decode_fps: float


@dataclass
class PointResult:
    """One clip at one bound. bytes: of the whole file, per frame; colour_bytes: the colours' part of them; once: bytes
    of the file that do not grow with the frames; draco_…: Draco at the same D1, interpolated.
    """

    clip: str
    points: int
    frames: int
    wanted_d1_mm: float
    bound_mm: float
    bytes: float
    colour_bytes: float
    once: int
    d1_mm: float
    d2_mm: float
    largest_mm: float
    psnr_db: float
    draco_bytes: float
    draco_coloured_bytes: float
    encode_fps: float
    decode_fps: float
    draco_encode_fps: float
    draco_decode_fps: float

    @property
    def long_bytes(self) -> float:
        """Bytes of a frame if the file had LONG frames."""
        return self.bytes - self.once / self.frames + self.once / LONG

    @property
    def place_share(self) -> float:
        """Bytes without colours, for LONG frames, over Draco's."""
        return (self.long_bytes - self.colour_bytes) / self.draco_bytes

    @property
    def share(self) -> float:
        """Bytes with colours, for LONG frames, over Draco's."""
        return self.long_bytes / self.draco_coloured_bytes

    @property
    def colour_bits(self) -> float:
        """Bits of a point's colour."""
        return 8 * self.colour_bytes / self.points

    @property
    def draco_colour_bits(self) -> float:
        """Bits of a point's colour in Draco, lossless."""
        return 8 * (self.draco_coloured_bytes - self.draco_bytes) / self.points


@dataclass
class ResidualResult:
    """One clip at one residual. bytes: per frame, without `once`, which is sent once; bound_mm: promised bound."""

    residual: str
    frames: int
    once: int
    bytes: float
    bound_mm: float | None
    d1_mm: float
    d2_mm: float
    largest_mm: float
    psnr_db: float


def read(folder: Path) -> tuple[list[PointResult], list[ResidualResult], str]:
    """The results of a folder, and a sentence about the machine."""
    content = read_json(folder / "cloud_points.json")
    points = [PointResult(**record) for record in content["records"]]
    measured = f"{measured_on(content['machine'])} The load of the machine was {content['load']:.0f}."
    return points, [ResidualResult(**record) for record in content["residuals"]], measured


def write(folder: Path) -> list[Path]:
    """Write cloud_points.md, and with Matplotlib cloud_points.png, from cloud_points.json; return all three paths."""
    results, residuals, _ = read(folder)
    paths = [folder / "cloud_points.json", write_tables(folder)]
    with contextlib.suppress(MissingExtra):
        plots.save(curves(results, residuals), folder / "cloud_points.png")
        paths.append(folder / "cloud_points.png")
    return paths


def write_tables(folder: Path) -> Path:
    """Write cloud_points.md from cloud_points.json; return its path."""
    results, residuals, measured = read(folder)
    page = markdown(results, residuals, measured)
    formats.replace_whole(folder / "cloud_points.md", page.encode())
    return folder / "cloud_points.md"


def markdown(results: Sequence[PointResult], residuals: Sequence[ResidualResult], machine: str) -> str:
    """The page."""
    parts = [
        "# Points within a bound, against Draco",
        "Made by `scripts/bench cloud-points`: fresh points of the actor in every frame, at 15 Hz, first pose given, "
        "with colours. Every file keeps its bound: the largest distance to the nearest point in both directions, by "
        "SciPy's k-d tree, is in the tables. Draco's bytes are interpolated to the same D1 between 6 and 13 bits; its "
        "colours are without loss. Bytes of bodycast spread what is sent once (the body and its surface) over "
        f"{LONG:,} frames. Frames a second are those of processor time, of all points with colours; bodycast's "
        "encoding includes tracking and a decoding that checks the file.",
        machine,
        "![bits a point over D1](cloud_points.png)",
    ]
    for points in sorted({r.points for r in results}):
        chosen = [r for r in results if r.points == points]
        parts += [f"## {points:,} points a frame", _means(chosen), _by_clip(chosen)]
    if residuals:
        parts += ["## One knob: `--residual`", *_residual_table(residuals)]
    parts += ["## Cited", _cited(results)]
    return "\n\n".join(parts) + "\n"


def _means(results: Sequence[PointResult]) -> str:
    head = [
        "D1 mm", "D2 mm", "clips", "places, bytes", "Draco", "share", "largest share", "colours, bits a point", "Y dB",
        "Draco, lossless", "all, bytes", "Draco", "share", "encode, decode /s", "Draco",
    ]  # fmt: skip
    rows = list[list[str]]()
    for d1 in D1_MM:
        same = [r for r in results if r.wanted_d1_mm == d1]
        if same:
            mean = {name: float(np.mean([getattr(r, name) for r in same])) for name in _AVERAGED}
            rows.append([
                f"{d1:g}", f"{mean['d2_mm']:.2f}", str(len(same)), f"{mean['long_bytes'] - mean['colour_bytes']:,.0f}",
                f"{mean['draco_bytes']:,.0f}", f"{mean['place_share']:.2f}", f"{max(r.place_share for r in same):.2f}",
                f"{mean['colour_bits']:.2f}", f"{mean['psnr_db']:.1f}", f"{mean['draco_colour_bits']:.1f}",
                f"{mean['long_bytes']:,.0f}", f"{mean['draco_coloured_bytes']:,.0f}", f"{mean['share']:.2f}",
                f"{mean['encode_fps']:.1f}, {mean['decode_fps']:.1f}",
                f"{mean['draco_encode_fps']:.0f}, {mean['draco_decode_fps']:.0f}",
            ])  # fmt: skip
    return md.table(head, rows)


_AVERAGED = (
    "d2_mm", "long_bytes", "colour_bytes", "draco_bytes", "place_share", "colour_bits", "psnr_db", "draco_colour_bits",
    "draco_coloured_bytes", "share", "encode_fps", "decode_fps", "draco_encode_fps", "draco_decode_fps",
)  # fmt: skip


def _by_clip(results: Sequence[PointResult]) -> str:
    rows = [
        [
            r.clip, str(r.frames), f"{r.bound_mm:.3g}", f"{r.largest_mm:.3g}", f"{r.d1_mm:.3g}", f"{r.d2_mm:.3g}",
            f"{r.psnr_db:.1f}", f"{r.bytes:,.0f}", f"{r.colour_bytes:,.0f}", f"{r.once:,}", f"{r.place_share:.2f}",
            f"{r.share:.2f}",
        ]
        for r in results
    ]  # fmt: skip
    head = [
        "clip", "frames", "bound mm", "largest mm", "D1 mm", "D2 mm", "Y dB", "bytes a frame", "of them colours",
        "sent once", "places, of Draco", "all, of Draco",
    ]  # fmt: skip
    return md.table(head, rows)


def _residual_table(residuals: Sequence[ResidualResult]) -> list[str]:
    rows = [
        [
            r.residual, f"{r.once:,}", f"{r.bytes:,.0f}", "–" if r.bound_mm is None else f"{r.bound_mm:.3g}",
            f"{r.largest_mm:.3g}", f"{r.d1_mm:.3g}", f"{r.d2_mm:.3g}", _decibels(r.psnr_db),
        ]
        for r in residuals
    ]  # fmt: skip
    text = (
        "Three frames of one clip, so what is sent once for a run of frames weighs. More residual takes more bytes, "
        "and never leaves more error."
    )
    head = ["residual", "sent once", "bytes a frame", "promised mm", "largest mm", "D1 mm", "D2 mm", "Y dB"]
    return [text, md.table(head, rows)]


def _decibels(psnr_db: float) -> str:
    return "exact" if psnr_db >= 99 else f"{psnr_db:.1f}"


def _cited(results: Sequence[PointResult]) -> str:
    """G-PCC beside bodycast at the same D1, both with colours."""
    sparse = [r for r in results if r.points == min(r.points for r in results)]
    ordered = sorted((r.d1_mm, r.long_bytes) for r in sparse)
    rows = list[list[str]]()
    for size, d1_cm, d2_cm in GPCC_BYTES:
        d1 = 10 * d1_cm
        known = ordered[0][0] <= d1 <= ordered[-1][0]
        logs = np.log([d for d, _ in ordered])
        ours = f"{np.interp(np.log(d1), logs, [b for _, b in ordered]):,.0f}" if known else "–"
        rows.append([f"{d1:g}", f"{10 * d2_cm:g}", f"{size:,}", ours])
    text = (
        "G-PCC (TMC13, octree), 10,000 fresh points of a MakeHuman body a frame, with colours, run elsewhere; bodycast "
        "is interpolated in the logarithm of D1."
    )
    return text + "\n\n" + md.table(["D1 mm", "D2 mm", "G-PCC, bytes a frame", "bodycast"], rows)


def curves(results: Sequence[PointResult], residuals: Sequence[ResidualResult]) -> Figure:
    """Bits a point over D1: places and all of bodycast and Draco, the cited G-PCC, and the residuals."""
    picture = plots.figure(9.0, 4.2)
    left, right = picture.subplots(1, 2)
    for points, line in zip(sorted({r.points for r in results}), ("-", "--"), strict=False):
        chosen = [r for r in results if r.points == points]
        d1s = [d1 for d1 in D1_MM if any(r.wanted_d1_mm == d1 for r in chosen)]
        for colour, name, ours, theirs in (
            (plots.OURS, "places", lambda r: r.long_bytes - r.colour_bytes, lambda r: r.draco_bytes),
            (plots.INK, "with colours", lambda r: r.long_bytes, lambda r: r.draco_coloured_bytes),
        ):
            for coder, value, marker in (("bodycast", ours, "o"), ("Draco", theirs, "x")):
                bits = [8 * float(np.mean([value(r) for r in chosen if r.wanted_d1_mm == d1])) / points for d1 in d1s]
                left.plot(d1s, bits, line, marker=marker, color=colour, label=f"{coder}, {name}, {points:,} points")
    cited = [(10 * d1, 8 * size / 10_000) for size, d1, _ in GPCC_BYTES]
    left.plot(*zip(*cited, strict=True), ":s", color=plots.SHELL, label="G-PCC, cited, with colours")
    left.set(xlabel="D1, mm", ylabel="bits a point", xscale="log", yscale="log")
    picture.legend(*left.get_legend_handles_labels(), fontsize=6, loc="outside lower center", ncols=3)
    shown = [r for r in residuals if r.d1_mm > 0]
    right.plot([r.bytes for r in shown], [r.d1_mm for r in shown], "-o", color=plots.OURS)
    for r in shown:
        right.annotate(r.residual, (r.bytes, r.d1_mm), fontsize=7, xytext=(3, 3), textcoords="offset points")
    right.set(xlabel="bytes a frame", ylabel="D1, mm", xscale="log", yscale="log", title="--residual")
    for axis in (left.xaxis, left.yaxis, right.xaxis, right.yaxis):
        axis.set_minor_formatter("")
        axis.set_major_formatter("{x:g}")
    left.set_xticks(D1_MM, labels=[f"{d1:g}" for d1 in D1_MM])
    left.set_yticks([2, 5, 10, 20], labels=["2", "5", "10", "20"])
    return picture
