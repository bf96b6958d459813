"""Encoded to the bytes of a `.mocz`, front to back: header, extras, signals, chunks, index."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any, BinaryIO

from ..encoded import Chunk, Encoded
from ..errors import CannotEncode
from ..motion import Motion
from ..pointcloud import PointClouds
from . import records, values
from .records import CHUNK, END_MAGIC, HEADER, INDEX, MAGIC, VERSION
from .wire import checksum, varint


def pack(encoded: Encoded[Any]) -> bytes:
    """The bytes of a `.mocz`; deterministic. Raises CannotEncode for data that the format cannot hold."""
    file = io.BytesIO()
    writer = Writer(
        file,
        about=encoded.about,
        codec=encoded.codec,
        settings=encoded.settings,
        margin=encoded.margin,
        shared=encoded.shared,
    )
    for chunk in encoded.chunks:
        writer.add(chunk)
    writer.close()
    return file.getvalue()


def extras_bytes(about: Motion | PointClouds) -> int:
    """Bytes that the extras of a recording take in a `.mocz`. Raises CannotEncode for extras that it cannot hold."""
    return sum(_bytes_of(values.pack_extras(about.extras) if about.extras else None))


def _bytes_of(extras: values.Extras | None) -> tuple[int, int]:
    """Bytes in the file of the section of extras, and of the signals behind it."""
    return (0, 0) if extras is None else (len(extras.section) + records.CHECKSUM_BYTES, extras.signal_bytes)


class Writer:
    """Writes a `.mocz` to a file object that need not seek: the header now, each chunk in `add`, the index in `close`.

    about, codec, settings, margin, shared: as in `Encoded`. extras_bytes, signal_bytes: of the file, for the section of
    extras and for the signals behind it. A file without its index can be salvaged.
    Raises CannotEncode for data that the format cannot hold.
    """

    def __init__(
        self,
        file: BinaryIO,
        *,
        about: Motion | PointClouds,
        codec: str,
        settings: Mapping[str, Any] | None = None,
        margin: int = 0,
        shared: tuple[bytes, ...] = (),
    ) -> None:
        self.file = file
        self.most_frames = records.most_frames(about.points if isinstance(about, Motion) else None)
        self.stop = 0
        self.frames: list[int] = []
        self.lengths: list[int] = []
        header, extras = header_record(about, codec, settings or {}, margin, shared)
        self.extras_bytes, self.signal_bytes = _bytes_of(extras)
        body = HEADER.pack(header)
        if len(body) > records.MAX_HEADER_BYTES:
            raise CannotEncode(f"a header of {len(body)} bytes; at most {records.MAX_HEADER_BYTES} are allowed")
        head = MAGIC + bytes([VERSION]) + varint(len(body)) + body
        file.write(head + checksum(head))
        if extras is not None:
            for part in (extras.section, *extras.signals):
                file.write(part + checksum(part))

    def add(self, chunk: Chunk) -> None:
        """Write the next chunk; its frames must follow those of the chunk before."""
        payload = bytes(chunk.payload)
        if chunk.start != self.stop:
            raise CannotEncode(
                f"the next chunk starts at frame {chunk.start}, not at frame {self.stop}, where the last one ends"
            )
        if not 0 < chunk.frames <= self.most_frames or len(payload) > records.MAX_PAYLOAD_BYTES:
            raise CannotEncode(
                f"a chunk of {chunk.frames} frames and {len(payload)} bytes is out of range: at most "
                f"{self.most_frames} frames of these points and {records.MAX_PAYLOAD_BYTES} bytes"
            )
        head = CHUNK.pack({"frames": chunk.frames, "length": len(payload)})
        self.file.write(head + payload + checksum(head, payload))
        self.stop += chunk.frames
        self.frames.append(chunk.frames)
        self.lengths.append(len(payload))

    def close(self) -> None:
        """Write the index. The caller closes the file object."""
        body = b"\0"
        if len(self.frames) != 1:
            body += INDEX.pack({"frames": self.frames, "lengths": self.lengths})
        index = body + checksum(body)
        self.file.write(index + varint(len(index))[::-1] + END_MAGIC)


def header_record(
    about: Motion | PointClouds, codec: str, settings: Mapping[str, Any], margin: int, shared: tuple[bytes, ...]
) -> tuple[dict[str, Any], values.Extras | None]:
    """The header's fields, and the extras that they declare."""
    extras = values.pack_extras(about.extras) if about.extras else None
    skeleton = about.skeleton if isinstance(about, Motion) else None
    has_rotations = isinstance(about, Motion) and about.rotations is not None
    present = {
        records.MARGIN: margin > 0,
        records.SKELETON: skeleton is not None,
        records.SETTINGS: bool(settings),
        records.SOURCE: bool(about.source),
        records.EXTRAS: extras is not None,
    }
    kind = "motion" if isinstance(about, Motion) else "clouds"
    record: dict[str, Any] = {
        "flags": records.flags(kind, about.up, present),
        "kind": kind,
        "codec": codec,
        "rate": about.rate,
        "margin": margin,
        "skeleton": (skeleton, has_rotations),
        "settings": dict(settings),
        "source": dict(about.source),
        "extras": (len(extras.section), extras.size, extras.signal_bytes) if extras is not None else None,
        "shared": tuple(shared),
    }
    if isinstance(about, Motion):
        record["names"] = about.names
    else:
        record["channels"] = (about.colours is not None) | (about.normals is not None) << 1
    return record, extras
