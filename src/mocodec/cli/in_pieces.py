"""`mocodec encode` of a recording that does not fit into memory: block by block, where format and options allow it."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from .. import api, formats
from ..codecs.tempo import Tempo
from ..codecs.tempo.models import prior as own_prior
from ..encoded import TARGETS
from ..errors import BadInput
from . import files
from .codec_options import codec_with

LARGE_BYTES = 1 << 28
"""Larger files are encoded in pieces without being asked, where that is possible."""


def encoded(
    source: str, output: str, asked: bool | None, chosen: Mapping[str, Any], options: Mapping[str, Any]
) -> dict[str, Any] | None:
    """Encode in pieces; the record, as of `encode.measures`, with notes. None, and nothing written, for a file that is
    to be encoded at once.

    asked: --in-pieces or --at-once, None if neither is given. chosen: codec, settings, targets and other choices of the
    command. options: those of readers. Raises BadInput, CannotEncode, and a usage error where the user asks for what is
    not possible.
    """
    if asked is False:
        return None
    is_file = source != "-" and not files.is_url(source) and formats.can_read_blocks(source) and output != "-"
    if not is_file or chosen["codec"] not in (None, Tempo.name) or "signal_error" in chosen:
        if asked:
            raise click.UsageError(
                f"--in-pieces takes a file of {', '.join(formats.BLOCKS)}, the codec tempo, and a file as output"
            )
        return None
    if not asked and (not Path(source).exists() or _bytes_of(source) < LARGE_BYTES):
        return None
    codec = codec_with(Tempo.name, chosen["settings"], chosen["targets"])
    try:
        blocks = formats.read_blocks(source, **options)
    except BadInput:
        if asked:
            raise
        return None  # reading the whole raises the error, if there is one
    if chosen.get("bare"):
        blocks = replace(blocks, about=formats.without_extras(blocks.about))
    if not asked and not _is_possible(codec, blocks):
        return None
    return _written(source, output, blocks, codec, chosen.get("prior"))


def _bytes_of(source: str) -> int:
    """Bytes of a file, of an .npz those of its arrays."""
    try:
        with zipfile.ZipFile(source) as archive:
            return sum(member.file_size for member in archive.infolist())
    except (zipfile.BadZipFile, OSError):
        return os.path.getsize(source)


def _is_possible(codec: Any, blocks: formats.Blocks) -> bool:
    """Whether nothing in the settings needs the whole recording at once."""
    has_size = codec.ratio is not None or codec.size is not None
    if codec.weights or codec.max_rotation is not None or codec.model == "hou2014":
        return False
    if blocks.about.rotations is not None and (has_size or codec.mean_error is not None):
        return False
    return not has_size or blocks.frames is not None


def _written(source: str, output: str, blocks: formats.Blocks, codec: Any, prior: str | None) -> dict[str, Any]:
    """Write the file; its record."""
    targets = {name: value for name in TARGETS if (value := getattr(codec, name, None)) is not None}
    with files.working(f"encoding {source} with {codec.name}"), own_prior.used(prior):
        written = api.encode_blocks(blocks, output, codec, **targets)
    raw = written.frames * written.points * 12
    return {
        "codec": codec.name,
        "frames": written.frames,
        "bytes": written.bytes,
        "motion": written.bytes - written.extras_bytes - written.signal_bytes,
        "signals": written.signal_bytes,
        "extras": written.extras_bytes,
        "raw_bytes": raw,
        "ratio": written.ratio,
        "mean_error": written.mean_error,
        "max_error": written.max_error,
        "samples": written.samples,
        "notes": formats.notes(blocks.about),
    }
