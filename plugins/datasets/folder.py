"""A user's own rectified stereo pair: two folders of images and the camera's numbers."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.contracts.dataset import Dataset
from bench.errors import BenchError, require_least
from bench.io.frame_names import NamedFiles, in_order, join
from bench.io.frame_poses import poses_of_images, read_times
from bench.io.frame_range import describe, parse_frame_range, select_frames
from bench.io.images import IMAGE_SUFFIXES, ImageSequence, describe_files
from bench.io.trajectories import known_poses, values_per_line
from bench.registry import PluginConfig, register
from bench.types import Float, StereoCamera, StereoFrame, Trajectory

# Without timestamps of its own a folder counts as recorded at this rate.
_RATE_HZ = 10.0


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
        left, right = in_order(_images("left", config.left)), in_order(_images("right", config.right))
        pairs = join(left, right)
        self.label = f"folder/{Path(config.left).resolve().parent.name}"
        counted = left.counted()
        self.numbers = _select(config.frames, counted, pairs.left, config.left)
        chosen = np.isin(counted[pairs.left], self.numbers)
        rows = pairs.left[chosen]
        self._left = [left.files[row] for row in rows]
        self._right = [right.files[row] for row in pairs.right[chosen]]
        chosen_files = [path for pair in zip(self._left, self._right, strict=True) for path in pair]
        self._images = ImageSequence(chosen_files, [*left.files, *right.files])
        self.camera = _camera(config, self._images.size)
        remarks = [*pairs.remarks, *_about_gaps(left, counted), *self._images.remarks]
        times, told = _times(config, left)
        self._poses: Float | None = None
        if config.poses:
            found = poses_of_images(Path(config.poses).expanduser(), left, times)
            self._poses, told = found.T_world_cam[rows], told + found.remarks
            times = times if found.times is None else found.times
            unknown = [number for number, T in zip(self.numbers, self._poses, strict=True) if not np.isfinite(T).all()]
            if unknown:
                told += (f"{len(unknown)} of {len(self)} frames have no ground truth: {describe(unknown)}",)
        self._times = np.array(self.numbers) / _RATE_HZ if times is None else times[rows]
        self.remarks = (*remarks, *told)

    def frame(self, position: int) -> StereoFrame:
        """Decode one pair; raises ``BenchError`` if an image turns out to be damaged."""
        left, right = (self._images.read(side[position]) for side in (self._left, self._right))
        return StereoFrame(self.numbers[position], float(self._times[position]), left, right)

    def ground_truth(self) -> Trajectory | None:
        """The poses of the file, of the frames that have one; None where none has."""
        if self._poses is None or not (known := known_poses(self._poses)).any():
            return None
        return Trajectory(self._poses[known], np.array(self.numbers, dtype=np.int64)[known], self._times[known])


def _images(side: str, folder: str) -> list[Path]:
    if not folder:
        raise BenchError(f"dataset.{side} is not set. Give the folder of the {side} images, dataset.{side}=FOLDER.")
    path = Path(folder).expanduser()
    if not path.is_dir():
        raise BenchError(f"dataset.{side}={folder}: this folder does not exist. Give the folder of the {side} images.")
    files = [file for file in path.iterdir() if file.is_file() and not file.name.startswith(".")]
    images = [file for file in files if file.suffix.lower() in IMAGE_SUFFIXES]
    if not images:
        raise BenchError(
            f"dataset.{side}={folder} holds no PNG or JPEG image, but {describe_files(files)}. Give the folder of the "
            f"{side} images, as PNG of 8 or 16 bits or JPEG."
        )
    return images


def _select(text: str, counted: npt.NDArray[np.int64], paired: npt.NDArray[np.intp], where: str) -> tuple[int, ...]:
    """The numbers among the pairs' that the setting ``frames`` asks for; those without a partner are left out."""
    there = counted[paired].tolist()
    wanted = parse_frame_range(text)
    if wanted is None:
        return tuple(there)
    first, end, step = wanted
    chosen = tuple(number for number in there if number >= first and (number - first) % step == 0)
    chosen = tuple(number for number in chosen if end is None or number < end)
    if not chosen or (end is not None and end > counted[-1] + 1):
        return select_frames(text, there, where)
    return chosen


def _camera(config: FolderConfig, size: tuple[int, int]) -> StereoCamera:
    width, height = size
    if config.cx >= width or config.cy >= height:
        raise BenchError(
            f"dataset.cx={config.cx}, dataset.cy={config.cy} lie outside the images of {width}x{height} pixels. "
            "Give the principal point for this size."
        )
    fx, fy, cx, cy = config.fx, config.fy, config.cx, config.cy
    return StereoCamera(width, height, fx=fx, fy=fy, cx=cx, cy=cy, right_position=(config.baseline, 0.0, 0.0))


def _about_gaps(left: NamedFiles, counted: npt.NDArray[np.int64]) -> list[str]:
    skipped = int(counted[-1]) + 1 - len(counted)
    if not skipped:
        return []
    after = left.files[int(np.argmax(np.diff(counted) > 1))]
    return [f"the numbers in the names of {after.parent.name} skip {skipped} frames, the first after {after.name}"]


def _times(config: FolderConfig, left: NamedFiles) -> tuple[Float | None, tuple[str, ...]]:
    """Times (N,) of the left images in seconds, or None where nothing tells them, and what to say of that."""
    if config.times:
        return read_times(Path(config.times).expanduser(), left)
    beside = Path(config.left).expanduser().parent / "times.txt"
    if left.times is not None or not config.poses or not beside.is_file():
        return left.times, ()
    if values_per_line(Path(config.poses).expanduser(), "pose file") != 8:
        return None, ()
    return read_times(beside, left)
