"""`python -m mocodec`."""

from .cli import main

main()
