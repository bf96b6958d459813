"""GLB: animated skeletons as binary glTF 2.0, metres, y up.

    header ─► JSON: nodes, animations, accessors ─► BIN: key times and values ─► sampled at one rate ─► Motion

`write` stores a node for each joint, joint rotations and the root's path as one animation and, if it is given, the
body's surface as coloured points that follow the joints. `read` takes the first animation.
"""

from .binary import Surface
from .reading import read
from .writing import write

__all__ = ["HOLDS", "Surface", "read", "write"]

HOLDS = frozenset({"skeleton", "joint rotations"})
"""What a GLB stores beside the positions."""
