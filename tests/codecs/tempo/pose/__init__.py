"""Tests of tempo, a file a module."""
