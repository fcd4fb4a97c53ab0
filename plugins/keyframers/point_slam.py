"""Point-SLAM's choice of frames to map: every so many, and all of them at the start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bench.contracts.keyframer import Keyframer
from bench.errors import require_least
from bench.registry import PluginConfig, register
from bench.types import KeyframeDecision, StereoFrame, TrackingResult


@dataclass(frozen=True)
class PointSlamKeyframerConfig(PluginConfig):
    """Settings of the choice; the defaults are the original's for Replica."""

    every: int = 5
    """A frame is mapped when its number is so much larger than the last mapped one's."""
    first_frames: int = 20
    """So many frame numbers from the first on are all mapped."""
    window: int = 12
    """Mapped frames that count as active, for mappers that go by it; mapper=point_slam chooses its own."""

    def __post_init__(self) -> None:
        require_least("keyframer", self, every=1, first_frames=0, window=1)


@register("keyframer", "point_slam", config=PointSlamKeyframerConfig)
class PointSlamKeyframer(Keyframer):
    """Maps every frame at the start and every fifth one later, whatever it shows."""

    def __init__(self, config: PointSlamKeyframerConfig) -> None:
        self._config = config
        self._first: int | None = None
        self._window: list[int] = []

    def update(self, frame: StereoFrame, tracking: TrackingResult) -> KeyframeDecision:
        """By the frame's number alone."""
        c, number = self._config, frame.number
        if self._first is None:
            self._first, reason = number, "first frame"
        elif number - self._first < c.first_frames:
            reason = f"one of the first {c.first_frames} frames"
        elif number - self._window[-1] >= c.every:
            reason = f"{number - self._window[-1]} after the last mapped frame"
        else:
            return KeyframeDecision(False, "too near to the last mapped frame", tuple(self._window))
        self._window = [*self._window, number][-c.window :]
        return KeyframeDecision(True, reason, tuple(self._window))

    def state(self) -> dict[str, Any]:
        """The first frame and the window."""
        return {"first": self._first, "window": list(self._window)}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        self._first, self._window = state["first"], list(state["window"])
