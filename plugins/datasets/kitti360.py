"""KITTI-360 (Liao, Xie and Geiger, PAMI 2022): one sequence of the rectified perspective pair."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset, SequenceOnDisk
from bench.data.places import existing_root
from bench.errors import BenchError, require_between
from bench.geometry import se3
from bench.geometry.lidar import project_to_depth
from bench.geometry.scan_motion import compensate_motion
from bench.io.frame_range import describe, select_frames
from bench.io.kitti360_files import Kitti360Calibration, NumberedPoses, read_cam0_poses, read_image_times
from bench.io.scans import check_scan_file, read_scan
from bench.io.stereo_images import StereoImages, images_by_number
from bench.registry import PluginConfig, register
from bench.types import Float, Map, StereoFrame, Trajectory

log = logging.getLogger(__name__)

_SIDES = ("image_00", "image_01")
# Recording rate that stands in for a missing timestamps.txt.
_RATE_HZ = 10.0
# The sequence whose perspective images the authors keep to themselves, for evaluation.
_WITHHELD = "0008"


@dataclass(frozen=True)
class Kitti360Config(PluginConfig):
    """Which part of KITTI-360, and what of it counts."""

    root: str = field(default="", metadata={"path": True, "data": "kitti360"})
    """Folder that holds ``data_2d_raw/``, ``calibration/`` and, where downloaded, ``data_poses/`` and ``data_3d_raw/``;
    empty: kitti360 in $BGS_DATA."""
    sequence: str = "0007"
    """Number of the drive."""
    frames: str = ""
    """Image numbers ``a:b`` or ``a:b:step``; empty: all."""
    first: int = 0
    """Only the first so many of these frames, counted after those without a pose have been left out; 0: all."""
    only_with_pose: bool = True
    """Leave out frames without a pose: about every tenth, where the car was slow, and the first. False keeps those that
    have a pose before and behind them, with a ground truth between the two."""
    uncurl: bool = True
    """Undo the car's motion during a turn of the LiDAR, as the data set's own tools do."""
    scale: float = 1.0
    """Sides of the images as they are used over the stored ones."""

    def __post_init__(self) -> None:
        if self.first < 0:
            raise BenchError(f"dataset.first={self.first} is negative. Give a number of frames, or 0 for all.")
        require_between("dataset", self, 0.05, 1.0, "scale")


@register("dataset", "kitti360", config=Kitti360Config)
class Kitti360(Dataset):
    """KITTI-360: rectified colour pair image_00 and image_01, poses by frame number, LiDAR.

    Ground truth is that of rectified image_00; the world is that camera in the first frame used, as the data set's own
    origin is kilometres away.
    """

    def __init__(self, config: Kitti360Config) -> None:
        sequence = _sequence_number(config.sequence)
        root = _existing_root(config.root)
        drive = f"2013_05_28_drive_{sequence}_sync"
        raw = _existing_sequence(root, drive, sequence)
        self.label = f"kitti360/{sequence}"
        left, right = (_rectified_images(raw / side, sequence) for side in _SIDES)
        calibration = Kitti360Calibration(root / "calibration")
        self._poses = read_cam0_poses(root / "data_poses" / drive, calibration)
        images = images_by_number(left)
        asked = select_frames(config.frames, list(images), str(left))
        self.numbers = self._with_poses(asked, config)[: config.first or None]
        self._images = StereoImages(images, images_by_number(right), self.numbers)
        self.remarks = self._images.remarks
        self.camera = calibration.stereo_camera(self._images.size).scaled(config.scale)
        self._times = _times(left.parent / "timestamps.txt", self.numbers, list(images))
        self._scans = root / "data_3d_raw" / drive / "velodyne_points" / "data"
        self._uncurl = config.uncurl
        self._T_left_velodyne = self._check_scans(calibration)

    @classmethod
    def sequences_in(cls, root: Path) -> Iterator[SequenceOnDisk]:
        """Each drive of ``data_2d_raw/``."""
        for folder in sorted((root / "data_2d_raw").glob("2013_05_28_drive_*_sync")):
            scans = root / "data_3d_raw" / folder.name / "velodyne_points" / "data"
            images = tuple(folder / side / "data_rect" for side in _SIDES)
            # The archive of the timestamps makes a folder for every drive.
            if any(any(each.parent.glob("data_*")) for each in images):
                yield SequenceOnDisk({"sequence": folder.name[17:21]}, (*images, scans))

    def lacks(self) -> tuple[str, ...]:
        """Poses and LiDAR that are not here."""
        without = sum(not self._scan(number).is_file() for number in self.numbers)
        found = [] if self._poses is not None else ["no ground truth (data_poses)"]
        if without:
            found.append("no LiDAR" if without == len(self) else f"{without} frames have no LiDAR")
        return tuple(found)

    def frame(self, position: int) -> StereoFrame:
        """Decode one pair; raises ``BenchError`` if an image turns out to be damaged."""
        return self._images.frame(self.numbers[position], float(self._times[position]), self.camera)

    def ground_truth(self) -> Trajectory | None:
        """Poses of rectified image_00, the first the identity; None without pose files."""
        if self._poses is None:
            return None
        numbers = np.array(self.numbers, dtype=np.int64)
        T = self._poses.interpolated(numbers)
        # Rounding leaves the first pose 1e-13 off what it is by definition.
        T = se3.inverse(T[0]) @ T
        T[0] = np.eye(4)
        return Trajectory(T, numbers, self._times.copy())

    def lidar_depth(self, position: int) -> Map | None:
        """The scan of this frame in the left image, or None where there is no scan of it."""
        number = self.numbers[position]
        if self._T_left_velodyne is None or not self._scan(number).is_file():
            return None
        points = read_scan(self._scan(number))
        # Points behind the vehicle can't be seen; dropping them first halves the work.
        points = points[points[:, 0] > 0]
        moved = self._motion_of_scan(number, self._T_left_velodyne) if self._uncurl else None
        seen = points if moved is None else compensate_motion(points, moved)
        T = self._T_left_velodyne
        return project_to_depth(seen @ T[:3, :3].T + T[:3, 3], self.camera)

    def _motion_of_scan(self, number: int, T_left_velodyne: Float) -> Float | None:
        """The LiDAR of the frame before seen from this one, 4x4, or None where one of the two has no pose.

        Poses are left out where the car hardly moved, so nothing needs to be undone then. Frame 1 is the first of most
        sequences; its motion is taken from itself to the next, as by the data set's own tools.
        """
        before, now = (number, number + 1) if number == 1 else (number - 1, number)
        poses = self._poses
        T_before, T_now = (None, None) if poses is None else (poses.of(before), poses.of(now))
        if T_before is None or T_now is None:
            return None
        T: Float = se3.inverse(T_now @ T_left_velodyne) @ (T_before @ T_left_velodyne)
        return T

    def _with_poses(self, asked: tuple[int, ...], config: Kitti360Config) -> tuple[int, ...]:
        """The frames that have, or can be given, a pose; all of them where the sequence has no pose file."""
        poses = self._poses
        if poses is None:
            return asked
        numbers = np.array(asked)
        own = poses.has(numbers)
        kept = own if config.only_with_pose else (numbers >= poses.ids[0]) & (numbers <= poses.ids[-1])
        if not kept.any():
            raise BenchError(
                f"dataset.frames={config.frames or 'all'}: none of {describe(asked)} has a pose in {poses.path}, which "
                f"has {_range(poses)}. Choose other frames, or move the pose files away to run without ground truth."
            )
        for what, frames in (("without a pose are left out", ~kept), ("get a pose between others", kept & ~own)):
            if frames.any():
                log.info("%s: %d of %d frames %s", self.label, frames.sum(), len(asked), what)
        return tuple(numbers[kept].tolist())

    def _scan(self, number: int) -> Path:
        return self._scans / f"{number:010d}.bin"

    def _check_scans(self, calibration: Kitti360Calibration) -> Float | None:
        if not self._scans.is_dir():
            return None
        for number in self.numbers:
            if self._scan(number).is_file():
                check_scan_file(self._scan(number))
        return calibration.T_rect0_velodyne()


def _range(poses: NumberedPoses) -> str:
    return f"{len(poses.ids)} poses of frames {poses.ids[0]} to {poses.ids[-1]}"


def _times(path: Path, numbers: tuple[int, ...], there: list[int]) -> Float:
    if not path.is_file():
        return np.array(numbers) / _RATE_HZ
    return read_image_times(path, numbers, there)


def _sequence_number(text: str) -> str:
    found = re.fullmatch(r"(?:2013_05_28_drive_)?(\d{1,4})(?:_sync)?", text.strip())
    if found is None:
        raise BenchError(f"dataset.sequence={text!r} is no sequence of KITTI-360. Give its number, for example 0002.")
    return f"{int(found[1]):04d}"


def _existing_root(text: str) -> Path:
    what = "KITTI-360's data_2d_raw/ and calibration/"
    root = existing_root(text, "kitti360", what)
    if not (root / "data_2d_raw").is_dir():
        raise BenchError(f"dataset.root={text} holds no folder 'data_2d_raw'. Give the folder that holds {what}.")
    return root


def _existing_sequence(root: Path, drive: str, sequence: str) -> Path:
    folder = root / "data_2d_raw" / drive
    if not folder.is_dir():
        _raise_if_withheld(sequence, folder)
        found = (re.fullmatch(r".*_drive_(\d{4})_sync", entry.name) for entry in (root / "data_2d_raw").iterdir())
        there = sorted(name[1] for name in found if name is not None)
        raise BenchError(
            f"dataset.sequence={sequence}: the folder {folder} does not exist; there are the sequences "
            f"{', '.join(there) or '(none)'}. Choose one of these, or download it."
        )
    return folder


def _rectified_images(side: Path, sequence: str) -> Path:
    folder = side / "data_rect"
    if folder.is_dir() and any(folder.glob("*.png")):
        return folder
    if (side / "data_rgb").is_dir():
        raise BenchError(
            f"{side} holds unrectified images (data_rgb), and none in data_rect. Download the rectified ones, "
            f"{side.parent.name}_{side.name}.zip."
        )
    _raise_if_withheld(sequence, folder)
    raise BenchError(
        f"The folder {folder} does not exist or holds no image. Download {side.parent.name}_{side.name}.zip and unpack "
        "it into data_2d_raw."
    )


def _raise_if_withheld(sequence: str, folder: Path) -> None:
    if sequence == _WITHHELD:
        raise BenchError(
            f"dataset.sequence={sequence}: there are no images in {folder}, as KITTI-360's authors withhold the "
            "perspective images of this sequence from the public. Choose 0000, 0002 to 0007, 0009 or 0010."
        )
