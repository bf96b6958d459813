"""python store.py RAW.json OUT.json: keep the measurements of pytest-benchmark, not the name of the machine."""

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
    for unit in ("frames", "symbols"):
        if unit in extra:
            record[f"{unit}_per_second"] = extra[unit] / median
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
