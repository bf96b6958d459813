"""Benchmarks of the codecs, against each other, against other coders and against their papers.

Run from the repository root: `scripts/bench COMMAND …` or `python -m benchmarks COMMAND …`; without a command it lists
them. docs/evaluation.md explains the measurements and which command makes which table.
"""
