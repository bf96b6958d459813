"""Hooks of mkdocs, which change pages of docs/ before rendering.

    <!-- include FILE -->      becomes FILE (a path from the repository root); a .py file becomes a code block
    <!-- help COMMAND -->      becomes the output of `mocodec COMMAND --help`; no COMMAND is mocodec itself

Links out of docs/ work in a checkout but not on the site, so they become plain text.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES_OF_ROOT = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md", "README.md": "index.md"}
"""Files of the repository root with their own pages."""

WIDTH = 80
"""Columns of a help text that a page shows without scrolling."""

INCLUDE = re.compile(r"<!-- include (\S+) -->")
HELP = re.compile(r"<!-- help ?(\S*) -->")
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\((?!https?://|#)([^)#\s]+)(#[^)]*)?\)")


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """The Markdown of a page, with inclusions, help texts and links resolved."""
    folder = (DOCS / page.file.src_uri).parent
    markdown = INCLUDE.sub(lambda match: included(ROOT / match[1], folder), markdown)
    markdown = HELP.sub(lambda match: help_text(match[1]), markdown)
    return LINK.sub(lambda match: link(match, folder), markdown)


def included(path: Path, folder: Path) -> str:
    """A file as Markdown for a page in `folder`."""
    text = path.read_text()
    if path.suffix == ".py":
        return f"```python\n{text.rstrip()}\n```"

    def moved(match: re.Match[str]) -> str:
        target = relative((path.parent / match[2]).resolve(), folder)
        return f"[{match[1]}]({target}{match[3] or ''})"

    return LINK.sub(moved, text)


def help_text(command: str) -> str:
    """The help of a command as a code block."""
    import click

    from mocodec import cli

    context = click.Context(cli.mocodec, info_name="mocodec", terminal_width=WIDTH, max_content_width=WIDTH)
    if command:
        chosen = cli.mocodec.get_command(context, command)
        assert chosen is not None, f"no command {command!r}"
        context = click.Context(chosen, context, info_name=command, terminal_width=WIDTH, max_content_width=WIDTH)
    return f"```text\n{context.get_help()}\n```"


def link(match: re.Match[str], folder: Path) -> str:
    """Resolves a link of a page in `folder`: unchanged within docs/; to the page of a root file; else only its text."""
    target = (folder / match[2]).resolve()
    if target.is_relative_to(DOCS):
        return match[0]
    page = PAGES_OF_ROOT.get(target.name) if target.parent == ROOT else None
    return match[1] if page is None else f"[{match[1]}]({relative(DOCS / page, folder)}{match[3] or ''})"


def relative(target: Path, folder: Path) -> str:
    """A path from `folder` to `target`, with forward slashes."""
    return Path(os.path.relpath(target, folder)).as_posix()
