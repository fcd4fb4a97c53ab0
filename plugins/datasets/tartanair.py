"""TartanAir (Wang et al., IROS 2020) and TartanAir V2: rendered stereo of many environments, with exact depth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset, SequenceOnDisk
from bench.data.places import existing_root
from bench.errors import BenchError, require_between
from bench.geometry import se3
from bench.io.foreign import read_plain, reading
from bench.io.frame_range import select_frames
from bench.io.images import decode_png, nearest_pixels
from bench.io.numpy_files import read_npy
from bench.io.stereo_images import StereoImages, images_by_number
from bench.io.trajectories import known_poses, read_poses_without_times
from bench.registry import PluginConfig, register
from bench.types import Float, Map, StereoCamera, StereoFrame, Trajectory

# Nothing says when the images were rendered.
_RATE_HZ = 10.0
_BASELINE_M = 0.25
_FAR_M = 1000.0
"""The renderer's sky is 10 km off, and more in some environments: nothing there is a depth."""
_MOST_BYTES = 1e8
# North, east, down to right, down, ahead: x is the second axis, y the third, z the first.
_NED_FROM_OURS = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True)
class _Layout:
    """Folders and what stands behind the number in the files' names."""

    left: str
    right: str
    depth: str
    poses: str
    behind: tuple[str, str]
    depth_suffix: str


_LAYOUTS = (
    _Layout("image_left", "image_right", "depth_left", "pose_left.txt", ("_left", "_right"), ".npy"),
    _Layout(
        "image_lcam_front",
        "image_rcam_front",
        "depth_lcam_front",
        "pose_lcam_front.txt",
        ("_lcam_front", "_rcam_front"),
        ".png",
    ),
)
"""Of the first version and of V2."""


@dataclass(frozen=True)
class TartanAirConfig(PluginConfig):
    """Which trajectory of TartanAir."""

    root: str = field(default="", metadata={"path": True, "data": "tartanair"})
    """Folder that holds the environments; empty: tartanair in $BGS_DATA."""
    sequence: str = ""
    """Folder of the trajectory in ``root``, such as hospital/Easy/P000; empty: ``root`` itself."""
    frames: str = ""
    """Frame numbers ``a:b`` or ``a:b:step``; empty: all."""
    scale: float = 1.0
    """Sides of the images as they are used over the stored ones."""

    def __post_init__(self) -> None:
        require_between("dataset", self, 0.05, 1.0, "scale")


@register("dataset", "tartanair", config=TartanAirConfig)
class TartanAir(Dataset):
    """TartanAir, either version: colour pair, exact poses and depth.

    The world is the left camera in the first frame used.
    """

    def __init__(self, config: TartanAirConfig) -> None:
        folder, layout = _existing(config)
        self.label = "tartanair/" + "/".join(folder.resolve().parts[-3:])
        left = images_by_number(folder / layout.left, behind=layout.behind[0])
        right = images_by_number(folder / layout.right, behind=layout.behind[1])
        self.numbers = select_frames(config.frames, list(left), str(folder / layout.left))
        self._images = StereoImages(left, right, self.numbers)
        self.remarks = self._images.remarks
        width, height = self._images.size
        # 90 degrees from the left border to the right one.
        camera = StereoCamera(
            width, height, width / 2, width / 2, width / 2, height / 2, right_position=(_BASELINE_M, 0.0, 0.0)
        )
        self.camera = camera.scaled(config.scale)
        self._depth = _depth_files(folder / layout.depth, layout, self.numbers)
        self._poses = _read_poses(folder / layout.poses, len(left), list(left), self.numbers)

    @classmethod
    def sequences_in(cls, root: Path) -> Iterator[SequenceOnDisk]:
        """Each folder, as deep as the archives have them, that holds the left camera's images."""
        for layout in _LAYOUTS:
            for depth in range(5):
                for left in sorted(root.glob("*/" * depth + layout.left)):
                    folder = left.parent
                    name = "" if folder == root else folder.relative_to(root).as_posix()
                    yield SequenceOnDisk({"sequence": name}, (left, folder / layout.right, folder / layout.depth))

    def lacks(self) -> tuple[str, ...]:
        """Depth and poses, where they are not here."""
        kinds = {"depth": self._depth, "ground truth": self._poses}
        return tuple(f"no {what}" for what, found in kinds.items() if found is None)

    def frame(self, position: int) -> StereoFrame:
        """Decode one pair; raises ``BenchError`` if an image turns out to be damaged."""
        number = self.numbers[position]
        return self._images.frame(number, number / _RATE_HZ, self.camera)

    def ground_truth(self) -> Trajectory | None:
        """The exact poses of the left camera in OpenCV's axes; None without the file."""
        if self._poses is None:
            return None
        T = se3.inverse(self._poses[0]) @ self._poses
        T[0] = np.eye(4)  # but for rounding
        numbers = np.array(self.numbers, dtype=np.int64)
        return Trajectory(T, numbers, numbers / _RATE_HZ)

    def true_depth(self, position: int) -> Map | None:
        """Exact, NaN from 1 km on (the sky); None without the depth files."""
        if self._depth is None:
            return None
        depth = _read_depth(self._depth[position], self._images.size)
        depth = nearest_pixels(depth, (self.camera.width, self.camera.height))
        return np.where((depth > 0) & (depth < _FAR_M), depth, np.float32(np.nan)).astype(np.float32)

    def sensor_depth(self, position: int) -> Map | None:
        """``true_depth``, as a depth camera's: for ``stereo=sensor``, and Depth-L1."""
        return self.true_depth(position)


def _existing(config: TartanAirConfig) -> tuple[Path, _Layout]:
    root = existing_root(config.root, "tartanair", "the environments")
    folder = root / config.sequence
    layout = next((layout for layout in _LAYOUTS if (folder / layout.left).is_dir()), None)
    if layout is not None:
        return folder, layout
    there = [one.settings["sequence"] for one in TartanAir.sequences_in(root)]
    raise BenchError(
        f"{folder} holds no folder {' or '.join(each.left for each in _LAYOUTS)}; in {root} there are "
        f"{', '.join(there[:8]) or 'no images of TartanAir'}. Choose one by dataset.sequence."
    )


def _depth_files(folder: Path, layout: _Layout, numbers: tuple[int, ...]) -> list[Path] | None:
    if not folder.is_dir():
        return None
    files = [folder / f"{number:06d}{layout.behind[0]}_depth{layout.depth_suffix}" for number in numbers]
    if missing := [file for file in files if not file.is_file()]:
        raise BenchError(f"{missing[0]} is missing. Unpack the depth again, or move its folder away.")
    return files


def _read_depth(path: Path, size: tuple[int, int]) -> Map:
    """(H, W) float32 metres: an array, or in V2 the bytes of one in the four channels of a PNG."""
    with reading(path, "can't be read as depth", "Unpack it again."):
        if path.suffix == ".npy":
            depth = read_npy(path, _MOST_BYTES)
        else:
            stored = decode_png(read_plain(path, _MOST_BYTES), size)
            if stored is None or stored.dtype != np.uint8 or stored.shape[2:] != (4,):
                raise ValueError(f"it is no PNG of {size[0]}x{size[1]} pixels and four channels of 8 bits")
            depth = np.ascontiguousarray(stored).view("<f4")[..., 0]
    if depth.shape != size[::-1] or depth.dtype != np.float32:
        raise BenchError(
            f"{path} holds {depth.dtype} {depth.shape}, and the images are {size[0]}x{size[1]}: expected float32. "
            "Unpack it again."
        )
    return np.asarray(depth, np.float32)


def _read_poses(path: Path, images: int, there: list[int], numbers: tuple[int, ...]) -> Float | None:
    """T_world_cam (N, 4, 4) in OpenCV's axes: line k is that of the k-th image. None without the file."""
    if not path.is_file():
        return None
    poses = read_poses_without_times(path)
    if len(poses) != images or not known_poses(poses).all():
        raise BenchError(f"{path} has {int(known_poses(poses).sum())} poses for {images} images. Unpack it again.")
    rows = np.searchsorted(there, numbers)
    T: Float = _NED_FROM_OURS.T @ poses[rows] @ _NED_FROM_OURS
    return T
