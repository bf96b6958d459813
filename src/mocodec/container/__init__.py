"""Encoded to one `.mocz` file and back: `pack` or `Writer`, `Reader`. docs/format.md specifies the format."""

from __future__ import annotations

from .reader import Reader
from .writer import Writer, extras_bytes, pack

__all__ = ["Reader", "Writer", "extras_bytes", "pack"]
