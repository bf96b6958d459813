"""Mocap-tailored transform coding (Hou, Chau, Magnenat-Thalmann and He, 2014).

    clip M_i ──► DCT along time ──► basis across points ──► quantise ──► entropy code
                 M_i D̃             S_i = Bᵀ M_i D̃          integers     bytes

One basis B serves every clip and travels once, so that chunks of clips can be decoded alone. Read `codec` first, then
`drafts` (how a motion is coded at one step), `transform` (B on disk), `stream` (all other bytes), `database`
(Algorithm 1).
"""

from .codec import Hou2014
from .database import Hou2014Database, Learned

__all__ = ["Hou2014", "Hou2014Database", "Learned"]
