"""Help of commands with many options: options under headings, in the order in which the command names them."""

from __future__ import annotations

from typing import Any

import click

OPTIONS = "Options"
TARGETS = "Target: how exact, or how small; give one"
CLOUDS = "For point clouds"
MANY = "For many files"
READING = "How the input is read"
WRITING = "How the output is written"


class Option(click.Option):
    """An option below a heading of the help."""

    def __init__(self, *names: Any, section: str = OPTIONS, **attributes: Any) -> None:
        super().__init__(*names, **attributes)
        self.section = section


class Command(click.Command):
    """A command whose help has a heading for each section of its options; OPTIONS is the first."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options of each section."""
        sections: dict[str, list[tuple[str, str]]] = {OPTIONS: []}
        for option in self.get_params(ctx):
            if isinstance(option, click.Option) and (record := option.get_help_record(ctx)) is not None:
                section = option.section if isinstance(option, Option) else OPTIONS
                sections.setdefault(section, []).append(record)
        for section, records in sections.items():
            with formatter.section(section):
                formatter.write_dl(records)


def option(*names: Any, section: str, **attributes: Any) -> Any:
    """A decorator, as `click.option`, for an option below this heading."""
    return click.option(*names, cls=Option, section=section, **attributes)
