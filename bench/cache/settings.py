"""The settings of the disk cache: ``cache.enabled``, ``cache.all``, ``cache.folder``, ``cache.limit_gb``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.errors import BenchError
from bench.weights.places import cache_root


@dataclass
class CacheConfig:
    """Where depth maps, sky masks and trajectories are stored for later runs; can't change a result."""

    enabled: bool = True
    """Use the cache, for plugins that are worth it (networks)."""
    all: bool = False
    """Also for what takes a few hundredths of a second per frame: other stereo, and tracking. Sweeps switch it on, so
    that their runs share it."""
    folder: str = ""
    """Where it is; empty: frames/ in $BGS_CACHE, else in the user's cache folder."""
    limit_gb: float = 20.0
    """How much it may hold, in GB of 1e9 bytes (inf: no limit); sequences that no run reads at the moment go first, and
    one that is larger keeps its first part."""

    def __post_init__(self) -> None:
        if not self.limit_gb > 0:
            raise BenchError(
                f"cache.limit_gb={self.limit_gb} must be positive. cache.enabled=false switches the cache off."
            )

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> CacheConfig:
        """Settings from plain data, with an absolute folder."""
        config = cls(**mapping)
        config.folder = str(Path(config.folder).expanduser().absolute() if config.folder else default_folder())
        return config


def default_folder() -> Path:
    """Where the cache is when ``cache.folder`` is not set."""
    return cache_root() / "frames"
