"""Archives of a million and ten million frames: opening, queries, similarity; SQLite against Parquet.

Rows are those of the CMU archive with other names, subjects and lengths. The index has vectors of real clips, played
faster or slower, scaled and mirrored, up to a million frames; ten million repeat these with noise.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from mocodec import archive
from mocodec.archive import similarity
from mocodec.archive.catalogue import Catalogue
from mocodec.archive.rows import Row
from mocodec.motion import Motion

FRAMES = (1_000_000, 10_000_000)
CONDITION = "subject == 86 and seconds > 10"
REPEATS = 9


def measure(vault: Path, folder: Path) -> dict[str, Any]:
    """Milliseconds of each step, medians, by the number of frames; bytes and times of catalogues."""
    return {
        "steps": [steps(vault, folder, frames) for frames in FRAMES],
        "catalogues": [catalogues(vault, folder, count) for count in (10_000, 100_000)],
    }


def milliseconds(work: Callable[[], Any]) -> float:
    """The median time of a call, milliseconds of processor time."""
    times = []
    for _ in range(REPEATS):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return float(1e3 * np.median(times))


def varied_rows(vault: Path, count: int | None = None, frames: int | None = None) -> Iterator[Row]:
    """Rows like those of an archive: `count` rows, or until they have `frames` frames together."""
    random = np.random.default_rng(0)
    with archive.open_archive(vault) as db:
        rows = list(db.rows())
    made, total = 0, 0
    while (count is None or made < count) and (frames is None or total < frames):
        row = rows[made % len(rows)]
        subject, length = made // 40, int(row.frames * random.uniform(0.7, 1.4))
        name = f"{subject:03}/{subject:03}_{made % 40:02}"
        yield replace(
            row,
            name=name,
            stem=name[4:],
            subject=subject,
            trial=made % 40,
            path=f"{name}.amc",
            origin=f"/vault/{name}.amc",
            frames=length,
            seconds=length / row.rate,
            block=0,
            stored_bytes=row.bytes,
            content=hashlib.sha256(f"content {name}".encode()).hexdigest()[:32],
            source_hash=hashlib.sha256(f"source {name}".encode()).hexdigest()[:32],
        )
        made, total = made + 1, total + length


def filled(folder: Path, rows: Iterator[Row]) -> int:
    """Write a catalogue of these rows; returns their number."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "catalogue.sqlite").unlink(missing_ok=True)
    catalogue, count = Catalogue(folder, create=True), 0
    with catalogue.transaction():
        for row in rows:
            catalogue.put(row)
            count += 1
    catalogue.close()
    return count


def steps(vault: Path, folder: Path, frames: int) -> dict[str, Any]:
    """Times of opening, of a query of the catalogue, and of a search for a clip."""
    where = folder / f"frames_{frames}"
    count = filled(where, varied_rows(vault, frames=frames))

    def opened() -> None:
        with archive.open_archive(where) as db:
            len(db)

    with archive.open_archive(where) as db:
        name = db.names[count // 2]
        result = {
            "frames": frames,
            "recordings": count,
            "open_ms": milliseconds(opened),
            "query_ms": milliseconds(lambda: list(db.query(CONDITION))),
            "by_name_ms": milliseconds(lambda: db.entry(name)),
        }
        query, found = similar(vault, frames, db.names)
        (where / similarity.FOLDER).mkdir(exist_ok=True)
        path = where / similarity.FOLDER / "all.npz"
        path.write_bytes(found.pack())
        result |= {
            "vectors": len(found.vectors),
            "index_bytes": path.stat().st_size,
            "load_ms": milliseconds(lambda: similarity.Index.read(path)),
            "search_ms": milliseconds(lambda: archive.search(db, query)),
        }
    return result


def similar(vault: Path, frames: int, names: list[str]) -> tuple[Motion, similarity.Index]:
    """A query of 4 s, and an index of varied clips with this many frames."""
    random = np.random.default_rng(0)
    with archive.open_archive(vault) as db:
        base = similarity.Index.read(next((vault / similarity.FOLDER).glob("*.npz")))
        motions = [entry.open()[:] for entry in db]
    query = motions[0][240:720]
    vectors, lengths, total = list[Any](), list[int](), 0
    most = min(frames, FRAMES[0])
    while total < most:
        motion = motions[len(lengths) % len(motions)]
        speed = random.uniform(0.7, 1.4)
        mirrored = random.choice([-1.0, 1.0])
        positions = motion.positions * random.uniform(0.9, 1.1) * [mirrored, 1, 1]
        varied = Motion(positions, motion.rate * speed, motion.names, motion.up)
        part = (similarity.windows(varied, base.pose) - base.mean) @ base.basis.T
        vectors.append(part)
        lengths.append(len(part))
        total += len(motion)
    whole = np.concatenate(vectors).astype(np.float32)
    again = round(frames / most)
    noise = random.normal(0, 0.01, (again, 1, whole.shape[1])).astype(np.float32)
    whole = (whole[None] + noise * (np.arange(again) > 0)[:, None, None]).reshape(-1, whole.shape[1])
    lengths = lengths * again
    used = [names[i % len(names)] for i in range(len(lengths))]
    first = np.concatenate([[0], np.cumsum(lengths)])
    return query, replace(base, names=tuple(used), contents=tuple(used), first=first, vectors=whole)


def catalogues(vault: Path, folder: Path, count: int) -> dict[str, Any]:
    """SQLite and Parquet with the same rows: bytes, and times of opening with a query and of adding one row."""
    import pyarrow  # pyright: ignore[reportMissingImports]
    import pyarrow.compute as compute  # pyright: ignore[reportMissingImports]
    import pyarrow.parquet as parquet  # pyright: ignore[reportMissingImports]

    rows = list(varied_rows(vault, count=count))
    where = folder / f"rows_{count}"
    filled(where, iter(rows))
    table = pyarrow.Table.from_pylist([asdict(row) for row in rows])
    path = where / "catalogue.parquet"
    parquet.write_table(table, path, compression="zstd")

    def by_sqlite() -> None:
        with archive.open_archive(where) as db:
            list(db.query(CONDITION))

    def by_parquet() -> None:
        chosen = (compute.field("subject") == 86) & (compute.field("seconds") > 10)
        parquet.read_table(path, filters=chosen).to_pylist()

    def add_to_sqlite() -> None:
        catalogue = Catalogue(where)
        with catalogue.transaction():
            catalogue.put(rows[count // 2])
        catalogue.close()

    def add_to_parquet() -> None:
        parquet.write_table(parquet.read_table(path), where / "new.parquet", compression="zstd")

    return {
        "rows": count,
        "sqlite_bytes": (where / "catalogue.sqlite").stat().st_size,
        "parquet_bytes": path.stat().st_size,
        "sqlite_query_ms": milliseconds(by_sqlite),
        "parquet_query_ms": milliseconds(by_parquet),
        "sqlite_add_ms": milliseconds(add_to_sqlite),
        "parquet_add_ms": milliseconds(add_to_parquet),
    }
