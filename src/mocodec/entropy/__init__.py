"""Integers to bytes and back, in integer arithmetic only: `coder` for arrays, `lanes` for learned tables."""
