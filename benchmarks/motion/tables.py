"""Tables of the motion benchmark, from its records.

Means are geometric, over the recordings that all coders of a column can code; the tables have their number.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from .records import HARD, MEAN, OURS, Record

HEADINGS = {MEAN: "mean error", HARD: "hard maximum"}
Table = tuple[list[str], list[list[str]]]
"""Header and rows."""


def successful(records: Iterable[Record]) -> list[Record]:
    """Records with a result."""
    return [r for r in records if r.bytes and not r.problem]


def coders(records: Sequence[Record]) -> list[str]:
    """Names of the coders: ours in the order of OURS, then rivals by name."""
    names = {r.codec for r in records}
    return [n for n in OURS if n in names] + sorted(names - set(OURS))


def geometric(values: Sequence[float]) -> float:
    """The geometric mean; NaN without values."""
    return float(np.exp(np.mean(np.log(values)))) if len(values) else float("nan")


def cell(records: Sequence[Record], codec: str, target: str, wanted: float) -> list[Record]:
    """Records with a result of one coder at one target."""
    return [r for r in successful(records) if (r.codec, r.target, r.target_m) == (codec, target, wanted)]


LEAST_SHARE = 0.8
"""A column omits a coder that codes less than this share of the recordings at its target."""


def comparable(
    records: Sequence[Record], names: Sequence[str], target: str, wanted: float
) -> tuple[list[str], set[str]]:
    """The coders of most recordings at this target, and the recordings that all of these coders can code."""
    files = {n: {r.file for r in cell(records, n, target, wanted)} for n in names}
    most = max(map(len, files.values()), default=0)
    able = [n for n in names if files[n] and len(files[n]) >= LEAST_SHARE * most]
    return able, set.intersection(*(files[n] for n in able)) if able else set()


def targets_of(records: Sequence[Record]) -> list[tuple[str, float]]:
    """All targets (kind, metres): mean errors, then hard maxima, each from small to large."""
    return sorted({(r.target, r.target_m) for r in records if r.target in HEADINGS}, key=lambda t: (t[0] == HARD, t[1]))


def bjontegaard(records: Sequence[Record], codec: str, against: str, target: str = MEAN) -> tuple[float, int]:
    """Bjøntegaard difference: bytes of `codec` over bytes of `against` at equal error, and the number of recordings.

    For each recording, the difference of log bytes is averaged over log error by trapezoids between the measured
    targets (no polynomial is fitted). The factor is the geometric mean over recordings.
    """
    errors = sorted({m for t, m in targets_of(records) if t == target})
    factors = []
    for file in sorted({r.file for r in records}):
        gains = []
        for wanted in errors:
            a = [r.bytes for r in cell(records, codec, target, wanted) if r.file == file]
            b = [r.bytes for r in cell(records, against, target, wanted) if r.file == file]
            if a and b:
                gains.append((np.log(wanted), np.log(a[0] / b[0])))
        if len(gains) >= 2:
            x, y = np.array(gains).T
            factors.append(float(np.exp(np.trapezoid(y, x) / (x[-1] - x[0]))))
        elif gains:
            factors.append(float(np.exp(gains[0][1])))
    return geometric(factors), len(factors)


def ratio_rows(records: Sequence[Record]) -> Table:
    """The main table: geometric mean ratio of each coder at each target, over the recordings that all can code."""
    wanted = targets_of(records)
    names = [n for n in coders(successful(records)) if any(cell(records, n, *t) for t in wanted)]
    compared = {t: comparable(records, names, *t) for t in wanted}
    head = ["codec"] + [f"{HEADINGS[t]} {m * 100:g} cm" for t, m in wanted]
    rows = []
    for name in names:
        row = [name]
        for t in wanted:
            able, files = compared[t]
            ratios = [r.ratio for r in cell(records, name, *t) if name in able and r.file in files]
            row.append(f"{geometric(ratios):.1f}" if ratios else "–")
        rows.append(row)
    rows.append(["recordings"] + [str(len(compared[t][1])) for t in wanted])
    return head, rows


def difference_rows(records: Sequence[Record]) -> Table:
    """Bjøntegaard differences from SZ3 and hou2014, in percent of bytes."""
    rows = []
    for name in coders(successful(records)):
        row = [name]
        for target in (MEAN, HARD):
            for against in ("sz3", "hou2014"):
                factor, count = bjontegaard(records, name, against, target)
                row.append(f"{(factor - 1) * 100:+.0f} % ({count})" if count else "–")
        if any(c != "–" for c in row[1:]):
            rows.append(row)
    head = ["codec"] + [f"{HEADINGS[t]}, against {a}" for t in (MEAN, HARD) for a in ("SZ3", "hou2014")]
    return head, rows


def lossless_rows(records: Sequence[Record]) -> Table:
    """Compression ratios of the lossless coders."""
    names = [n for n in coders(successful(records)) if cell(records, n, "lossless", 0.0)]
    names, files = comparable(records, names, "lossless", 0.0)
    return ["codec", "lossless ratio", "recordings"], [
        [
            n,
            f"{geometric([r.ratio for r in cell(records, n, 'lossless', 0.0) if r.file in files]):.2f}",
            str(len(files)),
        ]
        for n in names
    ]


def speed_rows(records: Sequence[Record]) -> Table:
    """Median frames a second. Our codecs search in one call; a rival's time is its last search step."""
    rows = []
    for name in coders(successful(records)):
        mine = [r for r in successful(records) if r.codec == name]
        encode, decode = (float(np.median([getattr(r, k) for r in mine])) for k in ("encode_fps", "decode_fps"))
        memory = float(np.median([r.peak_memory_mb for r in mine]))
        rows.append([name, f"{encode:,.0f}", f"{decode:,.0f}", f"{memory:,.0f}"])
    return ["codec", "encode, frames/s", "decode, frames/s", "peak memory of the process, MB"], rows


def file_rows(records: Sequence[Record]) -> Table:
    """A row for each recording: frames, points, rate, and the ratios of our codecs and SZ3 at all targets."""
    names = [n for n in ("tempo", "hou2014", "liu2006", "sz3") if n in coders(successful(records))]
    wanted = targets_of(records)
    head = ["recording", "frames", "points", "Hz"] + [
        f"{n} {'≤' if t == HARD else '~'}{m * 100:g}" for t, m in wanted for n in names
    ]
    rows = []
    for file in sorted({r.file for r in successful(records)}):
        one = next(r for r in successful(records) if r.file == file)
        row = [file, str(one.frames), str(one.points), f"{one.rate:g}"]
        for t in wanted:
            for n in names:
                found = [r.ratio for r in cell(records, n, *t) if r.file == file]
                row.append(f"{found[0]:.1f}" if found else "–")
        rows.append(row)
    return head, rows


def problem_rows(records: Sequence[Record]) -> Table:
    """Measurements without a result, with the reason."""
    seen = {}
    for r in records:
        if r.problem:
            what = "" if r.frames == 0 else f"{r.codec} at {HEADINGS.get(r.target, r.target)} {r.target_m * 100:g} cm"
            seen.setdefault((r.file, what, r.problem), None)
    return ["recording", "codec and target", "why"], [list(key) for key in sorted(seen)]


def tables(records: Sequence[Record]) -> list[tuple[str, Table]]:
    """All tables of the report: title, header and rows."""
    return [
        ("Compression ratio against float32, all side information counted", ratio_rows(records)),
        ("Bytes saved at equal error (Bjøntegaard difference, number of recordings)", difference_rows(records)),
        ("Without loss", lossless_rows(records)),
        ("Speed and memory", speed_rows(records)),
        ("Every recording", file_rows(records)),
        ("Not measured, and why", problem_rows(records)),
    ]


def our_rows(table: Table) -> Table:
    """The rows of our codecs."""
    head, rows = table
    return head, [row for row in rows if row[0] in OURS]
