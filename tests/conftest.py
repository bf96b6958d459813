"""Internal errors of codecs fail tests, where a user would get a larger file and a note."""

from __future__ import annotations

import os

os.environ.setdefault("MOCODEC_STRICT", "1")
