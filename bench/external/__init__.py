"""Other systems' output: read from a folder of theirs, written as a run folder, scored like any run."""
