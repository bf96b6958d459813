"""Tempo, the codec of this project. `tempo.py` has the flow; docs/tempo.md what was tried and what it gave."""

from .tempo import Tempo

__all__ = ["Tempo"]
