"""What a command on many files has done in an output folder: one JSON line a file, so that a later run can go on.

    OUT/.mocodec-done.jsonl     {"output": …, "command": …, "options": …, "record": …, "source": …, "written": …}

A file is done if its source, its output and the options are what they were when it was written: sizes in bytes and
times of change in nanoseconds. A line is appended before the work on a file ("begun"), and after it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .. import formats
from ..errors import BadInput
from ..formats.folders import fingerprint

NAME = ".mocodec-done.jsonl"


class Journal:
    """The journal of an output folder. Raises BadInput if it cannot be written."""

    def __init__(self, folder: str, command: str, options: Mapping[str, Any]) -> None:
        self.folder = Path(folder)
        self.command = command
        self.options = json.loads(json.dumps(options))
        self.path = self.folder / NAME
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            lines = self.path.read_text("utf-8", "surrogateescape").splitlines() if self.path.exists() else []
        except OSError as error:
            raise BadInput(f"{folder}: cannot write here ({error.strerror})") from error
        self.entries: dict[str, dict[str, Any]] = {}
        for line in lines:
            self._take(line)
        if len(lines) > 2 * len(self.entries):
            text = "".join(json.dumps(entry) + "\n" for entry in self.entries.values())
            formats.replace_whole(self.path, text.encode())

    def _take(self, line: str) -> None:
        try:
            entry = json.loads(line)
        except ValueError:  # a line that a killed process left incomplete
            return
        if isinstance(entry, dict) and isinstance(entry.get("output"), str):
            self.entries[entry["output"]] = entry

    def knows(self, output: str | None) -> bool:
        """Whether an earlier run wrote this output, or began to."""
        return output in self.entries

    def done(self, output: str, source: str) -> dict[str, Any] | None:
        """The record of an output that need not be made again; None if it must be."""
        entry = self.entries.get(output, {})
        state = {"command": self.command, "options": self.options}
        state |= {"source": fingerprint(source, self.options), "written": fingerprint(str(self.folder / output))}
        is_same = all(entry.get(name) == value for name, value in state.items())
        record = entry.get("record")
        return record if is_same and state["written"] and isinstance(record, dict) else None

    def begin(self, output: str) -> None:
        """Note that work on an output begins: what lies there from now on may be replaced."""
        if output not in self.entries:
            self._append({"output": output, "begun": True})

    def add(self, output: str, source: str, record: Mapping[str, Any]) -> None:
        """Note that an output is complete."""
        entry = {"output": output, "command": self.command, "options": self.options, "record": dict(record)}
        entry |= {"source": fingerprint(source, self.options), "written": fingerprint(str(self.folder / output))}
        self._append(entry)

    def _append(self, entry: dict[str, Any]) -> None:
        self.entries[entry["output"]] = entry
        line = (json.dumps(entry) + "\n").encode()
        try:
            descriptor = os.open(self.path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
            try:
                size = os.fstat(descriptor).st_size
                if size and os.lseek(descriptor, size - 1, os.SEEK_SET) >= 0 and os.read(descriptor, 1) != b"\n":
                    line = b"\n" + line
                os.write(descriptor, line)
            finally:
                os.close(descriptor)
        except OSError as error:
            raise BadInput(f"{self.path}: cannot be written ({error.strerror})") from error
