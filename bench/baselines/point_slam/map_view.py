"""Neural points as a tracker sees them: rays around the sensor's depth, and no whole views."""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

import torch

from bench.baselines.point_slam.radius import QUERY_FACTOR, RadiusSettings, add_radius
from bench.baselines.point_slam.rays import RayRenderer, Rays, RaySettings, RenderedRays
from bench.contracts.map_view import ImageLoss, MapView
from bench.errors import BenchError
from bench.types import Float, Map, PinholeView, RenderedView

_WHY = (
    "mapper=point_slam shows its map only along rays with the sensor's depth, and a {} needs a view without it. Choose "
    "tracker=point_slam and keyframer=point_slam, or parts that do not look at the map."
)


class PointMapView(MapView):
    """The points as they are when they are asked; beyond the contract it has ``render_rays`` and what goes with it.

    ``usable``: a copy of a depth map (H, W) with NaN where the map makes no use of it.
    """

    def __init__(self, renderer: RayRenderer, radius: RadiusSettings, usable: Callable[[Map], Map]) -> None:
        self._renderer, self._radius, self.usable = renderer, radius, usable

    @property
    def settings(self) -> RaySettings:
        """How rays are sampled."""
        return self._renderer.settings

    @property
    def device(self) -> torch.device:
        """Where its tensors lie."""
        return self._renderer.cloud.device

    def query_radius(self, edge: Map, depth: Map) -> Map:
        """Metres in which neighbours are looked for, for Sobel magnitudes and depths of equal shape."""
        return QUERY_FACTOR * add_radius(edge, depth, self._radius)

    def render_rays(self, rays: Rays) -> RenderedRays:
        """Depth, its variance and colour along rays, differentiable by their origins and directions."""
        return self._renderer.render(rays)

    def require_images(self) -> None:
        """Raises ``BenchError``."""
        self._refuse("tracker or keyframer that compares whole images")

    def render(self, view: PinholeView) -> RenderedView:
        """Raises ``BenchError``."""
        self._refuse("render")

    def differentiate(self, view: PinholeView, loss: ImageLoss) -> tuple[float, Float]:
        """Raises ``BenchError``."""
        self._refuse("gradient by the pose")

    def seen(self, view: PinholeView) -> NoReturn:
        """Raises ``BenchError``."""
        self._refuse("count of points seen")

    def median_depth(self, view: PinholeView) -> Map:
        """Raises ``BenchError``."""
        self._refuse("median depth")

    @staticmethod
    def _refuse(what: str) -> NoReturn:
        raise BenchError(_WHY.format(what))
