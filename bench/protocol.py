"""How a run is scored, and the stamp that goes with every number."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from bench.errors import BenchError, did_you_mean, first_line, require_choice
from bench.settings import check_numbers

ALIGNMENTS = ("se3", "none")
RENDERED_DEPTHS = ("raw", "normalized")
DEPTH_MASKS = ("all", "unoccluded")
SSIM_FLAVOURS = ("skimage-gaussian", "3dgs", "ms-ssim")
SKIES = ("in", "out")


@dataclass(frozen=True)
class Protocol:
    """Settings of the evaluation; two numbers may be compared when their stamps agree."""

    name: str = "default"
    """Name of the protocol in tables."""
    holdout_every: int = 0
    """k keeps every k-th frame out of mapping; 0 keeps none out."""
    holdout_remainder: int = 2
    """Those whose number leaves this remainder modulo holdout_every are kept out."""
    alignment: str = "se3"
    """Alignment of the ATE: se3 (rotation and translation, no scale) or none."""
    rendered_depth: str = "raw"
    """What depth the system saved: raw = sum d a T, normalized = divided by the accumulated alpha."""
    depth_min_m: float = 0.5
    """Nearer LiDAR returns don't count for Depth-L1."""
    depth_max_m: float | None = None
    """Farther LiDAR returns don't count for Depth-L1; null: no cap."""
    depth_mask: str = "all"
    """all LiDAR returns count, or unoccluded: none from behind an edge."""
    right_view: bool = True
    """Score the right camera too."""
    ssim: str = "skimage-gaussian"
    """Windows that lie in the image (skimage-gaussian) or reach beyond it into black (3dgs); or five scales
    (ms-ssim)."""
    lpips: bool = True
    """Compute LPIPS."""
    lpips_weights: str | None = None
    """File of AlexNet weights; null: that of `bgs-bench weights path alexnet`."""
    sky: str = "in"
    """out: no pixel counts that the data set's own sky mask says is sky; there is no LPIPS then."""

    def __post_init__(self) -> None:
        """Check the values; raises ``BenchError`` naming the setting, its value and what is accepted."""
        check_numbers("protocol", self)
        require_choice("protocol.alignment", self.alignment, ALIGNMENTS)
        require_choice("protocol.rendered_depth", self.rendered_depth, RENDERED_DEPTHS)
        require_choice("protocol.ssim", self.ssim, SSIM_FLAVOURS)
        require_choice("protocol.depth_mask", self.depth_mask, DEPTH_MASKS)
        require_choice("protocol.sky", self.sky, SKIES)
        self._check_sky()
        if self.holdout_every < 0 or self.holdout_every == 1:
            raise BenchError(
                f"protocol.holdout_every={self.holdout_every} is no use: 0 keeps no frame out, 2 or more every so many."
            )
        if self.holdout_every and not 0 <= self.holdout_remainder < self.holdout_every:
            raise BenchError(
                f"protocol.holdout_remainder={self.holdout_remainder} must lie in 0..{self.holdout_every - 1}, "
                f"because protocol.holdout_every={self.holdout_every}."
            )
        if self.depth_min_m < 0:
            raise BenchError(f"protocol.depth_min_m={self.depth_min_m} must not be negative (metres).")
        if self.depth_max_m is not None and self.depth_max_m <= self.depth_min_m:
            raise BenchError(
                f"protocol.depth_max_m={self.depth_max_m} must be above protocol.depth_min_m={self.depth_min_m}, "
                "or null for no cap."
            )

    def _check_sky(self) -> None:
        if self.sky == "in":
            return
        if self.right_view:
            raise BenchError(
                "protocol.sky=out needs protocol.right_view=false: data sets know the sky of left images only."
            )
        if self.ssim == "ms-ssim":
            raise BenchError(
                "protocol.sky=out can't go with protocol.ssim=ms-ssim, whose larger scales mix sky and street; choose "
                "skimage-gaussian or 3dgs."
            )

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Protocol:
        """Build it from a plain dict (``config["protocol"]``); raises ``BenchError`` for an unknown setting."""
        accepted = [field.name for field in fields(cls)]
        for key in values:
            if key not in accepted:
                raise BenchError(
                    f"protocol.{key} is no setting of the protocol; there are {', '.join(accepted)}."
                    f"{did_you_mean(str(key), accepted)}"
                )
        try:
            return cls(**values)
        except (TypeError, ValueError) as error:
            raise BenchError(f"protocol: a value is of the wrong kind ({first_line(error)}). Correct it.") from error

    def is_held_out(self, number: int) -> bool:
        """Whether the frame with this number is kept out of mapping."""
        return self.holdout_every > 0 and number % self.holdout_every == self.holdout_remainder

    def stamp(self) -> dict[str, Any]:
        """What ``metrics.json`` says about how its numbers were made (without paths of this machine)."""
        stamp = asdict(self)
        del stamp["lpips_weights"]
        values = "pixels and channels" if self.sky == "in" else "channels and the pixels that are not sky"
        returns = "LiDAR pixels" if self.depth_mask == "all" else "LiDAR pixels without a nearer return beside them"
        return stamp | {
            **trajectory_stamp(self.alignment),
            "psnr": f"joint over {values}, 8-bit images, capped at 100 dB",
            "lpips_net": "alex, v0.1" if self.lpips and self.sky == "in" else None,
            "depth_l1": f"left views, {returns} in range, no surface counts as depth 0, mean of frame means",
            "average": "mean of per-frame values",
        }


def trajectory_stamp(alignment: str) -> dict[str, str]:
    """How the numbers about trajectories were made, for any trajectory that ``alignment`` was used on."""
    scale = "with scale" if alignment == "sim3" else "no scale"
    return {
        "alignment": alignment,
        "trajectory": f"RMSE over all tracked frames that have ground truth, {scale}",
        "rpe": f"pairs of tracked frames, {scale}",
        "t_rel": f"KITTI's definition, plain mean over all segments whose ends are tracked, {scale}",
    }
