"""Packages of the [bench] extra, which the rivals need."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as version_of
from typing import Any

from mocodec.errors import MissingExtra


def needs(module: str) -> Any:
    """Import a module. Raises MissingExtra if it is not installed."""
    try:
        return import_module(module)
    except ImportError as missing:
        raise MissingExtra(f"the rival {module}", "bench") from missing


def installed_version(package: str) -> str:
    """The version of a package, or "not installed"."""
    try:
        return version_of(package)
    except PackageNotFoundError:
        return "not installed"
