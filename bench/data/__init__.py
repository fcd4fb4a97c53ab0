"""Data sets on this machine: which there are, where they lie, how they get there, and whether they are whole."""
