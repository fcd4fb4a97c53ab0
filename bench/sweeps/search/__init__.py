"""Searches with Optuna: what is varied and sought, and the runs that it takes."""
