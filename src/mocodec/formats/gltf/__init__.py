"""GLB and glTF 2.0: animated skeletons, metres, y up.

    header, JSON, buffers ─► nodes, animations, skins ─► tracks sampled at one rate, 4 × 4 matrices ─► Motion

`read` takes one animation and the joints of one skin. `write` stores a node for each joint, a skin over them with a
mesh that shows the bones (or the body's surface, if it is given), and one animation: every frame, or sparse cubic keys.
"""

from .binary import Surface
from .reading import read
from .writing import write

__all__ = ["HOLDS", "Surface", "read", "write"]

HOLDS = frozenset({"skeleton", "joint rotations", "gltf"})
"""What a GLB stores beside the positions."""
