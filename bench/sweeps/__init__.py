"""Sweeps: the runs that a table wants, each in a process of its own, made once and resumed after a kill."""
