"""A made-up ring road of landmarks with random descriptors, and a car whose odometry drifts along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from bench.geometry import se3
from bench.tracking.features import Features
from bench.tracking.local_map import KeyframeRecord, View
from bench.types import Float, StereoCamera

RANGE_M = 40.0
WALL_M = 7.0


def flipped(descriptors: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Descriptors (N, 4) with a share of their bits inverted."""
    bits = np.unpackbits(descriptors.view(np.uint8), axis=1)
    return np.packbits(bits ^ (rng.random(bits.shape) < share), axis=1).view(np.uint64)


@dataclass
class RingRoad:
    """A circle of ``length_m`` metres between two walls of landmarks. The left wall repeats every ``period_m`` metres,
    shapes and descriptors; the right wall is unique where ``unique_right``, else it repeats as well."""

    length_m: float
    period_m: float
    unique_right: bool
    seed: int
    camera: StereoCamera

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        periods = round(self.length_m / self.period_m)
        left = self._wall(self.period_m, -1.0, periods)
        right = self._wall(self.length_m, 1.0, 1) if self.unique_right else self._wall(self.period_m, 1.0, periods)
        self.s, self.d, self.y = (np.concatenate([a, b]) for a, b in zip(left[:3], right[:3], strict=True))
        self.descriptors = np.concatenate([left[3], right[3]])
        self.points = self.at(self.s, self.d, self.y)

    def _wall(self, length: float, side: float, copies: int) -> tuple[np.ndarray, ...]:
        count = int(9 * length)
        s = self.rng.uniform(0, length, count)
        d = side * (WALL_M + self.rng.uniform(0, 2, count))
        y = self.rng.uniform(-4.0, 1.5, count)
        descriptors = self.rng.integers(0, 2**64, (count, 4), dtype=np.uint64)
        along = (s + length * np.arange(copies)[:, None]).reshape(-1)
        return along, np.tile(d, copies), np.tile(y, copies), np.tile(descriptors, (copies, 1))

    def at(self, s: Float, d: Float, y: Float) -> Float:
        """World positions (N, 3) of road coordinates; the road bends to the right."""
        radius = self.length_m / (2 * np.pi)
        angle = s / radius
        return np.column_stack([radius - (radius - d) * np.cos(angle), y, (radius - d) * np.sin(angle)])

    def pose(self, s: float) -> Float:
        """T_world_cam on the middle of the road."""
        T = np.eye(4)
        T[:3, :3] = se3.so3_exp(np.array([0.0, 2 * np.pi * s / self.length_m, 0.0]))
        T[:3, 3] = self.at(np.array([s]), np.zeros(1), np.zeros(1))[0]
        return T

    def view(self, s: float, rng: np.random.Generator) -> View:
        """What a camera at ``s`` sees: 60 % of the landmarks ahead, with noise of half a pixel and 4 % of the bits."""
        camera = self.camera
        ahead = (self.s - s) % self.length_m < RANGE_M
        T = se3.inverse(self.pose(s))
        in_camera = self.points[ahead] @ T[:3, :3].T + T[:3, 3]
        z = in_camera[:, 2]
        u, v = camera.fx * in_camera[:, 0] / z + camera.cx, camera.fy * in_camera[:, 1] / z + camera.cy
        seen = (z > 2) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height) & (rng.random(len(z)) < 0.6)
        count = int(seen.sum())
        xy = np.column_stack([u, v])[seen] + rng.normal(0, 0.5, (count, 2))
        disparity = camera.fx * camera.baseline / z[seen] + rng.normal(0, 0.3, count)
        disparity[disparity < 1.0] = np.nan
        features = Features(xy, np.zeros(count, np.int64), flipped(self.descriptors[ahead][seen], 0.04, rng))
        return View(features, disparity, np.ones(count), camera.fx / 35.0)


class Drive:
    """Keyframes every metre, with the poses of an odometry that drifts and takes over corrections."""

    def __init__(self, road: RingRoad, metres: int, seed: int = 0, yaw_bias_deg: float = 0.02) -> None:
        self.road, self.rng = road, np.random.default_rng((seed, 7))
        self.truth = np.stack([road.pose(float(s)) for s in range(metres)])
        noise = self.rng.normal(0, [0.01] * 3 + [0.0003] * 3, (metres - 1, 6))
        noise[:, 4] += np.deg2rad(yaw_bias_deg)
        self.steps = se3.inverse(self.truth[:-1]) @ self.truth[1:] @ se3.exp(noise)
        self.poses = self.truth[:1].copy()

    def keyframe(self, k: int, begins_map: bool = False) -> KeyframeRecord:
        """Drive to keyframe ``k``; ``poses`` then holds keyframes 0 .. k."""
        if k > 0:
            self.poses = np.concatenate([self.poses, self.poses[-1:] @ self.steps[k - 1]])
        view = self.road.view(float(k), self.rng)
        nothing = np.full(len(view.features), -1)
        return KeyframeRecord(k, se3.inverse(self.poses[-1]), view, nothing, begins_map)

    def error_m(self) -> float:
        """RMS distance of the poses to the truth, both starting at the same pose."""
        difference = self.poses[:, :3, 3] - self.truth[: len(self.poses), :3, 3]
        return float(np.sqrt((difference**2).sum(axis=1).mean()))


@pytest.fixture(scope="session")
def road_camera() -> StereoCamera:
    return StereoCamera(640, 192, 365.0, 365.0, 319.5, 95.5, (0.54, 0.0, 0.0))


@pytest.fixture(scope="session")
def make_road(road_camera: StereoCamera) -> object:
    """``make_road(length_m, period_m, unique_right, seed)``."""

    def make(length_m: float = 240.0, period_m: float = 30.0, unique_right: bool = True, seed: int = 0) -> RingRoad:
        return RingRoad(length_m, period_m, unique_right, seed, road_camera)

    return make


@pytest.fixture(scope="session")
def make_drive() -> type[Drive]:
    """``Drive`` itself: test files can't import from this one."""
    return Drive


@pytest.fixture(scope="session")
def flip_bits() -> object:
    return flipped
