"""A second decoder of hou2014, liu2006, lossless and tempo, written from docs/payloads/: the pages suffice."""
