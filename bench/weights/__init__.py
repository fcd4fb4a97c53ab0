"""Network weights: what there is, where it lies on this machine, and how it gets there."""

from bench.weights.places import chosen, locate, missing, resolve

__all__ = ["chosen", "locate", "missing", "resolve"]
