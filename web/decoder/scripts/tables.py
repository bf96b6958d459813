"""Writes src/tables.json: the literal tables of the format (docs/format.md), from the Python package.

    python web/decoder/scripts/tables.py            # write it again after a table has grown
    python web/decoder/scripts/tables.py --check    # exit status 1 if it would change

Run it with mocodec importable (an installed package, or PYTHONPATH=src).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from mocodec.container import tables, values
from mocodec.signals import residuals

TARGET = Path(__file__).parents[1] / "src" / "tables.json"


def content() -> str:
    found = {
        "codecs": {str(number): name for number, name in tables.CODEC_IDS.items()},
        "rates": tables.RATES,
        "vocabulary": " ".join(tables.VOCABULARY),
        "nameDictionaryHead": tables.NAME_DICTIONARY.decode().removesuffix("\n".join(dict.fromkeys(tables.VOCABULARY))),
        "trees": tables.TREES,
        "referenceOffsets": {str(number): offsets for number, offsets in tables.REFERENCE_OFFSETS.items()},
        "referenceLimits": {str(number): limits for number, limits in tables.REFERENCE_LIMITS.items()},
        "limitRanges": tables.CMU_RANGES,
        "limitFrames": tables.CMU_FRAMES,
        "words": tables.WORDS,
        "moreWords": tables.MORE_WORDS,
        "sources": tables.SOURCES,
        "valueDictionary": values.dictionary().decode("latin-1"),
        "laplaceRatios": residuals.LAPLACE_RATIOS,
        "gaussRatios": residuals.GAUSS_RATIOS,
    }
    return json.dumps(found, ensure_ascii=True, separators=(",", ":")).replace(',"', ',\n"') + "\n"


def main() -> None:
    if "--check" in sys.argv[1:]:
        raise SystemExit(TARGET.read_text() != content())
    TARGET.write_text(content())


if __name__ == "__main__":
    main()
