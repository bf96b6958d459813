"""Downloads recordings of the Carnegie Mellon database from its website.

    index page of a subject ──► names of its trials ──► subjects/SS/SS.asf, SS_TT.amc, and SHA256SUMS beside them

The site publishes no checksums, so the first download writes them. A later run checks existing files and downloads only
missing ones. Two people can compare checksums to see whether they measured the same data.
"""

from __future__ import annotations

import hashlib
import re
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from pathlib import Path

import click

from mocodec import formats
from mocodec.errors import BadInput, Corrupt

SITE = "http://mocap.cs.cmu.edu"
SUMS = "SHA256SUMS"
LARGEST_BYTES = 64 << 20
BY_HAND = (
    f"download all_asfamc.zip from {SITE} on a machine with a network, unpack it, "
    "and pass its folder: scripts/bench eval --data FOLDER"
)


def get(url: str) -> bytes:
    """The bytes at a URL. If the download fails, raises BadInput with instructions for a manual download."""
    try:
        with urllib.request.urlopen(url, timeout=30) as answer:
            data = answer.read(LARGEST_BYTES + 1)
    except (urllib.error.URLError, OSError) as problem:
        raise BadInput(f"cannot fetch {url} ({problem}); {BY_HAND}") from problem
    if len(data) > LARGEST_BYTES:
        raise BadInput(f"{url} is larger than {LARGEST_BYTES >> 20} MiB; no trial of the database is")
    return data


def read_sums(path: Path) -> dict[str, str]:
    """SHA-256 by file name, from a SHA256SUMS file; empty without a file."""
    if not path.is_file():
        return {}
    return {name: digest for digest, name in (line.split(maxsplit=1) for line in path.read_text().splitlines() if line)}


def cmu(
    subjects: Sequence[str],
    folder: Path,
    fetch: Callable[[str], bytes] = get,
    report: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Download all trials of these subjects to `folder`; return the paths of old and new files.

    Raises BadInput without a network or for an unknown subject, Corrupt if a file differs from its checksum.
    """
    paths = []
    for subject in (s.strip().zfill(2) for s in subjects):
        if not re.fullmatch(r"\d{2,3}", subject):
            raise BadInput(f"a subject is a number such as 14, not {subject!r}")
        page = fetch(f"{SITE}/search.php?subjectnumber={int(subject)}").decode("latin-1")
        trials = sorted(set(re.findall(rf"subjects/{subject}/({subject}_\d+\.amc)", page)))
        if not trials:
            raise BadInput(f"{SITE} lists no trial of subject {subject}")
        subject_folder = folder / "subjects" / subject
        subject_folder.mkdir(parents=True, exist_ok=True)
        sums = read_sums(subject_folder / SUMS)
        for name in (f"{subject}.asf", *trials):
            path = subject_folder / name
            data = path.read_bytes() if path.is_file() else fetch(f"{SITE}/subjects/{subject}/{name}")
            digest = hashlib.sha256(data).hexdigest()
            if sums.setdefault(name, digest) != digest:
                raise Corrupt(
                    f"{path} differs from its checksum in {subject_folder / SUMS}; remove the file and fetch again"
                )
            if not path.is_file():
                formats.replace_whole(path, data)
            paths.append(path)
            report(str(path))
        lines = "".join(f"{digest}  {name}\n" for name, digest in sorted(sums.items()))
        formats.replace_whole(subject_folder / SUMS, lines.encode())
    return paths


@click.group("fetch")
def command() -> None:
    """Download recordings from their publishers."""


@command.command("cmu")
@click.option("--subjects", required=True, metavar="14,15", help="Subjects of the CMU database.")
@click.option("-o", "--output", default="cmu", show_default=True, type=click.Path(file_okay=False, path_type=Path))
def cmu_command(subjects: str, output: Path) -> None:
    """Download subjects of the Carnegie Mellon database.

    mocap.cs.cmu.edu; the database was created with funding from NSF EIA-0196217.
    """
    paths = cmu(subjects.split(","), output, report=lambda path: click.echo(path, err=True))
    click.echo(f"{len(paths)} files below {output}; to measure on them: scripts/bench eval --data {output} -o results")
