"""Benchmarks of codecs for point clouds of people, on synthetic sequences with known surface and skeleton."""
