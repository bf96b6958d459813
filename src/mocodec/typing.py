# pyright: strict
"""Types of arrays, named once for the whole project."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
"""Samples of pictures, colours (…, 3), single bits: the shape says which."""
YCoCg = NDArray[np.int16]
"""Colours (…, 3) as Y, Co and Cg of YCoCg-R."""
AnyInteger = NDArray[Any]
"""Integers of any width."""
