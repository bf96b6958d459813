"""Comparison with independent readers of C3D and TRC files."""
