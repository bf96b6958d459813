"""Mocap-tailored transform coding (Hou, Chau, Magnenat-Thalmann and He, 2014).

    clip M_i ──► DCT along time ──► left transform across points ──► quantise ──► entropy code
                 M_i D̃             S_i = Bᵀ M_i D̃                   integers     bytes

All clips share one left transform B, stored once, so each chunk of clips decodes without the other chunks.

    codec               the ways of encoding, and decoding
    settings            what can be set, and where a search begins
    motion_encoder      encoding of a motion (figure 6) and the searches for a target
    decoding            bytes ─► positions
    quantised_motion    positions ─► quantised coefficients at one quantisation step
    clip_segmentation   clip lengths, the step of each clip, grouping of clips into chunks
    left_transform      B: fitting, rounding, bytes
    stream              all other bytes
    database            K left transforms for many recordings (Algorithm 1)
    analysis            the measurements of section III
"""

from .codec import Hou2014
from .database import Hou2014Database, LearnedTransforms

__all__ = ["Hou2014", "Hou2014Database", "LearnedTransforms"]
