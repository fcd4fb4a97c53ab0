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
    windows = _windows(rays, corners)
    # Near to far, so that what is hidden is found hidden by one look; decals last.
    order = np.lexsort((nearest, decals))
    for p in order[(offset[order] < -1e-6) & windows.seen[order]]:
        rows, columns, largest = windows.at(p)
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


@dataclass(frozen=True)
class _Windows:
    """Parts of a grid that may see each of N things: ``bounds`` (N, 4) first and last row, first and last column (the
    last ones excluded), ``largest`` (N,) the largest inverse range of each, ``seen`` (N,) whether any ray does."""

    bounds: npt.NDArray[np.int64]
    largest: Float
    seen: npt.NDArray[np.bool_]

    def at(self, index: np.signedinteger) -> tuple[slice, slice, float]:
        """Rows, columns and the largest inverse range of one thing."""
        top, bottom, left, right = self.bounds[index].tolist()
        return slice(top, bottom), slice(left, right), float(self.largest[index])


def _windows(rays: RayGrid, hulls: Float) -> _Windows:
    """Windows of the convex hulls of ``hulls`` (N, K, 3), in the sensor's axes."""
    z = hulls[:, :, 2]
    nearest, farthest = z.min(axis=1, initial=np.inf), z.max(axis=1, initial=-np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = hulls[:, :, :2] / z[:, :, None]
    low, high = slopes.min(axis=1), slopes.max(axis=1)
    for n in np.flatnonzero((nearest < _NEAR_M) & (farthest > _NEAR_M)):
        # Clip the hull at the near plane: keep the corners before it, and the crossings of all connections.
        before, behind = hulls[n][z[n] >= _NEAR_M], hulls[n][z[n] < _NEAR_M]
        t = (_NEAR_M - behind[None, :, 2]) / (before[:, None, 2] - behind[None, :, 2])
        crossing = behind[None] + t[..., None] * (before[:, None] - behind[None])
        clipped = np.vstack([before, crossing.reshape(-1, 3)])
        clipped_slopes = clipped[:, :2] / clipped[:, 2:]
        low[n], high[n], nearest[n] = clipped_slopes.min(axis=0), clipped_slopes.max(axis=0), clipped[:, 2].min()
    bounds = np.empty((len(hulls), 4), dtype=np.int64)
    bounds[:, 2] = rays.column_slopes.searchsorted(low[:, 0])
    bounds[:, 3] = rays.column_slopes.searchsorted(high[:, 0])
    if rays.planar_rows:
        bounds[:, 0], bounds[:, 1] = rays.row_slopes.searchsorted(low[:, 1]), rays.row_slopes.searchsorted(high[:, 1])
        largest = 1.0 / np.maximum(nearest, _NEAR_M / 2)
    else:
        bounds[:, 0], bounds[:, 1] = 0, len(rays.rows)
        largest = np.full(len(hulls), np.inf)
    seen = (farthest > _NEAR_M) & (bounds[:, 0] < bounds[:, 1]) & (bounds[:, 2] < bounds[:, 3])
    return _Windows(bounds, largest, seen)


def _cast_quadrics(rays: RayGrid, surfaces: Surfaces, hits: Hits) -> None:
    """Ellipsoids and cylinders: the nearer root of a quadratic in the range, in coordinates where they are round."""
    R, origin = rays.T_world_sensor[:3, :3], rays.T_world_sensor[:3, 3]
    x, z, radius, height = surfaces.cylinders.T
    centres = np.vstack([surfaces.ellipsoids[:, :3], np.stack([x, -height / 2, z], axis=1)])
    half_sizes = np.vstack([surfaces.ellipsoids[:, 3:], np.stack([radius, height / 2, radius], axis=1)])
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    windows = _windows(rays, (centres[:, None] + signs * half_sizes[:, None] - origin) @ R)
    for index in np.flatnonzero(windows.seen):
        rows, columns, largest = windows.at(index)
        centre, radii, is_cylinder = centres[index], half_sizes[index], bool(index >= len(surfaces.ellipsoids))
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
        np.copyto(hits.surface[rows, columns], np.int32(surfaces.first_ellipsoid + index), where=better)


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
