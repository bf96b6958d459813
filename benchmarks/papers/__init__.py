"""Tables and figures of three papers, our results beside the printed ones; each module has a `run`."""
