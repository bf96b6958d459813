"""Encoded to one `.mocz` file and back."""
