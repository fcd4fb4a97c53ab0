"""The mapper's settings; the defaults are the original's for Replica."""

from __future__ import annotations

from dataclasses import dataclass, field

from bench.baselines.point_slam.radius import RadiusSettings
from bench.baselines.point_slam.rays import RaySettings
from bench.errors import BenchError, require_between, require_least
from bench.registry import PluginConfig


@dataclass(frozen=True)
class PointSlamMapperConfig(PluginConfig):
    """Points, rays and iterations of Point-SLAM's mapping."""

    uniform_pixels: int = 6000
    """Random pixels of a mapped frame that may add points; of the first frame up to three times as many, by the square
    of its median depth over 2.5 m."""
    edge_pixels: int = 1000
    """Pixels that may add points besides, drawn from the five times as many that have the strongest edges."""
    layers: int = 3
    """Points that a pixel adds along its ray, around its depth."""
    layer_share: float = 0.02
    """Reach of these points before and behind the depth, as a share of it."""
    radius: RadiusSettings = field(default_factory=RadiusSettings)
    """How densely points lie."""
    ray: RaySettings = field(default_factory=RaySettings)
    """How rays are sampled."""
    relative_positions: bool = True
    """Whether colour features are passed, with their point's relative position, through a network before they are
    averaged."""
    pretrained_geometry: bool = False
    """Whether the geometry decoder is the original's, frozen from the start (weights nice_slam_middle: see `bgs-bench
    weights list`); false = it is trained with the points of the first frame, and frozen then."""
    keyframe_every: int = 20
    """A mapped frame so many numbers after the last keyframe becomes one: later frames learn from it again."""
    window: int = 12
    """Frames that a mapped frame learns from, itself included."""
    rays: int = 5000
    """Rays of an iteration, shared out evenly over these frames."""
    first_iterations: int = 1500
    """Iterations of the first frame."""
    first_geometry_iterations: int = 400
    """Those of them that learn geometry alone."""
    iterations: int = 300
    """Iterations of a later frame that adds 300 points: in proportion to the points added, from 0.95 to 2 times as
    many."""
    geometry_share: float = 0.4
    """Share of these iterations that learns geometry alone."""
    geometry_rate: float = 0.03
    """Rate of geometry features while geometry alone is learned."""
    color_stage_rate: float = 0.005
    """Rate of geometry features, colour features and decoders while colour is learned, too."""
    decoder_rate: float = 0.001
    """Rate of the geometry decoder, where it is trained, while geometry alone is learned."""
    color_weight: float = 0.1
    """Weight of colour (sum of absolute differences) beside depth (the same, in metres)."""
    behind_m: float = 0.5
    """Points this far behind a frame's depth still learn from it."""
    refinement_rounds: int = 5
    """Rounds of colour refinement at the end, each of twice the iterations with random keyframes; 0 = none."""
    depth_range_m: tuple[float, float] = field(default=(0.0, float("inf")), metadata={"infinite": True})
    """Depths that are used; others count as unknown."""
    device: str = "auto"
    """Where it computes: auto (CUDA where there is one), cpu, cuda or cuda:1. The neighbour search runs on the CPU."""

    def __post_init__(self) -> None:
        require_least("mapper", self, uniform_pixels=1, edge_pixels=0, layers=1, keyframe_every=1, window=2, rays=1)
        require_least("mapper", self, first_iterations=1, first_geometry_iterations=0, iterations=0)
        require_least("mapper", self, color_weight=0, behind_m=0, refinement_rounds=0)
        require_between("mapper", self, 0, 1, "geometry_share", "geometry_rate", "color_stage_rate", "decoder_rate")
        require_between("mapper", self, 0, 0.5, "layer_share")
        if 2 * self.window > self.rays:
            raise BenchError(f"mapper.rays={self.rays} are too few for twice mapper.window={self.window} frames.")
        low, high = self.depth_range_m
        if not 0 <= low < high:
            raise BenchError(f"mapper.depth_range_m=[{low},{high}] must begin at 0 or above, and end higher.")
