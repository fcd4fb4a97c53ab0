"""The disk cache: depth maps, sky masks and trajectories, computed once and shared by all runs."""

from bench.cache.cost import cost_of
from bench.cache.settings import CacheConfig
from bench.cache.sources import cached_depth_source, cached_segmenter
from bench.cache.tracking import cached_tracker

__all__ = ["CacheConfig", "cached_depth_source", "cached_segmenter", "cached_tracker", "cost_of"]
