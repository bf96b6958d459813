"""The tables of docs/archive.md and docs/howto/learning.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mocodec import formats

from .. import markdown
from ..machine import measured_on

FOLDER = Path("docs/results")


def write(found: dict[str, Any], folder: Path = FOLDER) -> list[Path]:
    """Write every table whose part was measured; returns their paths."""
    paths: list[Path] = []
    for part, name, make in (
        ("sizes", "archive_sizes.md", sizes),
        ("windows", "archive_windows.md", windows),
        ("training", "archive_training.md", training),
        ("large", "archive_large.md", large),
        ("large", "archive_catalogue.md", catalogues),
        ("retrieval", "archive_retrieval.md", retrieval),
    ):
        if part in found:
            text = (
                f"{make(found[part])}\n\n{measured_on(found['machine'])} Times are of the processor, in one process.\n"
            )
            formats.replace_whole(folder / name, text.encode())
            paths.append(folder / name)
    return paths


def sizes(rows: list[dict[str, Any]]) -> str:
    head = ("archive", "recordings", "frames", "in shards", "of float32 positions", "as .mocz files")
    head += ("signals and extras", "names and lengths", "catalogue", "mean error", "largest", "built, frames/s")
    return markdown.table(
        head,
        [
            (
                "positions" if r["kind"] == "positions" else "with rotations",
                f"{r['recordings']:,}",
                f"{r['frames']:,}",
                f"{r['stored_bytes']:,}",
                f"{r['percent']:.3f} %",
                f"{r['bytes']:,}",
                f"{r['side_bytes']:,}",
                f"{r['shard_bytes'] - r['stored_bytes']:,}",
                f"{r['catalogue_bytes']:,}",
                f"{1e3 * r['mean_error']:.2f} mm",
                f"{1e3 * r['max_error']:.0f} mm",
                f"{r['frames_per_second']:,.0f}" if r["frames_per_second"] else "–",
            )
            for r in rows
        ],
    )


def windows(found: dict[str, Any]) -> str:
    head = ("from", "features", "rate", "windows/s, any order, in memory", "windows/s, a shuffled epoch from the start")
    body = [
        (
            {"archive": "archive", "npz": ".npz, compressed", "npy": ".npy, memory-mapped"}[r["source"]],
            ", ".join(r["features"]),
            f"{r['rate']:g} Hz" if r["rate"] else "120 Hz",
            f"{r['random']:,.0f}",
            f"{r['epoch']:,.0f}" if "epoch" in r else "–",
        )
        for r in found["rows"]
    ]
    memory = found["memory"]
    return (
        f"{markdown.table(head, body)}\n\nWindows of {found['frames']} frames, stride {found['stride']}, of 31 joints. "
        f"With a cache of 4 MB the process has at most {memory['after_one']:.0f} MB in the first epoch and "
        f"{memory['after_four']:.0f} MB after four."
    )


def training(rows: list[dict[str, Any]]) -> str:
    epochs = range(1, len(rows[0]["losses"]) + 1)
    head = ("windows from", *(f"epoch {epoch}" for epoch in epochs), "reading", "in all")
    body = [
        (
            r["source"],
            *(f"{1e4 * loss:.2f} cm²" for loss in r["losses"]),
            f"{r['reading_s']:.2f} s",
            f"{r['seconds']:.1f} s",
        )
        for r in rows
    ]
    return markdown.table(head, body)


def large(found: dict[str, Any]) -> str:
    head = ("frames", "recordings", "open", "query of the catalogue", "by name", "index", "load it")
    head += ("search for 4 s, with loading",)
    return markdown.table(
        head,
        [
            (
                f"{r['frames']:,}",
                f"{r['recordings']:,}",
                *(f"{r[name]:.1f} ms" for name in ("open_ms", "query_ms", "by_name_ms")),
                f"{r['index_bytes'] / 1e6:.1f} MB",
                *(f"{r[name]:.0f} ms" for name in ("load_ms", "search_ms")),
            )
            for r in found["steps"]
        ],
    )


def catalogues(found: dict[str, Any]) -> str:
    head = ("rows", "", "bytes", "open and query", "add a recording")
    body = [
        (
            f"{r['rows']:,}" if kind == "sqlite" else "",
            "SQLite" if kind == "sqlite" else "Parquet",
            f"{r[f'{kind}_bytes']:,}",
            f"{r[f'{kind}_query_ms']:.1f} ms",
            f"{r[f'{kind}_add_ms']:.1f} ms",
        )
        for r in found["catalogues"]
        for kind in ("sqlite", "parquet")
    ]
    return markdown.table(head, body)


def retrieval(rows: list[dict[str, Any]]) -> str:
    head = ("searched in", "by", "queries", "nearest is of the same kind", "of the nearest five")
    return markdown.table(
        head,
        [
            (
                "other subjects" if r["other_subjects"] else "all other trials",
                r["method"],
                r["queries"],
                f"{100 * r['first']:.0f} %",
                f"{100 * r['five']:.0f} %",
            )
            for r in rows
        ],
    )
