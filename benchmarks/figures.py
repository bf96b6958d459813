"""Matplotlib figures: a backend without windows, and readable logarithmic axes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mocodec.errors import MissingExtra


def pyplot() -> Any:
    """matplotlib.pyplot without windows. Raises MissingExtra if Matplotlib is not installed."""
    try:
        import matplotlib
    except ImportError:
        raise MissingExtra("drawing figures", "plot") from None
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def short_number(value: float) -> str:
    """A tick label: 0.2, 50, 20k, 1M."""
    for unit, letter in ((1e6, "M"), (1e3, "k")):
        if value >= unit:
            return f"{value / unit:g}{letter}"
    return f"{value:g}"


def set_logarithmic(axes: Any, which: str = "xy") -> None:
    """Make these axes logarithmic, with plain numbers at 1, 2 and 5 times powers of ten, and a grid."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for letter in which:
        getattr(axes, f"set_{letter}scale")("log")
        axis = getattr(axes, f"{letter}axis")
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: short_number(value)))
        axis.set_minor_formatter(NullFormatter())
    axes.grid(True, which="both", alpha=0.2)


def remove_frame(axes: Any) -> None:
    """A light grid and no top and right border."""
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def save_png(figure: Any, path: Path, dpi: int = 120) -> None:
    """Write a pyplot figure and close it; equal figures give equal bytes."""
    figure.savefig(path, dpi=dpi, metadata={"Software": None})
    pyplot().close(figure)
