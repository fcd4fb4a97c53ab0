"""A map of Gaussians in readable units: to the tensor of planes (``bench/gaussians/schema.py``) and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from bench.gaussians.schema import COLOR, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, SH_C0

if TYPE_CHECKING:
    from torch import Tensor


def planes_from(means: Tensor, scales: Tensor, quaternions: Tensor, opacities: Tensor, colors: Tensor) -> Tensor:
    """Parameters in readable units to the (P, N) tensor of degree 0.

    ``means`` (N, 3) metres in the world; ``scales`` (N, 3) standard deviations in metres; ``quaternions`` (N, 4) w,
    x, y, z, any length but zero; ``opacities`` (N,) in (0, 1); ``colors`` (N, 3) RGB in [0, 1].
    """
    return torch.cat(
        [
            means.T,
            scales.log().T,
            quaternions.T,
            torch.logit(opacities)[None],
            ((colors - 0.5) / SH_C0).T,
        ]
    ).contiguous()


@dataclass
class NamedParameters:
    """Readable views of a (P, N) tensor, activations applied: what other renderers and file formats expect."""

    planes: Tensor

    @property
    def means(self) -> Tensor:
        """(N, 3) metres, world frame."""
        return self.planes[MEAN].T

    @property
    def scales(self) -> Tensor:
        """(N, 3) standard deviations in metres."""
        return self.planes[LOG_SCALE].T.exp()

    @property
    def quaternions(self) -> Tensor:
        """(N, 4) w, x, y, z, unit length."""
        return torch.nn.functional.normalize(self.planes[QUATERNION].T, dim=1)

    @property
    def opacities(self) -> Tensor:
        """(N,) in (0, 1)."""
        return torch.sigmoid(self.planes[OPACITY_LOGIT])

    @property
    def colors(self) -> Tensor:
        """(N, 3) RGB of the constant harmonic alone, at least 0."""
        return (0.5 + SH_C0 * self.planes[COLOR].T).clamp_min(0.0)
