"""Formats: what is read is what was written, and damage is one clear line."""
