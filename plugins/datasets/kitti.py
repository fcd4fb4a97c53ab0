"""KITTI odometry benchmark (Geiger et al., CVPR 2012): one sequence, grey or colour pair."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset, SequenceOnDisk
from bench.data.places import existing_root
from bench.errors import BenchError, require_between, require_choice
from bench.io.frame_range import select_frames
from bench.io.kitti360_files import read_image_times
from bench.io.kitti_files import KittiCalibration, read_kitti_times
from bench.io.scans import NumberedScans
from bench.io.stereo_images import StereoImages, images_by_number
from bench.io.trajectories import known_poses, read_kitti_poses
from bench.registry import PluginConfig, register
from bench.types import Float, Map, StereoFrame, Trajectory

# Left and right camera of each pair, as KITTI numbers them.
_PAIRS = {"gray": (0, 1), "color": (2, 3)}
# Recording rate that stands in for a missing times.txt.
_RATE_HZ = 10.0
_PUBLISHED_FRAMES = {
    **{"00": 4541, "01": 1101, "02": 4661, "03": 801, "04": 271, "05": 2761, "06": 1101, "07": 1101, "08": 4071},
    **{"09": 1591, "10": 1201, "11": 921, "12": 1061, "13": 3281, "14": 631, "15": 1901, "16": 1731, "17": 491},
    **{"18": 1801, "19": 4981, "20": 831, "21": 2721},
}
_LAST_WITH_POSES = "10"


@dataclass(frozen=True)
class KittiConfig(PluginConfig):
    """Which part of KITTI odometry, and by which pair of cameras."""

    root: str = field(default="", metadata={"path": True, "data": "kitti"})
    """Folder that holds ``sequences/`` and ``poses/``, or a day of KITTI raw; empty: kitti_odometry in $BGS_DATA."""
    sequence: str = "06"
    """Number of the sequence, 00 to 21, or the folder of a drive of KITTI raw."""
    frames: str = ""
    """Frame numbers ``a:b`` or ``a:b:step``; empty: all."""
    camera: str = "color"
    """color (image_2 and image_3) or gray (image_0 and image_1)."""
    scale: float = 1.0
    """Sides of the images as they are used over the stored ones."""

    def __post_init__(self) -> None:
        require_choice("dataset.camera", self.camera, _PAIRS)
        require_between("dataset", self, 0.05, 1.0, "scale")


@register("dataset", "kitti", config=KittiConfig)
class Kitti(Dataset):
    """KITTI odometry: grey or colour stereo pair, official poses, LiDAR.

    Ground truth is that of the LEFT camera of the pair: T_world_cam0 [I | -t_left]; the world stays cam0's first frame.
    """

    def __init__(self, config: KittiConfig) -> None:
        left, right = _PAIRS[config.camera]
        sequence = f"{int(config.sequence):02d}" if config.sequence.isdecimal() else config.sequence
        root = _existing_root(config.root)
        folder = _existing_sequence(root, sequence)
        self.label = f"kitti/{sequence}"
        self._folder = folder
        folders = _image_folder(folder, left, config.camera), _image_folder(folder, right, config.camera)
        images, others = (images_by_number(side) for side in folders)
        self.numbers = select_frames(config.frames, list(images), str(folders[0]))
        self._images = StereoImages(images, others, self.numbers)
        calibration = KittiCalibration.in_folders(folder, root)
        self._t_left = calibration.projection(left)[1]
        self._scans = NumberedScans(folder / "velodyne", self.numbers)
        self._lines = {"times": 0, "poses": 0}
        self._T_left_velodyne = self._check_scans(calibration)
        self._times = self._read_times(folders[0], list(images))
        self._poses = self._read_poses(root / "poses" / f"{sequence}.txt")
        self.camera = calibration.stereo_camera(left, right, self._images.size).scaled(config.scale)
        self.remarks = (*self._images.remarks, *self._about_poses())

    @classmethod
    def sequences_in(cls, root: Path) -> Iterator[SequenceOnDisk]:
        """Each pair of cameras that lies in ``sequences/NN``, or in a drive of KITTI raw."""
        parent = root / "sequences" if (root / "sequences").is_dir() else root
        for folder in sorted(entry for entry in parent.iterdir() if entry.is_dir()):
            for pair, cameras in _PAIRS.items():
                images = [folder / f"image_{zero}{camera}" for camera in cameras for zero in ("", "0")]
                if there := tuple(each for each in images if each.is_dir()):
                    settings = {"sequence": folder.name, "camera": pair}
                    yield SequenceOnDisk(settings, (*there, folder / "velodyne"))

    def lacks(self) -> tuple[str, ...]:
        """Frames of KITTI odometry, LiDAR and ground truth that are not here."""
        sequence = self.label.rpartition("/")[2]
        published, here = _PUBLISHED_FRAMES.get(sequence), len(self)
        found = []
        if published is not None and here != published:
            found.append(f"{here} of the {published} published frames are here")
        without = sum(number not in self._scans for number in self.numbers)
        if without:
            found.append("no LiDAR" if without == here else f"{without} frames have no LiDAR")
        if self._poses is None and (published is None or sequence <= _LAST_WITH_POSES):
            found.append("no ground truth")
        if self._lines["times"] == 0:
            found.append(f"no times.txt: {_RATE_HZ:g} Hz stand in, or the images' timestamps.txt")
        return tuple(found)

    def frame(self, position: int) -> StereoFrame:
        """Decode one pair; raises ``BenchError`` if an image turns out to be damaged."""
        return self._images.frame(self.numbers[position], float(self._times[position]), self.camera)

    def ground_truth(self) -> Trajectory | None:
        """Official poses of the left camera of the pair, or None for the sequences that have none (11 to 21).

        Frames whose line of the pose file is NaN have none.
        """
        if self._poses is None:
            return None
        T_cam0_left = np.eye(4)
        T_cam0_left[:3, 3] = -self._t_left
        known = known_poses(self._poses)
        numbers = np.array(self.numbers, dtype=np.int64)
        return Trajectory(self._poses[known] @ T_cam0_left, numbers[known], self._times[known])

    def lidar_depth(self, position: int) -> Map | None:
        """The scan of this frame in the left image, or None where the data set has no scan of it."""
        if self._T_left_velodyne is None:
            return None
        return self._scans.depth(self.numbers[position], self._T_left_velodyne, self.camera)

    def _check_scans(self, calibration: KittiCalibration) -> Float | None:
        if not (self._folder / "velodyne").is_dir():
            return None
        T_left_cam0 = np.eye(4)
        T_left_cam0[:3, 3] = self._t_left
        return T_left_cam0 @ calibration.T_cam0_velodyne()

    def _about_poses(self) -> list[str]:
        if self._poses is None:
            return []
        unknown = int((~known_poses(self._poses)).sum())
        remarks = [f"{unknown} of {len(self)} frames have no ground truth (NaN in the pose file)"] if unknown else []
        if self._lines["times"] and self._lines["times"] != self._lines["poses"]:
            counts = "the sequence has {poses} poses and {times} times".format_map(self._lines)
            remarks.append(f"{counts}: line k (from 0) is that of frame k, so one of the files is of something else")
        return remarks

    def _read_times(self, images: Path, there: list[int]) -> Float:
        numbers = np.array(self.numbers)
        path = self._folder / "times.txt"
        if not path.is_file():
            of_raw = images.parent / "timestamps.txt"
            if of_raw.is_file():
                return read_image_times(of_raw, self.numbers, there)
            return numbers / _RATE_HZ
        times = read_kitti_times(path)
        self._lines["times"] = len(times)
        if len(times) <= numbers[-1]:
            raise BenchError(f"{path} has {len(times)} times, too few for frame {numbers[-1]}. Restore the file.")
        return times[numbers]

    def _read_poses(self, path: Path) -> Float | None:
        if not path.is_file():
            return None
        poses = read_kitti_poses(path)
        self._lines["poses"] = len(poses)
        last = self.numbers[-1]
        if len(poses) <= last:
            raise BenchError(
                f"{path} has {len(poses)} poses, too few for frame {last}. Restore the file, move it away to run "
                f"without ground truth, or choose dataset.frames up to {len(poses)}."
            )
        return poses[np.array(self.numbers)]


def _existing_root(text: str) -> Path:
    root = existing_root(text, "kitti", "KITTI's sequences/")
    if not (root / "sequences").is_dir() and not any(root.glob("*/image_0[0-3]")):
        raise BenchError(
            f"dataset.root={text} holds no folder 'sequences', nor drives of KITTI raw. Give the root of KITTI's "
            "odometry data set."
        )
    return root


def _existing_sequence(root: Path, sequence: str) -> Path:
    parent = root / "sequences" if (root / "sequences").is_dir() else root
    folder = parent / sequence
    if not folder.is_dir():
        there = sorted(entry.name for entry in parent.iterdir() if entry.is_dir())
        raise BenchError(
            f"dataset.sequence={sequence} does not exist in {parent}, which holds "
            f"{', '.join(there) or 'no sequence'}. Choose one of these, or download it."
        )
    return folder


def _image_folder(folder: Path, camera: int, pair: str) -> Path:
    """``image_2`` of the odometry data set, or KITTI raw's ``image_02/data``."""
    for name in (f"image_{camera}", f"image_0{camera}"):
        if (folder / name / "data").is_dir():
            return folder / name / "data"
        if (folder / name).is_dir():
            return folder / name
    raise BenchError(
        f"The folder {folder / f'image_{camera}'} of the {pair} pair does not exist. Download it, or choose the other "
        "dataset.camera (color or gray)."
    )
