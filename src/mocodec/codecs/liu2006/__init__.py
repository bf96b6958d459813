"""Segment-based human motion compression (Liu and McMillan, 2006), the whole method.

    motion ─► marker groups ─► normalisation ─► segments ─► PCA ─► key frames ─► integers ─► bytes
              normalisation,   body frame       PPCA        each   splines       quantised   entropy coded
              feet, others

    codec.py           settings, compression and decompression (figure 2), the blend at transitions
    marker_groups.py   normalisation markers, feet, other markers
    segment_model.py   the PCA models and key frames of one segment: fitting and bytes
    paper_tables.py    the counts of Table 2; global and piecewise PCA of Table 3

`docs/papers/liu2006.md` maps the paper to the code and lists the decisions where the paper leaves a choice open.
"""

from .codec import Liu2006
from .paper_tables import global_pca, piecewise_pca, statistics

__all__ = ["Liu2006", "global_pca", "piecewise_pca", "statistics"]
