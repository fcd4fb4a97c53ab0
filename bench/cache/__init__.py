"""The disk cache: depth maps and sky masks of networks, computed once and shared by all runs."""

from bench.cache.settings import CacheConfig
from bench.cache.sources import cached_depth_source, cached_segmenter, cost_of

__all__ = ["CacheConfig", "cached_depth_source", "cached_segmenter", "cost_of"]
