"""Data sets, runs and tables: how the codecs are measured, against each other and against the papers."""
