"""`scripts/bench speed-published`: hou2014 and liu2006 to a mean error, on one thread.

    recordings ─each codec at each mean error─► median of runs ─► docs/results/speed_published.json, speed_published.md

Times are processor times.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

import mocodec as mc
from mocodec import native
from mocodec.codecs.hou2014 import Hou2014
from mocodec.codecs.liu2006 import Liu2006

from ..machine import machine_description
from ..markdown import table
from ..results import read_json, rounded, write_json
from .against_sz3 import ENCODING_RUNS, RUNS, seconds
from .recordings import DATA

RESULTS, PAGE = Path("docs/results/speed_published.json"), Path("docs/results/speed_published.md")
RECORDINGS = (("31 joints", "cmu/asfamc/01/01_01.amc"), ("41 markers", "cmu/c3d/85_12.c3d"))
MEAN_ERRORS = (0.001, 0.003, 0.01)
CODECS = (Hou2014, Liu2006)


def measure(label: str, path: str) -> list[dict[str, Any]]:
    """Frames a second of both codecs at each mean error, and without the compiled module."""
    motion = replace(mc.read(DATA / path, mc.Motion), rotations=None, extras={})
    frames, found = len(motion), list[dict[str, Any]]()
    for codec in CODECS:
        for target in MEAN_ERRORS:
            settings = codec(mean_error=target)
            encoded = settings.encode(motion)
            case = {
                "label": label,
                "frames": frames,
                "codec": codec.name,
                "mean_error": target,
                "bytes": encoded.payload_bytes,
                "encode": frames / seconds(lambda s=settings: s.encode(motion), ENCODING_RUNS),
                "decode": frames / seconds(lambda c=codec, e=encoded: c.decode(e), RUNS),
            }
            with native.without():
                case["decode_numpy"] = frames / seconds(lambda c=codec, e=encoded: c.decode(e), ENCODING_RUNS)
            found.append(case)
            click.echo(
                f"{label}, {codec.name}, {1000 * target:g} mm: {case['encode']:,.0f} in, {case['decode']:,.0f} out"
            )
    return found


def page(results: dict[str, Any]) -> str:
    """The table of docs/performance.md."""
    rows = [
        [
            c["label"], c["codec"], f"{1000 * c['mean_error']:g} mm", f"{c['bytes']:,}", f"{c['encode']:,.0f}",
            f"{c['decode']:,.0f}", f"{c['decode_numpy']:,.0f}",
        ]
        for c in results["cases"]
    ]  # fmt: skip
    machine = results["machine"]
    return "\n\n".join(
        [
            "Frames a second on one thread, median of processor time:",
            table(["recording", "codec", "mean error", "bytes", "encode", "decode", "decode, NumPy alone"], rows),
            f"Measured with mocodec {machine['mocodec']}, Python {machine['python']}, NumPy {machine['numpy']}, on "
            f"{machine['cores']} cores with a load of {results['load']:.0f} by other work.",
        ]
    )


@click.command("speed-published")
@click.option("--table-only", is_flag=True, help="Write the table from the stored results.")
def command(table_only: bool) -> None:
    """Measure the published codecs; write docs/results/speed_published.json and speed_published.md."""
    if not table_only:
        cases = [case for label, path in RECORDINGS if (DATA / path).exists() for case in measure(label, path)]
        write_json(RESULTS, rounded({"cases": cases, "load": os.getloadavg()[0], "machine": machine_description()}))
    PAGE.write_text(page(read_json(RESULTS)) + "\n")
    click.echo(f"wrote {RESULTS} and {PAGE}")
