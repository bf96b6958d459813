"""Speed, single thread, with pytest-benchmark: codecs, the entropy coder, readers, opening a file, start."""
