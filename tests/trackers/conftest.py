"""Data sets in memory, and a made-up world in front of a stereo pair."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.contracts.dataset import Dataset
from bench.geometry import se3
from bench.types import StereoCamera, StereoFrame, Trajectory

Pair = tuple[np.ndarray, np.ndarray]


class MemoryDataset(Dataset):
    """Frames and poses given as arrays; the tests' own, so that they don't lean on a data set plugin."""

    def __init__(
        self,
        camera: StereoCamera,
        pairs: list[Pair],
        numbers: list[int] | None = None,
        poses: np.ndarray | None = None,
    ) -> None:
        self.label = "memory"
        self.camera = camera
        self.numbers = tuple(range(len(pairs)) if numbers is None else numbers)
        self._pairs, self._poses = pairs, poses

    def frame(self, position: int) -> StereoFrame:
        left, right = self._pairs[position]
        return StereoFrame(self.numbers[position], 0.1 * self.numbers[position], left, right)

    def ground_truth(self) -> Trajectory | None:
        if self._poses is None:
            return None
        numbers = np.array(self.numbers)
        return Trajectory(self._poses, numbers, 0.1 * numbers)


@pytest.fixture(scope="session")
def kitti_grey(kitti_root: Path) -> MemoryDataset:
    """Frames 0-50 of KITTI 06, grey, with the official poses; calibration as in the data set's calib.txt."""
    folder = kitti_root / "sequences" / "06"
    camera = StereoCamera(1226, 370, 707.0912, 707.0912, 601.8873, 183.1104, (379.8145 / 707.0912, 0.0, 0.0))
    pairs = []
    for i in range(51):
        left, right = (cv2.imread(str(folder / side / f"{i:06d}.png"), 0) for side in ("image_0", "image_1"))
        assert left is not None
        assert right is not None
        pairs.append((np.dstack([left] * 3), np.dstack([right] * 3)))
    table = np.loadtxt(kitti_root / "poses" / "06.txt")[:51].reshape(-1, 3, 4)
    return MemoryDataset(camera, pairs, poses=se3.compose(table[:, :, :3], table[:, :, 3]))


@pytest.fixture(scope="session")
def small_camera() -> StereoCamera:
    return StereoCamera(480, 240, 400.0, 400.0, 239.5, 119.5, (0.5, 0.0, 0.0))


def texture(height: int, width: int, seed: int = 0, blur: float = 1.5) -> np.ndarray:
    """Corner-rich noise (height, width) uint8."""
    noise = np.random.default_rng(seed).normal(size=(height, width))
    smooth = cv2.GaussianBlur(noise, (0, 0), blur)
    return np.clip(128 + 50 * smooth / smooth.std(), 0, 255).astype(np.uint8)


@pytest.fixture(scope="session")
def wall(small_camera: StereoCamera) -> MemoryDataset:
    """A textured wall 10 m away; the pair slides along it by 0.25 m per frame: 10 whole pixels, disparity 20."""
    picture = texture(240, 1000)
    pairs, poses = [], np.tile(np.eye(4), (12, 1, 1))
    for i in range(12):
        left, right = picture[:, 100 + 10 * i :][:, :480], picture[:, 120 + 10 * i :][:, :480]
        pairs.append((np.dstack([left] * 3), np.dstack([right] * 3)))
        poses[i, 0, 3] = 0.25 * i
    return MemoryDataset(small_camera, pairs, poses=poses)


@pytest.fixture(scope="session")
def make_dataset() -> type[MemoryDataset]:
    """``MemoryDataset`` itself: test files can't import from this one."""
    return MemoryDataset
