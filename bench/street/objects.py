"""The things that stand in a street: houses, parked cars, trees, lamps, signs, hills, each as a few surfaces."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.street.surfaces import Look, Material, SurfaceList
from bench.types import Float

WALL_COLORS = (
    (0.80, 0.72, 0.58), (0.74, 0.46, 0.36), (0.62, 0.60, 0.57), (0.86, 0.80, 0.70),
    (0.66, 0.52, 0.40), (0.56, 0.62, 0.66), (0.82, 0.66, 0.44), (0.52, 0.36, 0.30),
)  # fmt: skip
ROOF_COLORS = ((0.50, 0.24, 0.18), (0.36, 0.22, 0.18), (0.28, 0.28, 0.31), (0.44, 0.30, 0.22))
CAR_COLORS = (
    (0.62, 0.09, 0.08), (0.10, 0.18, 0.42), (0.70, 0.70, 0.72), (0.16, 0.17, 0.18),
    (0.86, 0.86, 0.84), (0.12, 0.30, 0.20), (0.46, 0.42, 0.36),
)  # fmt: skip
LEAF_COLORS = ((0.20, 0.34, 0.12), (0.26, 0.38, 0.14), (0.17, 0.28, 0.13), (0.34, 0.40, 0.16))

_STOREY_M = 3.1


@dataclass(frozen=True)
class Place:
    """A spot on the ground (x, z) with a heading: local (right, up, forward) metres to world points."""

    x: float
    z: float
    heading: float

    def points(self, right_up_forward: list[tuple[float, float, float]]) -> Float:
        """World points (N, 3) of local ones."""
        local = np.array(right_up_forward, dtype=np.float64)
        sin, cos = np.sin(self.heading), np.cos(self.heading)
        x = self.x + local[:, 0] * cos + local[:, 2] * sin
        z = self.z - local[:, 0] * sin + local[:, 2] * cos
        return np.stack([x, -local[:, 1], z], axis=1)


def texture_offset(rng: np.random.Generator) -> tuple[float, float]:
    """Where in the noise texture a surface begins, in metres; equal houses don't look equal."""
    return float(rng.uniform(0, 50)), float(rng.uniform(0, 50))


def pick(rng: np.random.Generator, colors: tuple[tuple[float, float, float], ...]) -> tuple[float, float, float]:
    """One of the colours, a little changed."""
    r, g, b = colors[rng.integers(len(colors))]
    k = rng.uniform(0.88, 1.12, size=3)
    return float(r * k[0]), float(g * k[1]), float(b * k[2])


def add_house(out: SurfaceList, rng: np.random.Generator, place: Place, width: float, side: float) -> None:
    """A house whose front is centred at ``place``, along the street; ``side`` is +1 right of the street, -1 left.

    Flat or gabled roof with the ridge along the street.
    """
    storeys = int(rng.integers(1, 4))
    height = storeys * _STOREY_M + 0.5
    depth = rng.uniform(8.0, 11.0)
    half = width / 2
    wall = Look(Material.FACADE, pick(rng, WALL_COLORS), texture_offset(rng), float(rng.uniform(0, 100)))
    blank = replace(wall, material=Material.WALL)
    near, far = 0.0, side * depth

    def wall_face(r0: float, f0: float, r1: float, f1: float) -> Float:
        return place.points([(r0, 0, f0), (r1, 0, f1), (r1, height, f1), (r0, height, f0)])

    faces = [
        (wall_face(near, -half, near, half), wall),
        (wall_face(far, -half, far, half), blank),
        (wall_face(near, -half, far, -half), wall if rng.random() < 0.5 else blank),
        (wall_face(near, half, far, half), blank),
    ]
    roof = Look(Material.ROOF, pick(rng, ROOF_COLORS), texture_offset(rng))
    if rng.random() < 0.6:
        ridge, eaves = height + rng.uniform(2.0, 3.6), side * 0.35
        middle = far / 2
        for edge in (near - eaves, far + eaves):
            slope = [
                (edge, height - 0.15, -half),
                (edge, height - 0.15, half),
                (middle, ridge, half),
                (middle, ridge, -half),
            ]
            faces.append((place.points(slope), roof))
        for f in (-half, half):
            faces.append((place.points([(near, height, f), (far, height, f), (middle, ridge, f)]), blank))
    else:
        top = [(near, height, -half), (near, height, half), (far, height, half), (far, height, -half)]
        faces.append((place.points(top), roof))
    out.add_solid(faces)


def add_car(out: SurfaceList, rng: np.random.Generator, place: Place) -> None:
    """A parked car: body, cabin with windows, and its shadow on the ground; ``place`` is its centre."""
    length, half_width = rng.uniform(3.9, 4.6), rng.uniform(0.84, 0.92)
    hood, roof = rng.uniform(0.82, 0.95), rng.uniform(1.42, 1.62)
    half = length / 2
    color, offset = pick(rng, CAR_COLORS), texture_offset(rng)
    side, end = Look(Material.CAR_SIDE, color, offset, length), Look(Material.CAR_END, color, offset, 2 * half_width)
    paint, glass = Look(Material.PAINT, color, offset), Look(Material.GLASS, (0.10, 0.12, 0.14), offset)
    w = half_width
    body = [
        (place.points([(s * w, 0.0, -half), (s * w, 0.0, half), (s * w, hood, half), (s * w, hood, -half)]), side)
        for s in (-1, 1)
    ]
    for f in (-half, half):
        body.append((place.points([(-w, 0.0, f), (w, 0.0, f), (w, hood, f), (-w, hood, f)]), end))
    body.append((place.points([(-w, hood, -half), (w, hood, -half), (w, hood, half), (-w, hood, half)]), paint))
    out.add_solid(body)
    low0, low1, top0, top1, t = -half * 0.86, half * 0.52, -half * 0.58, half * 0.16, w * 0.78
    cabin = [
        (
            place.points(
                [(s * w * 0.97, hood, low0), (s * w * 0.97, hood, low1), (s * t, roof, top1), (s * t, roof, top0)]
            ),
            replace(glass, variant=1.0),
        )
        for s in (-1, 1)
    ]
    for low, top in ((low0, top0), (low1, top1)):
        cabin.append(
            (place.points([(-w * 0.97, hood, low), (w * 0.97, hood, low), (t, roof, top), (-t, roof, top)]), glass)
        )
    cabin.append((place.points([(-t, roof, top0), (t, roof, top0), (t, roof, top1), (-t, roof, top1)]), paint))
    out.add_solid(cabin)
    _add_shadow(out, place, w + 0.25, half + 0.2)


def add_lorry_box(out: SurfaceList, place: Place, length: float, half_width: float, height: float, look: Look) -> None:
    """A lorry's unit as one box from the ground up, and its shadow; ``place`` is its centre."""
    w, half = half_width, length / 2
    faces = [
        (
            place.points([(s * w, 0.0, -half), (s * w, 0.0, half), (s * w, height, half), (s * w, height, -half)]),
            replace(look, variant=1.0),
        )
        for s in (-1, 1)
    ]
    for f in (-half, half):
        faces.append((place.points([(-w, 0.0, f), (w, 0.0, f), (w, height, f), (-w, height, f)]), look))
    top = [(-w, height, -half), (w, height, -half), (w, height, half), (-w, height, half)]
    faces.append((place.points(top), replace(look, material=Material.PAINT)))
    out.add_solid(faces)
    _add_shadow(out, place, w + 0.3, half + 0.3)


def _add_shadow(out: SurfaceList, place: Place, half_width: float, half_length: float) -> None:
    w, f = half_width, half_length
    shadow = place.points([(-w, 0, -f), (w, 0, -f), (w, 0, f), (-w, 0, f)])
    out.add_polygon(shadow, np.array([0.0, -1.0, 0.0]), Look(Material.SHADOW, (0.0, 0.0, 0.0)))


def add_tree(out: SurfaceList, rng: np.random.Generator, x: float, z: float, size: float) -> None:
    """A trunk and a few overlapping crowns; ``size`` 1 is a street tree of about 6 m."""
    trunk = rng.uniform(1.9, 2.6) * size
    bark = Look(Material.BARK, (0.30, 0.23, 0.17), texture_offset(rng))
    out.add_cylinder(x, z, rng.uniform(0.11, 0.19) * size, trunk + 1.0 * size, bark)
    color = pick(rng, LEAF_COLORS)
    for _ in range(int(rng.integers(3, 6))):
        r = rng.uniform(0.8, 1.35, size=3) * size
        centre = (
            x + rng.normal(0, 0.55) * size,
            -(trunk + rng.uniform(0.6, 2.3) * size),
            z + rng.normal(0, 0.55) * size,
        )
        k = float(rng.uniform(0.8, 1.2))
        albedo = (color[0] * k, color[1] * k, color[2] * k)
        out.add_ellipsoid(centre, (r[0], r[1], r[2]), Look(Material.LEAVES, albedo, texture_offset(rng)))


def add_bush(out: SurfaceList, rng: np.random.Generator, x: float, z: float) -> None:
    """A low ellipsoid of leaves."""
    r = rng.uniform(0.6, 1.4, size=3)
    look = Look(Material.LEAVES, pick(rng, LEAF_COLORS), texture_offset(rng))
    out.add_ellipsoid((x, -0.4 * float(r[1]), z), (r[0], r[1], r[2]), look)


def add_lamp(out: SurfaceList, rng: np.random.Generator, place: Place, side: float) -> None:
    """A street lamp: a pole and an arm towards the road (``side`` +1 right of the road, -1 left)."""
    metal = Look(Material.METAL, (0.42, 0.45, 0.46), texture_offset(rng))
    height = rng.uniform(5.5, 7.0)
    out.add_cylinder(place.x, place.z, 0.07, height, metal)
    _add_box(out, place, (-side * 0.8, height - 0.05, 0.0), (1.0, 0.05, 0.10), metal)


def add_sign(out: SurfaceList, rng: np.random.Generator, place: Place) -> None:
    """A traffic sign on a thin pole."""
    metal = Look(Material.METAL, (0.55, 0.56, 0.57), texture_offset(rng))
    out.add_cylinder(place.x, place.z, 0.03, 2.6, metal)
    look = Look(Material.SIGN, ((0.75, 0.08, 0.08), (0.08, 0.20, 0.60))[rng.integers(2)], texture_offset(rng))
    _add_box(out, place, (0.0, 2.25, -0.06), (0.35, 0.35, 0.02), look)


def add_fence(out: SurfaceList, rng: np.random.Generator, place: Place, length: float) -> None:
    """A garden wall along the street."""
    look = Look(Material.WALL, pick(rng, WALL_COLORS), texture_offset(rng))
    height = rng.uniform(0.9, 1.6)
    _add_box(out, place, (0.0, height / 2, 0.0), (0.12, height / 2, length / 2), look)


def add_hill(out: SurfaceList, rng: np.random.Generator, x: float, z: float, radius: float) -> None:
    """A wooded hill that closes the view between the houses."""
    look = Look(Material.LEAVES, (0.24, 0.30, 0.20), texture_offset(rng))
    out.add_ellipsoid((x, 0.0, z), (radius, rng.uniform(5.0, 10.0), radius), look)


def _add_box(
    out: SurfaceList, place: Place, centre: tuple[float, float, float], half: tuple[float, float, float], look: Look
) -> None:
    (r, u, f), (hr, hu, hf) = centre, half
    faces = []
    for s in (-1, 1):
        side = [
            (r + s * hr, u - hu, f - hf),
            (r + s * hr, u - hu, f + hf),
            (r + s * hr, u + hu, f + hf),
            (r + s * hr, u + hu, f - hf),
        ]
        end = [
            (r - hr, u - hu, f + s * hf),
            (r + hr, u - hu, f + s * hf),
            (r + hr, u + hu, f + s * hf),
            (r - hr, u + hu, f + s * hf),
        ]
        cap = [
            (r - hr, u + s * hu, f - hf),
            (r + hr, u + s * hu, f - hf),
            (r + hr, u + s * hu, f + hf),
            (r - hr, u + s * hu, f + hf),
        ]
        faces += [(place.points(corners), look) for corners in (side, end, cap)]
    out.add_solid(faces)
