"""The street's images, depth, poses and LiDAR agree with each other as a real camera's would."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bench.errors import BenchError
from bench.types import Float, Image, Map, StereoCamera
from plugins.datasets.street import Street, StreetConfig

POSITION = 7


@pytest.fixture(scope="module")
def street() -> Street:
    return Street(StreetConfig(frames=12, width=480, height=144))


def backproject(camera: StereoCamera, depth: Map) -> Float:
    """Points (H, W, 3) in the camera's frame of all pixels."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    return (
        np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
        * depth[..., None]
    )


def photometric_difference(camera: StereoCamera, image: Image, depth: Map, other: Image, T_other_cam: Float) -> Map:
    """Grey-level difference of ``image`` and ``other`` at the points that ``depth`` and the pose say are the same.

    Left out: what falls off the other image, what a nearer point hides there (own z-buffer), and depth edges.
    """
    points = backproject(camera, depth) @ T_other_cam[:3, :3].T + T_other_cam[:3, 3]
    with np.errstate(invalid="ignore"):
        u = camera.fx * points[..., 0] / points[..., 2] + camera.cx
        v = camera.fy * points[..., 1] / points[..., 2] + camera.cy
    ok = np.isfinite(u) & (u > 1) & (u < camera.width - 2) & (v > 1) & (v < camera.height - 2) & (points[..., 2] > 0.5)
    buffer = np.full((camera.height, camera.width), np.inf)
    at = np.rint(v[ok]).astype(int), np.rint(u[ok]).astype(int)
    np.minimum.at(buffer, at, points[..., 2][ok])
    # A surface seen closer up leaves holes in the buffer, through which a hidden one would show.
    buffer = cv2.erode(buffer, np.ones((5, 5)))
    hidden = np.zeros_like(ok)
    hidden[ok] = points[..., 2][ok] > 1.04 * buffer[at]
    filled = np.nan_to_num(depth, nan=1e4)
    edge = cv2.dilate(filled, np.ones((5, 5))) / cv2.erode(filled, np.ones((5, 5))) > 1.15
    there = cv2.remap(other, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR).astype(float)
    difference = np.abs(there - image).mean(axis=-1)
    return difference[ok & ~hidden & ~edge]


def check_photometric(street: Street, other: Image, T_other_cam: Float) -> None:
    image, depth = street.frame(POSITION).left, street.true_depth(POSITION)
    difference = photometric_difference(street.camera, image, depth, other, T_other_cam)
    assert len(difference) > 0.5 * image.shape[0] * image.shape[1]
    assert np.median(difference) < 2.5
    assert np.quantile(difference, 0.95) < 18.0
    # The check can tell: depth that is 4 % off fits far worse.
    wrong = photometric_difference(street.camera, image, depth * np.float32(1.04), other, T_other_cam)
    assert np.median(wrong) > 1.3 * np.median(difference)


def test_depth_takes_the_right_image_to_the_left(street: Street) -> None:
    check_photometric(street, street.frame(POSITION).right, np.linalg.inv(street.camera.T_left_right))


def test_depth_and_poses_take_the_next_image_to_this_one(street: Street) -> None:
    T = street.ground_truth().T_world_cam
    check_photometric(street, street.frame(POSITION + 1).left, np.linalg.inv(T[POSITION + 1]) @ T[POSITION])


def test_lidar_is_sparse_exact_and_in_64_beams(street: Street) -> None:
    lidar, depth = street.lidar_depth(POSITION), street.true_depth(POSITION)
    known = np.isfinite(lidar)
    np.testing.assert_array_equal(lidar[known], depth[known])
    assert 0.08 < known.mean() < 0.5
    assert lidar[known].max() <= 80.0
    # Elevation seen from the sensor, 0.3 m above and 0.27 m behind the camera: near one of the 64 beams.
    points = backproject(street.camera, lidar)[known] + [0.0, 0.3, 0.27]
    far = points[:, 2] > 6.0
    elevation = np.rad2deg(np.arctan2(-points[:, 1], np.hypot(points[:, 0], points[:, 2])))[far]
    beams = np.linspace(2.0, -24.8, 64)
    off = np.abs(elevation[:, None] - beams).min(axis=1)
    # Half a pixel is 0.1 degrees here, the beams are 0.43 degrees apart.
    assert np.quantile(off, 0.95) < 0.13
    assert (np.abs(elevation[:, None] - beams) < 0.13).any(axis=0).sum() > 25


def test_sky_is_where_there_is_no_depth(street: Street) -> None:
    sky = street.true_sky(POSITION)
    assert 0.02 < sky.mean() < 0.4
    assert not sky[street.camera.height // 2 :].any()
    image = street.frame(POSITION).left
    assert image[sky].mean() > image[~sky].mean() + 40


def test_drive_has_turns_and_keeps_its_speed(street: Street) -> None:
    truth = Street(StreetConfig(frames=60, width=64, height=32, speed_m=0.9)).ground_truth()
    np.testing.assert_allclose(truth.T_world_cam[0], np.eye(4), atol=1e-12)
    steps = np.linalg.norm(np.diff(truth.T_world_cam[:, :3, 3], axis=0), axis=1)
    # The lane is beside the centre line: longer outside a bend, shorter inside.
    np.testing.assert_allclose(steps, 0.9, atol=0.08)
    heading = np.rad2deg(np.arctan2(truth.T_world_cam[:, 0, 2], truth.T_world_cam[:, 2, 2]))
    assert np.ptp(heading) > 15.0


def test_same_seed_same_frames_however_long_the_drive(street: Street) -> None:
    longer = Street(StreetConfig(frames=70, width=480, height=144))
    one, other = street.frame(POSITION), longer.frame(POSITION)
    np.testing.assert_array_equal(one.left, other.left)
    np.testing.assert_array_equal(one.right, other.right)
    np.testing.assert_array_equal(street.lidar_depth(POSITION), longer.lidar_depth(POSITION))
    different = Street(StreetConfig(frames=12, width=480, height=144, seed=1)).frame(POSITION)
    assert np.abs(one.left.astype(int) - different.left).mean() > 20


def test_number_of_threads_changes_nothing(street: Street) -> None:
    threads = cv2.getNumThreads()
    two = street.frame(POSITION).left
    try:
        cv2.setNumThreads(1)
        np.testing.assert_array_equal(street.frame(POSITION).left, two)
    finally:
        cv2.setNumThreads(threads)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"frames": 0}, "dataset.frames=0"),
        ({"width": 10}, "dataset.width=10 .* 64 to 4096"),
        ({"height": 9000}, "dataset.height=9000"),
        ({"speed_m": -1.0}, "dataset.speed_m=-1.0"),
        ({"seed": -3}, "dataset.seed=-3"),
    ],
)
def test_settings_out_of_range(settings: dict[str, int], message: str) -> None:
    with pytest.raises(BenchError, match=message):
        Street(StreetConfig(**settings))
