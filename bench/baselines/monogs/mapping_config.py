"""The settings of MonoGS's mapping (``plugins/mappers/monogs.py``)."""

from __future__ import annotations

from dataclasses import dataclass, field

from bench.contracts.mapper import MapNeeds
from bench.errors import BenchError, require_between, require_least
from bench.gaussians.schema import planes_of
from bench.registry import PluginConfig, plugin_field

# Gaussians at the end for each that the first frame inserts, and share of the frames that become keyframes.
_GROWTH, _KEYFRAMES = 3.0, 0.25
_FLOAT, _NORMALS, _MOMENTS = 4, 3, 2
_PROGRAM_GB, _PIXEL_BYTES, _KEYFRAME_BYTES = 0.45, 900.0, 7.0


@dataclass(frozen=True)
class MonoGSMapperConfig(PluginConfig):
    """Settings of MonoGS's mapping; the defaults are those for Replica."""

    first_iterations: int = 1050
    """Iterations on the first keyframe alone."""
    iterations: int = 150
    """Iterations for each later keyframe, each of which draws all keyframes of the window."""
    older_views: int = 2
    """So many keyframes outside of the window, at random, are drawn in each iteration too."""
    refinement_iterations: int = 26000
    """Iterations after the last keyframe, each of one keyframe at random, by L1 and SSIM of the colours (0: none)."""
    color_share: float = 0.95
    """Weight of the colours in the loss; the depth has the rest."""
    isotropy: float = 10.0
    """Weight of the mean difference of a Gaussian's axes, in metres."""
    first_downsample: float = 32.0
    """The first keyframe inserts a Gaussian for one in so many pixels whose depth is known."""
    downsample: float = 64.0
    """So do later keyframes."""
    point_size: float = 0.05
    """Variance of a new Gaussian, as a share of the mean squared distance to its three nearest neighbours."""
    adaptive_point_size: bool = True
    """Whether the share is ``point_size`` for each metre of median depth, 0.05 at most."""
    max_depth_m: float = field(default=100.0, metadata={"infinite": True})
    """Depth beyond this counts as unknown."""
    position_rate: float = 9.6e-4
    """Adam's rate of positions, in metres a step, at first ..."""
    final_position_rate: float = 9.6e-6
    """... and after ``position_steps``; in between it falls by the same share in each step."""
    position_steps: int = 30000
    """Iterations in which it falls; the refinement begins anew."""
    color_rate: float = 2.5e-3
    """Adam's rate of colours."""
    opacity_rate: float = 5e-2
    """Adam's rate of opacity logits."""
    scale_rate: float = 6e-3
    """Adam's rate of log scales."""
    rotation_rate: float = 1e-3
    """Adam's rate of quaternions."""
    pose_window: int = 5
    """The poses of so many of the newest keyframes are optimised with the map (0: the tracker's stay)."""
    camera_translation_rate: float = 5e-4
    """Adam's rate of keyframes' translations, in metres a step."""
    camera_rotation_rate: float = 1.5e-3
    """Adam's rate of keyframes' rotations, in radians a step."""
    exposure_rate: float = 1e-2
    """Adam's rate of the exposures of keyframes in the window."""
    densify_every: int = 150
    """In one of so many iterations after the first keyframe's, Gaussians are cloned, split and removed."""
    densify_gradient: float = 2e-4
    """Those are cloned or split by whose place in the image, in half images, the loss changes this much."""
    clone_below_m: float = 0.06
    """Larger ones (standard deviation) are split; 30 times as large in the first keyframe's iterations."""
    prune_opacity: float = 0.7
    """Gaussians below this opacity are removed; in the first keyframe's iterations, below 0.005."""
    prune_scale_m: float = field(default=0.6, metadata={"infinite": True})
    """Larger ones are removed (inf: none)."""
    prune_radius_px: float = field(default=20.0, metadata={"infinite": True})
    """So are those whose radius, three standard deviations, is larger in a view of the iteration (inf: none)."""
    rasterizer: PluginConfig = plugin_field("rasterizer", "cpu")
    """What renders the Gaussians: `mapper.rasterizer=NAME`, one of `bgs-bench list rasterizer`."""

    def __post_init__(self) -> None:
        counts = ("first_iterations", "iterations", "older_views", "refinement_iterations", "pose_window", "isotropy")
        rates = ("color_rate", "opacity_rate", "scale_rate", "rotation_rate", "exposure_rate", "densify_gradient")
        cameras = ("camera_translation_rate", "camera_rotation_rate")
        sizes = ("clone_below_m", "prune_scale_m", "prune_radius_px")
        require_least("mapper", self, **dict.fromkeys((*counts, *rates, *cameras, *sizes), 0))
        require_least("mapper", self, densify_every=1, position_steps=1)
        require_least("mapper", self, first_downsample=1, downsample=1)
        require_between("mapper", self, 0, 1, "color_share", "prune_opacity")
        for name in ("position_rate", "final_position_rate", "point_size", "max_depth_m"):
            if not getattr(self, name) > 0:
                raise BenchError(f"mapper.{name}={getattr(self, name)} must be above 0.")

    def position_rate_at(self, step: int) -> float:
        """Metres a step after so many iterations."""
        share = min(step / self.position_steps, 1.0)
        return float(self.position_rate * (self.final_position_rate / self.position_rate) ** share)

    def needs(self, pixels: int, frames: int) -> MapNeeds:
        """Roughly, for images of so many pixels."""
        keyframes, planes = 1 + _KEYFRAMES * (frames - 1), planes_of(0)
        gaussians = pixels * (_GROWTH / self.first_downsample + (keyframes - 1) / self.downsample)
        of_keyframes = keyframes * pixels * _KEYFRAME_BYTES
        learning = gaussians * planes * _FLOAT * (1 + _MOMENTS)
        return MapNeeds(
            map_bytes=gaussians * (planes + _NORMALS) * _FLOAT,
            checkpoint_bytes=learning,
            memory_gb=_PROGRAM_GB + (pixels * _PIXEL_BYTES + of_keyframes + 2 * learning) / 1e9,
        )
