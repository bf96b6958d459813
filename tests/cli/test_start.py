"""`mocodec --help` imports no slow module: a command imports those when it needs them."""

from __future__ import annotations

import subprocess
import sys

HEAVY = ("scipy", "rich", "matplotlib", "ezc3d", "asyncio")


def test_help_imports_nothing_heavy() -> None:
    code = f"import sys, mocodec.cli as c; c.run(['encode', '--help']); print([m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
