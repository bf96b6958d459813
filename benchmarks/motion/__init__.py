"""Motion codecs against rivals: every codec at every target on every recording, and a report."""
