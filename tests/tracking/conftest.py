"""A short drive along the built-in street, rendered once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from bench.io.images import grey
from bench.registry import lookup
from bench.tracking.features import OrbExtractor
from bench.tracking.odometry import OdometrySettings, StereoOdometry
from bench.types import StereoCamera

Pair = tuple[np.ndarray, np.ndarray]


class Drive:
    """Grey pairs of the street, 1 m apart, with the camera and the true poses (N, 4, 4)."""

    def __init__(self, frames: int) -> None:
        plugin = lookup("dataset", "street")
        street = plugin.cls(plugin.config(name="street", frames=frames, width=512, height=192, seed=1))
        self.camera: StereoCamera = street.camera
        self.poses: np.ndarray = street.ground_truth().T_world_cam
        rendered = [street.frame(i) for i in range(frames)]
        self.pairs: list[Pair] = [(grey(f.left), grey(f.right)) for f in rendered]


@pytest.fixture(scope="session")
def drive(_plugins: None) -> Drive:
    return Drive(24)


@pytest.fixture
def settings() -> OdometrySettings:
    """The plugin's own defaults."""
    config = lookup("tracker", "stereo_orb").config(name="stereo_orb")
    return OdometrySettings(**{name: getattr(config, name) for name in OdometrySettings.__dataclass_fields__})


@pytest.fixture(scope="session")
def extractor() -> OrbExtractor:
    """With fewer keypoints than the plugin's default, for the smaller image."""
    return OrbExtractor(1000, fast_threshold=7)


@pytest.fixture
def odometry(drive: Drive, settings: OdometrySettings, extractor: OrbExtractor) -> Callable[..., StereoOdometry]:
    def make(**arguments: object) -> StereoOdometry:
        return StereoOdometry(drive.camera, settings, extractor, **arguments)  # type: ignore[arg-type]

    return make
