"""The optional compiled module `mocodec._native` (C++ in src/native).

    if (kernel := native.kernel("tempo_encode")) is not None:
        return kernel(…)
    …                                           the same in NumPy, which defines the result

Without the module, or with MOCODEC_PURE=1 in the environment, everything works, only slower.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


def _load() -> Any:
    if os.environ.get("MOCODEC_PURE", "0") not in ("", "0"):
        return None
    try:
        return importlib.import_module("mocodec._native")
    except ImportError:
        return None


_module = _load()


def kernel(name: str) -> Callable[..., Any] | None:
    """The compiled function of this name, or None where there is none: the caller then uses NumPy."""
    return getattr(_module, name, None)


def available() -> bool:
    """Whether the compiled module is loaded."""
    return _module is not None


@contextmanager
def without() -> Iterator[None]:
    """A context in which `kernel` returns None, for tests that compare compiled and NumPy results."""
    global _module
    module, _module = _module, None
    try:
        yield
    finally:
        _module = module
