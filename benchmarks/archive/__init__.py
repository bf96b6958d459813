"""Measurements of archives: sizes, windows, queries, retrieval."""
