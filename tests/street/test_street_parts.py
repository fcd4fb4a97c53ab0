"""Parts of the street against textbook calculations: path, ray casting, filtered textures."""

from __future__ import annotations

import numpy as np
import pytest

from bench.street.casting import cast, pinhole_rays
from bench.street.circuit import CircuitPath
from bench.street.path import StreetPath
from bench.street.scene import build_street
from bench.street.surfaces import Surfaces
from bench.street.textures import band, sample_noise, stripes
from bench.types import StereoCamera

CAMERA = StereoCamera(160, 48, 91.0, 91.0, 79.5, 23.5, (0.54, 0.0, 0.0))


def test_path_is_smooth_and_has_unit_speed() -> None:
    path = StreetPath(np.random.default_rng(3), -30.0, 400.0)
    s = np.arange(-25.0, 395.0, 0.01)
    x, z, heading = np.array([path.at(value) for value in s]).T
    step = np.stack([np.diff(x), np.diff(z)]) / 0.01
    middle = (heading[1:] + heading[:-1]) / 2
    np.testing.assert_allclose(step, [np.sin(middle), np.cos(middle)], atol=1e-4)
    assert np.abs(np.diff(heading)).max() < 0.01 / 20.0
    assert np.ptp(heading) > np.deg2rad(40.0)


@pytest.mark.parametrize("seed", range(6))
def test_circuit_is_smooth_closes_and_has_unit_speed(seed: int) -> None:
    path = CircuitPath(np.random.default_rng(seed), 420.0)
    s = np.arange(0.0, 421.0, 0.01)
    x, z, heading = np.array([path.at(value) for value in s]).T
    heading = np.unwrap(heading)
    step = np.stack([np.diff(x), np.diff(z)]) / 0.01
    middle = (heading[1:] + heading[:-1]) / 2
    np.testing.assert_allclose(step, [np.sin(middle), np.cos(middle)], atol=1e-4)
    assert abs(heading[42_000] - heading[0]) == pytest.approx(2 * np.pi)
    np.testing.assert_allclose([x[42_000], z[42_000]], [0.0, 0.0], atol=1e-9)
    # Four straights and four bends of 90 degrees.
    bends = np.diff(np.abs(np.diff(heading)) > 1e-9)
    assert np.count_nonzero(bends) == 8


def test_every_point_near_a_circuit_is_located() -> None:
    path = CircuitPath(np.random.default_rng(2), 300.0)
    rng = np.random.default_rng(0)
    s, d = rng.uniform(0.0, 300.0, 20_000), rng.uniform(-12.0, 12.0, 20_000)
    points = np.array([path.beside(*pair) for pair in zip(s, d, strict=True)])
    s_found, d_found, _ = path.locate(*points[:, :2].T.astype(np.float32), 0.0, 0.0)
    np.testing.assert_allclose((s_found - s + 150.0) % 300.0, 150.0, atol=3e-3)
    np.testing.assert_allclose(d_found, d, atol=3e-3)


def test_locate_undoes_beside() -> None:
    path = StreetPath(np.random.default_rng(5), -30.0, 300.0)
    rng = np.random.default_rng(0)
    s, d = rng.uniform(-20.0, 250.0, 500), rng.uniform(-9.0, 9.0, 500)
    points = np.array([path.beside(*pair) for pair in zip(s, d, strict=True)])
    s_found, d_found, heading = path.locate(*points[:, :2].T.astype(np.float32), -40.0, 300.0)
    np.testing.assert_allclose(s_found, s, atol=2e-3)
    np.testing.assert_allclose(d_found, d, atol=2e-3)
    np.testing.assert_allclose(heading, points[:, 2], atol=1e-4)


def _moller_trumbore(origin: np.ndarray, ray: np.ndarray, corners: np.ndarray) -> float:
    """Smallest range of a ray with the triangles (0, 1, 2) and (0, 2, 3) of polygons (P, 4, 3)."""
    best = np.inf
    for a, b, c in ((0, 1, 2), (0, 2, 3)):
        e1, e2 = corners[:, b] - corners[:, a], corners[:, c] - corners[:, a]
        p = np.cross(ray, e2)
        det = np.einsum("ij,ij->i", e1, p)
        with np.errstate(all="ignore"):
            t_vec = origin - corners[:, a]
            u = np.einsum("ij,ij->i", t_vec, p) / det
            q = np.cross(t_vec, e1)
            v = q @ ray / det
            t = np.einsum("ij,ij->i", e2, q) / det
            hit = (np.abs(det) > 1e-12) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        best = min(best, t[hit].min(initial=np.inf))
    return best


def _round(origin: np.ndarray, ray: np.ndarray, surfaces: Surfaces) -> float:
    """Smallest range with the ellipsoids and the cylinders, by the quadratic formula in world coordinates."""
    best = np.inf
    for cx, cy, cz, rx, ry, rz in surfaces.ellipsoids:
        o, w = (origin - (cx, cy, cz)) / (rx, ry, rz), ray / (rx, ry, rz)
        roots = np.roots([w @ w, 2 * o @ w, o @ o - 1])
        if np.isreal(roots).all() and roots.real.min() > 0:
            best = min(best, roots.real.min())
    for x, z, radius, height in surfaces.cylinders:
        o, w = (origin - (x, 0, z))[[0, 2]] / radius, ray[[0, 2]] / radius
        roots = np.roots([w @ w, 2 * o @ w, o @ o - 1])
        if np.isreal(roots).all() and roots.real.min() > 0:
            t = roots.real.min()
            if -height <= origin[1] + t * ray[1] <= 0:
                best = min(best, t)
    return best


@pytest.mark.slow
def test_casting_against_moller_trumbore() -> None:
    street = build_street(1, 60.0)
    surfaces = street.seen_from(35.0)
    x, z, heading = street.path.beside(35.0, 1.6)
    yaw, pitch = heading + 0.3, 0.02
    R = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    R = R @ np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, (x, -1.65, z)
    hits = cast(pinhole_rays(CAMERA, T), surfaces)
    rng = np.random.default_rng(2)
    differ = 0
    for _ in range(250):
        row, column = rng.integers(CAMERA.height), rng.integers(CAMERA.width)
        ray = R @ [(column - CAMERA.cx) / CAMERA.fx, (row - CAMERA.cy) / CAMERA.fy, 1.0]
        ground = 1.65 / ray[1] if ray[1] > 0 else np.inf
        expected = min(ground, _moller_trumbore(T[:3, 3], ray, surfaces.corners), _round(T[:3, 3], ray, surfaces))
        expected = expected if expected < 1500.0 else np.inf
        got = 1.0 / hits.inverse_range[row, column] if hits.inverse_range[row, column] > 0 else np.inf
        differ += not np.isclose(got, expected, rtol=2e-5)
    # A ray through a silhouette may fall either way in float32.
    assert differ <= 1


def test_stripes_and_bands_are_box_averages() -> None:
    rng = np.random.default_rng(4)
    x, footprint = rng.uniform(-5, 5, 200), rng.uniform(0.02, 3.0, 200)
    fine = x[:, None] + footprint[:, None] * (np.arange(20_000) + 0.5 - 10_000) / 20_000
    np.testing.assert_allclose(band(x, 0.2, 1.1, footprint), ((fine > 0.2) & (fine < 1.1)).mean(axis=1), atol=2e-4)
    inside = np.abs(fine - 0.7 * np.rint(fine / 0.7)) < 0.15
    np.testing.assert_allclose(stripes(x, 0.7, 0.15, footprint), inside.mean(axis=1), atol=2e-4)


def test_noise_of_a_large_footprint_is_the_average_of_the_fine_noise() -> None:
    rng = np.random.default_rng(5)
    n, k = 60, 48
    u, v = rng.uniform(0, 20, (2, n)).astype(np.float32)
    for width, height in ((0.64, 0.01), (0.01, 0.32), (0.32, 0.64)):
        offsets = (np.arange(k) + 0.5) / k - 0.5
        du, dv = np.meshgrid(width * offsets, height * offsets)
        points_u, points_v = (u[:, None] + du.ravel()).ravel(), (v[:, None] + dv.ravel()).ravel()
        least = np.full(len(points_u), 0.001, dtype=np.float32)
        fine = sample_noise(points_u.astype(np.float32), points_v.astype(np.float32), least, least)
        averaged = fine.reshape(n, k * k, 3).mean(axis=1)
        direct = sample_noise(u, v, np.full(n, width, np.float32), np.full(n, height, np.float32))
        assert np.corrcoef(averaged.ravel(), direct.ravel())[0, 1] > 0.95
        assert 0.8 < direct.std() / averaged.std() < 1.2
    assert abs(fine.mean()) < 0.3
    assert 0.7 < fine.std() < 1.3
