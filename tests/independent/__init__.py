"""A second decoder of hou2014, liu2006 and lossless, written from docs/payloads/: it shows that the pages suffice."""
