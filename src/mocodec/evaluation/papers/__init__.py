"""The tables and figures of the three papers, ours beside the published: a module for each, with `run`."""
