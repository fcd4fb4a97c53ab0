"""KITTI odometry benchmark (Geiger et al., CVPR 2012): one sequence, grey or colour pair."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError, require_choice
from bench.geometry.lidar import project_to_depth
from bench.io.frame_range import describe, select_frames
from bench.io.images import read_rgb, require_one_size
from bench.io.kitti_files import KittiCalibration, read_kitti_times
from bench.io.scans import check_scan_file, read_scan
from bench.io.trajectories import read_kitti_poses
from bench.registry import PluginConfig, register
from bench.types import Float, Map, StereoCamera, StereoFrame, Trajectory

# Left and right camera of each pair, as KITTI numbers them.
_PAIRS = {"gray": (0, 1), "color": (2, 3)}
# Recording rate that stands in for a missing times.txt.
_RATE_HZ = 10.0


@dataclass(frozen=True)
class KittiConfig(PluginConfig):
    """Which part of KITTI odometry, and by which pair of cameras."""

    root: str = field(default="", metadata={"path": True})
    """Folder that holds ``sequences/`` and ``poses/``; must be given."""
    sequence: str = "06"
    """Number of the sequence, 00 to 21."""
    frames: str = ""
    """Frame numbers ``a:b`` or ``a:b:step``; empty: all."""
    camera: str = "color"
    """color (image_2 and image_3) or gray (image_0 and image_1)."""

    def __post_init__(self) -> None:
        require_choice("dataset.camera", self.camera, _PAIRS)


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
        self._left, self._right = folder / f"image_{left}", folder / f"image_{right}"
        self.numbers = _frames_on_disk(self._left, self._right, config)
        calibration = KittiCalibration(folder / "calib.txt")
        self._t_left = calibration.projection(left)[1]
        self._T_left_velodyne = self._check_scans(calibration)
        self._times = self._read_times()
        self._poses = self._read_poses(root / "poses" / f"{sequence}.txt")
        images = [side / f"{number:06d}.png" for number in self.numbers for side in (self._left, self._right)]
        self.camera = _stereo_camera(calibration, left, right, require_one_size(images))

    def frame(self, position: int) -> StereoFrame:
        """Decode one pair; raises ``BenchError`` if an image turns out to be damaged."""
        number = self.numbers[position]
        size = (self.camera.width, self.camera.height)
        left, right = (read_rgb(side / f"{number:06d}.png", size) for side in (self._left, self._right))
        return StereoFrame(number, float(self._times[position]), left, right)

    def ground_truth(self) -> Trajectory | None:
        """Official poses of the left camera of the pair, or None for the sequences that have none (11 to 21)."""
        if self._poses is None:
            return None
        T_cam0_left = np.eye(4)
        T_cam0_left[:3, 3] = -self._t_left
        return Trajectory(self._poses @ T_cam0_left, np.array(self.numbers, dtype=np.int64), self._times.copy())

    def lidar_depth(self, position: int) -> Map | None:
        """The scan of this frame in the left image, or None where the data set has no scan of it."""
        path = self._scan(self.numbers[position])
        if self._T_left_velodyne is None or not path.is_file():
            return None
        points = read_scan(path)
        # Points behind the vehicle can't be seen; dropping them first halves the work.
        points = points[points[:, 0] > 0]
        T = self._T_left_velodyne
        return project_to_depth(points @ T[:3, :3].T + T[:3, 3], self.camera)

    def _scan(self, number: int) -> Path:
        return self._folder / "velodyne" / f"{number:06d}.bin"

    def _check_scans(self, calibration: KittiCalibration) -> Float | None:
        if not (self._folder / "velodyne").is_dir():
            return None
        for number in self.numbers:
            if self._scan(number).is_file():
                check_scan_file(self._scan(number))
        T_left_cam0 = np.eye(4)
        T_left_cam0[:3, 3] = self._t_left
        return T_left_cam0 @ calibration.T_cam0_velodyne()

    def _read_times(self) -> Float:
        numbers = np.array(self.numbers)
        path = self._folder / "times.txt"
        if not path.is_file():
            return numbers / _RATE_HZ
        times = read_kitti_times(path)
        if len(times) <= numbers[-1]:
            raise BenchError(f"{path} has {len(times)} times, too few for frame {numbers[-1]}. Restore the file.")
        return times[numbers]

    def _read_poses(self, path: Path) -> Float | None:
        if not path.is_file():
            return None
        poses = read_kitti_poses(path)
        last = self.numbers[-1]
        if len(poses) <= last:
            raise BenchError(
                f"{path} has {len(poses)} poses, too few for frame {last}. Restore the file, move it away to run "
                f"without ground truth, or choose dataset.frames up to {len(poses)}."
            )
        return poses[np.array(self.numbers)]


def _existing_root(text: str) -> Path:
    if not text:
        raise BenchError("dataset.root is not set. Give the folder that holds KITTI's sequences/, dataset.root=FOLDER.")
    root = Path(text).expanduser()
    if not root.is_dir():
        raise BenchError(
            f"dataset.root={text}: this folder does not exist. Give the one that holds KITTI's sequences/."
        )
    if not (root / "sequences").is_dir():
        raise BenchError(
            f"dataset.root={text} holds no folder 'sequences'. Give the root of KITTI's odometry data set."
        )
    return root


def _existing_sequence(root: Path, sequence: str) -> Path:
    folder = root / "sequences" / sequence
    if not folder.is_dir():
        there = sorted(entry.name for entry in (root / "sequences").iterdir() if entry.is_dir())
        raise BenchError(
            f"dataset.sequence={sequence} does not exist in {root / 'sequences'}, which holds "
            f"{', '.join(there) or 'no sequence'}. Choose one of these, or download it."
        )
    return folder


def _frames_on_disk(left: Path, right: Path, config: KittiConfig) -> tuple[int, ...]:
    for folder in (left, right):
        if not folder.is_dir():
            raise BenchError(
                f"The folder {folder} of the {config.camera} pair does not exist. Download it, or choose the other "
                "dataset.camera (color or gray)."
            )
    there = _image_numbers(left)
    numbers = select_frames(config.frames, there, str(left))
    there_right = set(_image_numbers(right))
    missing = [number for number in numbers if number not in there_right]
    if missing:
        raise BenchError(
            f"{right} lacks {describe(missing)}, whose left images are in {left} ({len(there)} left and "
            f"{len(there_right)} right images). Restore the right images, or choose dataset.frames without them."
        )
    return numbers


def _image_numbers(folder: Path) -> list[int]:
    return sorted(int(path.stem) for path in folder.glob("*.png") if path.stem.isdecimal())


def _stereo_camera(calibration: KittiCalibration, left: int, right: int, size: tuple[int, int]) -> StereoCamera:
    K, t_left = calibration.projection(left)
    K_right, t_right = calibration.projection(right)
    if not np.allclose(K, K_right, atol=1e-6):
        raise BenchError(f"{calibration.path}: P{left} and P{right} differ in K; a rectified pair shares it.")
    x, y, z = (float(value) for value in t_left - t_right)
    if x <= 0:
        raise BenchError(f"{calibration.path}: P{left} and P{right} give a baseline of {x:.4f} m; it must be positive.")
    fx, fy, cx, cy = (float(K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return StereoCamera(*size, fx=fx, fy=fy, cx=cx, cy=cy, right_position=(x, y, z))
