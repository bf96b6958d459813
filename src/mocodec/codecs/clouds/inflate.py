"""zlib streams with a size limit."""

from __future__ import annotations

import zlib

from ...errors import Corrupt


def inflate(data: bytes, limit: int) -> bytes:
    """The content of a zlib stream of at most `limit` bytes. Raises Corrupt."""
    try:
        inflater = zlib.decompressobj()
        content = inflater.decompress(data, limit + 1)
    except zlib.error as error:
        raise Corrupt(f"damaged data ({error})") from None
    if len(content) > limit or not inflater.eof:
        raise Corrupt(f"damaged data: a zlib stream is cut off or has more than {limit} bytes")
    return content
