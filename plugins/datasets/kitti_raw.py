"""KITTI raw (Geiger et al., IJRR 2013): a drive, or the part of one that is a sequence of KITTI odometry."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset, SequenceOnDisk
from bench.data.places import existing_root
from bench.errors import BenchError, require_between, require_choice
from bench.geometry import se3
from bench.io.frame_range import select_frames
from bench.io.kitti360_files import read_image_times
from bench.io.kitti_raw_files import RawCalibration, read_oxts
from bench.io.scans import NumberedScans
from bench.io.stereo_images import StereoImages, images_by_number
from bench.registry import PluginConfig, register
from bench.types import Float, Map, StereoFrame, Trajectory

# Left and right camera of each pair, as KITTI numbers them.
_PAIRS = {"gray": (0, 1), "color": (2, 3)}
_ODOMETRY = {
    "00": ("2011_10_03_drive_0027", 0, 4540),
    "01": ("2011_10_03_drive_0042", 0, 1100),
    "02": ("2011_10_03_drive_0034", 0, 4660),
    "03": ("2011_09_26_drive_0067", 0, 800),
    "04": ("2011_09_30_drive_0016", 0, 270),
    "05": ("2011_09_30_drive_0018", 0, 2760),
    "06": ("2011_09_30_drive_0020", 0, 1100),
    "07": ("2011_09_30_drive_0027", 0, 1100),
    "08": ("2011_09_30_drive_0028", 1100, 5170),
    "09": ("2011_09_30_drive_0033", 0, 1590),
    "10": ("2011_09_30_drive_0034", 0, 1200),
}
"""Drive, first and last image of each sequence, as KITTI's odometry devkit gives them."""
_WITHHELD = "2011_09_26_drive_0067"


@dataclass(frozen=True)
class KittiRawConfig(PluginConfig):
    """Which part of KITTI raw, and by which pair of cameras."""

    root: str = field(default="", metadata={"path": True, "data": "kitti_raw"})
    """Folder that holds the days, ``2011_09_30/`` and so on, or one of these; empty: kitti_raw in $BGS_DATA."""
    sequence: str = "06"
    """Number of a sequence of KITTI odometry, 00 to 10, or the name of a drive, such as 2011_09_26_drive_0005."""
    frames: str = ""
    """Frame numbers ``a:b`` or ``a:b:step``, those of the odometry sequence where its number is given; empty: all."""
    camera: str = "color"
    """color (image_02 and image_03) or gray (image_00 and image_01)."""
    uncurl: bool = True
    """Undo the car's motion during a turn of the LiDAR, by the GPS/IMU; in KITTI raw it is not undone."""
    scale: float = 1.0
    """Sides of the images as they are used over the stored ones."""

    def __post_init__(self) -> None:
        require_choice("dataset.camera", self.camera, _PAIRS)
        require_between("dataset", self, 0.05, 1.0, "scale")


@register("dataset", "kitti_raw", config=KittiRawConfig)
class KittiRaw(Dataset):
    """KITTI raw, synchronised and rectified drives: grey or colour pair, poses of the GPS/IMU, LiDAR.

    Ground truth is that of the left camera of the pair; the world is that camera in the first frame used.
    """

    def __init__(self, config: KittiRawConfig) -> None:
        left, right = _PAIRS[config.camera]
        sequence, drive, self._first, last = _part(config.sequence)
        folder = _existing_drive(config.root, drive)
        self.label = f"kitti_raw/{sequence}"
        images, others = (images_by_number(folder / f"image_0{camera}" / "data") for camera in (left, right))
        there = [number - self._first for number in images if self._first <= number <= (last or number)]
        self.numbers = select_frames(config.frames, there, f"{folder / f'image_0{left}'} as {self.label}")
        self._stored = [number + self._first for number in self.numbers]
        self._images = StereoImages(images, others, self._stored)
        calibration = RawCalibration(folder.parent)
        self.camera = calibration.stereo_camera(left, right, self._images.size).scaled(config.scale)
        times = folder / f"image_0{left}" / "timestamps.txt"
        self._times = read_image_times(times, self._stored, list(images))
        self._scans = NumberedScans(folder / "velodyne_points" / "data", self._stored)
        self._T_left_velodyne = calibration.T_left_velodyne(left)
        self._uncurl = config.uncurl
        # The motion of a scan is that from the frame before.
        needed = {number - step for number in self._stored for step in (0, 1)}
        self._poses = read_oxts(folder / "oxts" / "data", needed)
        self._T_imu_velodyne = np.eye(4) if self._poses is None else se3.inverse(calibration.T_velodyne_imu())
        self.remarks = (*self._images.remarks, *self._about_gaps())

    @classmethod
    def sequences_in(cls, root: Path) -> Iterator[SequenceOnDisk]:
        """Each pair of cameras of each drive; of a drive in both forms the one that is read."""
        forms = (f"{day}*_drive_*_{form}" for form in ("extract", "sync") for day in ("", "*/"))
        drives = {folder.name.rpartition("_")[0]: folder for form in forms for folder in root.glob(form)}
        for drive, folder in sorted(drives.items()):
            scans = folder / "velodyne_points" / "data"
            for pair, cameras in _PAIRS.items():
                images = tuple(folder / f"image_0{camera}" / "data" for camera in cameras)
                if any(each.is_dir() for each in images):
                    settings = {"sequence": drive, "camera": pair}
                    yield SequenceOnDisk(settings, (*images, scans))

    def lacks(self) -> tuple[str, ...]:
        """LiDAR and ground truth, where there is none at all; ``remarks`` tells of gaps."""
        no_scans = not any(number in self._scans for number in self._stored)
        return (*(["no LiDAR"] if no_scans else []), *(["no ground truth (oxts)"] if self._poses is None else []))

    def frame(self, position: int) -> StereoFrame:
        """Decode one pair; raises ``BenchError`` if an image turns out to be damaged."""
        stored = self._images.frame(self._stored[position], float(self._times[position]), self.camera)
        return StereoFrame(self.numbers[position], stored.timestamp, stored.left, stored.right)

    def ground_truth(self) -> Trajectory | None:
        """Poses of the left camera by the GPS/IMU, of the frames that have one, the first the identity; or None."""
        has = np.zeros(len(self), dtype=bool) if self._poses is None else self._poses.has(self._stored)
        if self._poses is None or not has.any():
            return None
        numbers = np.array(self.numbers, dtype=np.int64)
        T_imu_left = self._T_imu_velodyne @ se3.inverse(self._T_left_velodyne)
        T = self._poses.T[np.searchsorted(self._poses.ids, np.array(self._stored)[has])] @ T_imu_left
        T = se3.inverse(T[0]) @ T
        T[0] = np.eye(4)  # but for rounding
        return Trajectory(T, numbers[has], self._times[has])

    def lidar_depth(self, position: int) -> Map | None:
        """The scan of this frame in the left image, or None where the drive has no scan of it."""
        number = self._stored[position]
        moved = self._motion_of_scan(number) if self._uncurl else None
        return self._scans.depth(number, self._T_left_velodyne, self.camera, moved)

    def _motion_of_scan(self, number: int) -> Float | None:
        """The LiDAR of the frame before seen from this one, 4x4, or None where one of the two has no pose."""
        before, now = (None, None) if self._poses is None else (self._poses.of(number - 1), self._poses.of(number))
        if before is None or now is None:
            return None
        T: Float = se3.inverse(now @ self._T_imu_velodyne) @ (before @ self._T_imu_velodyne)
        return T

    def _about_gaps(self) -> list[str]:
        without = sum(number not in self._scans for number in self._stored)
        remarks = [f"{without} of {len(self)} frames have no LiDAR scan"] if 0 < without < len(self) else []
        known = 0 if self._poses is None else int(self._poses.has(self._stored).sum())
        if self._poses is not None and known < len(self):
            remarks.append(f"{len(self) - known} of {len(self)} frames have no ground truth (no packet in oxts)")
        return remarks


def _part(text: str) -> tuple[str, str, int, int | None]:
    """Name of the sequence, its drive, and the drive's first and last image (None: all) that belong to it."""
    if text.isdecimal():
        number = f"{int(text):02d}"
        if number not in _ODOMETRY:
            raise BenchError(f"dataset.sequence={text}: KITTI tells the drives of the sequences 00 to 10 only.")
        return number, *_ODOMETRY[number]
    drive = re.fullmatch(r"(\d{4}_\d\d_\d\d_drive_\d{4})(_sync)?", text)
    if drive is None:
        raise BenchError(
            f"dataset.sequence={text!r} is neither a sequence of KITTI odometry, such as 06, nor a drive, such as "
            "2011_09_26_drive_0005."
        )
    return drive[1], drive[1], 0, None


def _existing_drive(text: str, drive: str) -> Path:
    root, date = existing_root(text, "kitti_raw", "2011_09_30/"), drive[:10]
    day = root if root.name == date else root / date
    folder = day / f"{drive}_sync"
    if folder.is_dir():
        return folder
    if drive == _WITHHELD:
        raise BenchError(
            f"{folder} does not exist: KITTI does not offer this drive, which is sequence 03 of the odometry data set. "
            "Take that one, dataset=kitti dataset.sequence=03."
        )
    if (day / f"{drive}_extract").is_dir():
        raise BenchError(f"{day / f'{drive}_extract'} holds unrectified images. Download {drive}_sync.zip instead.")
    there = sorted(entry.name for entry in (*root.glob("*_sync"), *root.glob("*/*_sync")))
    raise BenchError(
        f"{folder} does not exist; dataset.root={root} holds {', '.join(there[:8]) or 'no drive'}. Choose one, or "
        f"download {drive}_sync.zip and {date}_calib.zip."
    )
