"""Contract of a tracker: stereo frames in, camera poses out."""

from __future__ import annotations

from abc import ABC, abstractmethod

from bench.contracts.dataset import Dataset
from bench.types import StereoFrame, TrackingResult, Trajectory


class Tracker(ABC):
    """Estimates ``T_world_cam`` of the left camera, frame by frame."""

    worth_caching: bool = False
    """Whether its answers may be shared between runs with the same frames and settings, and cost more than reading
    them: True for a tracker that looks at images and always says the same about them."""

    @abstractmethod
    def start(self, dataset: Dataset) -> None:
        """Called once before the first frame. The data set gives the camera and, to ``groundtruth``, the poses."""

    @abstractmethod
    def track(self, frame: StereoFrame) -> TrackingResult:
        """Pose of this frame, as well as it is known now. Called once a frame, in order."""

    @abstractmethod
    def trajectory(self) -> Trajectory:
        """The best poses known now of all frames tracked so far (later corrections included; lost frames absent)."""
