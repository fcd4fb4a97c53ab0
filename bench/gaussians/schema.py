"""The columns of a map of Gaussians, and the thresholds of rendering; the numbers are the C++ core's.

All parameters live in one float32 tensor of shape (P, N), one row ("plane") per scalar parameter: so eight Gaussians
load as one vector on the CPU, and one fused optimizer step updates everything. P = 11 + 3 (degree + 1)^2 for colours of
spherical harmonics up to a degree of 0 to 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from bench import _native
from bench.errors import BenchError

_FIRST = _native.FIRST_PLANE

MEAN = slice(_FIRST["mean"], _FIRST["log_scale"])
"""Position in the world, metres."""
LOG_SCALE = slice(_FIRST["log_scale"], _FIRST["quaternion"])
"""Logarithms of the standard deviations in metres along the Gaussian's own axes."""
QUATERNION = slice(_FIRST["quaternion"], _FIRST["opacity_logit"])
"""Rotation of those axes to the world: w, x, y, z of any length but zero."""
OPACITY_LOGIT = _FIRST["opacity_logit"]
COLOR = slice(_FIRST["color"], _FIRST["harmonics"])
"""Coefficients of the constant harmonic for red, green and blue."""
HARMONICS = slice(_FIRST["harmonics"], None)
"""Coefficients k >= 1 of the channels c, at 3 (k - 1) + c; empty for degree 0."""

MAX_DEGREE = _native.MAX_DEGREE
SH_C0 = _native.SH_C0
"""The constant harmonic: colour = 0.5 + SH_C0 * coefficient (+ higher harmonics), clamped at zero (as in 3DGS)."""


@dataclass(frozen=True)
class Thresholds:
    """Where rendering cuts off, as in gsplat."""

    near_m: float
    """Gaussians nearer than this depth are skipped."""
    low_pass_px2: float
    """Added to the diagonal of the projected covariance."""
    alpha_min: float
    """What covers less of a pixel is not blended there."""
    alpha_max: float
    """The most that one Gaussian covers of a pixel."""
    transmittance_end: float
    """A pixel ends before its transmittance falls to this."""
    jacobian_margin: float
    """The projection is linearised at most this share of the image's size beyond its borders."""


THRESHOLDS = Thresholds(**_native.THRESHOLDS)


def planes_of(degree: int) -> int:
    """Number of planes for spherical harmonics up to ``degree`` (0 to 3)."""
    if not 0 <= degree <= MAX_DEGREE:
        raise BenchError(f"Spherical harmonics of degree {degree}: the degree must be 0 to {MAX_DEGREE}.")
    return int(COLOR.start + 3 * (degree + 1) ** 2)


def degree_of(planes: int) -> int:
    """Degree of the spherical harmonics of a map with that many planes; ``BenchError`` if there is none."""
    degree = math.isqrt(max(planes - COLOR.start, 0) // 3) - 1
    if not 0 <= degree <= MAX_DEGREE or planes_of(degree) != planes:
        known = ", ".join(str(planes_of(each)) for each in range(MAX_DEGREE + 1))
        raise BenchError(f"A map has {planes} planes; for harmonics of degree 0 to {MAX_DEGREE} it has {known}.")
    return degree


def column_names(degree: int) -> tuple[str, ...]:
    """The names that 3DGS gives the planes in its PLY files, in the order of the planes."""
    harmonics = planes_of(degree) - HARMONICS.start
    # 3DGS numbers them channel by channel.
    rest = (f"f_rest_{k % 3 * (harmonics // 3) + k // 3}" for k in range(harmonics))
    scales, turns, colors = (
        tuple(f"{name}_{k}" for k in range(count)) for name, count in (("scale", 3), ("rot", 4), ("f_dc", 3))
    )
    return ("x", "y", "z", *scales, *turns, "opacity", *colors, *rest)
