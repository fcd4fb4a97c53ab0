"""One run as tables see it, wherever it was read from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

VIEW_GROUPS = ("left", "heldout", "right")
_IMAGE_KEYS = ("psnr_db", "ssim", "lpips", "depth_l1_cm")


@dataclass(frozen=True)
class RunRecord:
    """One run, without anything about where it lay: ``name`` is that of its folder.

    ``source`` is what a table links to: the run folder, or a record file with ``#L`` and the run's line in it.
    ``state`` is that of ``status.json`` in words ("done", "out of memory", "killed" ...), ``date`` its day. ``metrics``
    are those of ``metrics.json`` but for ``protocol``, their stamp; ``provenance`` is that of ``read_provenance``.
    ``views`` says whose PSNR, SSIM, LPIPS and Depth-L1 are its ``values``: "left" (all left images), "heldout" or
    "right".
    """

    name: str
    source: Path
    config: Mapping[str, Any]
    state: str
    reason: str = ""
    frames_done: int = 0
    frames_total: int = 0
    date: str = ""
    metrics: Mapping[str, Any] = field(default_factory=dict)
    protocol: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    views: str = "left"

    @property
    def seed(self) -> int:
        """The run's seed; 0 where its config has none."""
        seed = self.config.get("seed")
        return seed if isinstance(seed, int) else 0

    @cached_property
    def frames(self) -> int:
        """How many frames the run got through."""
        total = self.part("frames").get("total")
        if self.state in ("done", "no status") and isinstance(total, int):
            return total
        # An interrupted run's metrics name the frames that there were to do.
        return self.frames_done

    @cached_property
    def values(self) -> dict[str, float]:
        """Numbers by metric key, only those that are known."""
        image = _part(self.part("views"), self.views)
        found: dict[str, Any] = {key: image.get(key) for key in _IMAGE_KEYS}
        found |= self.part("resources")
        found["ate_rmse_m"] = self.part("trajectory").get("ate_rmse_m")
        return {key: value for key, value in found.items() if is_number(value)}

    @property
    def notes(self) -> tuple[str, ...]:
        """Why numbers are missing."""
        return tuple(f"{name}: {reason}" for name, reason in self.part("notes").items())

    @property
    def static_camera_m(self) -> float | None:
        """The ATE in metres of a camera that never moves, on this run's frames."""
        static = self.part("trajectory").get("static_camera_ate_rmse_m")
        return static if is_number(static) else None

    def part(self, name: str) -> dict[str, Any]:
        """A part of the metrics ("trajectory", "views", ...); empty where there is none."""
        return _part(self.metrics, name)


def _part(mapping: Mapping[str, Any], key: str) -> dict[str, Any]:
    part = mapping.get(key)
    return part if isinstance(part, dict) else {}


def is_number(value: Any) -> bool:
    """Whether it is an int or a float, and no bool."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)
