"""The codec that the options of a command ask for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import click

from .. import api, codecs
from ..codecs.base import Codec
from ..errors import BadInput
from . import quantities


def codec_with(codec: str, settings: Sequence[str], targets: Mapping[str, float]) -> Codec[Any]:
    """The codec with these settings and targets. Raises a usage error for settings that it does not have."""
    kind = codecs.codec_class(codec)
    try:
        return api.with_options(codec, **dict(quantities.setting(kind, text) for text in settings), **targets)
    except (BadInput, TypeError) as error:
        raise click.UsageError(str(error)) from error
