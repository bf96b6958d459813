"""Raw deflate (RFC 1951) of a known size."""

from __future__ import annotations

import zlib

from ..errors import Corrupt


def deflate(data: bytes, dictionary: bytes = b"") -> bytes:
    """Raw deflate, primed with a dictionary. Bytes may differ between zlibs; all of them are valid."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15, 9, zlib.Z_DEFAULT_STRATEGY, dictionary)
    return packer.compress(data) + packer.flush()


def inflate(data: bytes, size: int, what: str, dictionary: bytes = b"") -> bytes:
    """Exactly `size` bytes from raw deflate; never allocates more. Raises Corrupt."""
    unpacker = zlib.decompressobj(-15, dictionary)
    try:
        out = unpacker.decompress(data, size) if size else unpacker.decompress(data, 1)
        rest = unpacker.decompress(unpacker.unconsumed_tail, 1) if not unpacker.eof else b""
    except zlib.error as error:
        raise Corrupt(f"{what}: {error}") from None
    if len(out) != size or rest or not unpacker.eof or unpacker.unused_data:
        raise Corrupt(f"{what}: does not unpack to the {size} bytes announced")
    return out
