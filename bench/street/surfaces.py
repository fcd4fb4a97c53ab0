"""Surfaces of a scene in arrays: planar convex polygons, ellipsoids and upright cylinders, with how each one looks."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from bench.types import Float


class Material(IntEnum):
    """How a surface is shaded (see ``bench.street.shading``)."""

    SKY = 0
    GROUND = 1
    FACADE = 2
    WALL = 3
    ROOF = 4
    CAR_SIDE = 5
    CAR_END = 6
    PAINT = 7
    GLASS = 8
    METAL = 9
    BARK = 10
    LEAVES = 11
    SHADOW = 12
    SIGN = 13
    TRUCK = 14


# Ids of the hit map: nothing hit, the ground plane, then polygons, ellipsoids and cylinders in this order.
SKY_ID = 0
GROUND_ID = 1


@dataclass(frozen=True)
class Look:
    """Material, albedo (RGB in 0..1), where in the noise texture the surface begins, a number for variations."""

    material: Material
    albedo: tuple[float, float, float]
    offset: tuple[float, float] = (0.0, 0.0)
    variant: float = 0.0


@dataclass
class SurfaceList:
    """Collects surfaces while a scene is built; lengths in metres, world axes (x right, y down, z forward)."""

    polygons: list[Float] = field(default_factory=list)
    polygon_axes: list[Float] = field(default_factory=list)
    polygon_looks: list[Look] = field(default_factory=list)
    ellipsoids: list[tuple[float, ...]] = field(default_factory=list)
    ellipsoid_looks: list[Look] = field(default_factory=list)
    cylinders: list[tuple[float, ...]] = field(default_factory=list)
    cylinder_looks: list[Look] = field(default_factory=list)

    def add_polygon(self, corners: Float, outward: Float, look: Look) -> None:
        """A convex polygon of 3 or 4 ``corners`` (K, 3), seen only from the side that ``outward`` (3,) points to.

        Its surface coordinates start at corner 0: u along the first edge, v across it inside the plane.
        """
        u = corners[1] - corners[0]
        u = u / np.linalg.norm(u)
        normal = np.cross(u, corners[-1] - corners[0])
        normal = normal / np.linalg.norm(normal)
        v = np.cross(normal, u)
        if normal @ outward < 0:
            normal = -normal
        if len(corners) == 3:
            corners = np.vstack([corners, corners[-1:]])
        self.polygons.append(corners)
        self.polygon_axes.append(np.stack([u, v, normal]))
        self.polygon_looks.append(look)

    def add_solid(self, faces: list[tuple[Float, Look]]) -> None:
        """The faces of a convex solid, each turned away from the solid's centre."""
        centre = np.mean([face.mean(axis=0) for face, _ in faces], axis=0)
        for corners, look in faces:
            self.add_polygon(corners, corners.mean(axis=0) - centre, look)

    def add_ellipsoid(self, centre: tuple[float, float, float], radii: tuple[float, float, float], look: Look) -> None:
        """An ellipsoid with axes along x, y, z."""
        self.ellipsoids.append((*centre, *radii))
        self.ellipsoid_looks.append(look)

    def add_cylinder(self, x: float, z: float, radius: float, height: float, look: Look) -> None:
        """An upright cylinder that stands on the ground."""
        self.cylinders.append((x, z, radius, height))
        self.cylinder_looks.append(look)

    def bounding_circle(self) -> tuple[Float, float]:
        """Centre (x, z) and radius in metres of a circle on the ground plan that holds everything."""
        discs = [np.c_[corners[:, [0, 2]], np.zeros(len(corners))] for corners in self.polygons]
        discs += [np.array([[e[0], e[2], max(e[3], e[5])]]) for e in self.ellipsoids]
        discs += [np.array([[c[0], c[1], c[2]]]) for c in self.cylinders]
        x_z_radius = np.vstack(discs)
        low, high = (x_z_radius[:, :2] - x_z_radius[:, 2:]).min(0), (x_z_radius[:, :2] + x_z_radius[:, 2:]).max(0)
        centre = (low + high) / 2
        return centre, float((np.linalg.norm(x_z_radius[:, :2] - centre, axis=1) + x_z_radius[:, 2]).max())

    def extend(self, other: SurfaceList) -> None:
        """Append the surfaces of another list."""
        self.polygons += other.polygons
        self.polygon_axes += other.polygon_axes
        self.polygon_looks += other.polygon_looks
        self.ellipsoids += other.ellipsoids
        self.ellipsoid_looks += other.ellipsoid_looks
        self.cylinders += other.cylinders
        self.cylinder_looks += other.cylinder_looks


@dataclass(frozen=True)
class Surfaces:
    """Frozen arrays of a ``SurfaceList``; ids of the hit map count polygons first, then ellipsoids, then cylinders.

    ``corners`` (P, 4, 3), ``axes`` (P, 3, 3) with rows u, v and outward normal, ``ellipsoids`` (E, 6) centre and radii,
    ``cylinders`` (C, 4) x, z, radius, height. ``material`` (N,), ``albedo`` (N, 3), ``offset`` (N, 2) and ``variant``
    (N,) are indexed by the hit map's id, N = 2 + P + E + C.
    """

    corners: Float
    axes: Float
    ellipsoids: Float
    cylinders: Float
    material: npt.NDArray[np.uint8]
    albedo: npt.NDArray[np.float32]
    offset: npt.NDArray[np.float32]
    variant: npt.NDArray[np.float32]

    @property
    def first_ellipsoid(self) -> int:
        """Id of the first ellipsoid."""
        return 2 + len(self.corners)

    @property
    def first_cylinder(self) -> int:
        """Id of the first cylinder."""
        return self.first_ellipsoid + len(self.ellipsoids)


def freeze(surfaces: SurfaceList) -> Surfaces:
    """The arrays of the surfaces collected so far."""
    background = [Look(Material.SKY, (0.5, 0.65, 0.9)), Look(Material.GROUND, (0.4, 0.4, 0.4))]
    looks = background + surfaces.polygon_looks + surfaces.ellipsoid_looks + surfaces.cylinder_looks
    return Surfaces(
        corners=np.array(surfaces.polygons, dtype=np.float64).reshape(-1, 4, 3),
        axes=np.array(surfaces.polygon_axes, dtype=np.float64).reshape(-1, 3, 3),
        ellipsoids=np.array(surfaces.ellipsoids, dtype=np.float64).reshape(-1, 6),
        cylinders=np.array(surfaces.cylinders, dtype=np.float64).reshape(-1, 4),
        material=np.array([look.material for look in looks], dtype=np.uint8),
        albedo=np.array([look.albedo for look in looks], dtype=np.float32),
        offset=np.array([look.offset for look in looks], dtype=np.float32),
        variant=np.array([look.variant for look in looks], dtype=np.float32),
    )
