# pyright: strict
"""Libraries that are optional: imported when they are used, with an error that names the extra."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ..errors import MissingExtra


def library(module: str, what: str, extra: str) -> Any:
    """The module. what: the function that needs it, for the message. Raises MissingExtra if it is not installed."""
    try:
        return import_module(module)
    except ImportError:
        raise MissingExtra(what, extra) from None
