"""Real spherical harmonics of degree 0 to 3, in the order and with the signs of 3DGS and gsplat, and how they turn."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch

from bench.gaussians.schema import COLOR, HARMONICS, MEAN, SH_C0, degree_of

if TYPE_CHECKING:
    from torch import Tensor


def basis(directions: Tensor, degree: int) -> Tensor:
    """The (degree + 1)^2 harmonics (..., K) of unit vectors (..., 3); differentiable.

    Band l holds the orders m = -l .. l: the real harmonics (Condon-Shortley phase included) of Sloan, "Stupid spherical
    harmonics tricks", 2008.
    """
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z

    def norm(numerator: int, denominator: int) -> float:
        return math.sqrt(numerator / (denominator * math.pi))

    values = [torch.full_like(x, SH_C0)]
    if degree > 0:
        values += [-norm(3, 4) * y, norm(3, 4) * z, -norm(3, 4) * x]
    if degree > 1:
        values += [norm(15, 4) * x * y, -norm(15, 4) * y * z, norm(5, 16) * (2 * zz - xx - yy)]
        values += [-norm(15, 4) * x * z, norm(15, 16) * (xx - yy)]
    if degree > 2:
        values += [-norm(35, 32) * y * (3 * xx - yy), norm(105, 4) * x * y * z, -norm(21, 32) * y * (4 * zz - xx - yy)]
        values += [norm(7, 16) * z * (2 * zz - 3 * xx - 3 * yy), -norm(21, 32) * x * (4 * zz - xx - yy)]
        values += [norm(105, 16) * z * (xx - yy), -norm(35, 32) * x * (xx - 3 * yy)]
    return torch.stack(values, -1)


def coefficients(planes: Tensor) -> Tensor:
    """The coefficients (N, K, 3) of a map's planes (P, N), K = (degree + 1)^2."""
    return torch.cat([planes[COLOR], planes[HARMONICS]]).T.reshape(planes.shape[1], -1, 3)


def colors(planes: Tensor, camera_center: Tensor) -> Tensor:
    """Colours (3, N) of a map seen from a point (3,) in the world: max(0, 0.5 + sum of harmonics); differentiable."""
    degree = degree_of(planes.shape[0])
    if degree == 0:
        return (0.5 + SH_C0 * planes[COLOR]).clamp_min(0.0)
    directions = torch.nn.functional.normalize(planes[MEAN].T - camera_center, dim=1)
    return (0.5 + torch.einsum("nk,nkc->cn", basis(directions, degree), coefficients(planes))).clamp_min(0.0)


def band_rotation(R: Tensor, degree: int) -> Tensor:
    """How coefficients turn with a rotation ``R`` (3, 3): a block diagonal, orthogonal matrix (K - 1, K - 1), K - 1 =
    (degree + 1)^2 - 1, for the harmonics from degree 1 on.

    With coefficients c of one channel, ``band_rotation(R, degree) @ c`` has in direction R d the value of c in d. Each
    band is a space that rotations keep, so its block follows from values in enough directions:
    basis(R d) @ block = basis(d).
    """
    count = (degree + 1) ** 2
    # Spread over the sphere (golden angle) such that every band's values have full rank.
    step = torch.arange(4 * count, dtype=torch.float64)
    z = 1 - (2 * step + 1) / len(step)
    angle, radius = step * math.pi * (3 - math.sqrt(5)), torch.sqrt(1 - z * z)
    d = torch.stack([radius * torch.cos(angle), radius * torch.sin(angle), z], 1)
    before, after = basis(d, degree), basis(d @ R.double().cpu().T, degree)
    blocks = [
        torch.linalg.lstsq(after[:, band**2 : (band + 1) ** 2], before[:, band**2 : (band + 1) ** 2]).solution
        for band in range(1, degree + 1)
    ]
    return torch.block_diag(*blocks).to(R) if blocks else R.new_zeros(0, 0)
