"""The street's images, depth, poses and LiDAR agree with each other as a real camera's would."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from bench.errors import BenchError
from bench.street.casting import cast, pinhole_rays
from bench.street.surfaces import SurfaceList, freeze
from bench.types import Float, Image, Map, Mask, StereoCamera
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


@pytest.fixture(scope="module")
def circuit() -> Street:
    """One lap and a bit more at 3 m per frame: frame 80 + k is where frame k is, one lap later."""
    return Street(StreetConfig(frames=110, width=480, height=144, speed_m=3.0, circuit_m=240))


@pytest.mark.parametrize("position", [2, 12, 27])
def test_second_lap_shows_the_same_world(circuit: Street, position: int) -> None:
    """Depth and exact poses take the frame one lap later to this one; the car is not at quite the same place."""
    T, later = circuit.ground_truth().T_world_cam, position + 80
    motion = np.linalg.inv(T[later]) @ T[position]
    assert 0.01 < np.linalg.norm(motion[:3, 3]) < 0.6
    image, depth = circuit.frame(position).left, circuit.true_depth(position)
    other = circuit.frame(later).left
    difference = photometric_difference(circuit.camera, image, depth, other, motion)
    assert len(difference) > 0.5 * image.shape[0] * image.shape[1]
    assert np.median(difference) < 2.5
    assert np.quantile(difference, 0.95) < 18.0
    astray = motion.copy()
    astray[0, 3] += 0.3
    assert np.median(photometric_difference(circuit.camera, image, depth, other, astray)) > 1.3 * np.median(difference)


def test_circuit_closes_and_turns_once_around(circuit: Street) -> None:
    T = circuit.ground_truth().T_world_cam
    heading = np.unwrap(np.arctan2(T[:, 0, 2], T[:, 2, 2]))
    assert abs(heading[80] - heading[0]) == pytest.approx(2 * np.pi, abs=0.05)
    assert np.linalg.norm(T[80, :3, 3] - T[0, :3, 3]) < 0.6
    # Two sides of the block are at least 60 m apart: houses fit back to back.
    assert np.ptp(T[:80, 0, 3]) > 55.0
    assert np.ptp(T[:80, 2, 3]) > 55.0


def test_what_a_circuit_leaves_out_would_not_be_seen() -> None:
    """The depth from the chunks that are looked at is the depth from all of them."""
    street = Street(StreetConfig(frames=200, width=320, height=96, speed_m=4.0, circuit_m=600, seed=4))
    for position in (0, 31, 77, 120):
        everything = SurfaceList()
        for chunk in street._street.chunks.values():
            everything.extend(chunk)
        inverse = cast(pinhole_rays(street.camera, street._pose(position)), freeze(everything)).inverse_range
        near = inverse > 1 / 200.0
        np.testing.assert_array_equal(street.true_depth(position)[near], np.float32(1.0) / inverse[near])
        assert len(street._street.visible_chunks(street._arc_length(position))) < len(street._street.chunks)


def test_repeated_facades_look_the_same_30_m_on_and_the_ground_does_not() -> None:
    """As if the camera 30 m on were at the same place: the houses fit to the pixel, the road does not."""
    street = Street(
        StreetConfig(frames=60, width=480, height=144, speed_m=2.5, circuit_m=900, repeated_facades=True, seed=1)
    )
    position, later = 2, 14
    T = [street._pose(k) for k in (position, later)]
    s = [street._arc_length(k) for k in (position, later)]
    assert s[1] - s[0] == 30.0
    (x0, z0, heading), (x1, z1, other_heading) = (street._street.path.at(value) for value in s)
    assert heading == other_heading == 0.0
    on = np.eye(4)
    on[:3, 3] = x1 - x0, 0.0, z1 - z0
    image, depth = street.frame(position).left, street.true_depth(position)
    points = backproject(street.camera, depth) @ T[0][:3, :3].T + T[0][:3, 3]
    # On this side of the houses are cars, lamps and trees, and the next bend is far enough.
    is_front = (np.abs(points[..., 0]) > 8.4) & (points[..., 2] < z0 + 32.0) & (points[..., 1] < -0.3)
    is_road = (np.abs(points[..., 1]) < 1e-3) & (np.abs(points[..., 0]) < 3.0)
    difference = {}
    for name, where in (("front", is_front), ("road", is_road)):
        kept = np.where(where, depth, np.float32(np.nan))
        motion = np.linalg.inv(T[1]) @ on @ T[0]
        difference[name] = photometric_difference(street.camera, image, kept, street.frame(later).left, motion)
        assert len(difference[name]) > 2500
    assert np.median(difference["front"]) < 3.0
    assert np.median(difference["road"]) > 2 * np.median(difference["front"])


@pytest.mark.slow
def test_lorry_covers_about_half_and_moves() -> None:
    settings = {"frames": 45, "width": 480, "height": 144}
    empty = Street(StreetConfig(**settings))
    street = Street(StreetConfig(**settings, truck=True, truck_frames=(22, 30)))

    def covered(position: int) -> Mask:
        with np.errstate(invalid="ignore"):
            return ~(np.abs(street.true_depth(position) - empty.true_depth(position)) < 1e-3) & (
                ~empty.true_sky(position) | ~street.true_sky(position)
            )

    for position in (22, 26, 30):
        assert 0.35 < covered(position).mean() < 0.65
    assert not covered(0).any()
    np.testing.assert_array_equal(street.frame(0).left, empty.frame(0).left)
    # Exact depth joins left and right as before, the lorry included.
    frame, depth = street.frame(26), street.true_depth(26)
    to_right = np.linalg.inv(street.camera.T_left_right)
    assert np.median(photometric_difference(street.camera, frame.left, depth, frame.right, to_right)) < 2.5
    # The world is static and the lorry is not: camera motion explains the one and not the other.
    T = street.ground_truth().T_world_cam
    motion, following = np.linalg.inv(T[27]) @ T[26], street.frame(27).left
    lorry = covered(26)
    for where, low, high in ((lorry, 4.0, 255.0), (~lorry, 0.0, 2.5)):
        kept = np.where(where, depth, np.float32(np.nan))
        assert low < np.median(photometric_difference(street.camera, frame.left, kept, following, motion)) < high


@pytest.mark.parametrize("seed", range(4))
def test_lorry_never_runs_over_the_camera(seed: int) -> None:
    street = Street(
        StreetConfig(frames=240, width=64, height=32, circuit_m=240, truck=True, truck_frames=(5, 239), seed=seed)
    )
    assert min(np.nanmin(street.true_depth(position)) for position in range(0, 240, 6)) > 0.3


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"circuit_m": 200}, "dataset.circuit_m=200 is out of range; choose 240 to 6000 metres, or 0."),
        ({"circuit_m": 400}, "dataset.circuit_m=400 is no multiple of 30 metres, .* choose 390"),
        ({"truck_frames": (5, 2)}, r"dataset.truck_frames=\[5, 2\] must be \[first, last\]"),
        ({"frames": 0}, "dataset.frames=0"),
        ({"width": 10}, "dataset.width=10 .* 64 to 4096"),
        ({"height": 9000}, "dataset.height=9000"),
        ({"speed_m": -1.0}, "dataset.speed_m=-1.0"),
        ({"seed": -3}, "dataset.seed=-3"),
        ({"light": 1.5}, "dataset.light=1.5"),
    ],
)
def test_settings_out_of_range(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(BenchError, match=message):
        Street(StreetConfig(**settings))


def test_exposure_jumps_in_both_cameras_alike_and_stays_for_some_frames() -> None:
    size: dict[str, Any] = {"width": 64, "height": 32, "seed": 2}
    plain, jumping = (
        Street(StreetConfig(frames=12, **size)),
        Street(StreetConfig(frames=12, exposure_jumps=0.3, **size)),
    )
    assert jumping.label == "street/2-exposure"
    np.testing.assert_array_equal(jumping.frame(0).left, plain.frame(0).left)
    found = []
    for k in range(12):
        frames = plain.frame(k), jumping.frame(k)
        (left, right), (new_left, new_right) = ([f.left.astype(float), f.right.astype(float)] for f in frames)
        inside = (new_left > 0) & (new_left < 255)
        gain, bias = np.polyfit(left[inside], new_left[inside], 1)
        assert np.abs(np.clip(gain * right + bias, 0, 255) - new_right).max() < 2
        assert 0.69 < gain < 1.31
        assert abs(bias) < 8
        found.append(round(float(gain), 2))
    assert 3 <= len(set(found)) <= 8
    longer = Street(StreetConfig(frames=30, exposure_jumps=0.3, **size))
    np.testing.assert_array_equal(longer.frame(11).left, jumping.frame(11).left)


def test_dark_and_noisy_and_blurred() -> None:
    """Dark: a share of each level. Noise: of its own everywhere. Blurred: the mean of instants, which a drive of a 32nd
    of the speed passes by in whole frames."""
    size: dict[str, Any] = {"frames": 6, "width": 96, "height": 32}
    clean = Street(StreetConfig(**size)).frame(4)
    street = Street(StreetConfig(**size, light=0.25, noise=2.0))
    assert street.label == "street/0-dark-noise"
    noisy, longer = street.frame(4), Street(StreetConfig(**(size | {"frames": 9}), light=0.25, noise=2.0)).frame(4)
    np.testing.assert_array_equal(noisy.right, longer.right)
    off = [seen.astype(float) - 0.25 * was for seen, was in ((noisy.left, clean.left), (noisy.right, clean.right))]
    assert np.std(off) == pytest.approx(2.0, rel=0.03)
    assert abs(np.corrcoef(off[0].ravel(), off[1].ravel())[0, 1]) < 0.05
    slow = Street(StreetConfig(**(size | {"frames": 140}), speed_m=1 / 32))
    mean = np.mean([slow.frame(position).left for position in range(121, 136, 2)], axis=0)
    blurred = Street(StreetConfig(**size, shutter=0.5))
    np.testing.assert_array_equal(blurred.frame(4).left, np.round(mean))
    sharp = Street(StreetConfig(**size)).frame(0).left
    assert 0 < np.abs(blurred.frame(0).left.astype(float) - sharp).mean() < 20


def test_plain_surfaces_have_one_colour_each() -> None:
    """Of the road and a parked car, all but their shade and the mixtures at outlines."""
    size: dict[str, Any] = {"frames": 6, "width": 240, "height": 72}
    usual, plain, half = (Street(StreetConfig(**size, texture=share)) for share in (1.0, 0.0, 0.5))
    np.testing.assert_array_equal(usual.true_depth(2), plain.true_depth(2))
    textured, even, between = (street.frame(2).left for street in (usual, plain, half))
    road = np.s_[60:, 80:160]
    assert len(np.unique(textured[road].reshape(-1, 3), axis=0)) > 100
    assert len(np.unique(even[road].reshape(-1, 3), axis=0)) < 12
    assert np.abs(between.astype(float) - (textured.astype(float) + even) / 2)[road].max() <= 1


@pytest.mark.parametrize(("position", "nearest", "furthest"), [(0, 6.5, 7.1), (10, 8.0, 10.0)])
def test_traffic_drives(position: int, nearest: float, furthest: float) -> None:
    """The rear of the car ahead is half a car nearer than 9 m at first, and 3 m more, along the bend, later."""
    settings: dict[str, Any] = {"frames": 11, "width": 96, "height": 32}
    empty, busy = (Street(StreetConfig(**settings, traffic=on)).true_depth(position) for on in (False, True))
    cars = busy < np.nan_to_num(empty, nan=np.inf) - 0.1
    assert 0.02 < cars.mean() < 0.3
    assert nearest < busy[cars].min() < furthest


def test_a_small_motion_can_be_asked_for() -> None:
    """2 cm and half a degree a frame, to and fro within 15 degrees, whatever the car's own pitch and roll do."""
    street = Street(StreetConfig(frames=100, width=64, height=32, speed_m=0.02, pan_deg=0.5))
    T = street.ground_truth().T_world_cam
    steps = np.linalg.inv(T[:-1]) @ T[1:]
    turned = np.rad2deg(np.arccos((np.trace(steps[:, :3, :3], axis1=1, axis2=2) - 1) / 2))
    assert np.linalg.norm(steps[:, :3, 3], axis=1) == pytest.approx(0.02, rel=0.05)
    assert turned == pytest.approx(0.5, abs=0.01)
    heading = np.rad2deg(np.arctan2(T[:, 0, 2], T[:, 2, 2]))
    assert (heading.max(), heading.min()) == (pytest.approx(15, abs=0.2), pytest.approx(-15, abs=0.2))
    np.testing.assert_array_equal(street.sensor_depth(3), street.true_depth(3))
