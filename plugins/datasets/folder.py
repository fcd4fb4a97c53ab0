"""A user's own rectified stereo pair: two folders of images and the camera's numbers."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError, require_least
from bench.io.own_pairs import FolderPairs, times_and_poses
from bench.io.trajectories import known_poses
from bench.registry import PluginConfig, register
from bench.types import StereoCamera, StereoFrame, Trajectory


@dataclass(frozen=True)
class FolderConfig(PluginConfig):
    """Where the images are, and the calibration of the rectified pair; all but the last three must be given."""

    left: str = field(default="", metadata={"path": True})
    """Folder of the left images, PNG or JPEG, in the order of the number or time in their names, counted from 0."""
    right: str = field(default="", metadata={"path": True})
    """Folder of the right images; pairs have the same number, time or name."""
    fx: float = 0.0
    """Focal length along x in pixels."""
    fy: float = 0.0
    """Focal length along y in pixels."""
    cx: float = 0.0
    """Principal point along x in pixels."""
    cy: float = 0.0
    """Principal point along y in pixels."""
    baseline: float = 0.0
    """Distance of the two cameras in metres."""
    poses: str | None = field(default=None, metadata={"path": True})
    """Ground truth of the left camera; null: none. A TUM file is joined by time where the images have times; else line
    i is image i, or of a KITTI file with more lines than images line k is the image with number k."""
    times: str | None = field(default=None, metadata={"path": True})
    """File with the time of each left image in seconds, one a line; null: those in the names, and where a TUM file
    needs some, ``times.txt`` beside the left folder."""
    frames: str = ""
    """Image numbers ``a:b`` or ``a:b:step``; empty: all."""

    def __post_init__(self) -> None:
        require_least("dataset", self, fx=0, fy=0, cx=0, cy=0, baseline=0)


@register("dataset", "folder", config=FolderConfig)
class Folder(Dataset):
    """Your own rectified pair: two folders of images, intrinsics, baseline, optional poses."""

    def __init__(self, config: FolderConfig) -> None:
        for what in fields(config):
            value = getattr(config, what.name)
            if what.name in ("fx", "fy", "cx", "cy", "baseline") and not (np.isfinite(value) and value > 0):
                raise BenchError(f"dataset.{what.name}={value} must be positive. Take it from your calibration.")
        self._pairs = FolderPairs(config.left, config.right, config.frames)
        self.label = f"folder/{Path(config.left).resolve().parent.name}"
        self.numbers = self._pairs.numbers
        self.camera = _camera(config, self._pairs.size)
        found = times_and_poses(self._pairs, config.poses, config.times)
        self._times, self._poses = found.times, found.poses
        self.remarks = (*self._pairs.remarks, *found.remarks)

    def frame(self, position: int) -> StereoFrame:
        """Decode one pair; raises ``BenchError`` if an image turns out to be damaged."""
        return StereoFrame(self.numbers[position], float(self._times[position]), *self._pairs.pair(position))

    def ground_truth(self) -> Trajectory | None:
        """The poses of the file, of the frames that have one; None where none has."""
        if self._poses is None or not (known := known_poses(self._poses)).any():
            return None
        return Trajectory(self._poses[known], np.array(self.numbers, dtype=np.int64)[known], self._times[known])


def _camera(config: FolderConfig, size: tuple[int, int]) -> StereoCamera:
    width, height = size
    if config.cx >= width or config.cy >= height:
        raise BenchError(
            f"dataset.cx={config.cx}, dataset.cy={config.cy} lie outside the images of {width}x{height} pixels. "
            "Give the principal point for this size."
        )
    fx, fy, cx, cy = config.fx, config.fy, config.cx, config.cy
    return StereoCamera(width, height, fx=fx, fy=fy, cx=cx, cy=cy, right_position=(config.baseline, 0.0, 0.0))
