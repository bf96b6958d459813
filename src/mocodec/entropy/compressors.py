"""Compressors of the standard library without their headers, for data of a known size: deflate (RFC 1951), LZMA2."""

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


LZMA_DICTIONARY = 1 << 22
"""The decoder's. The encoder takes a smaller one for short data: setting up the tables of a large one takes longer than
compressing them. A larger dictionary decodes them too."""
LEAST_LZMA_DICTIONARY = 1 << 12


def lzma2(data: bytes, preset: int = 2, **options: int) -> bytes:
    """Raw LZMA2 with a dictionary of 2²² bytes; options: those of the filter, as `lc`."""
    import lzma

    size = min(LZMA_DICTIONARY, max(LEAST_LZMA_DICTIONARY, 1 << (len(data) - 1).bit_length()))
    return lzma.compress(data, lzma.FORMAT_RAW, filters=_filters(size, preset=preset, **options))


def unlzma2(data: bytes, size: int, what: str) -> bytes:
    """Exactly `size` bytes from raw LZMA2; never allocates more. Raises Corrupt."""
    import lzma

    unpacker = lzma.LZMADecompressor(lzma.FORMAT_RAW, filters=_filters(LZMA_DICTIONARY, preset=2))
    try:
        out = unpacker.decompress(data, size)
        rest = b"" if unpacker.eof else unpacker.decompress(b"", 1)
    except (lzma.LZMAError, EOFError) as error:
        raise Corrupt(f"{what}: {error}") from None
    if len(out) != size or rest or not unpacker.eof or unpacker.unused_data:
        raise Corrupt(f"{what}: does not unpack to the {size} bytes declared")
    return out


def _filters(dictionary_size: int, **options: int) -> list[dict[str, int]]:
    import lzma

    return [{"id": lzma.FILTER_LZMA2, **options, "dict_size": dictionary_size}]
