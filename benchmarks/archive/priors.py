"""A studio's own prior: bytes of its people's recordings with the general prior, with its own, and with one of both.

people of the studio: every second recording trains, the others are encoded
general    learned from all other people     own    from the training recordings     both    from all of these
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mocodec import api, archive
from mocodec.codecs.tempo import Tempo, training
from mocodec.codecs.tempo.models import prior
from mocodec.motion import Motion

STUDIOS = (("118", "49"), ("16", "64"))
MEAN_ERRORS_M = (0.003,)


def measure(vault: Path) -> list[dict[str, Any]]:
    """Bytes of each studio's recordings outside all priors. vault: an archive with rotations."""
    with archive.open_archive(vault) as db:
        recordings = {entry.row.name: api.decode(entry.place, Motion) for entry in db}
    rows: list[dict[str, Any]] = []
    for people in STUDIOS:
        own = [name for name in sorted(recordings) if name.partition("/")[0] in people]
        others = [name for name in sorted(recordings) if name not in own]
        known, unseen = own[::2], own[1::2]
        sets = {"general": others, "own": known, "both": others + known}
        for kind, names in sets.items():
            data = prior.unpack_own(training.train([recordings[name] for name in names]))
            with prior.installed(*data):
                for mean_error in MEAN_ERRORS_M:
                    rows.append(
                        {
                            "people": people,
                            "prior": kind,
                            "known_frames": sum(len(recordings[name]) for name in names),
                            "unseen": len(unseen),
                            "unseen_frames": sum(len(recordings[name]) for name in unseen),
                            "mean_error": mean_error,
                            "bytes": encoded_bytes([recordings[name] for name in unseen], mean_error),
                        }
                    )
    return rows


def encoded_bytes(motions: Sequence[Motion], mean_error: float) -> int:
    """Bytes of the payloads of motions without rotations, with their shared blobs."""
    total = 0
    for motion in motions:
        encoded = Tempo(mean_error=mean_error).encode(replace(motion, rotations=None))
        total += encoded.payload_bytes + sum(map(len, encoded.shared))
    return total
