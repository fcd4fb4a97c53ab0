"""Virtual KITTI 2 (Cabon, Murray and Humenberger, 2020): rendered copies of KITTI drives, in any weather."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset, SequenceOnDisk
from bench.data.places import existing_root
from bench.errors import BenchError, require_between
from bench.geometry import se3
from bench.io.frame_range import select_frames
from bench.io.images import nearest_pixels, read_16_bit, read_rgb
from bench.io.named_matrices import is_rotation
from bench.io.stereo_images import StereoImages, images_by_number
from bench.io.text_files import read_text
from bench.registry import PluginConfig, register
from bench.types import Float, Map, Mask, StereoCamera, StereoFrame, Trajectory

# Nothing says when the images were rendered; the drives that they copy have ten a second.
_RATE_HZ = 10.0
_CM = 100.0
_NO_DEPTH = 65535
"""Sky, and what is farther than 655.34 m."""
_SKY = (90, 200, 255)
"""Colour of the sky in classSegmentation, RGB."""
_K = ("K[0,0]", "K[1,1]", "K[0,2]", "K[1,2]")
_RT = tuple(name for row in "123" for name in (*(f"r{row},{column}" for column in "123"), f"t{row}"))
_ONE_PLACE = 1e-2
"""By how much, in metres, the right camera may be off its place beside the left one: files have a few digits."""

Rows = dict[tuple[int, int], Float]


@dataclass(frozen=True)
class Vkitti2Config(PluginConfig):
    """Which scene of Virtual KITTI 2, and in which weather."""

    root: str = field(default="", metadata={"path": True, "data": "vkitti2"})
    """Folder that holds the scenes, ``Scene01/`` and so on; empty: vkitti2 in $BGS_DATA."""
    sequence: str = "Scene01"
    """Scene01, 02, 06, 18 or 20, the copies of KITTI tracking's drives of these numbers."""
    variation: str = "clone"
    """clone, fog, morning, overcast, rain, sunset, or the camera turned: 15-deg-left, 30-deg-right ..."""
    frames: str = ""
    """Frame numbers ``a:b`` or ``a:b:step``; empty: all."""
    scale: float = 1.0
    """Sides of the images as they are used over the stored ones."""

    def __post_init__(self) -> None:
        require_between("dataset", self, 0.05, 1.0, "scale")


@register("dataset", "vkitti2", config=Vkitti2Config)
class Vkitti2(Dataset):
    """Virtual KITTI 2: colour pair, exact poses, depth and sky. Cars that drive are in all of them.

    The world is the left camera in the first frame used.
    """

    def __init__(self, config: Vkitti2Config) -> None:
        folder = _existing(config)
        self.label = f"vkitti2/{folder.parent.name.removeprefix('Scene')}/{folder.name}"
        frames = folder / "frames"
        left, right = (images_by_number(frames / "rgb" / f"Camera_{camera}", "rgb_") for camera in (0, 1))
        if lone := sorted(right.keys() - left.keys()):
            raise BenchError(f"{frames / 'rgb' / 'Camera_0'} lacks frame {lone[0]}, which Camera_1 has. Unpack rgb.")
        self.numbers = select_frames(config.frames, list(left), f"{frames / 'rgb'}")
        self._images = StereoImages(left, right, self.numbers)
        self.remarks = self._images.remarks
        poses = _read_rows(folder / "extrinsic.txt", _RT, self.numbers)
        self._T = _poses(folder / "extrinsic.txt", poses, self.numbers, 0)
        of_right = _poses(folder / "extrinsic.txt", poses, self.numbers, 1)
        self.camera = _camera(folder, self._images.size, self.numbers, se3.inverse(self._T) @ of_right)
        self.camera = self.camera.scaled(config.scale)
        self._depth = _beside(frames / "depth" / "Camera_0", "depth_", self.numbers)
        self._classes = _beside(frames / "classSegmentation" / "Camera_0", "classgt_", self.numbers)

    @classmethod
    def sequences_in(cls, root: Path) -> Iterator[SequenceOnDisk]:
        """Each variation of each scene."""
        for rgb in sorted(root.glob("Scene*/*/frames/rgb")):
            folder = rgb.parents[1]
            images = tuple(rgb.parent / kind / f"Camera_{camera}" for kind in ("rgb", "depth") for camera in (0, 1))
            yield SequenceOnDisk({"sequence": folder.parent.name, "variation": folder.name}, images)

    def lacks(self) -> tuple[str, ...]:
        """Depth and classes, where they are not here."""
        kinds = {"depth": self._depth, "classSegmentation (for the sky)": self._classes}
        return tuple(f"no {what}" for what, files in kinds.items() if files is None)

    def frame(self, position: int) -> StereoFrame:
        """Decode one pair; raises ``BenchError`` if an image turns out to be damaged."""
        number = self.numbers[position]
        return self._images.frame(number, number / _RATE_HZ, self.camera)

    def ground_truth(self) -> Trajectory:
        """The exact poses of the left camera."""
        T = se3.inverse(self._T[0]) @ self._T
        T[0] = np.eye(4)  # but for rounding
        numbers = np.array(self.numbers, dtype=np.int64)
        return Trajectory(T, numbers, numbers / _RATE_HZ)

    def true_depth(self, position: int) -> Map | None:
        """Exact to the centimetre, up to 655 m, NaN in the sky and beyond; None without the depth images."""
        if self._depth is None:
            return None
        stored = read_16_bit(self._depth[position], self._images.size, "Virtual KITTI 2 stores depth")
        stored = nearest_pixels(stored, (self.camera.width, self.camera.height))
        return np.where(stored == _NO_DEPTH, np.float32(np.nan), stored / np.float32(_CM)).astype(np.float32)

    def sensor_depth(self, position: int) -> Map | None:
        """``true_depth``, as a depth camera's: for ``stereo=sensor``, and Depth-L1."""
        return self.true_depth(position)

    def true_sky(self, position: int) -> Mask | None:
        """Where the class is sky; None without classSegmentation."""
        if self._classes is None:
            return None
        classes = read_rgb(self._classes[position], self._images.size)
        sky = (classes == np.array(_SKY, np.uint8)).all(axis=2)
        return np.asarray(nearest_pixels(sky.astype(np.uint8), (self.camera.width, self.camera.height)) == 1)


def _existing(config: Vkitti2Config) -> Path:
    root = existing_root(config.root, "vkitti2", "Scene01/ and so on")
    number = re.fullmatch(r"(?:Scene)?(\d{1,2})", config.sequence)
    if number is None:
        raise BenchError(f"dataset.sequence={config.sequence!r} is no scene. Give its name, for example Scene01.")
    scene = root / f"Scene{int(number[1]):02d}"
    folder = scene / config.variation
    if not (folder / "frames").is_dir():
        there = sorted(f"{rgb.parents[2].name} {rgb.parents[1].name}" for rgb in root.glob("Scene*/*/frames/rgb"))
        raise BenchError(
            f"{folder / 'frames'} does not exist; {root} holds {', '.join(there[:12]) or 'no scene'}. Choose by "
            "dataset.sequence and dataset.variation, or unpack it."
        )
    return folder


def _read_rows(path: Path, columns: tuple[str, ...], numbers: tuple[int, ...]) -> Rows:
    """Of each frame and camera the numbers of these columns, which the header names, in whatever order."""
    lines = [line.split() for line in read_text(path, "text file of vkitti_2.0.3_textgt").splitlines()]
    header = lines[0] if lines else []
    wanted = ("frame", "cameraID", *columns)
    if lacking := [name for name in wanted if name not in header]:
        raise BenchError(f"{path}: the header names no column {lacking[0]!r}. Unpack vkitti_2.0.3_textgt again.")
    at = [header.index(name) for name in wanted]
    rows: Rows = {}
    for number, words in enumerate(lines[1:], start=2):
        try:
            frame, camera = (int(words[column]) for column in at[:2])
            values = [float(words[column]) for column in at[2:]]
        except (ValueError, IndexError):
            raise BenchError(f"{path}, line {number}: no row of numbers for this header. Unpack it again.") from None
        rows[frame, camera] = np.array(values)
    for key in ((number, camera) for number in numbers for camera in (0, 1)):
        if key not in rows or not np.isfinite(rows[key]).all():
            raise BenchError(f"{path} has no numbers of frame {key[0]}, camera {key[1]}. Unpack it again.")
    return rows


def _poses(path: Path, rows: Rows, numbers: tuple[int, ...], camera: int) -> Float:
    """T_world_cam (N, 4, 4): the file has world to camera."""
    T = np.tile(np.eye(4), (len(numbers), 1, 1))
    T[:, :3] = np.array([rows[number, camera] for number in numbers]).reshape(-1, 3, 4)
    if not (good := is_rotation(T[:, :3, :3])).all():
        raise BenchError(f"{path}: frame {numbers[int(np.argmin(good))]} is no rotation. Unpack it again.")
    return se3.inverse(se3.orthonormalise(T))


def _camera(folder: Path, size: tuple[int, int], numbers: tuple[int, ...], T_left_right: Float) -> StereoCamera:
    """The pair, which must be one for all frames, with the right camera (N, 4, 4) straight beside the left one."""
    rows = _read_rows(folder / "intrinsic.txt", _K, numbers)
    K = np.array([rows[number, camera] for number in numbers for camera in (0, 1)])
    if np.ptp(K, axis=0).max() > 0:
        raise BenchError(f"{folder / 'intrinsic.txt'}: the cameras differ, or change from frame to frame. Restore it.")
    place = np.median(T_left_right[:, :3, 3], axis=0)
    off = np.abs(T_left_right - se3.compose(np.eye(3), np.array([place[0], 0.0, 0.0]))).max(axis=(1, 2))
    if place[0] <= 0 or off.max() > _ONE_PLACE:
        raise BenchError(
            f"{folder / 'extrinsic.txt'}, frame {numbers[int(np.argmax(off))]}: camera 1 is not straight on the right "
            "of camera 0. The file must have world to camera; unpack it again."
        )
    fx, fy, cx, cy = (float(value) for value in K[0])
    return StereoCamera(*size, fx, fy, cx, cy, right_position=(float(place[0]), 0.0, 0.0))


def _beside(folder: Path, before: str, numbers: tuple[int, ...]) -> list[Path] | None:
    """The images of these frames in a folder that may be absent as a whole."""
    if not folder.is_dir():
        return None
    files = images_by_number(folder, before)
    if missing := [number for number in numbers if number not in files]:
        raise BenchError(f"{folder} lacks frame {missing[0]}. Unpack it again, or move the folder away.")
    return [files[number] for number in numbers]
