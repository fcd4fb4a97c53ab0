"""A data set of a few frames whose scores can be worked out by hand, and folders of a system that ran on it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.cli import main
from bench.contracts.dataset import Dataset
from bench.io.trajectories import write_kitti
from bench.registry import PluginConfig, register
from bench.types import Map, StereoCamera, StereoFrame, Trajectory

HEIGHT, WIDTH, COUNT, LIDAR_M = 40, 56, 8, 12.0


@dataclass(frozen=True)
class CaseConfig(PluginConfig):
    """Frames ``first``, ``first + step`` ...; ``sequence`` only names it."""

    first: int = 0
    count: int = COUNT
    step: int = 1
    sequence: str = "03"
    has_truth: bool = True


@register("dataset", "foreign_for_tests", config=CaseConfig)
class CaseDataset(Dataset):
    """Noise images, LiDAR at 12 m in the upper half, a car in a gentle curve."""

    label = "case"
    camera = StereoCamera(WIDTH, HEIGHT, 50.0, 50.0, 27.5, 19.5, (0.5, 0.0, 0.0))

    def __init__(self, config: CaseConfig) -> None:
        self.numbers = tuple(range(config.first, config.first + config.count * config.step, config.step))
        self._has_truth = config.has_truth

    def frame(self, position: int) -> StereoFrame:
        number = self.numbers[position]
        left, right = np.random.default_rng(number).integers(0, 200, (2, HEIGHT, WIDTH, 3), dtype=np.uint8)
        return StereoFrame(number, 0.1 * number, left, right)

    def lidar_depth(self, position: int) -> Map | None:
        depth = np.full((HEIGHT, WIDTH), np.nan, np.float32)
        depth[: HEIGHT // 2] = LIDAR_M
        return depth

    def ground_truth(self) -> Trajectory | None:
        if not self._has_truth:
            return None
        numbers = np.array(self.numbers)
        return Trajectory(curve(numbers), numbers, 0.1 * numbers)


def curve(numbers: np.ndarray) -> np.ndarray:
    """T_world_cam (N, 4, 4): about a metre a frame forward (z), turning right by 0.02 rad a frame."""
    angle = 0.02 * numbers
    T = np.tile(np.eye(4), (len(numbers), 1, 1))
    T[:, 0, 0] = T[:, 2, 2] = np.cos(angle)
    T[:, 0, 2], T[:, 2, 0] = np.sin(angle), -np.sin(angle)
    T[:, 0, 3], T[:, 2, 3] = 50 * (1 - np.cos(angle)), 50 * np.sin(angle)
    return T


def dataset(**settings: Any) -> CaseDataset:
    return CaseDataset(CaseConfig(**settings))


def write_renders(folder: Path, numbers: Sequence[int], offset: int = 4, name: str = "gs_{:04d}.png") -> Path:
    """The true left images plus ``offset``: PSNR is 20 log10(255 / offset)."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        image = np.random.default_rng(number).integers(0, 200, (2, HEIGHT, WIDTH, 3), dtype=np.uint8)[0] + offset
        assert cv2.imwrite(str(folder / name.format(number)), image[..., ::-1])
    return folder


def write_depth(folder: Path, numbers: Sequence[int], metres: float, scale: float = 256.0) -> Path:
    """16-bit PNGs of one depth everywhere."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        picture = np.full((HEIGHT, WIDTH), round(metres * scale), np.uint16)
        assert cv2.imwrite(str(folder / f"{number:06d}.png"), picture)
    return folder


def write_poses(path: Path, T: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_kitti(path, T)
    return path


def arguments(folder: Path, output: Path, *more: str) -> list[str]:
    """``bgs-bench score`` of the folder on the data set of this file."""
    common = ("dataset=foreign_for_tests", "protocol.lpips=false", "protocol.depth_min_m=0", "--output", str(output))
    return ["score", str(folder), *common, *(() if "--name" in more else ("--name", "Theirs")), *more]


def score(folder: Path, output: Path, *more: str) -> dict[str, Any]:
    """The metrics of the folder, scored through the command line; fails unless that went well."""
    assert main(arguments(folder, output, *more)) == 0
    metrics = json.loads((output / "metrics.json").read_text())
    assert isinstance(metrics, dict)
    return metrics


def refusal(capfd: pytest.CaptureFixture[str], folder: Path, output: Path, *more: str) -> str:
    """The one line of an error; fails unless the exit code is 2 and nothing was written."""
    before = sorted(output.parent.rglob("*"))
    assert main(arguments(folder, output, *more)) == 2
    out, error = capfd.readouterr()
    assert error.startswith("bgs-bench: ")
    assert error.count("\n") == 1, error
    assert out == ""
    assert sorted(output.parent.rglob("*")) == before
    return error
