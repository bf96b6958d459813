"""Tempo, the codec of this project.

codec           settings; encode and decode, one verb a stage
preparation     gaps filled, y up, spikes found
repeats         frames that repeat                        header        the shared bytes: model and flags
model_choice    which model makes a recording smallest    models/       coordinates and statistics
target          steps for a target, about; a size         chunk         one chunk, both ways
equal_slopes    a mean error, shared among chunks         hard_bound    a bound
pose/           heading, leaps, bone directions           coding/       coefficients as bytes
fallback        hou2014 in place of the chunks            stream        live encoding and decoding

docs/tempo has how it works and its results, docs/payloads/tempo.md its bytes.
"""

from .codec import Tempo
from .stream import Decoder, Encoder

__all__ = ["Decoder", "Encoder", "Tempo"]
