"""Network weights: what there is, where it lies on this machine, and how it gets there."""

from bench.weights.places import locate, resolve

__all__ = ["locate", "resolve"]
