# pyright: strict
"""Motion in the tar shards of WebDataset: a `.mocz` for each sample. Reading needs the package, writing does not.

recordings ─write_tar─► walks-000000.tar: 07_walk_01.mocz, 07_walk_02.mocz, …
tar ─WebDataset─► {"__key__", "mocz": bytes} ─decode(mocz(…))─► {"__key__", "mocz": {"positions": …}}

webdataset.WebDataset("walks-000000.tar").decode(learning.mocz(rate=30)).to_tuple("__key__", "mocz")
"""

from __future__ import annotations

import io
import tarfile
from collections.abc import Callable, Sequence
from os import PathLike

import numpy as np

from .. import api
from ..archive import Recordings, open_archive
from ..errors import BadInput
from ..motion import Motion
from .dataset import Window
from .features import FEATURES, known

SUFFIX = "mocz"


class SampleDecoder:
    """What `mocz` returns: `decoder(key, data)`, which can be pickled for the workers of a loader."""

    def __init__(self, features: tuple[str, ...], rate: float | None, points: tuple[str, ...] | None, up: str | None):
        self.features, self.rate, self.points, self.up = features, rate, points, up

    def __call__(self, key: str, data: bytes) -> Window | None:
        """The features of a sample whose key ends in `mocz`; None for other keys, which other handlers decode."""
        if key.rpartition(".")[2].lower() != SUFFIX:
            return None
        motion = api.decode(data, Motion)
        if self.up is not None and motion.up != self.up:
            motion = motion.turned(self.up)
        if self.points is not None:
            motion = motion.select(self.points)
        if self.rate is not None:
            motion = motion.resample(self.rate)
        return {name: np.ascontiguousarray(FEATURES[name](motion), np.float32) for name in self.features}


def mocz(
    features: str | Sequence[str] = ("positions",),
    rate: float | None = None,
    points: Sequence[str] | None = None,
    up: str | None = None,
) -> Callable[[str, bytes], Window | None]:
    """A handler for `WebDataset.decode`: a sample's `.mocz` becomes a dict of float32 arrays (frames, …).

    features: names in `mocodec.learning.FEATURES`. rate: hertz; None: that of each recording. points: names of the
    points to take, in this order; None: all. up: turn the motion so that this axis is vertical. Raises BadInput for
    unknown features; the handler raises what `mocodec.decode` raises, and BadInput for point clouds or missing points.
    """
    return SampleDecoder(known(features), rate, None if points is None else tuple(points), up)


def write_tar(recordings: Recordings | str | PathLike[str], path: str | PathLike[str]) -> int:
    """Write the recordings of an archive, or of a query, into a tar that WebDataset reads; how many there are.

    Each is a sample with its `.mocz` as it is in the archive. Its key is its name, with "_" for "/" and for dots, where
    WebDataset would end the key. The same recordings give the same bytes. Raises BadInput if two names give one key.
    """
    found = recordings if isinstance(recordings, Recordings) else open_archive(recordings)
    keys = [name.replace("/", "_").replace(".", "_") for name in found.names]
    if twice := sorted({key for key in keys if keys.count(key) > 1}):
        raise BadInput(f"several recordings would have the key {twice[0]}: choose others by a query")
    with tarfile.open(path, "w", format=tarfile.PAX_FORMAT) as shard:
        for key, entry in zip(keys, found, strict=True):
            content = entry.read()
            member = tarfile.TarInfo(f"{key}.{SUFFIX}")
            member.size = len(content)
            shard.addfile(member, io.BytesIO(content))
    return len(keys)
