"""Contract of a keyframer: which frames the map learns from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from bench.contracts.map_view import MapView
from bench.types import KeyframeDecision, StereoCamera, StereoFrame, TrackingResult


class Keyframer(ABC):
    """Decides which tracked frames become keyframes and which keyframes are active."""

    uses_map: bool = False
    """True for a keyframer that looks at the map: it gets ``use_map``, and the run goes in step."""

    def start(self, camera: StereoCamera) -> None:  # noqa: B027 - most rules don't ask for the camera
        """Called once, before ``use_map`` and the first frame."""

    def use_map(self, view: MapView) -> None:
        """The map to look at, for one that ``uses_map``; called once, before the first frame."""
        raise NotImplementedError(f"{type(self).__name__} says uses_map and has no use_map()")

    @abstractmethod
    def update(self, frame: StereoFrame, tracking: TrackingResult) -> KeyframeDecision:
        """Called for every tracked frame that mapping may use, in order; never for lost or held-out frames."""

    def state(self) -> dict[str, Any] | None:
        """All that deciding resumes from, for a checkpoint, as ``Tracker.state``; None (the default) = it has none.

        Where tracker and keyframer both give one, a run is resumed without repeating its frames.
        """
        return None

    def restore(self, state: dict[str, Any]) -> None:
        """Resume from what ``state`` gave; called after ``start`` and ``use_map``."""
        raise NotImplementedError(f"{type(self).__name__} gives a state() and has no restore() to resume from it")
