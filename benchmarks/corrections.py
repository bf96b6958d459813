"""Savings of a body-centred cubic lattice outside tempo's lattice engine: `scripts/bench corrections`.

    markers and joints ──► hou2014, liu2006: payloads with and without the lattice engine in their corrections
                      └──► tempo: upper limit of savings in corrections and in the direct engine

A cell of the body-centred cubic lattice has `SAVED_BITS` more volume than the cube in the same ball: no code for
lattice points saves more for each coded point, if the steps are as fine as the errors. Every payload is decoded and
its bound checked.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from mocodec.codecs.hou2014 import Hou2014
from mocodec.codecs.liu2006 import Liu2006
from mocodec.codecs.tempo import Tempo
from mocodec.codecs.tempo.chunk import DIRECT, TRANSFORM, Payload
from mocodec.codecs.tempo.coding import coefficients, corrections
from mocodec.codecs.tempo.header import StreamHeader
from mocodec.errors import CannotEncode
from mocodec.motion import Motion
from mocodec.stages import bounded

from . import datasets, results
from . import markdown as md
from .bounds import JOINTS, bare, largest_distance, marker_files
from .machine import machine_description
from .tempo import geometric

RESULTS, TABLE = Path("docs/results/corrections.json"), Path("docs/results/corrections.md")
BOUNDS_M = (0.0001, 0.0005, 0.001, 0.005)
MOST_FRAMES = 400
"""Frames from the middle of each recording."""
SAVED_BITS = float(np.log2(32 / 5**1.5) - np.log2((4 / 3) ** 1.5))
NEVER = 2.0
"""A share of samples that no recording reaches."""


def coded_bytes(codec: type[Hou2014 | Liu2006], motion: Motion, bound: float, with_engine: bool) -> int | None:
    """Payload bytes, None if the codec refuses the bound. Raises ValueError if a payload breaks it."""
    usual = bounded.ENGINE_FROM
    bounded.ENGINE_FROM = usual if with_engine else NEVER
    try:
        encoded = codec(max_error=bound).encode(motion)
    except CannotEncode:
        return None
    finally:
        bounded.ENGINE_FROM = usual
    if not largest_distance(motion.positions, codec.decode(encoded).positions) <= bound:
        raise ValueError(f"{codec.name}: an error beyond {bound} m")
    return encoded.payload_bytes


def of_tempo(motion: Motion, bound: float, model: str) -> dict[str, int]:
    """Bytes of the payload and of its directly coded chunks, and the number of corrections; without deduplication."""
    encoded = Tempo(max_error=bound, model=model).encode_without_repeats(motion)
    header = StreamHeader.unpack(encoded.shared, motion.points)
    found = {"bytes": encoded.payload_bytes, "direct_bytes": 0, "corrections": 0}
    for chunk in encoded.chunks if header.fallback is None else ():
        payload = Payload.unpack(chunk.payload)
        if payload.engine == DIRECT:
            found["direct_bytes"] += len(chunk.payload)
        elif payload.engine == TRANSFORM:
            frames, data = [chunk.frames], [payload.numbers]
            (numbers,) = coefficients.unpack(header.read_model(encoded.about), frames, data, corrections.FIELDS)
            found["corrections"] += numbers.lists.shape[-1]
    return found


def of_recording(name: str, kind: str, motion: Motion) -> Iterator[dict[str, Any]]:
    """Yields a record for each bound."""
    for bound in BOUNDS_M:
        layers = {
            codec.name: {way: coded_bytes(codec, motion, bound, way == "engine") for way in ("cubic", "engine")}
            for codec in (Hou2014, Liu2006)
        }
        yield {
            "file": name, "kind": kind, "frames": len(motion), "points": motion.points, "max_error_m": bound,
            **layers, "tempo": of_tempo(motion, bound, "auto"), "transform": of_tempo(motion, bound, "transform"),
        }  # fmt: skip


def share(record: Mapping[str, Any], codec: str) -> float | None:
    """Bytes with the lattice engine over bytes without."""
    cell = record[codec]
    return cell["engine"] / cell["cubic"] if cell["engine"] and cell["cubic"] else None


def saved_by_corrections(record: Mapping[str, Any]) -> float:
    """Upper limit of the share of the transform's payload that the lattice could save in its corrections."""
    return SAVED_BITS / 8 * record["transform"]["corrections"] / record["transform"]["bytes"]


def tables(records: Sequence[Mapping[str, Any]]) -> str:
    """The tables of docs/architecture.md."""
    head = ["", *(f"{1000 * b:g} mm" for b in BOUNDS_M)]
    rows: list[list[str]] = []
    for codec in ("hou2014", "liu2006"):
        for kind in ("markers", "joints"):
            cells = [[s for r in at(records, b, kind) if (s := share(r, codec)) is not None] for b in BOUNDS_M]
            rows.append([f"{codec}, {kind}", *(f"{geometric(c):.2f} ({min(c):.2f})" for c in cells)])
    lines = ["Bytes with the lattice engine in the corrections over bytes without: geometric mean (least).", ""]
    lines += [md.table(head, rows), ""]
    lines += [
        "What the lattice saves at most in corrections of tempo's transform, and the share of bytes that tempo codes"
    ]
    lines += ["directly: mean (largest).", ""]
    rows = []
    for kind in ("markers", "joints"):
        cells = [[saved_by_corrections(r) for r in at(records, b, kind)] for b in BOUNDS_M]
        rows.append(
            [f"saved in corrections, {kind}", *(f"{100 * np.mean(c):.1f} % ({100 * max(c):.1f} %)" for c in cells)]
        )
    for kind in ("markers", "joints"):
        cells = [[r["tempo"]["direct_bytes"] / r["tempo"]["bytes"] for r in at(records, b, kind)] for b in BOUNDS_M]
        rows.append([
            f"direct, {kind}", *(f"{100 * np.mean(c):.1f} % ({100 * max(c):.1f} %)" for c in cells)
        ])  # fmt: skip
    return "\n".join([*lines, md.table(head, rows), ""])


def at(records: Sequence[Mapping[str, Any]], bound: float, kind: str) -> list[Mapping[str, Any]]:
    return [r for r in records if r["max_error_m"] == bound and r["kind"] == kind]


@click.command("corrections")
@click.option("--data", type=click.Path(path_type=Path), default=datasets.SHARED, help="Folder of the recordings.")
@click.option("--only", default="", help="Only files whose name contains this; print instead of storing.")
@click.option("--draw", is_flag=True, help="Only draw the tables again.")
def command(data: Path, only: str, draw: bool) -> None:
    """Measure the lattice engine in corrections under a hard bound; write docs/results/corrections.json."""
    stored = results.read_json(RESULTS) or {"records": []}
    if not draw:
        recordings = [(name, "markers", motion) for name, motion in marker_files(data)]
        recordings += [
            (Path(path).name, "joints", bare(datasets.labelled(data / path, data).load())) for path in JOINTS
        ]
        records: list[dict[str, Any]] = []
        for name, kind, motion in recordings:
            first = max(0, (len(motion) - MOST_FRAMES) // 2)
            motion = motion[first : first + MOST_FRAMES]
            for record in of_recording(name, kind, motion) if only in name else ():
                records.append(record)
                click.echo(
                    f"{name} {1000 * record['max_error_m']:g} mm: {record['hou2014']} {record['liu2006']}"
                    f" corrections {saved_by_corrections(record):.4f} {record['tempo']}"
                )
        if only:
            return
        stored = {"records": results.rounded(records), "machine": machine_description()}
        results.write_json(RESULTS, stored)
    TABLE.write_text(tables(stored["records"]))
