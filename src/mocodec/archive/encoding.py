# pyright: strict
"""One source to the bytes of its `.mocz` and the facts for its row: the work that runs in other processes.

source ─local─► path ─read─► recording ─encode─► .mocz ─decode─► errors
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from .. import api, metrics
from ..codecs.tempo.models import prior
from ..encoded import Recording
from ..errors import BadInput, CannotEncode, MocodecError
from ..file_range import FileRange
from ..formats import folders, replace_whole, without_extras
from ..motion import Motion
from ..packing import DEFAULT_CODECS, with_options
from . import names, sources
from .sources import Source

SLACK = 1 + 1e-9  # of a sum's last bit
HASH_DIGITS = 32
"""Hexadecimal digits of SHA-256 that the catalogue stores: 128 bits."""


@dataclass(frozen=True)
class Options:
    """How recordings are coded: JSON values, which the catalogue stores.

    codec: by default that of the recording's kind. targets: `max_error`, `mean_error` (m), `ratio`, … as in
    `mocodec.encode`. settings: other settings of the codec. reader: options of the reader (`up`, `unit`, …).
    signal_error: as in `mocodec.encode`. bare: leave out signals, events and parameters. rotations: keep the rotations
    of joints. prior: hash of a prior of one's own, which is in the archive (`keep_prior`), or "".
    """

    codec: str | None = None
    targets: Mapping[str, float] = field(default_factory=dict[str, float])
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    reader: Mapping[str, Any] = field(default_factory=dict[str, Any])
    signal_error: str | None = None
    bare: bool = False
    rotations: bool = True
    prior: str = ""

    def stored(self) -> dict[str, Any]:
        """What differs from the defaults."""
        plain = Options()
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {name: value for name, value in values.items() if value != getattr(plain, name)}


@dataclass(frozen=True)
class Task:
    """A source to encode. known: hash of the source that the archive has already, coded alike, or "".
    prior: file of a prior of one's own."""

    source: Source
    options: Options
    known: str = ""
    prior: str | None = None


@dataclass(frozen=True)
class Outcome:
    """What became of a task: a `.mocz` and the facts of its row, a reason why not, or neither if its hash is known."""

    source_hash: str = ""
    blob: bytes = b""
    facts: Mapping[str, Any] = field(default_factory=dict[str, Any])
    reason: str = ""


def encode(task: Task) -> Outcome:
    """Encode a source, decode it and measure its errors. Errors become the reason of the outcome."""
    try:
        with sources.local(task.source) as path:
            try:
                return _encoded(path, task)
            except MocodecError as error:
                error.args = (str(error).replace(path, task.source.where),)
                raise
    except MocodecError as error:
        return Outcome(reason=" ".join(str(error).split()).removeprefix(f"{task.source.where}: "))
    except MemoryError:
        return Outcome(reason="not enough memory for this recording; cut it into parts")
    except OSError as error:
        return Outcome(reason=error.strerror or str(error))


def _encoded(path: str, task: Task) -> Outcome:
    source_hash = hash_of(path, task.source.companions)
    if source_hash == task.known:
        return Outcome(source_hash)
    if api.is_mocz(path):
        blob = Path(path).read_bytes()
        with api.open(blob) as f:
            f.verify()
            return Outcome(source_hash, blob, facts_of(f))
    options = task.options
    recording = api.read(path, **options.reader)
    if options.bare:
        recording = without_extras(recording)
    if isinstance(recording, Motion) and not options.rotations:
        recording = replace(recording, rotations=None)
    settings: dict[str, Any] = {**options.settings, **options.targets}
    if options.signal_error is not None:
        settings["signal_error"] = options.signal_error
    with prior.used(task.prior):
        blob = api.encode(recording, options.codec, **settings)
        with api.open(blob) as f:
            facts = {**facts_of(f), **measured(recording, f[:], options.targets), "prior": options.prior}
    return Outcome(source_hash, blob, facts)


def measured(recording: Recording, decoded: Recording, targets: Mapping[str, float]) -> dict[str, float]:
    """Mean and largest error of a motion, metres. Raises CannotEncode if a target is not met."""
    if not (isinstance(recording, Motion) and isinstance(decoded, Motion)):
        return {}
    if not recording.positions.size or recording.gaps.all():
        return {"mean_error": 0.0, "max_error": 0.0}
    errors = metrics.distances(recording.positions, decoded.positions)
    present = errors[~recording.gaps]
    found = {"mean_error": float(present.mean()), "max_error": float(present.max())}
    for name, value in found.items():
        if value > targets.get(name, value) * SLACK:
            raise CannotEncode(f"the {name.replace('_', ' ')} is {value:.3g} m, and {targets[name]:g} m was asked for")
    return found


def facts_of(file: api.File[Any]) -> dict[str, Any]:
    """What a `.mocz` says about itself, for its row."""
    info, about = file.info, file.encoded.about
    parts: Mapping[str, int] = info["bytes_by_part"]
    side, raw = parts["extras"] + parts["signals"], info["raw_bytes_float32"] or 0
    return {
        "format": str(about.source.get("format", "")),
        "kind": info["kind"],
        "frames": len(file),
        "rate": file.rate,
        "seconds": file.seconds,
        "points": info["points"] or 0,
        "joints": (info["points"] or 0) if info["skeleton"] else 0,
        "rotations": int(info["rotations"]),
        "layout": layout_of(file.names),
        "codec": file.encoded.codec,
        "mean_error": None,
        "max_error": None,
        "bytes": info["bytes"],
        "side_bytes": side,
        "raw_bytes": raw,
        "ratio": raw / (info["bytes"] - side) if raw else None,
    }


def layout_of(names: Sequence[str]) -> str:
    """The hash of the names of points; "" of none."""
    return hashlib.sha256("\n".join(names).encode("utf-8", "surrogatepass")).hexdigest()[:16] if names else ""


def facts_of_name(name: str) -> dict[str, Any]:
    """What the name of a recording says about it, for its row."""
    parsed = names.parse(name)
    labels = f" {' '.join(parsed.labels)} " if parsed.labels else ""
    stem = name.rpartition("/")[2]
    return {"name": name, "stem": stem, "subject": parsed.subject, "trial": parsed.trial, "labels": labels}


def hash_of(path: str, companions: Sequence[str] = ()) -> str:
    """SHA-256 of a source: its content, and that of the files that belong to it. Names do not count."""
    digest = hashlib.sha256()
    folder, suffix = os.path.dirname(path), os.path.splitext(path)[1].lower()
    beside = folders.COMPANIONS.get(suffix)
    if os.path.isdir(path):
        files = sorted(os.path.join(path, name) for name in os.listdir(path))
    else:
        near = [] if beside is None else sorted(n for n in os.listdir(folder or ".") if n.lower().endswith(beside))
        files = [path, *(os.path.join(folder, name) for name in near)]
    for name in files:
        if os.path.isfile(name):
            with open(name, "rb") as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()[:HASH_DIGITS]


def content_hash(blob: bytes) -> str:
    """The hash of a `.mocz` that the catalogue stores."""
    return hashlib.sha256(blob).hexdigest()[:HASH_DIGITS]


def bytes_of(place: FileRange) -> bytes:
    """All bytes of a range of a file. Raises BadInput, Truncated."""
    from ..container.byte_sources import byte_source

    source = byte_source(place)
    try:
        return source.read(0, source.size)
    finally:
        source.close()


PRIORS = "priors"


def prior_path(folder: Path, hash_: str) -> Path:
    """The file of a prior of one's own in an archive."""
    return folder / PRIORS / f"{hash_}{prior.OWN_SUFFIX}"


def keep_prior(folder: Path, data: bytes) -> str:
    """Store a prior of one's own in an archive, once by its content; returns its hash. Raises BadInput."""
    prior.unpack_own(data)
    name = hashlib.sha256(data).hexdigest()[:16]
    path = prior_path(folder, name)
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        replace_whole(path, data)
    return name


def require_options(options: Options) -> None:
    """Raises BadInput for settings that no codec has: before any source is read."""
    problems: list[BadInput] = []
    for codec in [options.codec] if options.codec else DEFAULT_CODECS:
        try:
            with_options(codec, **{**options.settings, **options.targets})
        except BadInput as error:
            problems.append(error)
        else:
            return
    raise problems[0]
