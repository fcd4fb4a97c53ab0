"""Exact ray casting of a scene for separable grids of rays.

Ray (i, j) of a grid is ``rows[i] + columns[j]``. That covers a pinhole camera (columns (x, 0, 1), rows (0, y, 0); the
range is then the depth z) and a spinning LiDAR (columns (sin a, 0, cos a), rows (0, -tan e, 0); the range is then
horizontal). A linear functional of the ray is then an outer sum, and for a plane the inverse range and the tests
against a polygon's edges are linear functionals: a polygon costs a few additions and comparisons a ray of its window.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from bench.street.surfaces import GROUND_ID, SKY_ID, Material, Surfaces
from bench.types import Float, Map, StereoCamera

_NEAR_M = 0.05
# The ground ends here; farther rays see the sky.
_GROUND_RANGE_M = 1500.0
# A decal lies in the plane of what it covers: it may be behind by rounding.
_DECAL_SLACK = np.float32(1.0 + 1e-4)


@dataclass(frozen=True)
class RayGrid:
    """Rays from a pose: ``T_world_sensor`` (4, 4), ``columns`` (W, 3) and ``rows`` (H, 3) float64 in the sensor's axes.

    ``columns`` have slopes x / z that increase. ``planar_rows`` says that row i sees the slope y / z = rows[i, 1].
    """

    T_world_sensor: Float
    columns: Float
    rows: Float
    planar_rows: bool

    @cached_property
    def column_slopes(self) -> Float:
        """x / z of each column, (W,), increasing."""
        return self.columns[:, 0] / self.columns[:, 2]

    @cached_property
    def row_slopes(self) -> Float:
        """y / z of each row, (H,), increasing; for a grid with ``planar_rows``."""
        return np.ascontiguousarray(self.rows[:, 1])

    def linear(self, functional: Float, rows: slice, columns: slice) -> Map:
        """The functional (3,) applied to a window of rays, (h, w) float32."""
        across = (self.columns[columns] @ functional).astype(np.float32)
        down = (self.rows[rows] @ functional).astype(np.float32)
        return np.add(across[None, :], down[:, None])

    def linear_double(self, functional: Float, rows: slice, columns: slice) -> Float:
        """As ``linear``, in float64, for what cancels."""
        return np.add((self.columns[columns] @ functional)[None, :], (self.rows[rows] @ functional)[:, None])


def pinhole_rays(camera: StereoCamera, T_world_cam: Float, supersampling: int = 1) -> RayGrid:
    """Rays through the centres of a camera's pixels, or of ``supersampling`` x ``supersampling`` parts of each."""
    k = supersampling
    u = (np.arange(camera.width * k) + 0.5) / k - 0.5
    v = (np.arange(camera.height * k) + 0.5) / k - 0.5
    columns = np.stack([(u - camera.cx) / camera.fx, np.zeros_like(u), np.ones_like(u)], axis=1)
    rows = np.stack([np.zeros_like(v), (v - camera.cy) / camera.fy, np.zeros_like(v)], axis=1)
    return RayGrid(T_world_cam, columns, rows, planar_rows=True)


@dataclass(frozen=True)
class Hits:
    """What each ray hits first: ``surface`` (H, W) int32 ids and ``inverse_range`` (H, W) float32, 0 in the sky."""

    surface: npt.NDArray[np.int32]
    inverse_range: Map


def cast(rays: RayGrid, surfaces: Surfaces) -> Hits:
    """First hit of every ray with the ground plane y = 0 and all surfaces; the sensor is above the ground."""
    R, origin = rays.T_world_sensor[:3, :3], rays.T_world_sensor[:3, 3]
    everything = slice(None)
    # The ground: origin_y + range * (ray in world)_y = 0, with y pointing down and the sensor at negative y.
    inverse = rays.linear(R[1] / -origin[1], everything, everything)
    inverse[inverse < 1.0 / _GROUND_RANGE_M] = 0.0
    surface = np.where(inverse > 0, np.int32(GROUND_ID), np.int32(SKY_ID))
    hits = Hits(surface, inverse)
    _cast_polygons(rays, surfaces, hits)
    _cast_quadrics(rays, surfaces, hits)
    return hits


def _cast_polygons(rays: RayGrid, surfaces: Surfaces, hits: Hits) -> None:
    R, origin = rays.T_world_sensor[:3, :3], rays.T_world_sensor[:3, 3]
    corners = (surfaces.corners - origin) @ R
    normals = surfaces.axes[:, 2] @ R
    offset = np.einsum("pi,pi->p", normals, corners[:, 0])
    decals = surfaces.material[2 : surfaces.first_ellipsoid] == Material.SHADOW
    # Plane through the sensor and each edge, positive towards the polygon's centre.
    edges = np.cross(corners, np.roll(corners, -1, axis=1))
    edges *= np.sign(np.einsum("pki,pi->pk", edges, corners.mean(axis=1)))[:, :, None]
    nearest = np.linalg.norm(corners, axis=2).min(axis=1)
    # Near to far, so that what is hidden is found hidden by one look; decals last.
    order = np.lexsort((nearest, decals))
    for p in order[(offset[order] < -1e-6) & (corners[order, :, 2].max(axis=1) > _NEAR_M)]:
        window = _window(rays, corners[p])
        if window is None:
            continue
        rows, columns, largest = window
        buffer = hits.inverse_range[rows, columns]
        if not decals[p] and buffer.min() >= np.float32(largest):
            continue
        inverse = rays.linear(normals[p] / offset[p], rows, columns)
        better = inverse * _DECAL_SLACK > buffer if decals[p] else inverse > buffer
        for edge in edges[p]:
            better &= rays.linear(edge, rows, columns) >= 0
        if decals[p]:
            better &= hits.surface[rows, columns] == GROUND_ID
        np.copyto(buffer, inverse, where=better)
        np.copyto(hits.surface[rows, columns], np.int32(p + 2), where=better)


def _window(rays: RayGrid, corners: Float) -> tuple[slice, slice, float] | None:
    """Rows and columns of the grid that may see the hull of ``corners`` (K, 3, sensor axes), and its largest inverse
    range; None if no ray does."""
    z = corners[:, 2]
    if z.min() < _NEAR_M:
        # Clip the hull at the near plane: keep the corners before it, and the crossings of all connections.
        before, behind = corners[z >= _NEAR_M], corners[z < _NEAR_M]
        if len(before) == 0:
            return None
        t = (_NEAR_M - behind[None, :, 2]) / (before[:, None, 2] - behind[None, :, 2])
        crossing = behind[None] + t[..., None] * (before[:, None] - behind[None])
        corners = np.vstack([before, crossing.reshape(-1, 3)])
        z = corners[:, 2]
    x = corners[:, 0] / z
    first, last = rays.column_slopes.searchsorted((x.min(), x.max()))
    if first == last:
        return None
    columns = slice(int(first), int(last))
    if not rays.planar_rows:
        return slice(0, len(rays.rows)), columns, float("inf")
    y = corners[:, 1] / z
    top, bottom = rays.row_slopes.searchsorted((y.min(), y.max()))
    return (slice(int(top), int(bottom)), columns, 1.0 / float(z.min())) if top < bottom else None


def _cast_quadrics(rays: RayGrid, surfaces: Surfaces, hits: Hits) -> None:
    """Ellipsoids and cylinders: the nearer root of a quadratic in the range, in coordinates where they are round."""
    R, origin = rays.T_world_sensor[:3, :3], rays.T_world_sensor[:3, 3]
    boxes: list[tuple[Float, Float, int, bool]] = []
    for e, row in enumerate(surfaces.ellipsoids):
        boxes.append((row[:3], row[3:], surfaces.first_ellipsoid + e, False))
    for c, (x, z, radius, height) in enumerate(surfaces.cylinders):
        half = np.array([radius, height / 2, radius])
        boxes.append((np.array([x, -height / 2, z]), half, surfaces.first_cylinder + c, True))
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    for centre, radii, surface_id, is_cylinder in boxes:
        window = _window(rays, (centre + signs * radii - origin) @ R)
        if window is None:
            continue
        rows, columns, largest = window
        buffer = hits.inverse_range[rows, columns]
        if buffer.min() >= np.float32(largest):
            continue
        inverse = _quadric_inverse_range(
            rays, (centre - origin) / radii, R / radii[:, None], rows, columns, is_cylinder
        )
        if is_cylinder:
            # Height of the hit above the ground, times the inverse range.
            drop = rays.linear(R[1], rows, columns)
            drop += np.float32(origin[1]) * inverse
            inverse[(drop < -np.float32(2 * radii[1]) * inverse) | (drop > 0)] = 0.0
        better = inverse > buffer
        np.copyto(buffer, inverse, where=better)
        np.copyto(hits.surface[rows, columns], np.int32(surface_id), where=better)


def _quadric_inverse_range(
    rays: RayGrid, centre: Float, M: Float, rows: slice, columns: slice, is_cylinder: bool
) -> Map:
    """Inverse range of the nearer hit with the unit sphere (or the unit cylinder about y) around ``centre``, 0 if none.

    ``M`` (3, 3) turns a ray into the coordinates in which the quadric is round. With w = M r, the inverse range q of
    |w / q - c|^2 = 1 solves (c.c - 1) q^2 - 2 (w.c) q + w.w = 0; the larger q is the nearer hit.
    """
    axes = [0, 2] if is_cylinder else [0, 1, 2]
    outside = float(centre[axes] @ centre[axes]) - 1.0
    if outside <= 0:
        return np.zeros((rows.stop - rows.start, columns.stop - columns.start), dtype=np.float32)
    # In float64: for a thin pole far away the discriminant is a tiny difference of large numbers.
    along = rays.linear_double(centre[axes] @ M[axes], rows, columns)
    length2 = np.zeros_like(along)
    for axis in axes:
        length2 += np.square(rays.linear_double(M[axis], rows, columns))
    discriminant = along * along - outside * length2
    inverse = (along + np.sqrt(np.maximum(discriminant, 0.0))) / outside
    inverse[(discriminant <= 0) | (along <= 0)] = 0.0
    return inverse.astype(np.float32)
