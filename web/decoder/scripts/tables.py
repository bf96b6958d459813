"""Writes src/tables.json and src/lab_words.json: literal tables of the format (docs/format.md), from the package.

    python web/decoder/scripts/tables.py            # write them again after a table has grown
    python web/decoder/scripts/tables.py --check    # exit status 1 if they would change

Run it with mocodec importable (an installed package, or PYTHONPATH=src).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from mocodec.container import tables, values
from mocodec.signals import residuals

SOURCE = Path(__file__).parents[1] / "src"


def contents() -> dict[str, str]:
    """The text of each file. A dictionary of bytes is a text with one character for each byte."""
    lab_words = values.lab_dictionary().removesuffix(values.dictionary())
    return {"tables.json": compact(literal_tables()), "lab_words.json": compact({"dictionary": as_text(lab_words)})}


def literal_tables() -> dict[str, Any]:
    vocabulary = "\n".join(dict.fromkeys(tables.VOCABULARY))
    return {
        "codecs": {str(number): name for number, name in tables.CODEC_IDS.items()},
        "rates": tables.RATES,
        "vocabulary": " ".join(tables.VOCABULARY),
        "nameDictionaryHead": tables.NAME_DICTIONARY.decode().removesuffix(vocabulary),
        "trees": tables.TREES,
        "referenceOffsets": {str(number): offsets for number, offsets in tables.REFERENCE_OFFSETS.items()},
        "referenceLimits": {str(number): limits for number, limits in tables.REFERENCE_LIMITS.items()},
        "limitRanges": tables.CMU_RANGES,
        "limitFrames": tables.CMU_FRAMES,
        "words": tables.WORDS,
        "moreWords": tables.MORE_WORDS,
        "sources": tables.SOURCES,
        "valueDictionary": as_text(values.dictionary()),
        "laplaceRatios": residuals.LAPLACE_RATIOS,
        "gaussRatios": residuals.GAUSS_RATIOS,
    }


def as_text(data: bytes) -> str:
    return data.decode("latin-1")


def compact(found: dict[str, Any]) -> str:
    return json.dumps(found, ensure_ascii=True, separators=(",", ":")).replace(',"', ',\n"') + "\n"


def main() -> None:
    found = contents()
    if "--check" in sys.argv[1:]:
        raise SystemExit(any((SOURCE / name).read_text() != text for name, text in found.items()))
    for name, text in found.items():
        (SOURCE / name).write_text(text)


if __name__ == "__main__":
    main()
