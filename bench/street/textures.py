"""A noise texture that can be sampled with any anisotropic footprint, and box-filtered stripes.

Everything that is drawn on a surface is averaged over the patch that a ray's part of a pixel covers there; so the left,
the right and the next image agree, and nothing flickers.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from bench.types import Image, Map

# One number or one for each ray.
Floats = np.float32 | Map

TEXELS = 1024
TEXEL_M = 0.01
_LEVELS = 9
_PAD = 2
# The 8-bit texture holds 128 + 36 x, x of unit variance.
_MIDDLE, _SCALE = 128.0, 36.0
# Exponents of the amplitude spectrum 1 / f^e of the three channels: blotches, tint, grain.
_SPECTRUM = (1.0, 1.15, 0.55)
_ROW = 4096


@lru_cache(maxsize=1)
def _noise_ripmap() -> tuple[Image, tuple[int, ...]]:
    """The texture at all pairs of horizontal and vertical resolutions in one image, and where each level begins."""
    rng = np.random.default_rng(20240607)
    frequency = np.hypot(np.fft.fftfreq(TEXELS)[:, None], np.fft.rfftfreq(TEXELS)[None, :]) * TEXELS
    frequency[0, 0] = np.inf
    channels = []
    for exponent in _SPECTRUM:
        white = np.fft.rfft2(rng.standard_normal((TEXELS, TEXELS)))
        noise = np.fft.irfft2(white * frequency**-exponent, s=(TEXELS, TEXELS))
        channels.append(noise / noise.std())
    starts = [0]
    for level in range(_LEVELS):
        starts.append(starts[-1] + (TEXELS >> level) + 2 * _PAD)
    ripmap = np.zeros((starts[-1], starts[-1], len(_SPECTRUM)), dtype=np.uint8)
    wide = np.stack(channels, axis=-1)
    for i in range(_LEVELS):
        part = wide
        for j in range(_LEVELS):
            padded = np.pad(part, ((_PAD, _PAD), (_PAD, _PAD), (0, 0)), mode="wrap")
            block = np.clip(np.rint(_MIDDLE + _SCALE * padded), 0, 255)
            ripmap[starts[j] : starts[j + 1], starts[i] : starts[i + 1]] = block
            part = (part[0::2] + part[1::2]) / 2
        wide = (wide[:, 0::2] + wide[:, 1::2]) / 2
    return ripmap, tuple(starts)


def sample_noise(u: Map, v: Map, footprint_u: Map, footprint_v: Map) -> Map:
    """Noise (N, 3) float32 of zero mean and about unit variance at surface coordinates u, v (N,), in metres.

    The footprints (N,), in metres, are the extent of the patch to average along u and v. The period is 10.24 m.
    """
    ripmap, starts = _noise_ripmap()
    low_u, weight_u = _level(footprint_u)
    low_v, weight_v = _level(footprint_v)
    first = np.array(starts, dtype=np.float32)
    xs = [_atlas_coordinate(u, low_u + k, first) for k in (0, 1)]
    ys = [_atlas_coordinate(v, low_v + k, first) for k in (0, 1)]
    total = np.zeros((len(u), 3), dtype=np.float32)
    for x, wx in zip(xs, (1 - weight_u, weight_u), strict=True):
        for y, wy in zip(ys, (1 - weight_v, weight_v), strict=True):
            total += _remap(ripmap, x, y) * (wx * wy)[:, None]
    total -= np.float32(_MIDDLE)
    total *= np.float32(1.0 / _SCALE)
    return total


def _level(footprint: Map) -> tuple[Map, Map]:
    """The finer of the two levels to mix, and the share of the coarser one."""
    level = np.log2(np.maximum(footprint, TEXEL_M) * np.float32(1.0 / TEXEL_M))
    level = np.minimum(level, np.float32(_LEVELS - 1.001))
    low = np.floor(level)
    return low, level - low


def _atlas_coordinate(u: Map, level: Map, first: Map) -> Map:
    texels = np.exp2(-level) * np.float32(TEXELS)
    period = np.float32(TEXELS * TEXEL_M)
    turns = u * np.float32(1.0 / period)
    turns -= np.floor(turns)
    return turns * texels + (first[level.astype(np.intp)] + np.float32(_PAD - 0.5))


def _remap(ripmap: Image, x: Map, y: Map) -> Image:
    # OpenCV maps images, not lists: fold the list into rows.
    n = len(x)
    rows = -(-n // _ROW)
    folded = np.zeros((2, rows * _ROW), dtype=np.float32)
    folded[0, :n], folded[1, :n] = x, y
    x2, y2 = folded.reshape(2, rows, _ROW)
    sampled = cv2.remap(ripmap, x2, y2, cv2.INTER_LINEAR)
    return np.asarray(sampled, dtype=np.uint8).reshape(-1, ripmap.shape[2])[:n]


def band(x: Map, low: float | Floats, high: float | Floats, footprint: Map) -> Map:
    """Share of the interval of length ``footprint`` around x that lies in [low, high], in 0..1."""
    half = footprint * np.float32(0.5)
    share: Map = (np.clip(x + half, low, high) - np.clip(x - half, low, high)) / footprint
    return share


def stripes(x: Map, period: float | Floats, half_width: float | Floats, footprint: Map) -> Map:
    """Share of the interval around x that lies within ``half_width`` of a multiple of ``period``, in 0..1."""

    def integral(at: Map) -> Map:
        cycle = np.floor(at / period + np.float32(0.5))
        total: Map = cycle * (2 * half_width) + np.clip(at - cycle * period, -half_width, half_width)
        return total

    half = footprint * np.float32(0.5)
    return (integral(x + half) - integral(x - half)) / footprint
