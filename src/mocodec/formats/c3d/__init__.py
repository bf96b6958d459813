"""C3D: markers, analog channels, events and parameters of a capture (www.c3d.org, the user guide of 2008).

    512-byte header · parameter section · data: per frame, 4 words a point (x y z, cameras and residual), then analog
                      └─ read into a tree       └─ NumPy views of the file's bytes

Every count is checked against the file's size before anything is allocated. Intel, DEC and MIPS files, integer and
float, are read; Intel float files are written. docs/formats.md lists what is kept.
"""

from .analog import analog
from .model_outputs import model_outputs
from .reading import read
from .writing import write

__all__ = ["HOLDS", "analog", "model_outputs", "read", "write"]

HOLDS = frozenset(
    {
        "analog",
        "events",
        "model_outputs",
        "parameters",
        "parameter_notes",
        "parameters_locked",
        "residuals",
        "rotations",
        "zero_samples",
    }
)
"""Extras that a C3D stores beside the positions."""
