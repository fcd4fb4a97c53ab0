"""Colour of every ray: coordinates on the surface that it hits, texture there, and light that no view changes."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from bench.street import materials
from bench.street.casting import cast, pinhole_rays
from bench.street.materials import Patch
from bench.street.path import CenterLine
from bench.street.surfaces import Material, Surfaces
from bench.types import Float, Image, Map, StereoCamera

# Towards the sun, and the share of light that comes from everywhere.
_SUN = np.array([0.52, -0.70, -0.49])
_AMBIENT = 0.62
_SHADOW = np.float32(0.42)
_LEAST_FOOTPRINT_M = np.float32(1e-5)

_ON_POLYGONS = {
    Material.FACADE: materials.facade,
    Material.WALL: materials.wall,
    Material.ROOF: materials.roof,
    Material.CAR_SIDE: materials.car_side,
    Material.CAR_END: materials.car_end,
    Material.PAINT: materials.paint,
    Material.GLASS: materials.glass,
    Material.METAL: materials.metal,
    Material.SIGN: materials.sign,
    Material.TRUCK: materials.truck,
}


@dataclass(frozen=True)
class Scene:
    """What the light falls on: the surfaces, the path for the ground's markings, the camera's place on it (metres); and
    the share of the contrast within each surface that is left."""

    surfaces: Surfaces
    path: CenterLine
    s: float
    texture: float = 1.0

    def colored(self, color: Map, plain: Map) -> Map:
        """Colours (N, 3) with as much of their difference to the ``plain`` ones as is left."""
        return color if self.texture == 1 else plain + np.float32(self.texture) * (color - plain)


@dataclass(frozen=True)
class Samples:
    """N rays of a pinhole camera and what they hit: ``rays`` (N, 3) with z = 1 in the camera's axes, ids (N,) int32,
    ``distance`` (N,) along z in metres (infinite in the sky), ``spacing`` (N,), the extent of the ray as a slope."""

    rays: Map
    surface: npt.NDArray[np.int32]
    distance: Map
    spacing: Map

    def at(self, index: npt.NDArray[np.int64]) -> Samples:
        """Some of the samples."""
        return Samples(self.rays[index], self.surface[index], self.distance[index], self.spacing[index])


def render(camera: StereoCamera, T_world_cam: Float, scene: Scene) -> Image:
    """The image (H, W, 3) uint8. Pixels that see one surface are one ray as wide as the pixel; others are four."""
    hits = cast(pinhole_rays(camera, T_world_cam, 2), scene.surfaces)
    quads = [hits.surface[i::2, j::2] for i in (0, 1) for j in (0, 1)]
    one = (quads[0] == quads[1]) & (quads[0] == quads[2]) & (quads[0] == quads[3])
    whole = np.flatnonzero(one)
    row, column = np.nonzero(~one)
    # Subpixel rows and columns of the mixed pixels, four in a row for each.
    rows4 = (2 * row[:, None] + np.array([0, 0, 1, 1])).ravel()
    columns4 = (2 * column[:, None] + np.array([0, 1, 0, 1])).ravel()
    # The inverse range is affine in a plane: the mean of four is that of the pixel's centre.
    inverse = cv2.resize(hits.inverse_range, (camera.width, camera.height), interpolation=cv2.INTER_AREA).ravel()[whole]
    inverse = np.concatenate([inverse, hits.inverse_range[rows4, columns4]])
    spacing = np.full(len(inverse), 1.0 / camera.fx, dtype=np.float32)
    spacing[len(whole) :] *= np.float32(0.5)
    whole_v, whole_u = np.divmod(whole.astype(np.int32), np.int32(camera.width))
    u = np.concatenate([whole_u, columns4 * 0.5 - 0.25])
    v = np.concatenate([whole_v, rows4 * 0.5 - 0.25])
    rays = np.empty((len(inverse), 3), dtype=np.float32)
    rays[:, 0], rays[:, 1], rays[:, 2] = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0
    surface = np.concatenate([quads[0].ravel()[whole], hits.surface[rows4, columns4]])
    with np.errstate(divide="ignore"):
        samples = Samples(rays, surface, np.float32(1.0) / inverse, spacing)
    color = shade(scene, T_world_cam, samples)
    image = np.empty((camera.height * camera.width, 3), dtype=np.float32)
    image[whole] = color[: len(whole)]
    image[np.flatnonzero(~one)] = color[len(whole) :].reshape(-1, 4, 3).mean(axis=1)
    return np.rint(image * np.float32(255.0)).astype(np.uint8).reshape(camera.height, camera.width, 3)


def shade(scene: Scene, T_world_cam: Float, samples: Samples) -> Map:
    """RGB (N, 3) float32 in 0..1 of the samples."""
    material = scene.surfaces.material[samples.surface]
    color = np.empty((len(material), 3), dtype=np.float32)
    for kind in np.flatnonzero(np.bincount(material, minlength=len(Material))):
        index = np.flatnonzero(material == kind)
        if kind == Material.SKY:
            color[index] = _shade_sky(T_world_cam, samples.at(index))
        elif kind in (Material.GROUND, Material.SHADOW):
            color[index] = _shade_ground(scene, T_world_cam, samples.at(index))
        else:
            # Metal is on boxes and on cylinders; everything else on one or the other.
            flat = samples.surface[index] < scene.surfaces.first_ellipsoid
            if flat.any():
                color[index[flat]] = _shade_polygons(scene, T_world_cam, Material(int(kind)), samples.at(index[flat]))
            if not flat.all():
                color[index[~flat]] = _shade_round(scene, T_world_cam, Material(int(kind)), samples.at(index[~flat]))
    return np.clip(color, 0.0, 1.0)


def _light(normals: Float | Map) -> Map:
    """Lambert light of world normals (N, 3), with a little more from above."""
    sun = np.maximum(normals @ (_SUN / np.linalg.norm(_SUN)), 0.0)
    return (_AMBIENT - 0.06 * normals[:, 1] + (1.0 - _AMBIENT) * sun).astype(np.float32)


def _along_axis(samples: Samples, normal: Map, axis: Map, start: Map) -> tuple[Map, Map, Map]:
    """Coordinate along ``axis`` and its change to the neighbouring ray right and below, each (N,).

    ``normal`` (N, 3) is the plane's functional (inverse range = normal . ray), ``axis`` (N, 3) the coordinate's
    direction, both in camera axes; ``start`` (N,) the coordinate of the camera. From
    u = start + (axis . r) / (normal . r) follows du/dr = t (axis - (u - start) normal). ``normal`` and ``axis`` may
    also be (3,), and ``start`` a number.
    """
    rays, distance = samples.rays, samples.distance
    along = (rays[:, 0] * axis[..., 0] + rays[:, 1] * axis[..., 1] + axis[..., 2]) * distance
    extent = samples.spacing * distance
    return (
        start + along,
        extent * (axis[..., 0] - along * normal[..., 0]),
        extent * (axis[..., 1] - along * normal[..., 1]),
    )


def _shade_polygons(scene: Scene, T_world_cam: Float, kind: Material, samples: Samples) -> Map:
    surfaces = scene.surfaces
    # Only the polygons that are seen.
    seen = np.flatnonzero(np.bincount(samples.surface))
    places = np.zeros(len(surfaces.material), dtype=np.intp)
    places[seen] = np.arange(len(seen))
    which = places[samples.surface]
    corners, axes = surfaces.corners[seen - 2], surfaces.axes[seen - 2]
    start = np.einsum("pi,pki->pk", T_world_cam[:3, 3] - corners[:, 0], axes)
    camera_axes = axes @ T_world_cam[:3, :3]
    normal = (camera_axes[:, 2] / -start[:, 2:3]).astype(np.float32)[which]
    camera_axes, start = camera_axes.astype(np.float32), start.astype(np.float32)
    u, u_right, u_below = _along_axis(samples, normal, camera_axes[which, 0], start[which, 0])
    v, v_right, v_below = _along_axis(samples, normal, camera_axes[which, 1], start[which, 1])
    extent_u = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).astype(np.float32)
    extent_v = np.linalg.norm(corners[:, 3] - corners[:, 0], axis=1).astype(np.float32)
    patch = Patch(
        u=u,
        v=v,
        footprint_u=np.abs(u_right) + np.abs(u_below) + _LEAST_FOOTPRINT_M,
        footprint_v=np.abs(v_right) + np.abs(v_below) + _LEAST_FOOTPRINT_M,
        extent_u=extent_u[which],
        extent_v=extent_v[which],
        albedo=surfaces.albedo[samples.surface],
        offset=surfaces.offset[samples.surface],
        variant=surfaces.variant[samples.surface],
    )
    return scene.colored(_ON_POLYGONS[kind](patch), patch.albedo) * _light(axes[:, 2])[which][:, None]


def _shade_ground(scene: Scene, T_world_cam: Float, samples: Samples) -> Map:
    R, origin = T_world_cam[:3, :3].astype(np.float32), T_world_cam[:3, 3].astype(np.float32)
    plane = R[1] / -origin[1]
    x, x_right, x_below = _along_axis(samples, plane, R[0], origin[0])
    z, z_right, z_below = _along_axis(samples, plane, R[2], origin[2])
    s, d, heading = scene.path.locate(x, z, scene.s - 40.0, scene.s + 260.0)
    sin, cos = np.sin(heading), np.cos(heading)
    footprint_s = np.abs(sin * x_right + cos * z_right) + np.abs(sin * x_below + cos * z_below) + _LEAST_FOOTPRINT_M
    footprint_d = np.abs(cos * x_right - sin * z_right) + np.abs(cos * x_below - sin * z_below) + _LEAST_FOOTPRINT_M
    color = scene.colored(materials.ground(s, d, footprint_s, footprint_d), materials.ASPHALT)
    color[scene.surfaces.material[samples.surface] == Material.SHADOW] *= _SHADOW
    return color


def _shade_round(scene: Scene, T_world_cam: Float, kind: Material, samples: Samples) -> Map:
    """Leaves on ellipsoids, bark and metal on cylinders."""
    surfaces = scene.surfaces
    centres = np.concatenate([surfaces.ellipsoids[:, :3], surfaces.cylinders[:, [0, 0, 1]] * [1, 0, 1]])
    radii = np.concatenate([surfaces.ellipsoids[:, 3:], surfaces.cylinders[:, [2, 2, 2]]]).astype(np.float32)
    k = samples.surface - surfaces.first_ellipsoid
    directions = samples.rays @ T_world_cam[:3, :3].T.astype(np.float32)
    hit = directions * samples.distance[:, None] + (T_world_cam[:3, 3] - centres).astype(np.float32)[k]
    radii = radii[k]
    cylinder = samples.surface >= surfaces.first_cylinder
    normal = hit / radii**2
    normal[cylinder, 1] = 0.0
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    angle = np.arctan2(hit[:, 0] / radii[:, 0], hit[:, 2] / radii[:, 2])
    extent = samples.spacing * samples.distance
    slant = np.abs(np.einsum("ni,ni->n", normal, directions)) / np.linalg.norm(directions, axis=1)
    patch = Patch(
        u=angle * radii[:, 0],
        v=-hit[:, 1],
        footprint_u=extent / np.maximum(slant, np.float32(0.1)),
        footprint_v=extent * np.where(cylinder, np.float32(1.0), np.float32(1.3)),
        extent_u=radii[:, 0],
        extent_v=radii[:, 1],
        albedo=surfaces.albedo[samples.surface],
        offset=surfaces.offset[samples.surface],
        variant=surfaces.variant[samples.surface],
    )
    color = materials.leaves(patch) if kind == Material.LEAVES else materials.bark(patch)
    return scene.colored(color, patch.albedo) * _light(normal)[:, None]


def _shade_sky(T_world_cam: Float, samples: Samples) -> Map:
    directions = samples.rays @ T_world_cam[:3, :3].T.astype(np.float32)
    elevation = np.arctan2(-directions[:, 1], np.hypot(directions[:, 0], directions[:, 2]))
    return materials.sky(np.arctan2(directions[:, 0], directions[:, 2]), elevation, samples.spacing)
