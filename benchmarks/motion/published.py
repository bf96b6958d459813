"""Printed results of systems that are not available here; the charts show them as hollow marks.

Ratios are against float32 positions unless the note says otherwise; errors are mean Euclidean distances in metres.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Published:
    """One printed result: system, sequence, ratio at a mean error, source, and a note."""

    system: str
    sequence: str
    ratio: float
    mean_error_m: float
    source: str
    note: str = ""


HOU = "Hou et al. 2014, Table IV"
LIN = "Hou et al. 2014, Table IV, after Lin et al. 2011"
CURVECODEC = "arXiv 2610.04211, estimated for CMU 13_29"

PUBLISHED = (
    Published("Hou 2014", "15_04", 45.7, 0.0012, HOU),
    Published("Hou 2014", "15_04", 114.1, 0.0029, HOU),
    Published("Hou 2014", "17_08", 35.0, 0.0015, HOU),
    Published("Hou 2014", "17_08", 93.8, 0.0037, HOU),
    Published("Hou 2014", "17_10", 14.2, 0.0022, HOU),
    Published("Hou 2014", "17_10", 63.2, 0.0107, HOU),
    Published("Hou 2014", "85_12", 16.1, 0.0012, HOU),
    Published("Hou 2014", "85_12", 59.3, 0.0084, HOU),
    Published("Lin 2011", "15_04", 114.7, 0.0186, LIN),
    Published("Lin 2011", "17_08", 91.2, 0.0152, LIN),
    Published("Lin 2011", "17_10", 62.6, 0.0265, LIN),
    Published("Lin 2011", "85_12", 60.1, 0.0501, LIN),
    Published("Arikan 2006", "15_04", 42.5, 0.0230, LIN),
    Published("Arikan 2006", "17_08", 30.0, 0.0163, LIN),
    Published("Arikan 2006", "17_10", 9.2, 0.0316, LIN),
    Published("Arikan 2006", "85_12", 11.1, 0.0478, LIN),
    Published("CurveCodec 2", "13_29", 77.0, 0.00095, CURVECODEC, "skeleton and rotations only"),
    Published("CurveCodec 2", "13_29", 259.0, 0.0030, CURVECODEC, "skeleton and rotations only"),
)
