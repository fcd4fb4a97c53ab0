"""The fast rasterizer on a GPU: gsplat (Apache-2.0), with the names, pixel centres and thresholds of the others."""

from __future__ import annotations

import ctypes
import importlib.util
from typing import TYPE_CHECKING

import torch

from bench.contracts.rasterizer import Observation
from bench.errors import BenchError
from bench.gaussians.autograd import AutogradRasterizer, perturbed
from bench.gaussians.parameters import NamedParameters
from bench.gaussians.schema import THRESHOLDS, degree_of
from bench.gaussians.spherical_harmonics import coefficients
from bench.registry import PluginConfig, register
from bench.types import PinholeView

if TYPE_CHECKING:
    from torch import Tensor


@register("rasterizer", "gsplat")
class GsplatRasterizer(AutogradRasterizer):
    """gsplat 1.5.3 on CUDA, for large maps on a GPU.

    It has not run on a GPU yet, because none was at hand; ``make gpu-check`` compares it with ``cpu`` and ``reference``
    on one. What is handed to gsplat is tested on the CPU, with gsplat's own Python code and its kernels in torch.
    """

    def __init__(self, config: PluginConfig) -> None:
        self.device = torch.device("cuda")

    @classmethod
    def unavailable_reason(cls) -> str | None:
        """None, or what is missing: the package, the driver, a CUDA device (last, since that imports torch)."""
        if importlib.util.find_spec("gsplat") is None:
            return "gsplat is not installed. With a GPU: pip install 'bgs-slam-bench[cuda]'; else mapper.rasterizer=cpu"
        try:
            ctypes.CDLL("libcuda.so.1")
        except OSError:
            return (
                "there is no NVIDIA driver (libcuda.so.1). Use mapper.rasterizer=cpu, or a machine with an NVIDIA GPU"
            )
        if not torch.cuda.is_available():
            return "torch sees no CUDA device. Use mapper.rasterizer=cpu, or a GPU and a CUDA build of torch"
        return None

    def observe(self, planes: Tensor, view: PinholeView) -> Observation:
        raise BenchError(
            "The rasterizer gsplat can't tell which Gaussians a view sees: its kernels do not give back a Gaussian's "
            "alpha at a pixel. Use mapper.rasterizer=cpu."
        )

    def splat(self, planes: Tensor, view: PinholeView, twist: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        from gsplat import rasterization

        count = planes.shape[1]
        if count == 0:
            black = (planes.sum() + twist.sum()) * planes.new_zeros(5, view.height, view.width)
            return black[:3], black[3], black[4], torch.zeros(0, dtype=torch.bool, device=planes.device)
        R, t = perturbed(torch.as_tensor(view.T_cam_world, dtype=planes.dtype, device=planes.device), twist)
        last_row = planes.new_tensor([[0.0, 0.0, 0.0, 1.0]])
        T_cam_world = torch.cat([torch.cat([R, t[:, None]], 1), last_row])
        # gsplat has the centre of the first pixel at 0.5, we at 0.
        K = planes.new_tensor([[view.fx, 0.0, view.cx + 0.5], [0.0, view.fy, view.cy + 0.5], [0.0, 0.0, 1.0]])
        gaussians, degree = NamedParameters(planes), degree_of(planes.shape[0])
        images, alpha, meta = rasterization(
            means=gaussians.means,
            quats=gaussians.quaternions,
            scales=gaussians.scales,
            opacities=gaussians.opacities,
            # Colours, or coefficients of harmonics in the direction from the camera, which gsplat takes from the pose.
            colors=coefficients(planes) if degree else gaussians.colors,
            viewmats=T_cam_world[None],
            Ks=K[None],
            width=view.width,
            height=view.height,
            # The other thresholds are constants of gsplat's kernels.
            near_plane=THRESHOLDS.near_m,
            eps2d=THRESHOLDS.low_pass_px2,
            sh_degree=degree or None,
            packed=False,
            render_mode="RGB+D",
            rasterize_mode="classic",
        )
        visible = (meta["radii"].reshape(count, -1) > 0).all(1)
        return images[0, ..., :3].permute(2, 0, 1).contiguous(), images[0, ..., 3], alpha[0, ..., 0], visible
