"""What is drawn on each kind of surface: pure functions of surface coordinates and footprints, to RGB in about 0..1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.street.scene import ROAD_HALF_M, SIDEWALK_END_M
from bench.street.textures import band, sample_noise, stripes
from bench.types import Map

_STOREY_M = np.float32(3.1)
_PLINTH_M = 0.5
_LANE_LINE_M = 3.15

ASPHALT = np.array([0.34, 0.34, 0.35], dtype=np.float32)
_PARKING = np.array([0.42, 0.40, 0.38], dtype=np.float32)
_LINE = np.array([0.86, 0.86, 0.82], dtype=np.float32)
_KERB = np.array([0.62, 0.61, 0.58], dtype=np.float32)
_PAVERS = np.array([0.58, 0.54, 0.49], dtype=np.float32)
_GRASS = np.array([0.30, 0.40, 0.18], dtype=np.float32)
_HORIZON = np.array([0.86, 0.91, 0.97], dtype=np.float32)
_ZENITH = np.array([0.42, 0.62, 0.93], dtype=np.float32)
_CLOUD = np.array([0.97, 0.97, 0.98], dtype=np.float32)

# Brightness of panes and doors, looked up by their place in the facade.
_VARIETY = np.random.default_rng(7).random(1024).astype(np.float32)


@dataclass(frozen=True)
class Patch:
    """N hits on surfaces of one kind, all float32: coordinates u, v (N,) in metres from the surface's first corner (u
    along its first edge), the extent of the surface (N,), the patch that a ray covers (N,), and the surface's look."""

    u: Map
    v: Map
    footprint_u: Map
    footprint_v: Map
    extent_u: Map
    extent_v: Map
    albedo: Map
    offset: Map
    variant: Map

    def noise(self, scale: float = 1.0, stretch_v: float = 1.0) -> Map:
        """Noise (N, 3) whose features are ``scale`` times as large, and ``stretch_v`` times longer along v."""
        k, kv = np.float32(1.0 / scale), np.float32(1.0 / (scale * stretch_v))
        u = (self.u + self.offset[:, 0]) * k
        v = (self.v + self.offset[:, 1]) * kv
        return sample_noise(u, v, self.footprint_u * k, self.footprint_v * kv)


def _mix(color: Map, other: Map, share: Map) -> Map:
    """``color`` (N, 3) with a share (N,) of ``other`` (3,) or (N, 3)."""
    return color + (other - color) * share[:, None]


def _rough(patch: Patch, grain: float, blotch: float, tint: float) -> Map:
    """The albedo with grain, large blotches and a little tint."""
    fine, coarse = patch.noise(), patch.noise(5.3)
    value = 1.0 + grain * (0.75 * fine[:, 0] + 0.6 * fine[:, 2]) + blotch * coarse[:, 0]
    color = patch.albedo * value[:, None]
    color[:, 0] += tint * coarse[:, 1]
    color[:, 2] -= tint * fine[:, 1]
    return color


def wall(patch: Patch) -> Map:
    """Plaster with stains."""
    color = _rough(patch, 0.09, 0.08, 0.015)
    return _mix(color, color * np.float32(0.72), band(patch.v, -1.0, _PLINTH_M, patch.footprint_v))


def facade(patch: Patch) -> Map:
    """Plaster with storeys of windows, cornices, a plinth and doors."""
    color = wall(patch)
    fu, fv = patch.footprint_u, patch.footprint_v
    cornice = stripes(patch.v - np.float32(0.12), _STOREY_M, 0.10, fv) * (patch.v > 1.0)
    color = _mix(color, color * np.float32(1.22), cornice)
    columns = np.maximum(np.rint(patch.extent_u / (2.1 + 0.012 * patch.variant)), 1.0).astype(np.float32)
    pitch = patch.extent_u / columns
    column = np.floor(patch.u / pitch)
    storey = np.clip(np.floor(patch.v / _STOREY_M), 0.0, None)
    u = patch.u - (column + np.float32(0.5)) * pitch
    v = patch.v - storey * _STOREY_M
    half = np.float32(0.42) + np.float32(0.0022) * patch.variant
    place = (column * 37 + storey * 101 + np.floor(patch.variant * 17)).astype(np.int64)
    chance, bright = _VARIETY[place % 1024], _VARIETY[(place * 13 + 5) % 1024]
    is_door = (storey == 0) & (_VARIETY[(column * 71 + np.floor(patch.variant * 7)).astype(np.int64) % 1024] < 0.3)
    low = np.where(is_door, np.float32(0.02), np.float32(0.95))
    high = np.where(is_door, np.float32(2.2), np.float32(2.4))

    def rectangle(margin: float) -> Map:
        across = band(u, -half - np.float32(margin), half + np.float32(margin), fu)
        return across * band(v, low - np.float32(margin), high + np.float32(margin), fv)

    frame = np.where(is_door, np.float32(0.45), np.float32(0.88))[:, None] * np.ones(3, dtype=np.float32)
    color = _mix(color, frame, rectangle(0.09))
    glass = np.stack([0.10 + 0.20 * bright, 0.13 + 0.21 * bright, 0.17 + 0.22 * bright], axis=1)
    # Some panes have light curtains; all have a soft pattern that stereo can hold on to.
    glass = np.where((chance > 0.7)[:, None], glass + np.float32(0.28), glass)
    glass *= (1.0 + 0.10 * patch.noise(0.7)[:, :1]) * (0.8 + 0.2 * v / _STOREY_M)[:, None]
    wood = np.stack([0.30 + 0.25 * chance, 0.20 + 0.12 * bright, 0.14 + 0.1 * bright], axis=1)
    wood *= 1.0 + 0.12 * patch.noise(0.8, 4.0)[:, :1]
    color = _mix(color, np.where(is_door[:, None], wood, glass).astype(np.float32), rectangle(0.0))
    bars = band(u, -0.03, 0.03, fu) + band(v, np.float32(1.85), np.float32(1.90), fv)
    return _mix(color, frame, np.minimum(bars, 1.0) * rectangle(0.0) * ~is_door)


def roof(patch: Patch) -> Map:
    """Rows of tiles."""
    color = _rough(patch, 0.14, 0.09, 0.02)
    return _mix(color, color * np.float32(0.6), stripes(patch.v, 0.32, 0.05, patch.footprint_v))


def car_side(patch: Patch) -> Map:
    """Painted side with two wheels, a dark gap to the ground, a door joint and a trim line."""
    fu, fv = patch.footprint_u, patch.footprint_v
    color = paint(patch)
    color = _mix(color, color * np.float32(0.45), stripes(patch.u - np.float32(2.0), 1.05, 0.012, fu))
    color = _mix(color, color * np.float32(0.5), band(patch.v, 0.52, 0.56, fv))
    color = _mix(color, np.full(3, 0.05, dtype=np.float32), band(patch.v, -1.0, 0.22, fv))
    radius = np.minimum(
        np.hypot(patch.u - np.float32(0.78), patch.v - np.float32(0.32)),
        np.hypot(patch.u - (patch.extent_u - np.float32(0.82)), patch.v - np.float32(0.32)),
    )
    footprint = np.maximum(fu, fv)
    color = _mix(color, np.full(3, 0.07, dtype=np.float32), band(radius, -1.0, 0.33, footprint))
    hub = np.full(3, 0.55, dtype=np.float32) * (1.0 + 0.2 * patch.noise(0.3)[:, :1])
    return _mix(color, hub, band(radius, -1.0, 0.19, footprint))


def car_end(patch: Patch) -> Map:
    """Front or back: lamps, a number plate, a dark bumper line."""
    fu, fv = patch.footprint_u, patch.footprint_v
    color = paint(patch)
    color = _mix(color, np.full(3, 0.06, dtype=np.float32), band(patch.v, -1.0, 0.24, fv))
    color = _mix(color, np.full(3, 0.15, dtype=np.float32), band(patch.v, 0.34, 0.40, fv))
    middle = np.abs(patch.u - patch.extent_u * np.float32(0.5))
    lamps = band(middle, patch.extent_u * 0.5 - 0.42, patch.extent_u * 0.5 - 0.06, fu) * band(patch.v, 0.58, 0.76, fv)
    color = _mix(color, np.array([0.75, 0.24, 0.16], dtype=np.float32), lamps)
    plate = band(middle, -0.26, 0.26, fu) * band(patch.v, 0.43, 0.54, fv)
    return _mix(color, np.array([0.88, 0.88, 0.84], dtype=np.float32), plate)


def paint(patch: Patch) -> Map:
    """Car paint: an even colour with dust and soft large spots."""
    return _rough(patch, 0.05, 0.10, 0.008)


def glass(patch: Patch) -> Map:
    """Car windows: dark, with a painted frame; side windows (variant 1) are parted in two."""
    fu, fv = patch.footprint_u, patch.footprint_v
    color = patch.albedo * (1.0 + 0.22 * patch.noise(0.9)[:, :1]) + 0.10 * patch.v[:, None]
    frame = 1.0 - band(patch.v, 0.05, patch.extent_v - np.float32(0.07), fv)
    post = band(patch.u, 1.25, 1.34, fu) * (patch.variant > 0.5)
    return _mix(color, np.full(3, 0.22, dtype=np.float32), np.clip(frame + post, 0.0, 1.0))


def metal(patch: Patch) -> Map:
    """Lamp arms."""
    return _rough(patch, 0.10, 0.10, 0.0)


def sign(patch: Patch) -> Map:
    """A coloured square with a white field."""
    fu, fv = patch.footprint_u, patch.footprint_v
    u, v = patch.u - patch.extent_u * np.float32(0.5), patch.v - patch.extent_v * np.float32(0.5)
    white = band(u, -0.22, 0.22, fu) * band(v, -0.22, 0.22, fv) - band(u, -0.12, 0.12, fu) * band(v, -0.04, 0.04, fv)
    return _mix(_rough(patch, 0.05, 0.03, 0.0), np.full(3, 0.9, dtype=np.float32), np.clip(white, 0.0, 1.0))


def truck(patch: Patch) -> Map:
    """A lorry's canvas with ribs, painted blocks and a dark skirt; wheels on its long sides (variant 1)."""
    fu, fv = patch.footprint_u, patch.footprint_v
    color = _rough(patch, 0.08, 0.12, 0.01)
    color = _mix(color, color * np.float32(0.7), stripes(patch.u, 0.62, 0.02, fu))
    blocks = stripes(patch.u - np.float32(0.8), 1.3, 0.32, fu) * band(patch.v, 1.7, 2.5, fv)
    ink = np.array([0.14, 0.16, 0.34], dtype=np.float32) * (1.0 + 0.2 * patch.noise(0.6)[:, :1])
    color = _mix(color, ink, blocks * (1.0 - stripes(patch.v, 0.27, 0.05, fv)))
    color = _mix(color, np.array([0.80, 0.45, 0.12], dtype=np.float32), band(patch.v, 3.1, 3.35, fv))
    color = _mix(color, np.full(3, 0.07, dtype=np.float32), band(patch.v, -1.0, 0.85, fv))
    from_end = np.minimum(patch.u, patch.extent_u - patch.u)
    radius = np.hypot(np.abs(from_end - np.float32(1.7)) - np.float32(0.6), patch.v - np.float32(0.5))
    hub = np.full(3, 0.5, dtype=np.float32) * (1.0 + 0.2 * patch.noise(0.3)[:, :1])
    return _mix(color, hub, band(radius, -1.0, 0.27, np.maximum(fu, fv)) * patch.variant)


def leaves(patch: Patch) -> Map:
    """Foliage: strong contrast on all scales, darker below."""
    fine, coarse = patch.noise(1.4), patch.noise(6.1)
    value = np.clip(1.0 + 0.34 * fine[:, 0] + 0.26 * fine[:, 2] + 0.16 * coarse[:, 0], 0.25, 2.4)
    color = patch.albedo * value[:, None]
    color[:, 0] += np.float32(0.04) * fine[:, 1]
    return color * np.clip(0.85 + 0.25 * patch.v / patch.extent_v, 0.55, 1.1)[:, None]


def bark(patch: Patch) -> Map:
    """Bark and painted poles: streaks along v."""
    streaks = patch.noise(0.35, 6.0)
    return patch.albedo * (1.0 + 0.22 * streaks[:, :1] + 0.10 * patch.noise(3.0)[:, :1])


def ground(s: Map, d: Map, footprint_s: Map, footprint_d: Map) -> Map:
    """Road with markings, parking lanes, kerbs, sidewalks, and grass beyond; s, d are street coordinates (N,)."""
    fs, fd = footprint_s, footprint_d
    fine = sample_noise(s, d, fs, fd)
    k = np.float32(1.0 / 6.7)
    coarse = sample_noise(s * k, d * k, fs * k, fd * k)
    side = np.abs(d)
    color = np.broadcast_to(ASPHALT, (len(s), 3))
    color = _mix(color, _PARKING, band(side, _LANE_LINE_M, 100.0, fd))
    edge_line = band(side, _LANE_LINE_M - 0.06, _LANE_LINE_M + 0.06, fd)
    dashes = band(d, -0.06, 0.06, fd) * stripes(s, 6.0, 1.5, fs)
    color = _mix(color, _LINE, np.clip(edge_line + dashes, 0.0, 1.0) * np.clip(0.85 + 0.18 * fine[:, 2], 0.3, 1.0))
    color = _mix(color, _KERB, band(side, ROAD_HALF_M - 0.12, ROAD_HALF_M + 0.08, fd))
    slabs = band(side, ROAD_HALF_M + 0.08, 100.0, fd)
    color = _mix(color, _PAVERS, slabs)
    joints = np.maximum(stripes(s, 0.6, 0.015, fs), stripes(side, 0.6, 0.015, fd))
    color = _mix(color, _PAVERS * np.float32(0.6), slabs * joints)
    grass = band(side, SIDEWALK_END_M + 0.1, 1e4, fd)
    color = _mix(color, _GRASS, grass)
    rough = 0.10 + 0.12 * grass
    value = 1.0 + rough * (fine[:, 0] + 0.8 * fine[:, 2]) + 0.09 * coarse[:, 0]
    color = color * value[:, None]
    color[:, 0] += np.float32(0.012) * coarse[:, 1]
    return color


def sky(azimuth: Map, elevation: Map, footprint: Map) -> Map:
    """A bright horizon, blue above, soft clouds; angles and footprint (N,) in radians."""
    scale, stretch = np.float32(9.0), np.float32(2.2)
    noise = sample_noise(azimuth * scale, elevation * scale * stretch, footprint * scale, footprint * scale * stretch)
    height = np.clip(elevation / np.float32(0.6), 0.0, 1.0) ** np.float32(0.7)
    color = _mix(np.broadcast_to(_HORIZON, (len(azimuth), 3)), _ZENITH, height)
    return _mix(color, _CLOUD, np.clip(0.30 + 0.34 * noise[:, 1], 0.0, 0.9))
