"""Description of the machine and versions of a measurement."""

from __future__ import annotations

import os
import platform
from typing import Any

import numpy as np

from mocodec import __version__


def machine_description() -> dict[str, Any]:
    """Processor, number of cores, operating system and versions: stored with all results."""
    return {
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "mocodec": __version__,
    }


def measured_on(machine: dict[str, Any]) -> str:
    """A sentence with versions and machine, for reports."""
    return (
        f"Measured with mocodec {machine.get('mocodec', '?')}, Python {machine.get('python', '?')}, "
        f"NumPy {machine.get('numpy', '?')} on {machine.get('cores', '?')} cores ({machine.get('processor', '?')})."
    )
