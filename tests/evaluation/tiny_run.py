"""A tiny run folder, written through ``RunFolder``, whose scores can be worked out by hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.contracts.dataset import Dataset
from bench.registry import PluginConfig, register
from bench.runs.folder import RunFolder
from bench.types import Map, RenderedView, StereoCamera, StereoFrame, Trajectory

HEIGHT, WIDTH = 40, 56
NUMBERS = (10, 11, 12, 13, 14)
LOST, HELD_OUT = 12, 13
# What is added to the true 8-bit image of each frame: PSNR is 20 log10(255 / error).
LEFT_ERROR = {10: 1, 11: 2, 13: 8, 14: 4}
RIGHT_ERROR = 16


@dataclass(frozen=True)
class TinyConfig(PluginConfig):
    """No settings."""


@register("dataset", "tiny_for_tests", config=TinyConfig)
class TinyDataset(Dataset):
    """Five frames of noise, a car that drives straight, LiDAR at 12 m in the upper half of three of them."""

    label = "tiny"
    camera = StereoCamera(WIDTH, HEIGHT, 50.0, 50.0, 27.5, 19.5, (0.5, 0.0, 0.0))
    numbers = NUMBERS

    def __init__(self, config: TinyConfig) -> None:
        self.decoded: list[int] = []

    def frame(self, position: int) -> StereoFrame:
        number = self.numbers[position]
        self.decoded.append(number)
        rng = np.random.default_rng(number)
        left, right = rng.integers(0, 200, (2, HEIGHT, WIDTH, 3), dtype=np.uint8)
        return StereoFrame(number, 0.1 * number, left, right)

    def lidar_depth(self, position: int) -> Map | None:
        if self.numbers[position] == 14:
            return None
        depth = np.full((HEIGHT, WIDTH), np.nan, np.float32)
        depth[: HEIGHT // 2] = 12.0
        return depth


def straight_drive(numbers: tuple[int, ...]) -> Trajectory:
    """One metre a frame along z."""
    T = np.tile(np.eye(4), (len(numbers), 1, 1))
    T[:, 2, 3] = numbers
    return Trajectory(T, np.array(numbers), 0.1 * np.array(numbers))


def frame_row(number: int) -> dict[str, Any]:
    return {
        "number": number,
        "timestamp": 0.1 * number,
        "state": "lost" if number == LOST else "ok",
        "mapped": number not in (LOST, HELD_OUT),
        "heldout": number == HELD_OUT,
    }


def write_tiny_run(path: Path, config: dict[str, Any], state: str = "done") -> Path:
    """A run of five frames: one lost, one held out, left and right renders with known errors, depth 10 m."""
    folder = RunFolder.create(path, config, "hash", rerun=False)
    folder.set_status("running", frames_total=len(NUMBERS))
    dataset = TinyDataset(TinyConfig())
    tracked = tuple(number for number in NUMBERS if number != LOST)
    for number in tracked:
        frame = dataset.frame(NUMBERS.index(number))
        depth = np.full((HEIGHT, WIDTH), 10.0 if number != HELD_OUT else np.nan, np.float32)
        alpha = np.ones((HEIGHT, WIDTH), np.float32)
        for view, image, error in (("left", frame.left, LEFT_ERROR[number]), ("right", frame.right, RIGHT_ERROR)):
            color = (image.astype(np.float32) + error) / np.float32(255)
            folder.write_view(view, number, RenderedView(color, depth, alpha), depth)  # type: ignore[arg-type]
    folder.write_trajectory(straight_drive(tracked), straight_drive(NUMBERS))
    folder.write_frames([frame_row(number) for number in NUMBERS])
    folder.write_json("resources.json", {"peak_memory_gb": 0.5, "mapping_s_per_frame": float("nan"), "gaussians": 1234})
    folder.set_status(state, frames_done=len(NUMBERS), frames_total=len(NUMBERS))
    return path
