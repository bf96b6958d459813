"""The tables and figures of three papers, our results beside the printed ones: a module with `run` for each."""
