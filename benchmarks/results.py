"""Result files: JSON with rounded numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mocodec import formats


def rounded(value: Any) -> Any:
    """JSON content with floats rounded to six significant digits; more digits are measurement noise."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    return [rounded(item) for item in value] if isinstance(value, list | tuple) else value


def write_json(path: Path, content: Any, indent: int | None = 1) -> None:
    """Replace a file by this content."""
    formats.replace_whole(path, (json.dumps(content, indent=indent) + "\n").encode())


def read_json(path: Path) -> Any:
    """The content of a file; None without a file."""
    return json.loads(path.read_text()) if path.is_file() else None
