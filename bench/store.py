"""python store.py RAW.json OUT.json: what a run of pytest-benchmark measured, without what names a machine."""

from __future__ import annotations

import json
import platform
import sys
from importlib.metadata import version
from pathlib import Path

raw = json.loads(Path(sys.argv[1]).read_text())
records = []
for b in raw["benchmarks"]:
    median = b["stats"]["median"]
    extra = b["extra_info"]
    record = {"name": b["name"].removeprefix("test_"), "median_s": median, "fastest_s": b["stats"]["min"], **extra}
    for what in ("frames", "symbols"):
        if what in extra:
            record[f"{what}_per_second"] = extra[what] / median
    records.append(record)
processor = raw["machine_info"]["cpu"].get("brand_raw", "unknown processor")
about = {
    "command": "scripts/bench --store",
    "mocodec": version("mocodec"),
    "numpy": version("numpy"),
    "python": platform.python_version(),
    "machine": f"{platform.machine()} {platform.system()}, {processor}",
    "threads": 1,
}
Path(sys.argv[2]).write_text(json.dumps({"about": about, "benchmarks": records}, indent=1) + "\n")
