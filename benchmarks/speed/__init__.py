"""Speed on a single thread, with pytest-benchmark: codecs, entropy coder, readers, opening a file, start."""
