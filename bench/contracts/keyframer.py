"""Contract of a keyframer: which frames the map learns from."""

from __future__ import annotations

from abc import ABC, abstractmethod

from bench.types import KeyframeDecision, StereoFrame, TrackingResult


class Keyframer(ABC):
    """Decides which tracked frames become keyframes and which keyframes are active."""

    @abstractmethod
    def update(self, frame: StereoFrame, tracking: TrackingResult) -> KeyframeDecision:
        """Called for every tracked frame that mapping may use, in order; never for lost or held-out frames."""
