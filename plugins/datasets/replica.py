"""Replica (Straub et al., 2019) as NICE-SLAM publishes it: rendered rooms with depth images and exact poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset, SequenceOnDisk
from bench.data.places import existing_root
from bench.errors import BenchError, require_between, require_least
from bench.io.frame_range import select_frames
from bench.io.images import IMAGE_SUFFIXES
from bench.io.rgbd import Intrinsics, RgbdImages, own_or
from bench.io.trajectories import read_kitti_poses
from bench.registry import PluginConfig, register
from bench.types import Float, Map, StereoFrame, Trajectory

_PUBLISHED = Intrinsics(600.0, 600.0, 599.5, 339.5, size=(1200, 680))
# Nothing says when the images were rendered.
_RATE_HZ = 30.0


@dataclass(frozen=True)
class ReplicaConfig(PluginConfig):
    """Which room; the camera's numbers where it is rendered otherwise."""

    root: str = field(default="", metadata={"path": True, "data": "replica"})
    """Folder of the rooms; empty: replica in $BGS_DATA."""
    sequence: str = "office0"
    """Folder of the room: office0 to office4, room0 to room2."""
    frames: str = ""
    """Frame numbers ``a:b`` or ``a:b:step``; empty: all."""
    scale: float = 1.0
    """Sides of the images as they are used over the stored ones."""
    depth_factor: float = 6553.5
    """Stored depth per metre."""
    fx: float = 0.0
    """Focal length along x in pixels; 0 here and in the next three: the published camera, of 1200x680 pixels."""
    fy: float = 0.0
    """Focal length along y in pixels."""
    cx: float = 0.0
    """Principal point along x in pixels."""
    cy: float = 0.0
    """Principal point along y in pixels."""

    def __post_init__(self) -> None:
        require_between("dataset", self, 0.05, 1.0, "scale")
        require_least("dataset", self, fx=0, fy=0, cx=0, cy=0, depth_factor=1e-6)


@register("dataset", "replica", config=ReplicaConfig)
class Replica(Dataset):
    """A room of Replica: rendered colour and depth images, exact poses."""

    has_right = False

    def __init__(self, config: ReplicaConfig) -> None:
        folder = _existing(config)
        results = folder / "results"
        color, depth = _numbered(results, "frame", IMAGE_SUFFIXES), _numbered(results, "depth", (".png",))
        self.label = f"replica/{config.sequence}"
        self.numbers = select_frames(config.frames, sorted(color), str(results))
        missing = next((number for number in self.numbers if number not in depth), None)
        if missing is not None:
            raise BenchError(f"{results / f'depth{missing:06d}.png'} is missing. Unpack the room again.")
        self._images = RgbdImages(
            [color[number] for number in self.numbers],
            [depth[number] for number in self.numbers],
            own_or(_PUBLISHED, Intrinsics(config.fx, config.fy, config.cx, config.cy), ""),
            config.depth_factor,
            config.scale,
        )
        self.camera, self.remarks = self._images.camera, self._images.remarks
        self._poses = _read_poses(folder / "traj.txt", self.numbers)

    @classmethod
    def sequences_in(cls, root: Path) -> Iterator[SequenceOnDisk]:
        """Each room."""
        for results in sorted(root.glob("*/results")):
            yield SequenceOnDisk({"sequence": results.parent.name}, (results,))

    def lacks(self) -> tuple[str, ...]:
        """The ground truth, where it is not here."""
        return () if self._poses is not None else ("no ground truth (traj.txt)",)

    def frame(self, position: int) -> StereoFrame:
        """Decode one colour image; raises ``BenchError`` if it turns out to be damaged."""
        number = self.numbers[position]
        return StereoFrame(number, number / _RATE_HZ, self._images.color(position))

    def sensor_depth(self, position: int) -> Map:
        """The depth image of this frame."""
        return self._images.depth(position)

    def ground_truth(self) -> Trajectory | None:
        """Exact poses; None without traj.txt."""
        if self._poses is None:
            return None
        numbers = np.array(self.numbers, dtype=np.int64)
        return Trajectory(self._poses, numbers, numbers / _RATE_HZ)


def _existing(config: ReplicaConfig) -> Path:
    root = existing_root(config.root, "replica", "Replica's rooms")
    folder = root / config.sequence
    if not (folder / "results").is_dir():
        there = sorted(entry.parent.name for entry in root.glob("*/results"))
        raise BenchError(
            f"{folder} holds no folder 'results'; in dataset.root={root} there are these rooms: "
            f"{', '.join(there) or 'none'}. Choose one of them by dataset.sequence, or download it."
        )
    return folder


def _numbered(folder: Path, prefix: str, suffixes: tuple[str, ...]) -> dict[int, Path]:
    """Images by the number behind ``prefix`` in their names."""
    files = (file for file in sorted(folder.iterdir()) if file.suffix.lower() in suffixes)
    named = ((file.stem.removeprefix(prefix), file) for file in files if file.stem.startswith(prefix))
    return {int(number): file for number, file in named if number.isdecimal()}


def _read_poses(path: Path, numbers: tuple[int, ...]) -> Float | None:
    """T_world_cam (N, 4, 4) of these frames: line k (from 0) is that of frame k. None without the file."""
    if not path.is_file():
        return None
    poses = read_kitti_poses(path, matrix_rows=4)
    if len(poses) <= numbers[-1]:
        raise BenchError(f"{path} has {len(poses)} poses, too few for frame {numbers[-1]}. Unpack the room again.")
    return poses[np.array(numbers)]
