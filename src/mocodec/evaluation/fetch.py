"""Recordings of the Carnegie Mellon database, fetched from its own site into the tree that the evaluation reads.

    index page of a subject ─► names of its trials ─► subjects/SS/SS.asf, SS_TT.amc ─► SHA256SUMS beside them

The site publishes no checksums. The first fetch writes them; a later one checks every file that is there against them,
so that two people can tell whether they measured the same data, and fetches only what is missing.
"""

from __future__ import annotations

import hashlib
import re
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from pathlib import Path

from .. import formats
from ..errors import BadInput, Corrupt

SITE = "http://mocap.cs.cmu.edu"
SUMS = "SHA256SUMS"
LARGEST = 64 << 20
BY_HAND = (
    f"fetch all_asfamc.zip from {SITE} on a machine that has a network, unpack it, "
    "and pass its folder: mocodec eval --data FOLDER"
)


def get(url: str) -> bytes:
    """The bytes at a URL. Raises BadInput where it cannot be had, saying what to do by hand."""
    try:
        with urllib.request.urlopen(url, timeout=30) as answer:
            data = answer.read(LARGEST + 1)
    except (urllib.error.URLError, OSError) as problem:
        raise BadInput(f"cannot fetch {url} ({problem}); {BY_HAND}") from problem
    if len(data) > LARGEST:
        raise BadInput(f"{url} is larger than {LARGEST >> 20} MiB, which no trial is")
    return data


def read_sums(path: Path) -> dict[str, str]:
    """File name → SHA-256 from a SHA256SUMS file; empty where there is none."""
    if not path.is_file():
        return {}
    return {name: digest for digest, name in (line.split(maxsplit=1) for line in path.read_text().splitlines() if line)}


def cmu(
    subjects: Sequence[str],
    folder: Path,
    fetch: Callable[[str], bytes] = get,
    told: Callable[[str], None] | None = None,
) -> list[Path]:
    """Fetch every trial of these subjects below `folder`; the paths of all their files, new or there already.

    Raises BadInput without a network or for an unknown subject, Corrupt where a file differs from its checksum.
    """
    paths = []
    for subject in (s.strip().zfill(2) for s in subjects):
        if not re.fullmatch(r"\d{2,3}", subject):
            raise BadInput(f"a subject is a number such as 14, not {subject!r}")
        page = fetch(f"{SITE}/search.php?subjectnumber={int(subject)}").decode("latin-1")
        trials = sorted(set(re.findall(rf"subjects/{subject}/({subject}_\d+\.amc)", page)))
        if not trials:
            raise BadInput(f"{SITE} lists no trial of subject {subject}")
        here = folder / "subjects" / subject
        here.mkdir(parents=True, exist_ok=True)
        sums = read_sums(here / SUMS)
        for name in (f"{subject}.asf", *trials):
            path = here / name
            data = path.read_bytes() if path.is_file() else fetch(f"{SITE}/subjects/{subject}/{name}")
            digest = hashlib.sha256(data).hexdigest()
            if sums.setdefault(name, digest) != digest:
                raise Corrupt(f"{path} is not what its checksum in {here / SUMS} says; remove it and fetch again")
            if not path.is_file():
                formats.replace_whole(path, data)
            paths.append(path)
            if told:
                told(str(path))
        lines = "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items()))
        formats.replace_whole(here / SUMS, lines.encode())
    return paths
