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
    """Where depth maps, sky masks and trajectories are kept for later runs; can't change a result.

    ``enabled``: use the cache, for plugins that are worth it (networks). ``all``: also for what takes a few hundredths
    of a second a frame, other stereo and tracking; sweeps switch it on, so that their runs share it. ``folder``: where;
    empty = ``$BGS_CACHE/frames``, else ``frames`` in the user's cache folder. ``limit_gb``: how much it may hold, in GB
    of 1e9 bytes; what was not used for the longest time goes first.
    """

    enabled: bool = True
    all: bool = False
    folder: str = ""
    limit_gb: float = 20.0

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any]) -> CacheConfig:
        """Settings from plain data, with an absolute folder; raises ``BenchError`` for a limit that is none."""
        config = cls(**mapping)
        if not config.limit_gb > 0:
            raise BenchError(
                f"cache.limit_gb={config.limit_gb} must be positive. cache.enabled=false switches the cache off."
            )
        config.folder = str(Path(config.folder).expanduser().absolute() if config.folder else default_folder())
        return config


def default_folder() -> Path:
    """Where the cache is when ``cache.folder`` is not set."""
    return cache_root() / "frames"
