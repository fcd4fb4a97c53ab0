"""The settings of BGS-SLAM's mapping (``plugins/mappers/gaussian.py``)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bench.errors import BenchError, require_between, require_choice, require_least
from bench.gaussians.schema import MAX_DEGREE
from bench.gaussians.seeding import SeedingConfig
from bench.registry import PluginConfig, plugin_field
from bench.supervision.appearance import CAMERA_COLORS
from bench.supervision.target import COLOR_PIXELS


def _seeding() -> SeedingConfig:
    """Few and pale Gaussians at first; ``refine_stride`` adds what they can't show."""
    return SeedingConfig(stride=4, opacity=0.15, ground=True, max_depth_m=120.0, margin=0.08)


@dataclass(frozen=True)
class GaussianMapperConfig(PluginConfig):
    """Settings of mapping; the defaults are those of ``system=bgs_slam``."""

    sh_degree: int = 0
    """Degree of the spherical harmonics of the colours, 0 (one colour from all sides) to 3."""
    iterations: int = 8
    """Rendered views when a keyframe arrives."""
    seconds: float = 0.0
    """With more than 0, as many iterations as this time allows when a keyframe arrives, at least one, in place of
    ``iterations``. Results then depend on the machine, and a resumed run has other bits than an unbroken one."""
    final_coarse_iterations: int = 15
    """Rendered views per keyframe at the end, at half resolution, each keyframe in turn."""
    final_iterations: int = 8
    """After them, the same at full resolution."""
    coarse_share: float = 1.0
    """The first part of a keyframe's iterations, which runs at half resolution."""
    newest_share: float = 0.3
    """Probability that a view is the newest keyframe."""
    window_share: float = 0.5
    """Probability that a view is another keyframe of the window; else it is an older one."""
    older_views: str = "by_age"
    """How an older one is drawn: by_age, in proportion to the steps since it was last learned from, or uniform."""
    position_rate: float = 2e-4
    """Adam's rate of positions, in metres per metre of depth at birth."""
    color_rate: float = 1e-2
    """Adam's rate of colours; a twentieth of it for the harmonics of degree 1 and more."""
    opacity_rate: float = 5e-2
    """Adam's rate of opacity logits."""
    scale_rate: float = 8e-2
    """Adam's rate of log scales."""
    rotation_rate: float = 5e-3
    """Adam's rate of quaternions."""
    second_moment_decay: float = 0.99
    """Adam's beta2; the paper's optimizer has 0.999, with which a Gaussian's first steps are the longer the later it
    comes into the map, up to six times the rate."""
    prune_opacity: float = 5e-3
    """Gaussians below this opacity are removed (paper, "Implementation Details")."""
    depth_range_m: tuple[float, float] = (0.5, 80.0)
    """Stereo depth outside [near, far] neither seeds nor supervises."""
    color_pixels: str = "all"
    """What the terms on colour see: all pixels, ground = all but the sky, supervised = where depth supervises."""
    moving: bool = False
    """Neither learn from nor seed what moves: what several keyframes that look at the same place see in other colours.
    The run folder gets the masks, ``views/left/moving``."""
    cached_targets: int = 3
    """How many keyframes keep their derived images in memory; at half resolution, four times as many."""
    live_m: float = field(default=50.0, metadata={"infinite": True})
    """The map is made in chunks: one gets its last iterations, with keyframes of its neighbourhood as far as this, when
    the camera is so many metres away from it, and goes to disk, so that memory and time per frame do not grow with the
    way. inf: the whole map stays in memory, and all of it is optimised at the end."""
    chunk_m: float = 25.0
    """Metres of the camera's way in a chunk."""
    live_keyframes: int = 200
    """The images of so many keyframes stay in memory; those of older ones are learned from again from disk. In chunks,
    the oldest one goes to disk, too, with more keyframes than this."""
    far_m: float = 120.0
    """Chunks on disk are drawn as far as this."""
    detail_m: float = 40.0
    """And from here on, and again from twice as far, in fewer Gaussians: those of 1.5 pixels are merged."""
    chunk_memory_mb: float = field(default=50.0, metadata={"infinite": True})
    """As much of the chunks on disk stays in memory beside what is being drawn; results are the same for any."""
    follow_corrections_m: float = field(default=0.01, metadata={"infinite": True})
    """Gaussians move with their keyframe once its pose has been corrected by more metres (0: always, inf: never);
    following every small correction of local bundle adjustment changes quality by less than 0.1 dB either way."""
    follow_corrections_deg: float = field(default=0.05, metadata={"infinite": True})
    """The same in degrees; one of the two is enough."""
    right_images: float = 0.0
    """Share of the views that are right images of keyframes, with the colour terms alone; 0: mapping never sees one.
    With more, or with ``camera_color``, the right camera is scored at held-out frames only."""
    camera_color: str = "none"
    """How the right camera's colours differ from the left one's in each keyframe, by pixels that stereo depth matches:
    none (not at all), gain_bias (per channel) or affine (3x3 and bias). Right images are learned from, and right views
    rendered, in the right camera's colours; those of frames in between lie between their neighbours'. To be
    used with ``exposure``: without, the map has the mean colours of all keyframes, and a pair tells of its own."""
    exposure: bool = True
    """Learn a gain and a bias per channel of each keyframe, relative to the first; for automatic exposure. Frames in
    between are rendered with what lies between those of their neighbours."""
    pose_refinement: float = 0.0
    """Rate at which keyframes' poses are optimised with the map, in metres a step (radians: a tenth); 0: the tracker's
    stay. For handheld data, for example 1e-3. The corrections are the mapper's own: frames in between are rendered with
    what lies between those of their neighbours, and the trajectory that is scored stays the tracker's."""
    seeding: SeedingConfig = field(default_factory=_seeding)
    """Where new Gaussians start."""
    refine_stride: int = 2
    """Before the last iterations at full resolution, keyframes seed once more, at every so many pixels (0: not)."""
    refine_error: float = 0.06
    """Where: the mean colour error, of 0 to 1, is above this, or nothing covers the pixel."""
    revisit_error: float = 0.0
    """What a chunk on disk covers already is seeded again, in both seedings, only where the mean colour error is above
    this, too. For roads that are driven many times: with 0.2 a second lap adds a third of the first one's Gaussians in
    place of nine tenths, and is 0.4 dB worse."""
    rasterizer: PluginConfig = plugin_field("rasterizer", "cpu")
    """What renders the Gaussians: `mapper.rasterizer=NAME`, one of `bgs-bench list rasterizer`."""

    def __post_init__(self) -> None:
        if not 0 <= self.sh_degree <= MAX_DEGREE:
            raise BenchError(f"mapper.sh_degree={self.sh_degree} must be 0 to {MAX_DEGREE}.")
        counts = dict.fromkeys(("final_iterations", "final_coarse_iterations", "refine_stride"), 0)
        require_least("mapper", self, iterations=1, refine_error=0, revisit_error=0, **counts)
        require_choice("mapper.color_pixels", self.color_pixels, COLOR_PIXELS)
        if self.color_pixels != "all" and self.right_images > 0:
            raise BenchError(
                f"mapper.color_pixels={self.color_pixels} is known of left images only. Give mapper.right_images=0."
            )
        require_between("mapper", self, 0, 1, "coarse_share", "prune_opacity", "right_images")
        if not 0 <= self.second_moment_decay < 1:
            raise BenchError(
                f"mapper.second_moment_decay={self.second_moment_decay} must be at least 0 and below 1 (usual: 0.99)."
            )
        require_choice("mapper.camera_color", self.camera_color, CAMERA_COLORS)
        rates = ("position_rate", "color_rate", "opacity_rate", "scale_rate", "rotation_rate", "pose_refinement")
        require_least("mapper", self, cached_targets=1, **dict.fromkeys(rates, 0))
        require_choice("mapper.older_views", self.older_views, ("by_age", "uniform"))
        if min(self.newest_share, self.window_share) < 0 or self.newest_share + self.window_share > 1:
            raise BenchError(
                "mapper.newest_share + mapper.window_share must lie between 0 and 1; the rest is older views."
            )
        if not 0 < self.depth_range_m[0] < self.depth_range_m[1]:
            raise BenchError(
                f"mapper.depth_range_m={list(self.depth_range_m)} must be [near, far] with 0 < near < far."
            )
        ways = ("live_m", "far_m", "chunk_memory_mb", "seconds")
        require_least("mapper", self, live_keyframes=4, **dict.fromkeys(ways, 0))
        for name, usual in (("chunk_m", 25), ("detail_m", 40)):
            if not 0 < getattr(self, name) < np.inf:
                raise BenchError(f"mapper.{name}={getattr(self, name)} must be above 0 metres (usual: {usual}).")
        if not min(self.follow_corrections_m, self.follow_corrections_deg) >= 0:
            raise BenchError(
                "mapper.follow_corrections_m and mapper.follow_corrections_deg must be 0 (always) or more (inf: never)."
            )
