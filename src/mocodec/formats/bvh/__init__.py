"""BVH: a joint hierarchy with channels, then one line of numbers per frame (Biovision).

    HIERARCHY   joints: OFFSET, CHANNELS in any order; End Sites ─┐
    MOTION      frames × channels, parsed as one block ───────────┴─► quaternions ─► forward kinematics ─► joints

Points are the joints and, as "<parent>_end", the End Sites: without these the rotations of the last joints would not
show in the positions. Position channels of a joint replace its OFFSET. `memory.py` is what `source` remembers of a
file, so that it is written back as it was, also after a codec has changed its rotations a little.
"""

from .reading import read
from .writing import write

__all__ = ["HOLDS", "read", "write"]

HOLDS = frozenset({"skeleton", "joint rotations"})
"""What a BVH stores beside the positions."""
