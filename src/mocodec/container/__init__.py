"""Encoded to one `.mocz` file and back: `pack` or `Writer`, `Reader`. docs/format.md specifies the format."""

from __future__ import annotations

from .reader import Reader
from .writer import Writer, pack

__all__ = ["Reader", "Writer", "pack"]
