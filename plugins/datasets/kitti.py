"""KITTI odometry benchmark (Geiger et al., CVPR 2012): one sequence, grey or colour pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError, require_between, require_choice
from bench.geometry.lidar import project_to_depth
from bench.io.frame_range import describe, select_frames
from bench.io.images import IMAGE_SUFFIXES, ImageSequence, describe_files, shrunk
from bench.io.kitti360_files import read_image_times
from bench.io.kitti_files import KittiCalibration, read_kitti_times
from bench.io.scans import check_scan_file, read_scan
from bench.io.trajectories import known_poses, read_kitti_poses
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
    """Folder that holds ``sequences/`` and ``poses/``, or a day of KITTI raw; must be given."""
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
        self._left, self._right = (_images_by_number(side) for side in folders)
        self.numbers = _frames_on_disk(self._left, self._right, folders, config)
        calibration = KittiCalibration.in_folders(folder, root)
        self._t_left = calibration.projection(left)[1]
        self._scans: dict[int, Path] = {}
        self._lines = {"times": 0, "poses": 0}
        self._T_left_velodyne = self._check_scans(calibration)
        self._times = self._read_times(folders[0])
        self._poses = self._read_poses(root / "poses" / f"{sequence}.txt")
        chosen = [side[number] for number in self.numbers for side in (self._left, self._right)]
        self._images = ImageSequence(chosen, [*self._left.values(), *self._right.values()])
        self.camera = _stereo_camera(calibration, left, right, self._images.size).scaled(config.scale)
        self.remarks = (*self._images.remarks, *self._about_poses())

    def frame(self, position: int) -> StereoFrame:
        """Decode one pair; raises ``BenchError`` if an image turns out to be damaged."""
        number = self.numbers[position]
        left, right = (self._images.read(side[number]) for side in (self._left, self._right))
        size = (self.camera.width, self.camera.height)
        return StereoFrame(number, float(self._times[position]), shrunk(left, size), shrunk(right, size))

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
        path = self._scans.get(self.numbers[position])
        if self._T_left_velodyne is None or path is None:
            return None
        points = read_scan(path)
        # Points behind the vehicle can't be seen; dropping them first halves the work.
        points = points[points[:, 0] > 0]
        T = self._T_left_velodyne
        return project_to_depth(points @ T[:3, :3].T + T[:3, 3], self.camera)

    def _check_scans(self, calibration: KittiCalibration) -> Float | None:
        if not (self._folder / "velodyne").is_dir():
            return None
        files = (self._folder / "velodyne").glob("*.bin")
        self._scans = {int(file.stem): file for file in files if file.stem.isdecimal()}
        for number in self.numbers:
            if number in self._scans:
                check_scan_file(self._scans[number])
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

    def _read_times(self, images: Path) -> Float:
        numbers = np.array(self.numbers)
        path = self._folder / "times.txt"
        if not path.is_file():
            of_raw = images.parent / "timestamps.txt"
            if of_raw.is_file():
                return read_image_times(of_raw, self.numbers, sorted(self._left))
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
    if not text:
        raise BenchError("dataset.root is not set. Give the folder that holds KITTI's sequences/, dataset.root=FOLDER.")
    root = Path(text).expanduser()
    if not root.is_dir():
        raise BenchError(
            f"dataset.root={text}: this folder does not exist. Give the one that holds KITTI's sequences/."
        )
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


def _images_by_number(folder: Path) -> dict[int, Path]:
    """PNG and JPEG images whose name is their number, with any number of digits."""
    images: dict[int, Path] = {}
    files = sorted(file for file in folder.iterdir() if file.is_file() and not file.name.startswith("."))
    for file in files:
        if file.suffix.lower() not in IMAGE_SUFFIXES or not file.stem.isdecimal():
            continue
        number = int(file.stem)
        if number in images:
            raise BenchError(f"{images[number]} and {file.name} both are image {number}. Move one of them away.")
        images[number] = file
    if not images:
        raise BenchError(
            f"{folder} holds no PNG or JPEG image whose name is its number, as 000000.png (it holds "
            f"{describe_files(files)}). Check dataset.root and dataset.sequence."
        )
    return images


def _frames_on_disk(
    left: Mapping[int, Path], right: Mapping[int, Path], folders: tuple[Path, Path], config: KittiConfig
) -> tuple[int, ...]:
    numbers = select_frames(config.frames, sorted(left), str(folders[0]))
    missing = [number for number in numbers if number not in right]
    if missing:
        raise BenchError(
            f"{folders[1]} lacks {describe(missing)}, whose left images are in {folders[0]} ({len(left)} left and "
            f"{len(right)} right images). Restore the right images, or choose dataset.frames without them."
        )
    return numbers


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
