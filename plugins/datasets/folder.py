"""A user's own rectified stereo pair: two folders of images and the camera's numbers."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.io.frame_range import select_frames
from bench.io.images import IMAGE_SUFFIXES, read_rgb, require_one_size
from bench.io.trajectories import read_kitti_poses, read_tum
from bench.registry import PluginConfig, register
from bench.types import Float, StereoCamera, StereoFrame, Trajectory

# Without timestamps of its own a folder counts as recorded at this rate.
_RATE_HZ = 10.0


@dataclass(frozen=True)
class FolderConfig(PluginConfig):
    """Where the images are, and the calibration of the rectified pair; all but the last two must be given."""

    left: str = field(default="", metadata={"path": True})
    """Folder of the left images, PNG or JPEG, sorted by name and numbered from 0."""
    right: str = field(default="", metadata={"path": True})
    """Folder of the right images."""
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
    """Ground truth of the left camera, a KITTI or TUM file, line i for image i; null: none."""
    frames: str = ""
    """Image numbers ``a:b`` or ``a:b:step``; empty: all."""


@register("dataset", "folder", config=FolderConfig)
class Folder(Dataset):
    """Your own rectified pair: two folders of images, intrinsics, baseline, optional poses."""

    def __init__(self, config: FolderConfig) -> None:
        for what in fields(config):
            value = getattr(config, what.name)
            if what.name in ("fx", "fy", "cx", "cy", "baseline") and not (np.isfinite(value) and value > 0):
                raise BenchError(f"dataset.{what.name}={value} must be positive. Take it from your calibration.")
        left, right = _images("left", config.left), _images("right", config.right)
        if len(left) != len(right):
            raise BenchError(
                f"{config.left} has {len(left)} images, but {config.right} has {len(right)}. Each left image needs its "
                "right one: restore the missing images, or remove those without a partner."
            )
        self.label = f"folder/{Path(config.left).resolve().parent.name}"
        self.numbers = select_frames(config.frames, range(len(left)), config.left)
        self._left, self._right = [left[n] for n in self.numbers], [right[n] for n in self.numbers]
        width, height = require_one_size([path for pair in zip(self._left, self._right, strict=True) for path in pair])
        if config.cx >= width or config.cy >= height:
            raise BenchError(
                f"dataset.cx={config.cx}, dataset.cy={config.cy} lie outside the images of {width}x{height} pixels. "
                "Give the principal point for this size."
            )
        self.camera = StereoCamera(
            width=width,
            height=height,
            fx=config.fx,
            fy=config.fy,
            cx=config.cx,
            cy=config.cy,
            right_position=(config.baseline, 0.0, 0.0),
        )
        self._poses, self._times = self._read_poses(config.poses)

    def frame(self, position: int) -> StereoFrame:
        """Decode one pair; raises ``BenchError`` if an image turns out to be damaged."""
        size = (self.camera.width, self.camera.height)
        left, right = read_rgb(self._left[position], size), read_rgb(self._right[position], size)
        return StereoFrame(self.numbers[position], float(self._times[position]), left, right)

    def ground_truth(self) -> Trajectory | None:
        """The poses of the file, or None without one."""
        if self._poses is None:
            return None
        return Trajectory(self._poses, np.array(self.numbers, dtype=np.int64), self._times)

    def _read_poses(self, path: str | None) -> tuple[Float | None, Float]:
        numbers = np.array(self.numbers)
        if not path:
            return None, numbers / _RATE_HZ
        poses, times = _read_either(Path(path).expanduser())
        if len(poses) <= numbers[-1]:
            raise BenchError(
                f"{path} has {len(poses)} poses, too few for image {numbers[-1]} (counted from 0). Give one line an "
                f"image, or choose dataset.frames up to {len(poses)}."
            )
        return poses[numbers], numbers / _RATE_HZ if times is None else times[numbers]


def _images(side: str, folder: str) -> list[Path]:
    if not folder:
        raise BenchError(f"dataset.{side} is not set. Give the folder of the {side} images, dataset.{side}=FOLDER.")
    path = Path(folder).expanduser()
    if not path.is_dir():
        raise BenchError(f"dataset.{side}={folder}: this folder does not exist. Give the folder of the {side} images.")
    images = sorted(file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
    if not images:
        raise BenchError(f"dataset.{side}={folder} holds no PNG or JPEG image. Give the folder of the {side} images.")
    return images


def _read_either(path: Path) -> tuple[Float, Float | None]:
    """Poses of a KITTI (12 numbers per line) or TUM (8 numbers per line) file, with the times of the latter."""
    try:
        with path.open(encoding="utf-8") as file:
            first = next((line for line in file if line.strip() and not line.startswith("#")), "")
    except (OSError, UnicodeDecodeError) as error:
        raise BenchError(f"dataset.poses={path} can't be read as text ({error}). Check the path.") from None
    if len(first.split()) == 8:
        trajectory = read_tum(path)
        return trajectory.T_world_cam, trajectory.timestamps
    return read_kitti_poses(path), None
