"""Seeds lie where the depth says, face as the surface does, and appear only where the map explains nothing yet."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from bench.gaussians.parameters import NamedParameters
from bench.gaussians.seeding import SeedingConfig, depth_to_seed_from, fill_inverse_depth, seed_gaussians
from bench.types import DepthMap, Keyframe, PinholeView, StereoFrame

H, W = 24, 40
ROTATION = cv2.Rodrigues(np.array([0.2, -0.4, 0.1]))[0]
T_WORLD_CAM = np.vstack([np.column_stack([ROTATION, [3.0, -1.0, 7.0]]), [0, 0, 0, 1]])
VIEW = PinholeView(T_WORLD_CAM, 50.0, 55.0, 18.0, 13.0, W, H)
PLAIN = SeedingConfig(
    stride=1, size=0.6, thickness=0.2, opacity=0.5, fill_holes=False, sky_distance_m=0.0, ground=False, margin=0.0
)
ALL = np.ones((H, W), bool)
RNG = np.random.default_rng(0)
IMAGE = RNG.integers(0, 256, (H, W, 3), dtype=np.uint8)


def back_projected(row: int, column: int, depth: float) -> np.ndarray:
    """World point of a pixel, by solving the projection: K R^T (p - t) is depth * (column, row, 1)."""
    K = np.array([[50.0, 0, 18.0], [0, 55.0, 13.0], [0, 0, 1]])
    return np.linalg.solve(K @ ROTATION.T, depth * np.array([column, row, 1.0])) + T_WORLD_CAM[:3, 3]


def axes_of(quaternions: torch.Tensor) -> np.ndarray:
    """Rotation matrices (N, 3, 3) by OpenCV's Rodrigues, from w, x, y, z."""
    out = []
    for w, x, y, z in quaternions.double().numpy():
        vector = np.array([x, y, z])
        size = np.linalg.norm(vector)
        angle = 2 * np.arctan2(size, w)
        out.append(cv2.Rodrigues(vector / max(size, 1e-12) * angle)[0])
    return np.array(out)


def plane_depth(normal: np.ndarray, distance: float) -> np.ndarray:
    """Depth of the plane n . p = distance in the camera's frame."""
    x, y = (np.arange(W) - 18.0) / 50.0, (np.arange(H) - 13.0) / 55.0
    return (distance / (normal[0] * x[None, :] + normal[1] * y[:, None] + normal[2])).astype(np.float32)


def test_means_colors_and_depths_at_known_points() -> None:
    depth = RNG.uniform(2, 30, (H, W)).astype(np.float32)
    planes, depths, _ = seed_gaussians(IMAGE, depth, None, ALL, VIEW, PLAIN)
    seeds = NamedParameters(planes)
    assert planes.shape == (14, H * W)
    assert planes.dtype == torch.float32
    for row, column in ((0, 0), (5, 17), (23, 39), (11, 3)):
        k = row * W + column
        np.testing.assert_allclose(seeds.means[k], back_projected(row, column, float(depth[row, column])), rtol=1e-5)
        np.testing.assert_allclose(seeds.colors[k], IMAGE[row, column] / 255.0, atol=1e-6)
        assert float(depths[k]) == pytest.approx(float(depth[row, column]), rel=1e-6)
    np.testing.assert_allclose(seeds.opacities, 0.5, atol=1e-6)


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, -0.8, 0.6), (0.36, 0.48, 0.8)])
def test_size_and_orientation_on_a_plane(normal: tuple[float, float, float]) -> None:
    """A disc lies in the plane: its thin axis is the plane's normal, its size that of the pixel's footprint."""
    depth = plane_depth(np.array(normal), 8.0)
    assert depth.min() > 0
    seeds = NamedParameters(seed_gaussians(IMAGE, depth, None, ALL, VIEW, PLAIN)[0])
    inside = np.zeros((H, W), bool)
    inside[4:-4, 4:-4] = True  # nearer to the border the smoothing sees mirrored depth
    thin = axes_of(seeds.quaternions[torch.from_numpy(inside.ravel())])[:, :, 2]
    wanted = ROTATION @ np.array(normal)
    np.testing.assert_allclose(np.abs(thin @ wanted), 1.0, atol=2e-5)
    sigma = 0.6 * depth.ravel() / 50.0
    np.testing.assert_allclose(seeds.scales, np.stack([sigma, sigma, 0.2 * sigma], 1), rtol=1e-5)


def test_stride_takes_every_other_pixel_and_doubles_the_size() -> None:
    depth = np.full((H, W), 10.0, np.float32)
    config = replace(PLAIN, stride=2)
    planes, *_ = seed_gaussians(IMAGE, depth, None, ALL, VIEW, config)
    assert planes.shape[1] == (H // 2) * (W // 2)
    np.testing.assert_allclose(NamedParameters(planes).scales[:, 0], 0.6 * 2 * 10.0 / 50.0, rtol=1e-5)
    np.testing.assert_allclose(NamedParameters(planes).means[1], back_projected(0, 2, 10.0), rtol=1e-5)


def test_only_where_unexplained_and_only_where_depth_is_known() -> None:
    depth = np.full((H, W), 10.0, np.float32)
    depth[:, :7] = np.nan
    unexplained = np.zeros((H, W), bool)
    unexplained[3, 2:10] = True
    planes, *_ = seed_gaussians(IMAGE, depth, None, unexplained, VIEW, PLAIN)
    expected = [back_projected(3, column, 10.0) for column in (7, 8, 9)]
    np.testing.assert_allclose(NamedParameters(planes).means, expected, rtol=1e-5)


def test_holes_get_seeds_when_asked_for() -> None:
    """A hole in a plane of constant depth is filled with that depth."""
    depth = np.full((H, W), 10.0, np.float32)
    depth[8:14, 10:20] = np.nan
    config = replace(PLAIN, fill_holes=True)
    planes, depths, _ = seed_gaussians(IMAGE, depth, None, ALL, VIEW, config)
    assert planes.shape[1] == H * W
    np.testing.assert_allclose(depths, 10.0, rtol=1e-5)


def test_sky_lies_at_the_distance_asked_for_and_faces_the_camera() -> None:
    depth = np.full((H, W), 10.0, np.float32)
    sky = np.zeros((H, W), bool)
    sky[:6] = True
    depth[:6] = np.nan
    config = replace(PLAIN, sky_distance_m=150.0)
    planes, depths, _ = seed_gaussians(IMAGE, depth, sky, ALL, VIEW, config)
    seeds = NamedParameters(planes)
    assert planes.shape[1] == H * W
    of_sky = torch.from_numpy(sky.ravel())
    np.testing.assert_allclose(depths[of_sky], 150.0, rtol=1e-6)
    rays = (seeds.means[of_sky].double().numpy() - T_WORLD_CAM[:3, 3]) @ ROTATION
    np.testing.assert_allclose(rays[:, 2], 150.0, rtol=1e-5)
    thin = axes_of(seeds.quaternions[of_sky])[:, :, 2] @ ROTATION
    cosine = np.abs((thin * rays).sum(1)) / np.linalg.norm(rays, axis=1)
    np.testing.assert_allclose(cosine, 1.0, atol=1e-5)


@pytest.mark.parametrize("fill", [False, True])
def test_no_sky_gaussians_when_not_asked_for(fill: bool) -> None:
    """Not even where stereo (wrongly) knows a depth, or a hole is filled."""
    depth = np.full((H, W), 10.0, np.float32)
    depth[:3] = np.nan
    sky = np.zeros((H, W), bool)
    sky[:6] = True
    config = replace(PLAIN, fill_holes=fill)
    planes, *_ = seed_gaussians(IMAGE, depth, sky, ALL, VIEW, config)
    assert planes.shape[1] == (H - 6) * W


@pytest.mark.parametrize("fill", [False, True])
def test_a_frame_without_any_depth_gives_no_seeds(fill: bool) -> None:
    depth = np.full((H, W), np.nan, np.float32)
    config = replace(PLAIN, fill_holes=fill)
    planes, depths, _ = seed_gaussians(IMAGE, depth, None, ALL, VIEW, config)
    assert planes.shape == (14, 0)
    assert depths.shape == (0,)


def test_fill_inverse_depth_keeps_what_is_known_and_fills_all() -> None:
    rng = np.random.default_rng(2)
    inverse = rng.uniform(0.02, 0.5, (30, 50)).astype(np.float32)
    known = rng.random((30, 50)) < 0.4
    known[:, 20:40] = False  # wider than the first window
    filled = fill_inverse_depth(inverse, known)
    np.testing.assert_array_equal(filled[known], inverse[known])
    assert (filled[~known] >= inverse[known].min()).all()
    assert (filled[~known] <= inverse[known].max()).all()


def test_fill_inverse_depth_by_hand() -> None:
    """A single hole is the mean of the known pixels in the 7x7 window around it; far outside, windows grow."""
    inverse = np.zeros((15, 15), np.float32)
    known = np.zeros((15, 15), bool)
    for (row, column), value in {(6, 6): 0.1, (8, 9): 0.4, (0, 0): 0.9}.items():
        inverse[row, column], known[row, column] = value, True
    filled = fill_inverse_depth(inverse, known)
    assert filled[7, 7] == pytest.approx(0.25)  # (6, 6) and (8, 9) lie within 3 pixels
    assert filled[14, 14] == pytest.approx(0.4)  # the next window is 15x15 and reaches (8, 9) only


def test_fill_inverse_depth_with_nothing_known() -> None:
    empty = np.zeros((9, 9), np.float32)
    assert not fill_inverse_depth(empty, empty.astype(bool)).any()


def test_the_margin_goes_on_with_the_borders_depth_and_colour() -> None:
    """A tenth of 40 columns: 4 more on each side, at the depth and with the colour of the first and last column."""
    depth = RNG.uniform(2, 30, (H, W)).astype(np.float32)
    config = replace(PLAIN, margin=0.1)
    unexplained = np.zeros((H, W + 8), bool)
    unexplained[5, :4], unexplained[7, -4:] = True, True
    planes, depths, _ = seed_gaussians(IMAGE, depth, None, unexplained, VIEW, config)
    seeds = NamedParameters(planes)
    places = [(5, 0, -4), (5, 0, -3), (5, 0, -2), (5, 0, -1), *((7, 39, column) for column in range(40, 44))]
    for k, (row, of, column) in enumerate(places):
        z = float(depth[row, of])
        assert float(depths[k]) == pytest.approx(z, rel=1e-6)
        np.testing.assert_allclose(seeds.means[k], back_projected(row, column, z), rtol=1e-5)
        np.testing.assert_allclose(seeds.colors[k], IMAGE[row, of] / 255.0, atol=1e-6)
    assert float(seeds.opacities.min()) > 0.8


def test_holes_are_not_filled_below_the_ground() -> None:
    """A road 1.5 m below the camera and a wall 60 m ahead; stereo lost a part of the road beside the wall's foot."""
    view = PinholeView(np.eye(4), 120.0, 120.0, 79.5, 39.5, 160, 120)
    slope = (np.arange(120, dtype=np.float32) - 39.5) / 120.0
    with np.errstate(divide="ignore"):
        truth = np.repeat(np.minimum(np.where(slope > 0, 1.5 / slope, np.inf), 60.0)[:, None], 160, axis=1)
    truth = truth.astype(np.float32)
    hole = np.zeros((120, 160), bool)
    hole[43:110, 100:] = True
    depth = np.where(hole, np.nan, truth).astype(np.float32)

    def error(ground: bool) -> float:
        config = replace(PLAIN, fill_holes=True, ground=ground)
        picture = np.zeros((120, 160, 3), np.uint8)
        depths = seed_gaussians(picture, depth, None, np.ones((120, 160), bool), view, config)[1].reshape(120, 160)
        np.testing.assert_allclose(depths[~hole], truth[~hole], rtol=1e-6)
        too_far = depths.numpy()[hole] / truth[hole]
        return float(too_far.max())

    assert error(ground=False) > 1.5
    assert error(ground=True) < 1.05


def test_how_far_depth_seeds_is_a_setting_of_its_own() -> None:
    depth = np.array([[0.2, 1.0, 70.0, 90.0, 150.0, np.nan]], np.float32)
    sky = np.array([[False, True, False, False, False, False]])
    keyframe = Keyframe(StereoFrame(0, 0.0, IMAGE[:1, :6]), DepthMap(depth, "by hand"), sky, np.eye(4))
    for furthest, seeded in ((0.0, [70.0]), (120.0, [70.0, 90.0])):
        got = depth_to_seed_from(keyframe, (0.5, 80.0), SeedingConfig(max_depth_m=furthest))
        assert got[np.isfinite(got)].tolist() == seeded
