"""Tests of the benchmarks themselves: `scripts/bench test`."""
