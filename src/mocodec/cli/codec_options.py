"""The codec that the options of a command ask for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import click

from .. import api, codecs
from ..codecs.base import Codec
from ..encoded import TARGETS
from ..errors import BadInput
from . import quantities

OPTIONS = ("skeleton", "residual", "chunk_seconds", "max_rotation")
"""Settings of codecs that `mocodec encode` has an option for: --chunk-seconds is `chunk_seconds`."""


def codec_with(codec: str, settings: Sequence[str], targets: Mapping[str, float]) -> Codec[Any]:
    """The codec with these settings and targets. Raises a usage error for settings that it does not have."""
    kind = codecs.codec_class(codec)
    require_options(kind, [text.partition("=")[0].strip().replace("-", "_") for text in settings])
    require_options(kind, targets)
    try:
        return api.with_options(codec, **dict(quantities.setting(kind, text) for text in settings), **targets)
    except (BadInput, TypeError) as error:
        raise click.UsageError(str(error)) from error


def require_options(kind: type[Codec[Any]], names: Iterable[str]) -> None:
    """Raises a usage error for an option of `mocodec encode` whose setting the codec does not have; it names the codecs
    that have it.
    """
    for name in names:
        if name in (*OPTIONS, *TARGETS) and not _has_setting(kind, name):
            others = [other for other in codecs.CODECS if _has_setting(codecs.codec_class(other), name)]
            option = f"--{name.replace('_', '-')}"
            listed = " and ".join([", ".join(others[:-1]), *others[-1:]]).removeprefix(" and ")
            raise click.UsageError(f"{option} is for {listed}; this recording is coded by {kind.name}")


def _has_setting(kind: Any, name: str) -> bool:
    return name in {field.name for field in fields(kind)}
