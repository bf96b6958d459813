"""Tempo, the codec of this project. `tempo.py` has the flow; docs/tempo.md what was tried and what it gave."""

from .stream import Decoder, Encoder
from .tempo import Tempo

__all__ = ["Decoder", "Encoder", "Tempo"]
