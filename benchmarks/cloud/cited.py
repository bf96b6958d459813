"""Results of other systems on point clouds of people, from their papers or from runs elsewhere."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Cited:
    """A result from elsewhere: system, data, compression ratio; D1 and D2 in metres and the PSNR of rendered views in
    dB, None if unknown.
    """

    system: str
    data: str
    ratio: float
    d1_m: float | None
    d2_m: float | None
    views_psnr_db: float | None


SPARSE = "10,000 fresh points a frame"
DENSE = "151,000 points on a 4.1 mm grid"
PAPER = "Lien and Bajcsy 2006, tables 1 and 2"
CITED_FLOOR_DB, CITED_FLOOR_M = 26.8, 0.0078
"""Scores of a second perfect sample on the sparse recording: views in dB, D1 in metres."""

CITED = (
    Cited("G-PCC, scale ½", SPARSE, 13, 0.0027, 0.0016, 30),
    Cited("G-PCC, scale ¼", SPARSE, 20, 0.0044, 0.0026, 28),
    Cited("G-PCC, scale ⅛", SPARSE, 55, 0.0083, 0.0052, 26),
    Cited("G-PCC, lossless geometry, qp 40", DENSE, 110, 0.0, 0.0, 36.5),
    Cited("G-PCC, scale ½", DENSE, 244, 0.0050, 0.0027, 29.4),
    Cited("G-PCC, scale ¼", DENSE, 692, 0.0087, 0.0055, 27.3),
    Cited("V-PCC TMC2 r3", DENSE, 147, 0.0029, 0.0020, 29.5),
    Cited("V-PCC TMC2 r1", DENSE, 375, 0.0042, 0.0031, 28.0),
    Cited("uvgVPCCenc fast", DENSE, 134, 0.0039, 0.0033, 26.9),
    Cited("uvgVPCCenc fast", DENSE, 301, 0.0068, 0.0063, 25.0),
    *(Cited(f"Lien 2006, {what}, {motion}", PAPER, ratio, None, None, psnr)
      for what, row in (
          ("no residuals", ((1490.31, 23.87), (3581.52, 24.10), (5839.59, 25.82), (5664.55, 26.27))),
          ("25 % residuals", ((195.62, 25.77), (173.52, 26.18), (183.80, 27.96), (183.82, 28.75))),
          ("100 % residuals", ((66.54, 27.95), (55.33, 28.27), (60.29, 29.91), (61.43, 30.83))),
          ("Yang et al. beside it", ((11.36, None), (11.73, None), (10.23, None), (14.41, None))),
          ("H.264 beside it", ((64.04, None), (53.78, None), (32.04, None), (49.58, None))),
      )
      for motion, (ratio, psnr) in zip(("dancer 1", "dancer 2", "student", "tai-chi"), row, strict=True)),
)  # fmt: skip
"""Reference software, run on a MakeHuman body in CMU motion at 15 frames a second; then the results of the paper."""

GPCC_BYTES = ((11_600, 0.27, 0.16), (7350, 0.44, 0.26), (2720, 0.83, 0.52))
"""G-PCC on the sparse recording: bytes per frame, D1 and D2 in centimetres. The floor there is 0.78 and 0.12 cm."""
