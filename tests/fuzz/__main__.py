"""Long runs: `scripts/fuzz [--minutes N] [--pure] [--motions N]`; the exit code is 1 if anything was found."""

from __future__ import annotations

import argparse
import platform
import sys
import tempfile
import time
from pathlib import Path

import mocodec
from mocodec import native

from . import campaign

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"


def main() -> int:
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=3.0, help="a third for each kind of call (default 3)")
    parser.add_argument("--pure", action="store_true", help="without the compiled module")
    parser.add_argument(
        "--asan", action="store_true", help="the compiled module with AddressSanitizer; memory without limit"
    )
    parser.add_argument(
        "--motions", type=int, metavar="N", help="only strange motions, N of them, however long it takes"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the mutations; for motions, the first number")
    parser.add_argument("--store", action="store_true", help="put the counts into docs/results")
    parser.add_argument("--findings", type=Path, default=Path(tempfile.gettempdir()) / "mocodec-fuzz", metavar="FOLDER")
    options = parser.parse_args()
    worker = campaign.Worker(options.pure, not options.asan)
    run = campaign.Campaign(worker, options.findings)
    start = time.perf_counter()
    if options.motions:
        run.run(campaign.code_calls(options.seed, options.motions), lambda: False)
    else:
        kinds = (
            campaign.read_calls(options.seed),
            campaign.decode_calls(options.seed),
            campaign.code_calls(options.seed),
        )
        for number, calls in enumerate(kinds, 1):
            stop = start + number / 3 * 60 * options.minutes
            run.run(calls, lambda stop=stop: time.perf_counter() > stop)
    worker.close()
    result = run.as_json(time.perf_counter() - start)
    result |= {"seed": options.seed, "version": mocodec.__version__}
    result |= {"python": platform.python_version(), "machine": platform.machine()}
    mode = "pure" if options.pure or not native.available() else "asan" if options.asan else "compiled"
    for kind, counts in result["calls"].items():
        print(f"{kind}: {counts}, slowest {result['slowest_seconds'][kind]} s")
    if options.store:
        campaign.store(RESULTS / ("strange_motions.json" if options.motions else "fuzz.json"), mode, result)
    return 1 if run.findings else 0


if __name__ == "__main__":
    sys.exit(main())
