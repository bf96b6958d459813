"""The tables of docs/archive.md and docs/howto/learning.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mocodec import formats

from .. import markdown
from ..machine import measured_on

FOLDER = Path("docs/results")


def write(found: dict[str, Any], folder: Path = FOLDER) -> list[Path]:
    """Write the tables of all measured parts; returns their paths."""
    paths: list[Path] = []
    for part, name, make in (
        ("sizes", "archive_sizes.md", sizes),
        ("windows", "archive_windows.md", windows),
        ("training", "archive_training.md", training),
        ("large", "archive_large.md", large),
        ("large", "archive_catalogue.md", catalogues),
        ("retrieval", "archive_retrieval.md", retrieval),
        ("priors", "archive_prior.md", priors),
        ("parallel", "archive_parallel.md", parallel),
        ("clusters", "archive_clusters.md", clusters),
    ):
        if part in found:
            times = "the clock" if part == "parallel" else "the processor, in one process"
            text = f"{make(found[part])}\n\n{measured_on(found['machine'])} Times are of {times}.\n"
            formats.replace_whole(folder / name, text.encode())
            paths.append(folder / name)
    if {"sizes", "large", "clusters"} <= found.keys():
        path = folder / "archive_scale.md"
        formats.replace_whole(path, f"{scale(found)}\n".encode())
        paths.append(path)
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


def priors(rows: list[dict[str, Any]]) -> str:
    head = ("mean error", "people", "recordings", "frames", "general prior", "own prior", "prior of both")
    cases = {(r["mean_error"], tuple(r["people"])): r for r in rows}
    body = []
    for (mean_error, people), one in sorted(cases.items()):
        found = {r["prior"]: r for r in rows if (r["mean_error"], tuple(r["people"])) == (mean_error, people)}
        sizes_ = [found[kind]["bytes"] for kind in ("general", "own", "both")]
        body.append(
            (
                f"{1e3 * mean_error:g} mm",
                ", ".join(people),
                one["unseen"],
                f"{one['unseen_frames']:,}",
                f"{sizes_[0]:,} bytes",
                *(f"{100 * (size / sizes_[0] - 1):+.1f} %" for size in sizes_[1:]),
            )
        )
    return (
        f"{markdown.table(head, body)}\n\nThe general prior is learned from all other people, the own one from every "
        "second recording of these people, the third from both. Recordings are encoded without rotations."
    )


def parallel(rows: list[dict[str, Any]]) -> str:
    head = ("work", "one worker", "two workers", "times faster", "efficiency")
    body = [
        (
            r["work"],
            f"{r['one_s']:.1f} s",
            f"{r['two_s']:.1f} s",
            f"{r['one_s'] / r['two_s']:.2f}",
            f"{r['efficiency']:.2f}",
        )
        for r in rows
    ]
    return markdown.table(head, body)


def clusters(found: dict[str, Any]) -> str:
    head = (
        "search of",
        "clusters looked at",
        "vectors compared",
        "time",
        "same nearest part",
        "same of the nearest ten",
    )
    body = [
        (
            f"{found['frames']:,} frames",
            f"{r['probed']} of {found['clusters']:,}" if r["probed"] else "all, without clusters",
            f"{100 * r['compared']:.1f} %",
            f"{r['ms']:.0f} ms",
            f"{100 * r['nearest']:.0f} %",
            f"{100 * r['ten']:.0f} %",
        )
        for r in found["rows"]
    ]
    return markdown.table(head, body)


BILLION = 1_000_000_000


def scale(found: dict[str, Any]) -> str:
    """Sizes and times at the measured number of frames, and scaled in proportion to a billion frames."""
    steps, rows = found["large"]["steps"][-1], found["large"]["catalogues"][-1]
    times = BILLION / steps["frames"]
    sizes_ = found["sizes"][0]
    bytes_ = [sizes_["stored_bytes"] / sizes_["frames"] * frames for frames in (steps["frames"], BILLION)]
    per_row, recordings = rows["sqlite_bytes"] / rows["rows"], steps["recordings"]
    query = rows["sqlite_query_ms"] / rows["rows"]
    few = next(r for r in found["clusters"]["rows"] if r["probed"])
    body = [
        ("recordings", f"{recordings:,}", f"{times * recordings:,.0f}"),
        ("shards", f"{bytes_[0] / 1e6:.0f} MB", f"{bytes_[1] / 1e9:.1f} GB, {-(-bytes_[1] // (256 << 20)):.0f} files"),
        ("catalogue", f"{per_row * recordings / 1e6:.1f} MB", f"{times * per_row * recordings / 1e6:.0f} MB"),
        ("open; a recording by name", f"{steps['open_ms']:.1f} ms; {steps['by_name_ms']:.2f} ms", "the same"),
        ("query of all rows", f"{query * recordings:.1f} ms", f"{times * query * recordings / 1e3:.2f} s"),
        ("similarity index", f"{steps['index_bytes'] / 1e6:.0f} MB", f"{times * steps['index_bytes'] / 1e9:.1f} GB"),
        ("search of the whole index", f"{steps['search_ms']:.0f} ms", f"{times * steps['search_ms'] / 1e3:.0f} s"),
        (
            f"vectors that a search of {few['probed']} clusters of {found['clusters']['clusters']:,} compares",
            f"{few['compared'] * found['clusters']['vectors']:,.0f}",
            f"{times * few['compared'] * found['clusters']['vectors']:,.0f}",
        ),
    ]
    return markdown.table(("", f"{steps['frames']:,} frames, measured", "1,000,000,000 frames, in proportion"), body)
