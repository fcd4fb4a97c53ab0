"""KITTI-360: poses, cameras and LiDAR worked by hand, frames without poses, and every way a root can be wrong."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.config import compose_run
from bench.errors import BenchError
from bench.registry import build
from bench.tables.named.definitions import cells
from bench.tables.named.find import named_table
from bench.tables.named.overrides import row_of
from bench.tables.named.published import read_sequences
from plugins.datasets.kitti360 import Kitti360, Kitti360Config
from tests.datasets.kitti360_disk import (
    ANGLE,
    BF,
    CAM_TO_VELO,
    CX,
    CY,
    HEIGHT,
    R_RECT,
    WIDTH,
    F,
    drive_of,
    noise,
    vehicle_pose,
    write_calibration,
    write_images,
    write_kitti360,
    write_poses,
    write_scan,
)


def open_kitti360(root: Path, **settings: Any) -> Kitti360:
    return Kitti360(Kitti360Config(root=str(root), **{"sequence": "0002", **settings}))


def truth_of(dataset: Kitti360) -> np.ndarray:
    truth = dataset.ground_truth()
    assert truth is not None
    assert truth.numbers.tolist() == list(dataset.numbers)
    return truth.T_world_cam


def test_camera_is_the_published_one(tmp_path: Path) -> None:
    write_calibration(tmp_path)
    write_images(tmp_path, "0007", range(2), noise(WIDTH, HEIGHT))
    dataset = open_kitti360(tmp_path, sequence="7")
    camera = dataset.camera
    assert dataset.label == "kitti360/0007"
    assert (camera.width, camera.height) == (1408, 376)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (F, F, CX, CY)
    # The baseline that the data set states.
    np.testing.assert_allclose(camera.right_position, (0.594184, 0.0, 0.0), atol=1e-6)
    frame = dataset.frame(1)
    np.testing.assert_array_equal(frame.left[..., ::-1], noise(WIDTH, HEIGHT)(1, 0))
    np.testing.assert_array_equal(frame.right[..., ::-1], noise(WIDTH, HEIGHT)(1, 1))
    assert dataset.ground_truth() is None
    assert dataset.lidar_depth(0) is None


@pytest.mark.parametrize("missing", ["nothing", "cam0_to_world.txt", "poses.txt"])
def test_a_point_is_seen_where_hand_calculation_puts_it(tmp_path: Path, missing: str) -> None:
    """The vehicle goes 5 m north, then stands where it began, turned to the east.

    The camera is 1.5 m ahead of and 0.6 m above the vehicle's origin; rectifying turns it by ANGLE, so that its axis
    points ANGLE west of north. P lies 20 m along the axis of the first frame.
    """
    write_kitti360(tmp_path, ids=range(4), size=(64, 24))
    write_poses(
        tmp_path,
        "0002",
        {1: vehicle_pose(100, 200), 2: vehicle_pose(100, 205), 3: vehicle_pose(100, 200, heading=0.0)},
    )
    if missing != "nothing":
        (tmp_path / "data_poses" / drive_of("0002") / missing).unlink()
    dataset = open_kitti360(tmp_path)
    T = truth_of(dataset)
    s, c = np.sin(ANGLE), np.cos(ANGLE)
    np.testing.assert_array_equal(T[0], np.eye(4))
    first = np.array([0.0, 0.0, 20.0, 1.0])
    # North is (s, 0, c) in the rectified camera: 5 m less of it.
    north = np.array([-5 * s, 0.0, 20 - 5 * c])
    np.testing.assert_allclose((np.linalg.inv(T[1]) @ first)[:3], north, atol=1e-9)
    # P - C in the world is (-1.5 - 20 s, 1.5 + 20 c, 0); facing east, x is -(north) and z is east; then R_RECT.
    east = R_RECT @ np.array([-(1.5 + 20 * c), 0.0, -1.5 - 20 * s])
    np.testing.assert_allclose((np.linalg.inv(T[2]) @ first)[:3], east, atol=1e-9)
    camera = dataset.camera
    u = F * north[0] / north[2] + CX
    right = camera.intrinsics @ (north - camera.right_position)
    assert right[0] / right[2] == pytest.approx(u - BF / north[2], abs=1e-9)


def test_lidar_point_through_the_whole_chain(tmp_path: Path) -> None:
    """A point at (2, 1, 10) m of the rectified camera, taken to the LiDAR forwards, without any inverse."""
    write_calibration(tmp_path)
    write_images(tmp_path, "0002", [3, 4], noise(WIDTH, HEIGHT), lines=5)
    rectified = np.array([[2.0, 1.0, 10.0], [-6.0, -0.5, 30.0]])
    cam0 = rectified @ R_RECT
    velodyne = cam0 @ CAM_TO_VELO[:, :3].T + CAM_TO_VELO[:, 3]
    assert (velodyne[:, 0] > 5).all()
    write_scan(tmp_path, "0002", 4, velodyne)
    dataset = open_kitti360(tmp_path)
    assert dataset.lidar_depth(0) is None
    depth = dataset.lidar_depth(1)
    assert depth is not None
    # u = 552.55 * 2 / 10 + 682.05 = 792.56, v = 552.55 / 10 + 238.77 = 294.02; 571.54 and 229.56.
    assert {tuple(pixel) for pixel in np.argwhere(np.isfinite(depth)).tolist()} == {(294, 793), (230, 572)}
    assert depth[294, 793] == pytest.approx(10.0, abs=1e-5)
    assert depth[230, 572] == pytest.approx(30.0, abs=1e-5)


def scan_of_a_moving_car(
    world: np.ndarray, T_left_velo: np.ndarray, pose_at: Callable[[float], np.ndarray]
) -> np.ndarray:
    """What a LiDAR measures that turns clockwise once a frame: of each point, at the time when it faces that point.

    ``pose_at(t)`` is the left camera at time t in frames; the LiDAR faces ahead at 0 and the left before.
    """
    measured = []
    for point in world:
        time = 0.0
        for _ in range(60):
            seen = np.linalg.inv(pose_at(time) @ T_left_velo) @ [*point, 1.0]
            time = -np.arctan2(seen[1], seen[0]) / (2 * np.pi)
        measured.append(seen[:3])
    return np.array(measured)


def test_scan_is_taken_to_the_moment_of_the_image(tmp_path: Path) -> None:
    """The car drives 1 m per frame and turns 2 degrees; an image's pixels then are those of where the points are."""
    write_calibration(tmp_path)
    write_images(tmp_path, "0002", [1, 2, 3, 4], noise(WIDTH, HEIGHT))
    write_poses(tmp_path, "0002", {n: vehicle_pose(100, 200 + n, 90 + 2.0 * n) for n in (1, 2, 4)})
    rng = np.random.default_rng(0)
    z = rng.uniform(6, 30, 60)
    pixels = np.column_stack([rng.uniform(20, 1380, 60), rng.uniform(60, 360, 60)])
    world = np.column_stack([(pixels - [CX, CY]) / F * z[:, None], z])
    T_velo_cam0 = np.vstack([CAM_TO_VELO, [0, 0, 0, 1]])
    T_left_velo = np.vstack([np.column_stack([R_RECT, np.zeros(3)]), [0, 0, 0, 1]]) @ np.linalg.inv(T_velo_cam0)

    poses = truth_of(open_kitti360(tmp_path))
    T_1_2 = poses[1]

    def of_frame_2(time: float) -> np.ndarray:
        """Left camera at a time around frame 2 (0), frame 1 being -1: the LiDAR's motion, spread evenly."""
        delta = np.linalg.inv(T_left_velo) @ np.linalg.inv(T_1_2) @ T_left_velo
        even = np.eye(4)
        even[:3, :3] = cv2.Rodrigues(-time * cv2.Rodrigues(delta[:3, :3])[0])[0]
        even[:3, 3] = -time * delta[:3, 3]
        return T_left_velo @ even @ np.linalg.inv(T_left_velo)

    measured = scan_of_a_moving_car(world, T_left_velo, of_frame_2)
    for number in (1, 2):
        write_scan(tmp_path, "0002", number, measured)
    still = np.column_stack([world, np.ones(60)]) @ np.linalg.inv(T_left_velo).T
    write_scan(tmp_path, "0002", 4, still[:, :3])
    expected = {(round(v), round(u)): depth for (u, v), depth in zip(pixels, z, strict=True)}
    dataset = open_kitti360(tmp_path, first=2)
    compensated, raw = dataset.lidar_depth(1), open_kitti360(tmp_path, uncurl=False).lidar_depth(1)
    # Nothing is known of the car before frame 1; it is taken to have moved as it does from there to frame 2.
    begun = dataset.lidar_depth(0)
    # Frame 3 has no pose, so frame 4's scan is left as it is.
    untouched = open_kitti360(tmp_path).lidar_depth(2)
    assert compensated is not None
    assert begun is not None
    assert raw is not None
    assert untouched is not None
    for depth in (compensated, begun, untouched):
        # A pixel may go to its neighbour where rounding decides.
        found = [abs(depth[at] - true) < 2e-4 * true for at, true in expected.items() if np.isfinite(depth[at])]
        assert sum(found) >= 56
    wrong = [at for at, true in expected.items() if not abs(raw[at] - true) < 2e-4 * true]
    assert len(wrong) > 50


def test_frames_without_a_pose_are_left_out_and_numbers_kept(tmp_path: Path) -> None:
    write_kitti360(tmp_path)
    dataset = open_kitti360(tmp_path)
    assert dataset.numbers == (1, 2, 4, 5)
    assert [dataset.frame(i).number for i in range(4)] == [1, 2, 4, 5]
    np.testing.assert_array_equal(dataset.frame(2).left[..., ::-1], noise(64, 24)(4, 0))
    # Driving along north, 1 m a number, the rectified camera sees itself go along (s, 0, c).
    forward = np.array([np.sin(ANGLE), 0.0, np.cos(ANGLE)])
    np.testing.assert_allclose(truth_of(dataset)[:, :3, 3], np.outer([0, 1, 3, 4], forward), atol=1e-9)
    np.testing.assert_allclose([dataset.frame(i).timestamp for i in range(4)], np.array([1, 2, 4, 5]) * 0.103000007)
    assert open_kitti360(tmp_path, frames="2:6:2").numbers == (2, 4)
    assert open_kitti360(tmp_path, frames="2:4").numbers == (2,)


def test_first_counts_frames_with_a_pose(tmp_path: Path) -> None:
    """The first 300 frames of a sequence are the first 300 that have a pose, whatever their numbers."""
    write_kitti360(tmp_path)
    assert open_kitti360(tmp_path, first=3).numbers == (1, 2, 4)
    assert open_kitti360(tmp_path, first=300).numbers == (1, 2, 4, 5)
    assert open_kitti360(tmp_path, first=2, only_with_pose=False).numbers == (1, 2)
    assert open_kitti360(tmp_path, first=2, frames="2:6").numbers == (2, 4)


def test_poses_between_others(tmp_path: Path) -> None:
    """Frames 0 (before the first pose) and 6 (behind the last) stay out; frame 3 lies between its neighbours."""
    write_kitti360(tmp_path, ids=range(7))
    poses = {1: vehicle_pose(0, 0, 90), 2: vehicle_pose(0, 1, 90), 5: vehicle_pose(0, 4, 30)}
    write_poses(tmp_path, "0002", poses)
    dataset = open_kitti360(tmp_path, only_with_pose=False)
    assert dataset.numbers == (1, 2, 3, 4, 5)
    T, given = truth_of(dataset), truth_of(open_kitti360(tmp_path))
    np.testing.assert_allclose(T[[0, 1, 4]], given, atol=1e-12)
    # From frame 2 to frame 5 it turns 60 degrees about an axis that stays: 20 degrees per frame.
    for before, after in ((1, 2), (2, 3), (3, 4)):
        turn = T[before, :3, :3].T @ T[after, :3, :3]
        assert np.rad2deg(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(20.0, abs=1e-6)
        np.testing.assert_allclose(
            T[after, :3, 3] - T[before, :3, 3], (given[2, :3, 3] - given[1, :3, 3]) / 3, atol=1e-9
        )


def test_sequence_that_begins_at_4391(tmp_path: Path) -> None:
    """0002 has poses of earlier frames, whose images are another sequence; its times may begin with its images."""
    raw = write_kitti360(tmp_path, ids=range(4391, 4396), with_pose=[4388, 4389, 4391, 4393, 4394])
    assert open_kitti360(tmp_path).numbers == (4391, 4393, 4394)
    by_number = open_kitti360(tmp_path)
    assert by_number.frame(0).timestamp == pytest.approx(4391 * 0.103000007)
    lines = (raw / "image_00" / "timestamps.txt").read_text().splitlines(keepends=True)
    (raw / "image_00" / "timestamps.txt").write_text("".join(lines[4391:4396]))
    short = open_kitti360(tmp_path)
    np.testing.assert_allclose([short.frame(i).timestamp for i in range(3)], np.array([0, 2, 3]) * 0.103000007)
    (raw / "image_00" / "timestamps.txt").unlink()
    assert open_kitti360(tmp_path).frame(1).timestamp == pytest.approx(439.3)


def test_far_from_the_origin_nothing_is_lost(tmp_path: Path) -> None:
    """Steps of a millimetre, hundreds of kilometres from the origin, survive float32."""
    write_kitti360(tmp_path)
    write_poses(tmp_path, "0002", {n: vehicle_pose(458_000.0, 5_428_000.0 + 0.001 * n) for n in range(6)})
    steps = np.diff(truth_of(open_kitti360(tmp_path))[:, :3, 3].astype(np.float32), axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 0.001, atol=2e-6)


@pytest.mark.parametrize("written", ["2", "0002", "'0002'", "02", "2013_05_28_drive_0002_sync"])
def test_sequence_through_the_command_line(tmp_path: Path, written: str) -> None:
    """Hydra reads 2 as a number and 0002 as a text."""
    write_kitti360(tmp_path)
    run = compose_run(["dataset=kitti360", f"dataset.root={tmp_path}", f"dataset.sequence={written}"])
    dataset = build(run.plugin("dataset"), "dataset")
    assert dataset.label == "kitti360/0002"


def test_the_cells_of_the_paper_s_table_are_runs_of_this_data_set(tmp_path: Path) -> None:
    write_kitti360(tmp_path)
    table = named_table("main_kitti360")
    for cell in (cell for cell in cells(table) if cell.column == "0002"):
        run = compose_run([*cell.overrides_with([f"dataset.root={tmp_path}"])])
        assert row_of(table, run.values) == (cell.row, "0002")
        assert build(run.plugin("dataset"), "dataset").numbers == (1, 2, 4, 5)


def test_a_run_of_all_frames_with_a_pose_is_a_whole_sequence() -> None:
    """The paper counts 11,600 images of 0004; poses end at 11399, and one in eleven is left out before."""
    facts = read_sequences("kitti360")["0004"]
    assert not facts.is_part(11399 * 10 // 11)
    assert facts.is_part(300)
    assert read_sequences("kitti")["03"].is_part(800)


def edit(path: Path, old: str, new: str) -> None:
    text, count = re.subn(old, new, path.read_text(), count=1, flags=re.MULTILINE)
    assert count == 1
    path.write_text(text)


Damage = Callable[[Path], object]
RAW, POSES = f"data_2d_raw/{drive_of('0002')}", f"data_poses/{drive_of('0002')}"
SCAN = f"data_3d_raw/{drive_of('0002')}/velodyne_points/data/0000000002.bin"


def without(name: str) -> Damage:
    return lambda root: (root / name).unlink()


def renamed(name: str, to: str) -> Damage:
    return lambda root: (root / name).rename(root / to)


def edited(name: str, old: str, new: str) -> Damage:
    return lambda root: edit(root / name, old, new)


def cut(name: str, to: int) -> Damage:
    return lambda root: (root / name).write_bytes((root / name).read_bytes()[:to])


def other_sequence(root: Path) -> None:
    write_poses(root, "0005", {n: vehicle_pose(0, 0) for n in (1, 2)})
    (root / f"data_poses/{drive_of('0005')}/poses.txt").replace(root / POSES / "poses.txt")


PERSPECTIVE, CAM0, VEHICLE = "calibration/perspective.txt", f"{POSES}/cam0_to_world.txt", f"{POSES}/poses.txt"
TIMES = f"{RAW}/image_00/timestamps.txt"
BAD_ROOTS: dict[str, tuple[Damage, dict[str, Any], str]] = {
    "no images folder": (renamed("data_2d_raw", "images"), {}, "holds no folder 'data_2d_raw'. Give the folder that"),
    "no calibration": (renamed("calibration", "calib"), {}, r"calibration does not exist. Unpack .*calibration.zip"),
    "no such sequence": (lambda r: None, {"sequence": "0005"}, r"sequence=0005: .*there are the sequences 0002\. "),
    "no number": (lambda r: None, {"sequence": "two"}, r"dataset.sequence='two' is no sequence of KITTI-360"),
    "withheld": (lambda r: None, {"sequence": "0008"}, r"sequence=0008: .*authors withhold the perspective images"),
    "withheld, timestamps only": (
        lambda r: (r / f"data_2d_raw/{drive_of('0008')}/image_00").mkdir(parents=True),
        {"sequence": "8"},
        r"sequence=0008: .*image_00/data_rect, as .*authors withhold",
    ),
    "not rectified": (renamed(f"{RAW}/image_01/data_rect", f"{RAW}/image_01/data_rgb"), {}, r"image_01 holds unrect"),
    "no right side": (renamed(f"{RAW}/image_01", "x"), {}, r"image_01/data_rect does not exist .*_sync_image_01.zip"),
    "right image missing": (
        without(f"{RAW}/image_01/data_rect/0000000004.png"),
        {},
        r"image_01/data_rect lacks frame 4,",
    ),
    "left image missing": (
        without(f"{RAW}/image_00/data_rect/0000000003.png"),
        {},
        r"Frame 3 is missing in .*image_00",
    ),
    "beyond the disk": (lambda r: None, {"frames": "2:9"}, r"frames=2:9: frame 6 is missing .*frames 0 to 5"),
    "no pose": (
        lambda r: None,
        {"frames": "0:1"},
        r"frames=0:1: none of frame 0 has a pose in .*4 poses of frames 1 to 5",
    ),
    "negative": (lambda r: None, {"first": -1}, r"dataset.first=-1 is negative"),
    "cut image": (cut(f"{RAW}/image_01/data_rect/0000000002.png", 600), {}, r"0000000002.png is truncated"),
    "other size": (
        edited(PERSPECTIVE, r"^S_rect_00: .*", "S_rect_00: 1408 376"),
        {},
        r"are 64x24 .*line 5, is for 1408x376",
    ),
    "no P_rect_01": (edited(PERSPECTIVE, r"^P_rect_01:.*\n", ""), {}, r"has no line 'P_rect_01:'"),
    "eleven numbers": (edited(PERSPECTIVE, r"^(P_rect_00:.*) \S+$", r"\1"), {}, r"line 7: 11 numbers, expected 12"),
    "no number in P": (edited(PERSPECTIVE, r"^P_rect_00: \S+", "P_rect_00: abc"), {}, r"line 7: 'abc' is not a number"),
    "K differs": (edited(PERSPECTIVE, r"^P_rect_01: \S+", "P_rect_01: 553.0"), {}, r"differ in K"),
    "not a projection": (
        edited(PERSPECTIVE, r"^P_rect_00: \S+", "P_rect_00: -1"),
        {},
        r"P_rect_00 is not the projection",
    ),
    "baseline": (edited(PERSPECTIVE, r"-3\.283", "3.283"), {}, r"a baseline of -0\.5942 m; it must be positive"),
    "left off the origin": (
        edited(PERSPECTIVE, r"^(P_rect_00: \S+ \S+ \S+) \S+", r"\1 33.0"),
        {},
        r"the last column of P_rect_00 must be zero",
    ),
    "R_rect": (
        edited(PERSPECTIVE, r"^R_rect_00: \S+", "R_rect_00: 2.0"),
        {},
        r"perspective.txt, line 6: .*not a rotation",
    ),
    "no vehicle calibration": (
        without("calibration/calib_cam_to_pose.txt"),
        {},
        r"calib_cam_to_pose.txt does not exist",
    ),
    "no LiDAR calibration": (without("calibration/calib_cam_to_velo.txt"), {}, r"calib_cam_to_velo.txt does not exist"),
    "two lines": (
        lambda r: (r / "calibration/calib_cam_to_velo.txt").write_text("1\n2\n"),
        {},
        r"calib_cam_to_velo.txt has 2 lines, expected one",
    ),
    "LiDAR mirrored": (
        edited("calibration/calib_cam_to_velo.txt", r"^4\.3", "-9.3"),
        {},
        r"velo.txt, line 1: .*rotation",
    ),
    "empty poses": (cut(CAM0, 0), {}, r"cam0_to_world.txt is empty"),
    "12 numbers a pose": (edited(VEHICLE, r"^1 ", ""), {}, r"poses.txt, line 1: 12 numbers, expected 13"),
    "no number in pose": (edited(CAM0, r"^2 \S+", "2 abc"), {}, r"cam0_to_world.txt, line 2: 'abc' is not a number"),
    "NaN": (edited(CAM0, r"^4 \S+", "4 nan"), {}, r"cam0_to_world.txt, line 3: not all numbers are finite"),
    "blank line": (edited(CAM0, r"^4 ", "\n4 "), {}, r"cam0_to_world.txt, line 3: 0 numbers, expected 17"),
    "no frame number": (edited(CAM0, r"^4 ", "4.5 "), {}, r"cam0_to_world.txt, line 3: '4.5' is no frame number"),
    "falling": (edited(CAM0, r"^4 ", "2 "), {}, r"cam0_to_world.txt, line 3: frame 2 comes after frame 2"),
    "no rotation": (edited(CAM0, r"^5 \S+", "5 1.4"), {}, r"cam0_to_world.txt, line 4: this is no rigid pose"),
    "last row": (edited(CAM0, r"^(5 .*) \S+$", r"\1 2.0"), {}, r"cam0_to_world.txt, line 4: this is no rigid pose"),
    "mixed pose files": (other_sequence, {}, r"frame [12]: the pose differs by .* from that of .*poses.txt"),
    "calibration of another car": (
        edited("calibration/calib_cam_to_pose.txt", r"1\.5000", "1.5100"),
        {},
        r"frame 1: the pose differs by 0\.01 from that of",
    ),
    "no common frame": (
        lambda r: (r / VEHICLE).write_text("9 " + (r / VEHICLE).read_text().splitlines()[3].split(" ", 1)[1]),
        {},
        r"have no frame in common",
    ),
    "few times": (lambda r: (r / TIMES).write_text((r / TIMES).read_text()[:60]), {}, r"has 2 lines, .*from 0 to 5"),
    "no time": (edited(TIMES, r"^(.*\n.*\n)2013.*", r"\1noon"), {}, r"timestamps.txt, line 3: 'noon' is no time"),
    "times fall": (
        edited(TIMES, r":03\.3.*", ":01.3"),
        {},
        r"timestamps.txt, line 5: the time does not increase after line 3",
    ),
    "empty scan": (cut(SCAN, 0), {}, r"0000000002.bin is empty"),
    "cut scan": (cut(SCAN, 20), {}, r"0000000002.bin has 20 bytes"),
}


@pytest.mark.parametrize("case", BAD_ROOTS)
def test_bad_roots_are_named_before_decoding(tmp_path: Path, case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    damage, settings, message = BAD_ROOTS[case]
    write_kitti360(tmp_path)
    damage(tmp_path)
    monkeypatch.setattr("bench.io.images.read_rgb", lambda *_: pytest.fail("decoded an image"))
    with pytest.raises(BenchError, match=message) as caught:
        open_kitti360(tmp_path, **settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("make", "message"), [("", "data get kitti360`"), ("gone", "does not exist")])
def test_bad_root_folder(tmp_path: Path, make: str, message: str) -> None:
    with pytest.raises(BenchError, match=message):
        Kitti360(Kitti360Config(root=str(tmp_path / make) if make else "", sequence="0002"))


def test_damage_that_only_decoding_finds(tmp_path: Path) -> None:
    path = write_kitti360(tmp_path) / "image_00" / "data_rect" / "0000000002.png"
    data = bytearray(path.read_bytes())
    at = data.index(b"IDAT") + 4
    data[at : at + 400] = bytes(400)
    path.write_bytes(bytes(data))
    dataset = open_kitti360(tmp_path)
    dataset.frame(0)
    with pytest.raises(BenchError, match=r"0000000002.png is damaged"):
        dataset.frame(1)


@pytest.fixture(scope="module")
def real(test_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Kitti360:
    """Two real images of the left camera and their scans; for want of the right ones they are the right ones too."""
    root, sample = tmp_path_factory.mktemp("kitti360"), test_data / "kitti360_sample"
    raw, scans = (root / kind / drive_of("0000") for kind in ("data_2d_raw", "data_3d_raw"))
    for side in ("image_00", "image_01"):
        (raw / side).mkdir(parents=True)
        (raw / side / "data_rect").symlink_to(sample / "data_2d_raw" / "sample" / "image_00" / "data")
    scans.mkdir(parents=True)
    (scans / "velodyne_points").symlink_to(sample / "data_3d_raw" / "sample" / "velodyne_points")
    (root / "calibration").symlink_to(sample / "calibration")
    return open_kitti360(root, sequence="0000")


def tracks(dataset: Kitti360) -> tuple[np.ndarray, np.ndarray]:
    """Corners (N, 2) of the first image that are found in the second one, and back."""
    images = [cv2.cvtColor(dataset.frame(i).left, cv2.COLOR_RGB2GRAY) for i in range(2)]
    start = cv2.goodFeaturesToTrack(images[0], 2000, 0.005, 5)[:, 0]
    there, seen, _ = cv2.calcOpticalFlowPyrLK(images[0], images[1], start, None)
    back, seen_again, _ = cv2.calcOpticalFlowPyrLK(images[1], images[0], there, None)
    good = (seen[:, 0] == 1) & (seen_again[:, 0] == 1) & (np.linalg.norm(back - start, axis=1) < 0.3)
    return start[good].astype(np.float64), there[good].astype(np.float64)


def depth_near(depth: np.ndarray, places: np.ndarray) -> np.ndarray:
    """LiDAR depth within 2 px of each place, where that is of one surface; else NaN."""
    found = np.full(len(places), np.nan)
    for i, (u, v) in enumerate(np.rint(places).astype(int)):
        near = depth[max(v - 2, 0) : v + 3, max(u - 2, 0) : u + 3]
        near = near[np.isfinite(near)]
        if len(near) and near.max() < 1.1 * near.min():
            found[i] = np.median(near)
    return found


def test_real_scans_agree_with_what_two_images_say_of_depth(real: Kitti360) -> None:
    """The camera's motion, and so depth up to one scale, follow from corners of both images without any LiDAR: the
    median deviation is 1.8 % (of 290 corners, at 11 m in the median). Scans beside their place agree worse."""
    assert (real.numbers, real.camera.width) == ((3000, 3001), 1408)
    start, there = tracks(real)
    K = real.camera.intrinsics
    E, inliers = cv2.findEssentialMat(start, there, K, cv2.RANSAC, 0.999, 0.5)
    _, R, t, inliers = cv2.recoverPose(E, start, there, K, mask=inliers)
    used = (inliers[:, 0] > 0) & (np.linalg.norm(there - start, axis=1) > 8)
    points = cv2.triangulatePoints(K @ np.eye(3, 4), K @ np.hstack([R, t]), start[used].T, there[used].T)
    z = points[2] / points[3]
    lidar = real.lidar_depth(0)
    assert lidar is not None
    assert np.isfinite(lidar).sum() > 25_000

    def deviation(depth: np.ndarray) -> float:
        ratio = depth_near(depth, start[used]) / z
        ratio = ratio[np.isfinite(ratio) & (z > 0)]
        assert len(ratio) > 200
        return float(np.median(np.abs(ratio / np.median(ratio) - 1)))

    assert deviation(lidar) < 0.025
    assert deviation(np.roll(lidar, 20, axis=1)) > 1.3 * deviation(lidar)
    # The same motion from the first scan's depth in metres: the second scan sees what the first one did, to 0.8 %.
    z = depth_near(lidar, start)
    known = np.isfinite(z)
    seen = np.column_stack([start[known], np.ones(known.sum())]) @ np.linalg.inv(K).T * z[known, None]
    _, turn, move, inliers = cv2.solvePnPRansac(seen, there[known], K, None, reprojectionError=1.0)
    assert len(inliers) > 0.7 * known.sum()
    predicted = (seen @ cv2.Rodrigues(turn)[0].T + move.T)[:, 2]
    assert np.nanmedian(np.abs(predicted / depth_near(real.lidar_depth(1), there[known]) - 1)) < 0.015
    assert 0.8 < np.linalg.norm(move) < 1.2  # metres in a tenth of a second: 36 km/h in a street of houses
