"""`scripts/bench speed`: runs the speed benchmarks and stores their results."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click

from mocodec import __version__

from ..results import write_json

BENCHMARKS = Path(__file__).parent / "bench_speed.py"
OPTIONS = (
    "-p", "no:cacheprovider", "--benchmark-max-time=1", "--benchmark-columns=median,min,rounds",
    "--benchmark-sort=name",
)  # fmt: skip
SINGLE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


@click.command("speed", context_settings={"ignore_unknown_options": True})
@click.option("--store", is_flag=True, help=f"Also write docs/results/bench-{__version__}.json.")
@click.argument("pytest_arguments", nargs=-1, type=click.UNPROCESSED)
def command(store: bool, pytest_arguments: tuple[str, ...]) -> None:
    """Time codecs, entropy coder, readers, opening and start on one thread. Other arguments go to pytest: -k encode."""
    with tempfile.TemporaryDirectory() as folder:
        raw = Path(folder) / "raw.json"
        arguments = [sys.executable, "-m", "pytest", BENCHMARKS, *OPTIONS, f"--benchmark-json={raw}", *pytest_arguments]
        done = subprocess.run(arguments, env=os.environ | SINGLE_THREAD)
        if store and done.returncode == 0:
            path = Path(f"docs/results/bench-{__version__}.json")
            write_json(path, summary(json.loads(raw.read_text())))
            click.echo(f"wrote {path}")
    sys.exit(done.returncode)


def summary(raw: dict[str, Any]) -> dict[str, Any]:
    """The results of pytest-benchmark without data about the machine's owner: medians, rates, versions."""
    records = []
    for benchmark in raw["benchmarks"]:
        median, extra = benchmark["stats"]["median"], benchmark["extra_info"]
        name = benchmark["name"].removeprefix("test_")
        record = {"name": name, "median_s": median, "fastest_s": benchmark["stats"]["min"], **extra}
        for unit in ("frames", "symbols"):
            if unit in extra:
                record[f"{unit}_per_second"] = extra[unit] / median
        records.append(record)
    processor = raw["machine_info"]["cpu"].get("brand_raw", "unknown processor")
    about = {
        "command": "scripts/bench speed --store",
        "mocodec": __version__,
        "numpy": version("numpy"),
        "python": platform.python_version(),
        "machine": f"{platform.machine()} {platform.system()}, {processor}",
        "threads": 1,
    }
    return {"about": about, "benchmarks": records}
