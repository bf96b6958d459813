"""Progress of a command on many files, on standard error: bars on a terminal, otherwise a line for each file."""

from __future__ import annotations

import sys
from typing import Any, Self

from . import files, summary


class Display:
    """total: files to work on; skipped: files that are done already. quiet: show only what fails."""

    def __init__(self, total: int, skipped: int, quiet: bool) -> None:
        self.total, self.skipped, self.quiet = total, skipped, quiet
        self.finished = 0
        self._bars: Any = None
        self._whole: Any = None
        self._of_file: dict[str, Any] = {}

    def __enter__(self) -> Self:
        if self.quiet:
            return self
        if self.skipped:
            files.line(f"{self.skipped} of {self.total + self.skipped} files are done already", err=True)
        if self.total and sys.stderr is not None and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            columns = (TextColumn("{task.description}", markup=False), BarColumn(24), MofNCompleteColumn())
            self._bars = Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True)
            self._whole = self._bars.add_task("all files", total=self.total)
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars is not None:
            self._bars.stop()

    def start(self, name: str) -> None:
        """Work on this file begins."""
        if self._bars is not None:
            self._of_file[name] = self._bars.add_task(files.printable(name), total=100)

    def advance(self, name: str, fraction: float) -> None:
        """This fraction of a file is done."""
        if name in self._of_file:
            self._bars.update(self._of_file[name], completed=round(100 * fraction))
            within = sum(task.completed / 100 for task in self._bars.tasks if task.id in self._of_file.values())
            self._bars.update(self._whole, completed=self.finished + round(within, 2))

    def finish(self, record: dict[str, Any]) -> None:
        """A file is done, or has failed."""
        self.finished += 1
        if self.quiet and record["status"] != "failed":
            return
        if self._bars is None:
            files.line(f"[{self.finished}/{self.total}] {summary.line(record)}", err=True)
            return
        if record["file"] in self._of_file:
            self._bars.remove_task(self._of_file.pop(record["file"]))
        self._bars.update(self._whole, completed=self.finished)
        if record["status"] == "failed":
            self._bars.console.print(files.printable(summary.line(record)), markup=False, highlight=False)
