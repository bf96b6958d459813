"""For authors of codecs: CodecTests, strategies, synthetic motion."""
