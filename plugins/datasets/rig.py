"""A user's own stereo rig: unrectified images or videos, and the calibration that a common tool wrote."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError, require_between, require_choice, require_least
from bench.geometry import se3
from bench.geometry.rectification import MODELS, Rectification
from bench.io.images import shrunk
from bench.io.own_pairs import FolderPairs, OwnPairs, VideoPairs, times_and_poses
from bench.io.rig_calibration import read_rig
from bench.io.trajectories import known_poses
from bench.registry import PluginConfig, register
from bench.tracking.row_offset import row_offset_of_pairs
from bench.types import Image, StereoFrame, Trajectory

_JUDGED = 5
"""Pairs, evenly over the frames, whose corners say how good the rectification is ..."""
_LEAST_CORNERS = 30
"""... if so many match."""
_FARTHEST_PX = 2.0
"""Stereo matching looks along rows: with corners farther off them it finds nothing, or what is wrong."""


@dataclass(frozen=True)
class RigConfig(PluginConfig):
    """Images or videos of a rig, its calibration, and what of the rectified images is used."""

    left: str = field(default="", metadata={"path": True})
    """Folder of the left camera's images (PNG or JPEG, grey or colour), or a video; must be given."""
    right: str = field(default="", metadata={"path": True})
    """Folder of the right camera's images, or a video; empty: each frame of the video ``left`` is both images side by
    side."""
    calibration: str = field(default="", metadata={"path": True})
    """YAML of OpenCV's stereoCalibrate, Kalibr's camchain, or the left camera's ROS camera_info or EuRoC sensor.yaml;
    must be given."""
    second_calibration: str | None = field(default=None, metadata={"path": True})
    """The right camera's file (ROS, EuRoC), or extrinsics.yml (OpenCV); null: one file holds all."""
    swapped: bool = False
    """The calibration's first camera (Kalibr's cam0) is the right one."""
    model: str = ""
    """Model of distortion, radtan or equidistant (fisheye); empty: as the calibration says. OpenCV's files do not."""
    unit_m: float = 1.0
    """Metres of the calibration's unit of length: 0.001 where the chessboard was given in millimetres."""
    focal: float = 0.0
    """Focal length of the rectified images in pixels, before ``scale``; 0: chosen so that no black border is left, of a
    fisheye that of its middle."""
    crop: list[int] | None = None
    """Part of the rectified images that is used: [column, row, width, height], before ``scale``; null: all."""
    scale: float = 1.0
    """Sides of the rectified images as they are used over those that they have."""
    frames: str = ""
    """Frame numbers ``a:b`` or ``a:b:step``; empty: all."""
    times: str | None = field(default=None, metadata={"path": True})
    """File with the time of each left image, one a line or the first column of a CSV; null: those in the names."""
    rate: float = 0.0
    """Frames a second where neither names nor ``times`` tell it; 0: the video's, or 10."""
    poses: str | None = field(default=None, metadata={"path": True})
    """Ground truth of the left camera as it stands in the rig, unrectified, joined as by dataset=folder; null: none."""

    def __post_init__(self) -> None:
        require_between("dataset", self, 0.05, 1.0, "scale")
        require_least("dataset", self, focal=0, rate=0, unit_m=1e-9)
        if self.model:
            require_choice("dataset.model", self.model, MODELS)
        if self.crop is not None and (len(self.crop) != 4 or min(self.crop) < 0 or min(self.crop[2:]) < 1):
            raise BenchError(f"dataset.crop={list(self.crop)} must be [column, row, width, height] in pixels.")


@register("dataset", "rig", config=RigConfig)
class Rig(Dataset):
    """Your own rig: unrectified pairs, rectified by its calibration as they are read.

    A few pairs are rectified beforehand to see how far matched corners are off their rows. ``ground_truth`` is that of
    the rectified left camera.
    """

    def __init__(self, config: RigConfig) -> None:
        for setting in ("left", "calibration"):
            if not getattr(config, setting):
                raise BenchError(f"dataset.{setting} is not set. Give it: dataset.{setting}=PATH.")
        self._pairs = _pairs(config)
        self.label = f"rig/{Path(config.left).expanduser().resolve().parent.name}"
        self.numbers = self._pairs.numbers
        second = None if config.second_calibration is None else Path(config.second_calibration).expanduser()
        calibration = read_rig(
            Path(config.calibration).expanduser(), second, self._pairs.size, config.model, config.unit_m
        )
        calibration = calibration.swapped() if config.swapped else calibration
        self._rectification = Rectification(
            calibration.left,
            calibration.right,
            calibration.T_right_left,
            config.focal or None,
            _checked_crop(config.crop, self._pairs.size),
        )
        self.camera = self._rectification.camera.scaled(config.scale)
        found = times_and_poses(self._pairs, config.poses, config.times, config.rate or None)
        self._times, self._poses = found.times, found.poses
        self.remarks = (*self._pairs.remarks, *found.remarks, self._about_rows(config.calibration))

    def frame(self, position: int) -> StereoFrame:
        """Decode and rectify one pair; raises ``BenchError`` if an image turns out to be damaged."""
        size = (self.camera.width, self.camera.height)
        left, right = (shrunk(image, size) for image in self._rectified(position))
        return StereoFrame(self.numbers[position], float(self._times[position]), left, right)

    def ground_truth(self) -> Trajectory | None:
        """The poses of the file turned to the rectified axes, of the frames that have one; None where none has."""
        if self._poses is None or not (known := known_poses(self._poses)).any():
            return None
        T = self._poses[known] @ se3.compose(self._rectification.R_rect_left.T, np.zeros(3))
        return Trajectory(T, np.array(self.numbers, dtype=np.int64)[known], self._times[known])

    def _rectified(self, position: int) -> tuple[Image, Image]:
        return self._rectification.pair(*self._pairs.pair(position))

    def _about_rows(self, calibration: str) -> str:
        """What matched corners say of the calibration; raises ``BenchError`` where it can't be that of these images."""
        positions = np.unique(np.linspace(0, len(self) - 1, _JUDGED).astype(int)).tolist()
        off, corners = row_offset_of_pairs(self._rectified(position) for position in positions)
        if corners < _LEAST_CORNERS:
            return f"rectification can't be judged: {corners} corners match in {len(positions)} pairs"
        if off > _FARTHEST_PX:
            raise BenchError(
                f"Rectified by {calibration}, matched corners are {off:.1f} px off their rows (median of "
                f"{corners} in {len(positions)} pairs); more than {_FARTHEST_PX:g} px are no stereo pair. Are left and "
                "right, or the calibration, those of this rig, at this size, and the pairs of one moment?"
            )
        return f"rectification: matched corners are {off:.2f} px off their rows (median of {corners})"


def _pairs(config: RigConfig) -> OwnPairs:
    left, right = (Path(path).expanduser() if path else None for path in (config.left, config.right))
    if left is not None and left.is_file():
        if right is not None and not right.is_file():
            raise BenchError(f"dataset.left is a video, and dataset.right={config.right} is none. Give two videos.")
        return VideoPairs(config.left, config.right, config.frames)
    return FolderPairs(config.left, config.right, config.frames)


def _checked_crop(crop: list[int] | None, size: tuple[int, int]) -> list[int] | None:
    if crop is not None and (crop[0] + crop[2] > size[0] or crop[1] + crop[3] > size[1]):
        raise BenchError(
            f"dataset.crop={list(crop)} reaches out of the rectified images of {size[0]}x{size[1]} pixels. Cut less."
        )
    return crop
