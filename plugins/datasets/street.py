"""A procedural street: the sequence that needs no download, with exact depth, sky, poses and LiDAR."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.registry import PluginConfig, register
from bench.street.casting import cast, pinhole_rays
from bench.street.lidar import lidar_depth, lidar_points
from bench.street.scene import LANE_CENTER_M, build_street
from bench.street.shading import Scene, render
from bench.types import Float, Image, Map, Mask, StereoCamera, StereoFrame, Trajectory

BASELINE_M = 0.54
CAMERA_HEIGHT_M = 1.65
_FOCAL_PER_WIDTH = 0.57
_RATE_HZ = 10.0
_SIZES = ((64, 4096), (32, 4096))


@dataclass(frozen=True)
class StreetConfig(PluginConfig):
    """Number of frames, image size in pixels, seed of the street, metres driven a frame."""

    frames: int = 20
    width: int = 640
    height: int = 192
    seed: int = 0
    speed_m: float = 1.0


@register("dataset", "street", config=StreetConfig)
class Street(Dataset):
    """Procedural street with exact depth, sky, poses and a simulated 64-beam LiDAR.

    Everything follows from the seed; a longer drive begins with the same frames. The world is the first left camera.
    """

    def __init__(self, config: StreetConfig) -> None:
        if config.frames < 1:
            raise BenchError(f"dataset.frames={config.frames}: the street needs at least 1 frame.")
        for what, value, (low, high) in zip(("width", "height"), (config.width, config.height), _SIZES, strict=True):
            if not low <= value <= high:
                raise BenchError(f"dataset.{what}={value} is out of range; choose {low} to {high} pixels.")
        if not 0.0 <= config.speed_m <= 20.0:
            raise BenchError(f"dataset.speed_m={config.speed_m} is out of range; choose 0 to 20 metres a frame.")
        if config.seed < 0:
            raise BenchError(f"dataset.seed={config.seed} is negative; choose 0 or more.")
        self.label = f"street/{config.seed}"
        self.numbers = tuple(range(config.frames))
        focal = _FOCAL_PER_WIDTH * config.width
        self.camera = StereoCamera(
            width=config.width,
            height=config.height,
            fx=focal,
            fy=focal,
            cx=config.width / 2 - 0.5,
            cy=config.height / 2 - 0.5,
            right_position=(BASELINE_M, 0.0, 0.0),
        )
        self._speed = config.speed_m
        self._street = build_street(config.seed, config.frames * config.speed_m)

    def frame(self, position: int) -> StereoFrame:
        """Render one pair."""
        T = self._pose(position)
        left, right = self._render(position, T), self._render(position, T @ self.camera.T_left_right)
        return StereoFrame(self.numbers[position], position / _RATE_HZ, left, right)

    def ground_truth(self) -> Trajectory:
        """Exact poses; the first is the identity."""
        T = np.stack([self._pose(position) for position in range(len(self))])
        numbers = np.array(self.numbers, dtype=np.int64)
        return Trajectory(np.linalg.inv(T[0]) @ T, numbers, numbers / _RATE_HZ)

    def true_depth(self, position: int) -> Map:
        """Exact depth at pixel centres, NaN in the sky."""
        surfaces = self._street.seen_from(self._arc_length(position))
        inverse = cast(pinhole_rays(self.camera, self._pose(position)), surfaces).inverse_range
        with np.errstate(divide="ignore"):
            return np.where(inverse > 0, np.float32(1.0) / inverse, np.float32(np.nan))

    def true_sky(self, position: int) -> Mask:
        """Exact sky at pixel centres."""
        return np.isnan(self.true_depth(position))

    def lidar_depth(self, position: int) -> Map:
        """Depth at the pixels that see a return of the simulated LiDAR."""
        surfaces = self._street.seen_from(self._arc_length(position))
        points = lidar_points(self.camera, self._pose(position), surfaces)
        return lidar_depth(self.camera, points, self.true_depth(position))

    def _arc_length(self, position: int) -> float:
        return position * self._speed

    def _pose(self, position: int) -> Float:
        """T_street_cam: in its lane, along the street, with a little pitch, roll and heave as of a car."""
        s = self._arc_length(position)
        x, z, heading = self._street.path.beside(s, LANE_CENTER_M)
        pitch, roll = 0.004 * np.sin(0.9 * s), 0.003 * np.sin(0.63 * s + 1.0)
        heave = 0.012 * np.sin(0.75 * s + 0.4)
        T = np.eye(4)
        T[:3, :3] = _rotation(1, heading) @ _rotation(0, pitch) @ _rotation(2, roll)
        T[:3, 3] = (x, -CAMERA_HEIGHT_M + heave, z)
        return T

    def _render(self, position: int, T_street_cam: Float) -> Image:
        s = self._arc_length(position)
        return render(self.camera, T_street_cam, Scene(self._street.seen_from(s), self._street.path, s))


def _rotation(axis: int, angle: float) -> Float:
    """Rotation about a coordinate axis by ``angle`` radians."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[i, i] = R[j, j] = np.cos(angle)
    R[i, j], R[j, i] = -np.sin(angle), np.sin(angle)
    return R
