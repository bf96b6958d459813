"""Segment-based human motion compression (Liu and McMillan, 2006), in full.

    motion ──► roles ──► normalise ──► segments ──► PCA ──► key frames ──► numbers ──► bytes
               who is    body frame    PPCA cuts    each    splines        quantised   entropy coded

    codec.py    the method, as in the paper's flow chart (figure 2), and its inverse with the blend at transitions
    models.py   what is kept of one segment, fitted and stored
    roles.py    normalisation markers, feet, others
    rivals.py   global and piecewise PCA (Table 3), and the paper's counts of an encoded motion (Table 2)

`docs/papers/liu2006.md` says where each equation is and what was decided where the paper leaves a gap.
"""

from .codec import Liu2006
from .rivals import global_pca, piecewise_pca, statistics

__all__ = ["Liu2006", "global_pca", "piecewise_pca", "statistics"]
