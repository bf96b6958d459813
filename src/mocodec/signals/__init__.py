"""Signals (analog channels, residuals, angles) to bytes and back: exactly, or within a bound for each channel."""
