"""``bgs-bench view``: a run in the browser."""
