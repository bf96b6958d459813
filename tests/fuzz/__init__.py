"""Fuzzing: damaged files for every reader, re-signed containers of every codec, and strange motions for every codec.

    seeds ─► mutations ─► one call in a process with limits (worker) ─► outcome ─► counts, minimised failures (campaign)

`scripts/fuzz --minutes 30` runs all three; `tests/fuzz/test_fuzz.py` runs some calls of each.
"""
