"""Integers to bytes and back, in integer arithmetic only."""
