"""What a run will take of disk and memory, said before it begins."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from bench.cache.sources import CachedDepthSource
from bench.config import RunConfig
from bench.contracts.mapper import MapNeeds
from bench.errors import BenchError
from bench.slam.system import System

# PNGs of one view, colour and depth together, for each pixel: 2.4 to 3.2 measured on the street, 2.6 on KITTI.
_VIEW_BYTES = 2.7
# Rows, events, poses and lines of the log.
_FRAME_BYTES = 3000.0
_DEPTH_MAP_BYTES = 4.0
# A run of fewer frames needs little memory beyond what the program itself takes.
_LONG_FRAMES = 500
# With less than this share of what it needs a run is not even begun.
_LEAST_SHARE = 0.1


@dataclass(frozen=True)
class Needs:
    """About what a run takes on disk, in bytes: ``renders`` and ``map`` stay, ``checkpoint`` is there until it is done,
    ``cache`` lies in ``cache_folder``.

    ``map`` and ``checkpoint`` are None where the mapper can't tell; so is ``memory_gb``, and of a short run.
    """

    folder: Path
    frames: int
    renders: float
    map: float | None
    checkpoint: float | None
    cache: float
    cache_folder: Path
    memory_gb: float | None

    @classmethod
    def of(cls, system: System, config: RunConfig) -> Needs:
        """The needs of a run that is about to begin."""
        frames, camera = len(system.dataset), system.dataset.camera
        pixels = camera.width * camera.height
        views = (2 if system.protocol.right_view and system.dataset.has_right else 1) * system.mapper.wants_keyframes
        mapped: MapNeeds | None = system.mapper.needs(frames)
        wanted = system.mapper.wants_keyframes or system.tracker.uses_depth
        cached = isinstance(system.stereo, CachedDepthSource) and wanted
        return cls(
            folder=config.output,
            frames=frames,
            renders=frames * (views * pixels * _VIEW_BYTES + _FRAME_BYTES),
            map=None if mapped is None else mapped.map_bytes,
            checkpoint=None if mapped is None else mapped.checkpoint_bytes,
            cache=min(frames * pixels * _DEPTH_MAP_BYTES, config.cache.limit_gb * 1e9) if cached else 0.0,
            cache_folder=Path(config.cache.folder),
            memory_gb=None if mapped is None or frames <= _LONG_FRAMES else mapped.memory_gb,
        )

    @property
    def run_folder(self) -> float:
        """Bytes of the run folder when it is largest: all is rendered and the checkpoint still there."""
        return self.renders + (self.map or 0.0) + (self.checkpoint or 0.0)

    def line(self) -> str:
        """What it needs and what is free, in one line; ``BenchError`` where not even a tenth of that is free."""
        free = _free(self.folder)
        if free < _LEAST_SHARE * self.run_folder:
            raise BenchError(
                f"This run needs about {_size(self.run_folder)} in {self.folder}, and {_size(free)} are free there. "
                "Make room, choose another place (output=FOLDER), fewer frames (dataset.frames=A:B), one view of each "
                "(protocol.right_view=false); where the cache fills the same disk, cache.enabled=false."
            )
        parts = {"renders": self.renders, "map": self.map, "checkpoint until it is done": self.checkpoint}
        known = ", ".join(f"{what} {_size(size)}" for what, size in parts.items() if size is not None)
        cache = f", and up to {_size(self.cache)} of cache" if self.cache else ""
        memory = "" if self.memory_gb is None else f"; memory about {self.memory_gb:.1f} GB"
        return (
            f"{self.frames} frames need about {_size(self.run_folder)} on disk ({known}){cache}; {_size(free)} free"
            f"{memory}{self._warning(free)}"
        )

    def _warning(self, free: float) -> str:
        if free < self.run_folder:
            return ". Warning: it may not fit; make room, or choose another output="
        if self.cache and _free(self.cache_folder) < self.cache:
            return ". Warning: the cache may not fit; see cache.folder, cache.limit_gb, cache.enabled"
        return ""


def _free(folder: Path) -> float:
    """Bytes that may be written below ``folder``; what lies there already is continued or replaced, so it counts."""
    there = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    own = sum(file.lstat().st_size for file in folder.rglob("*") if file.is_file()) if folder.is_dir() else 0
    return shutil.disk_usage(there).free + own


def _size(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.3g} MB"
