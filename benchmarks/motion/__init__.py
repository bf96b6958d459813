"""Motion codecs against rivals: every codec at every target on every recording, and the report of it."""
