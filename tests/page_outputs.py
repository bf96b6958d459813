"""Fill the outputs that the tutorial and the how-to pages show, so that no number is typed by hand: `scripts/outputs`.

A ```text block shows what the last command of the ```console block above it prints: the paragraph (lines up to an empty
one) that begins with the first word of the block. A block whose first word begins no line of this output stays as it
is. The blocks of a page run in order, in a folder of their own.
"""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import subprocess
import sys
import tempfile
import textwrap
from itertools import pairwise, takewhile
from pathlib import Path

from .test_docs import PAGES

WIDTH = 80
"""Columns that a page shows without scrolling."""
BLOCK = re.compile(r"^```(console|python|text)\n(.*?)^```\n(\n?)", re.DOTALL | re.MULTILINE)


def filled(page: str) -> str:
    """The text of a page with its outputs. Runs its blocks in the working folder."""
    names: dict[str, object] = {}
    output, end, result = "", 0, ""
    for match in BLOCK.finditer(page):
        language, block = match[1], match[2]
        result += page[end : match.start()]
        if language == "text":
            block = shown(output, block.split()[0]) or block
        elif language == "python":
            with contextlib.redirect_stdout(io.StringIO()):
                exec(compile(block, "page", "exec"), names)
        else:
            for line in block.splitlines():
                output = printed(shlex.split(line, comments=True)[1:])
        result += f"```{language}\n{block}```\n{match[3]}"
        end = match.end()
    return result + page[end:]


def printed(words: list[str]) -> str:
    """What a command prints, on standard output and error."""
    command = [sys.executable, "-m", *words]
    return subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True).stdout


def shown(output: str, first_word: str) -> str:
    """The paragraph of an output that begins with this word, in lines of at most WIDTH columns; "" if none does."""
    lines = output.splitlines()
    start = next((i for i, line in enumerate(lines) if line.split()[:1] == [first_word]), len(lines))
    paragraph = takewhile(str.strip, lines[start:])
    return "".join(textwrap.fill(line, WIDTH, subsequent_indent="  ") + "\n" for line in paragraph)


def main() -> None:
    """Fill the pages that are named, or all that show outputs."""
    named = {Path(name).resolve() for name in sys.argv[1:]}
    for page in PAGES:
        text = page.read_text()
        languages = [match[1] for match in BLOCK.finditer(text)]
        if (named and page not in named) or ("console", "text") not in pairwise(languages):
            continue
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            after = filled(text)
        page.write_text(after)
        print(f"{page.name}: {'filled' if after != text else 'as it was'}")


if __name__ == "__main__":
    main()
