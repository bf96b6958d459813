"""Where the `mocodec` command begins: signals end it without a traceback while `mocodec` is being imported.

A package of its own, since importing anything of `mocodec` imports NumPy, which takes a tenth of a second.
"""

from __future__ import annotations

import os
import signal


def main() -> None:
    """The `mocodec` command."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda received, _: os._exit(128 + received))
    from mocodec import cli

    cli.main()
