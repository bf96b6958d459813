"""The compiled accelerator, `mocodec._native` (C++ in src/native), where it was built.

    kernel = native.kernel("tempo_encode")
    return kernel(…) if kernel else …          the same in NumPy, which is what defines the result

It costs nothing but speed to be without it. With MOCODEC_PURE=1 in the environment it is left aside.
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
    """The kernel of this name; None where it is not there, and the caller does it in NumPy."""
    return getattr(_module, name, None)


def available() -> bool:
    return _module is not None


@contextmanager
def without() -> Iterator[None]:
    """Within this context there is no kernel: for comparing both ways."""
    global _module
    module, _module = _module, None
    try:
        yield
    finally:
        _module = module
