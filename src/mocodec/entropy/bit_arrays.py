"""Arrays of bits through the adaptive binary coder of `adaptive_bits`, one array after the other.

    bits (n,), contexts (n, 5) ──BitEncoder.code──► bytes ──BitDecoder.code──► the same bits

Both classes have the same method `code`, which returns the bits: a function that codes something runs unchanged in the
encoder, where it knows the bits, and in the decoder, where it does not.

`BitCheck` decodes the bytes of an encoder that is still coding, and compares the bits.
"""

from __future__ import annotations

import copy
from typing import Any, NamedTuple, Protocol

import numpy as np

from .. import native
from ..errors import Corrupt
from ..typing import AnyInteger, Booleans
from .adaptive_bits import INPUTS, Decoder, Encoder, Mixer, tables

CUT_OFF = "a stream of adaptive bits is cut off or damaged"
DIFFERENT = "a stream of adaptive bits does not decode to the bits that were coded"


class BitCoder(Protocol):
    """What `BitEncoder` and `BitDecoder` have in common."""

    @property
    def compiled(self) -> Any:
        """The compiled coder, for kernels that code a whole structure; None in NumPy."""
        ...

    def code(self, contexts: AnyInteger, sets: AnyInteger, bits: Booleans | None) -> Booleans:
        """Code one array of bits (n,) and return it.

        contexts (n, INPUTS): what each bit's probability is learned from, numbers below 2^24. sets (n,): the weights
        that mix the probabilities, numbers below MIXERS. bits: None in the decoder.
        """
        ...


class CodedPart(NamedTuple):
    """What an encoder coded in one step. data: the whole bytes that it wrote. bits: with their contexts, compiled."""

    data: bytes
    bits: Any


class BitEncoder:
    """Arrays of bits to bytes."""

    def __init__(self, keeps_bits: bool = False) -> None:
        """keeps_bits: for `take`, which needs `BitCheck.is_available`."""
        kernel = native.kernel("BitArrayEncoder")
        self._kernel: Any = kernel(*tables()) if kernel else None
        self._mixer, self._encoder = (None, None) if kernel else (Mixer(), Encoder())
        self._taken = 0  # bytes
        if keeps_bits:
            self._kernel.keep_bits()

    @property
    def compiled(self) -> Any:
        """As `BitCoder.compiled`."""
        return self._kernel

    def code(self, contexts: AnyInteger, sets: AnyInteger, bits: Booleans | None) -> Booleans:
        """As `BitCoder.code`; bits: needed."""
        if bits is None:
            raise ValueError("an encoder needs the bits")
        if self._mixer is None or self._encoder is None:
            self._kernel.encode(*_arrays(contexts, sets), np.ascontiguousarray(bits, np.uint8))
            return bits
        for row, which, bit in zip(contexts.tolist(), sets.tolist(), bits.tolist(), strict=True):
            self._mixer.contexts(row)
            self._encoder.bit(int(bit), self._mixer.mix(0, which))
            self._mixer.learn(int(bit))
        return bits

    def copy(self) -> BitEncoder:
        """An encoder that goes on from here by itself, to try something."""
        result = copy.copy(self)
        if self._kernel is not None:
            result._kernel = self._kernel.copy()
        result._mixer, result._encoder = copy.deepcopy(self._mixer), copy.deepcopy(self._encoder)
        return result

    @property
    def size(self) -> int:
        """Whole bytes so far."""
        return int(self._kernel.size()) if self._encoder is None else self._encoder.size

    def take(self) -> CodedPart:
        """What was coded since the last call, for `BitCheck.follow`."""
        part = CodedPart(bytes(self._kernel.written(self._taken)), self._kernel.take_bits())
        self._taken += len(part.data)
        return part

    def finish(self) -> bytes:
        """The bytes of all arrays."""
        return bytes(self._kernel.finish()) if self._encoder is None else self._encoder.finish()


class BitDecoder:
    """The inverse of `BitEncoder`, call for call."""

    def __init__(self, data: bytes) -> None:
        kernel = native.kernel("BitArrayDecoder")
        self._kernel: Any = kernel(bytes(data), *tables()) if kernel else None
        self._mixer, self._decoder = (None, None) if kernel else (Mixer(), Decoder(bytes(data)))

    @property
    def compiled(self) -> Any:
        """As `BitCoder.compiled`."""
        return self._kernel

    def code(self, contexts: AnyInteger, sets: AnyInteger, bits: Booleans | None = None) -> Booleans:
        """As `BitCoder.code`; bits are not used. Raises Corrupt where the bytes end too early."""
        if self._mixer is None or self._decoder is None:
            decoded = np.asarray(self._kernel.decode(*_arrays(contexts, sets))) != 0
            exhausted = self._kernel.exhausted()
        else:
            decoded = np.zeros(len(sets), bool)
            for i, (row, which) in enumerate(zip(contexts.tolist(), sets.tolist(), strict=True)):
                self._mixer.contexts(row)
                bit = self._decoder.bit(self._mixer.mix(0, which))
                self._mixer.learn(bit)
                decoded[i] = bit
            exhausted = self._decoder.exhausted
        if exhausted:
            raise Corrupt(CUT_OFF)
        return decoded

    def finish(self) -> None:
        """Raises Corrupt if bytes are left."""
        if not (self._kernel.at_end() if self._decoder is None else self._decoder.at_end):
            raise Corrupt("a stream of adaptive bits does not end where its bytes end")


class BitCheck:
    """Decodes all bits from the bytes of an encoder, and compares them with the coded ones.

    It follows the encoder part by part, with counters, weights and a range decoder of its own. The contexts are the
    encoder's: they follow from earlier bits, and those are equal up to the first difference, where the check fails.
    """

    def __init__(self) -> None:
        kernel = native.kernel("BitArrayCheck")
        assert kernel is not None
        self._kernel: Any = kernel(*tables())

    @staticmethod
    def is_available() -> bool:
        """Whether the compiled module has it."""
        return native.kernel("BitArrayCheck") is not None

    def follow(self, part: CodedPart) -> None:
        """Compare the next bits as far as the bytes so far reach. Raises Corrupt where they differ."""
        if not self._kernel.follow(part.data, part.bits):
            raise Corrupt(DIFFERENT)

    def finish(self, data: bytes) -> None:
        """Compare the remaining bits with all bytes of the encoder, which begin with those so far. Raises Corrupt."""
        if not self._kernel.finish(data):
            raise Corrupt(DIFFERENT)


def _arrays(contexts: AnyInteger, sets: AnyInteger) -> tuple[Any, Any]:
    """Contexts and sets as the compiled coder takes them."""
    return np.ascontiguousarray(contexts, np.uint32).reshape(-1, INPUTS), np.ascontiguousarray(sets, np.uint32)
