"""KITTI: known facts of the real sequences, and every way in which a root can be wrong."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.errors import BenchError
from bench.io.kitti_files import KittiCalibration
from plugins.datasets.kitti import Kitti, KittiConfig
from tests.datasets.kitti_disk import CX, CY, FX, T_CAM, TR, row, write_image, write_kitti


def open_kitti(root: Path, **settings: Any) -> Kitti:
    return Kitti(KittiConfig(root=str(root), **{"sequence": "04", **settings}))


def test_facts_of_sequence_06_colour(kitti_root: Path) -> None:
    kitti = Kitti(KittiConfig(root=str(kitti_root), sequence="6"))
    camera = kitti.camera
    assert kitti.label == "kitti/06"
    assert (camera.width, camera.height) == (1226, 370)
    np.testing.assert_allclose((camera.fx, camera.fy, camera.cx, camera.cy), (707.0912, 707.0912, 601.8873, 183.1104))
    # Worked out from calib.txt outside this project (the shortcut over P[0, 3] would give 0.5379).
    np.testing.assert_allclose(camera.right_position, (0.535449, -0.003310, 0.002885), atol=2e-6)
    assert kitti.numbers == tuple(range(10))
    assert kitti.frame(3).left.shape == (370, 1226, 3)
    assert kitti.frame(1).timestamp == pytest.approx(0.1044989)


def test_facts_of_sequence_06_grey(kitti_root: Path) -> None:
    kitti = Kitti(KittiConfig(root=str(kitti_root), sequence="06", camera="gray"))
    np.testing.assert_allclose(kitti.camera.right_position, (0.537151, 0.0, 0.0), atol=1e-6)
    assert len(kitti) == 51
    left = kitti.frame(0).left
    assert left.shape == (370, 1226, 3)
    assert (left == left[..., :1]).all()


def test_ground_truth_is_that_of_the_left_camera(kitti_root: Path) -> None:
    """The colour camera is 6 cm off cam0, rigidly: seen from cam0's own pose its position never changes."""
    color = Kitti(KittiConfig(root=str(kitti_root), sequence="06")).ground_truth()
    gray = Kitti(KittiConfig(root=str(kitti_root), sequence="06", camera="gray", frames="0:10")).ground_truth()
    assert color is not None
    assert gray is not None
    relative = np.linalg.inv(gray.T_world_cam) @ color.T_world_cam
    np.testing.assert_allclose(relative[:, :3, 3], np.tile([-0.061031, 0.001440, -0.006203], (10, 1)), atol=2e-6)
    rotations = color.T_world_cam[:, :3, :3]
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (10, 1, 1)), atol=1e-12)
    # Line 6 of poses/06.txt, last column of each row.
    line = np.array((kitti_root / "poses" / "06.txt").read_text().splitlines()[5].split(), dtype=float)
    np.testing.assert_allclose(gray.T_world_cam[5, :3, 3], line.reshape(3, 4)[:, 3])


@pytest.mark.parametrize("sequence", ["03", "06"])
def test_lidar_agrees_with_stereo(kitti_root: Path, sequence: str) -> None:
    """An independent witness of Tr, t_left and the baseline: OpenCV's matcher, called directly."""
    kitti = Kitti(KittiConfig(root=str(kitti_root), sequence=sequence))
    frame, depth = kitti.frame(5), kitti.lidar_depth(5)
    assert depth is not None
    known = np.isfinite(depth)
    assert 15_000 < known.sum() < 25_000
    assert depth[known].min() > 0.5
    matcher = cv2.StereoSGBM.create(0, 96, 5, 200, 800, 1, 31, 10, 100, 2)
    disparity = matcher.compute(*(cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) for i in (frame.left, frame.right))) / 16.0
    both = known & (disparity > 0)
    difference = disparity[both] - kitti.camera.fx * kitti.camera.baseline / depth[both]
    assert np.median(np.abs(difference)) < 0.6


def test_projects_a_point_where_hand_calculation_does(tmp_path: Path) -> None:
    write_kitti(tmp_path)
    kitti = open_kitti(tmp_path)
    depth = kitti.lidar_depth(0)
    assert depth is not None
    expected = {}
    for point in ([10.0, 1.0, 0.5], [20.0, -2.0, 0.0]):
        x, y, z = TR[:, :3] @ point + TR[:, 3] + np.array(T_CAM[2])
        expected[round(FX * y / z + CY), round(FX * x / z + CX)] = z
    assert {(int(v), int(u)) for v, u in np.argwhere(np.isfinite(depth))} == set(expected)
    for pixel, z in expected.items():
        assert depth[pixel] == pytest.approx(z, rel=1e-6)


def test_half_the_size_shows_the_same_at_half_the_pixels(tmp_path: Path) -> None:
    """A pixel's centre is at an integer: pixels 2k and 2k + 1 become k, whose centre is at 2k + 0.5 of before."""
    write_kitti(tmp_path)
    whole, half = open_kitti(tmp_path), open_kitti(tmp_path, scale=0.5)
    frame, small = whole.frame(0), half.frame(0)
    w, h = half.camera.width, half.camera.height
    assert (w, h) == (round(whole.camera.width / 2), round(whole.camera.height / 2))
    assert small.left.shape == (h, w, 3)
    np.testing.assert_allclose(small.left, frame.left.reshape(h, 2, w, 2, 3).mean((1, 3)), atol=0.51)
    point = np.array([1.0, -0.5, 8.0])
    u, v = ((c.intrinsics @ point / point[2])[:2] for c in (whole.camera, half.camera))
    ratio = np.array([w / whole.camera.width, h / whole.camera.height])
    np.testing.assert_allclose((v + 0.5) / (u + 0.5), ratio, rtol=1e-12)
    depth = half.lidar_depth(0)
    assert depth is not None
    assert depth.shape == (h, w)
    assert open_kitti(tmp_path, scale=1.0).camera == whole.camera
    with pytest.raises(BenchError, match=r"dataset.scale=2"):
        open_kitti(tmp_path, scale=2.0)


def test_frame_ranges_are_half_open_and_keep_numbers(tmp_path: Path) -> None:
    write_kitti(tmp_path, frames=6)
    kitti = open_kitti(tmp_path, frames="1:6:2")
    assert kitti.numbers == (1, 3, 5)
    truth = kitti.ground_truth()
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_cam[:, 2, 3], np.array([1.0, 3.0, 5.0]) - T_CAM[2][2])
    np.testing.assert_allclose(truth.timestamps, [0.1, 0.3, 0.5])
    assert kitti.frame(1).number == 3


def test_lives_without_poses_times_and_scans(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path)
    (tmp_path / "poses" / "04.txt").unlink()
    (folder / "times.txt").unlink()
    (folder / "velodyne" / "000001.bin").unlink()
    kitti = open_kitti(tmp_path)
    assert kitti.ground_truth() is None
    assert kitti.frame(2).timestamp == pytest.approx(0.2)
    assert kitti.lidar_depth(1) is None
    assert kitti.lidar_depth(2) is not None


def edit(path: Path, old: str, new: str) -> None:
    text, count = re.subn(old, new, path.read_text(), count=1, flags=re.MULTILINE)
    assert count == 1
    path.write_text(text)


def drop(*names: str) -> Callable[[Path, Path], None]:
    def damage(root: Path, folder: Path) -> None:
        for name in names:
            (folder / name).unlink()

    return damage


def truncate(name: str, to: int) -> Callable[[Path, Path], None]:
    def damage(root: Path, folder: Path) -> None:
        (folder / name).write_bytes((folder / name).read_bytes()[:to])

    return damage


def calibration(old: str, new: str) -> Callable[[Path, Path], None]:
    return lambda root, folder: edit(folder / "calib.txt", old, new)


def poses(old: str, new: str) -> Callable[[Path, Path], None]:
    return lambda root, folder: edit(root / "poses" / "04.txt", old, new)


BAD_ROOTS: dict[str, tuple[Callable[[Path, Path], None], dict[str, str], str]] = {
    "image missing in the middle": (drop("image_2/000002.png"), {}, "Frame 2 is missing in .*image_2"),
    "image missing in the range": (drop("image_2/000002.png"), {"frames": "0:4"}, r"frames=0:4: frame 2 is missing"),
    "range beyond the disk": (lambda r, f: None, {"frames": "2:9"}, r"frame 4 is missing .*frames 0 to 3"),
    "no range": (lambda r, f: None, {"frames": "first"}, r"dataset.frames='first' is no range"),
    "empty range": (lambda r, f: None, {"frames": "3:3"}, "holds no frame"),
    "wrong camera": (lambda r, f: None, {"camera": "colour"}, "dataset.camera='colour' .* Did you mean 'color'"),
    "no grey pair": (lambda r, f: None, {"camera": "gray"}, "image_0 of the gray pair does not exist"),
    "truncated image": (truncate("image_3/000001.png", 600), {}, r"image_3/000001.png is truncated"),
    "truncated header": (truncate("image_2/000001.png", 14), {}, r"image_2/000001.png is truncated"),
    "not an image": (lambda r, f: (f / "image_2/000001.png").write_text("hello"), {}, "is not a PNG"),
    "another size": (
        lambda r, f: write_image(f / "image_2/000002.png", 1, width=60),
        {},
        r"image_2/000002.png is 60x24 pixels, but .* is 64x24",
    ),
    "right fewer than left": (drop("image_3/000003.png"), {}, r"image_3 lacks frame 3.*4 left and 3 right"),
    "no P3": (calibration(r"^P3:.*\n", ""), {}, "has no line 'P3:'"),
    "no Tr": (calibration(r"^Tr:.*\n", ""), {}, "has no line 'Tr:'"),
    "no calibration": (drop("calib.txt"), {}, "calib.txt does not exist"),
    "eleven numbers": (calibration(r"^(P2:.*) \S+$", r"\1"), {}, r"calib.txt, line 3: 11 numbers, expected 12"),
    "not a number": (calibration(r"^P2: \S+", "P2: abc"), {}, r"calib.txt, line 3: 'abc' is not a number"),
    "few poses": (poses(r"^.*\n\Z", ""), {}, r"04.txt has 3 poses, too few for frame 3"),
    "only NaN": (lambda r, f: (r / "poses/04.txt").write_text("nan " * 12 + "\n"), {}, "04.txt holds no pose: each"),
    "empty line": (poses(r"\A(.*\n)", r"\1\n"), {}, r"04.txt, line 2: found 0 values"),
    "scaled rotation": (poses(r"\A\S+", "1.1"), {}, r"04.txt, line 1: .* rotation"),
    "few times": (lambda r, f: (f / "times.txt").write_text("0.0\n0.1\n"), {}, r"times.txt has 2 times"),
    "times fall": (
        lambda r, f: (f / "times.txt").write_text("0.0\n0.2\n0.1\n0.3\n"),
        {},
        r"times.txt, line 3: .*increase",
    ),
    "empty scan": (truncate("velodyne/000001.bin", 0), {}, r"000001.bin is empty"),
    "short scan": (truncate("velodyne/000002.bin", 20), {}, r"000002.bin has 20 bytes"),
    "no such sequence": (lambda r, f: None, {"sequence": "17"}, r"dataset.sequence=17 does not exist .* holds 04"),
}


@pytest.mark.parametrize("case", BAD_ROOTS)
def test_bad_roots_are_named_before_decoding(tmp_path: Path, case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    damage, settings, message = BAD_ROOTS[case]
    damage(tmp_path, write_kitti(tmp_path))
    monkeypatch.setattr("bench.io.images.read_rgb", lambda *_: pytest.fail("decoded an image"))
    with pytest.raises(BenchError, match=message) as caught:
        open_kitti(tmp_path, **settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("make", "message"), [("", "data get kitti`"), ("gone", "does not exist"), ("empty", "no folder 'seq")]
)
def test_bad_root_folder(tmp_path: Path, make: str, message: str) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(BenchError, match=message):
        Kitti(KittiConfig(root=str(tmp_path / make) if make else "", sequence="04"))


def test_damage_that_only_decoding_finds(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path)
    path = folder / "image_2" / "000001.png"
    data = bytearray(path.read_bytes())
    at = data.index(b"IDAT") + 4
    data[at : at + 400] = bytes(400)
    path.write_bytes(bytes(data))
    kitti = open_kitti(tmp_path)
    kitti.frame(0)
    with pytest.raises(BenchError, match=r"000001.png is damaged"):
        kitti.frame(1)


def renamed(name: str) -> Callable[[Path], None]:
    """Each picture again under another name, in the format that the name says."""

    def change(folder: Path) -> None:
        for old in list(folder.glob("image_*/*.png")):
            new = name.format(int(old.stem))
            encoded = cv2.imencode(Path(new).suffix.lower(), cv2.imread(str(old)))[1]
            old.unlink()
            (old.parent / new).write_bytes(encoded.tobytes())

    return change


def like_raw(folder: Path) -> None:
    renamed("{:010d}.png")(folder)
    for camera in (2, 3):
        (folder / f"image_0{camera}").mkdir()
        (folder / f"image_{camera}").rename(folder / f"image_0{camera}" / "data")


@pytest.mark.parametrize(
    ("change", "off"),
    [
        (renamed("{:06d}.jpg"), 80),
        (renamed("{:06d}.PNG"), 0),
        (renamed("{:010d}.jpeg"), 80),
        (renamed("{}.png"), 0),
        (like_raw, 0),
    ],
    ids=["jpg", "PNG", "ten digits, jpeg", "unpadded", "raw"],
)
def test_images_of_other_names_and_formats(tmp_path: Path, change: Callable[[Path], None], off: float) -> None:
    """Twelve frames, so that the order by number is not that of the alphabet; JPEG keeps little of noise."""
    folder = write_kitti(tmp_path, frames=12)
    before = open_kitti(tmp_path).frame(10)
    change(folder)
    kitti = open_kitti(tmp_path)
    assert kitti.numbers == tuple(range(12))
    assert np.abs(kitti.frame(10).left.astype(int) - before.left).mean() <= off
    assert kitti.remarks == ()


def test_names_that_are_no_numbers_are_counted(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path)
    for file in list((folder / "image_2").iterdir()):
        file.rename(file.with_suffix(".bmp"))
    with pytest.raises(
        BenchError, match=r"image_2 holds no PNG or JPEG image .* \(it holds 4 \.bmp, the first 000000\.bmp\)"
    ):
        open_kitti(tmp_path)
    write_image(folder / "image_2" / "000001.png", 1)
    write_image(folder / "image_2" / "1.jpg", 1)
    with pytest.raises(BenchError, match=r"000001\.png and 1\.jpg both are image 1"):
        open_kitti(tmp_path)


RAW_CALIBRATION = "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.95e-02\nS_00: 1.392e+03 5.12e+02\nR_00: 1 0 0 0 1\n"


def test_a_day_of_kitti_raw(tmp_path: Path) -> None:
    """Drives, and one calibration for all of them beside these."""
    folder = write_kitti(tmp_path / "odometry")
    before = open_kitti(tmp_path / "odometry")
    like_raw(folder)
    lines = [f"P_rect_0{line[1:]}" for line in (folder / "calib.txt").read_text().splitlines() if line[0] == "P"]
    day = tmp_path / "2011_09_26"
    day.mkdir()
    (day / "calib_cam_to_cam.txt").write_text(RAW_CALIBRATION + "\n".join(lines) + "\n")
    drive = folder.rename(day / "2011_09_26_drive_0005_sync")
    for name in ("calib.txt", "times.txt"):
        (drive / name).unlink()
    (drive / "velodyne").rename(drive / "velodyne_points")
    times = "".join(f"2011-09-26 13:02:25.{n}00000000\n" for n in range(4))
    (drive / "image_02" / "timestamps.txt").write_text(times)
    kitti = open_kitti(day, sequence="2011_09_26_drive_0005_sync")
    assert kitti.camera == before.camera
    np.testing.assert_allclose([kitti.frame(i).timestamp for i in range(4)], [0.0, 0.1, 0.2, 0.3])
    assert kitti.ground_truth() is None


def test_calibration_as_kitti_object_has_it(tmp_path: Path) -> None:
    """There Tr leads to the camera before rectification: a turn of 90 degrees about z is taken apart into both."""
    folder = write_kitti(tmp_path)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    edit(folder / "calib.txt", r"^Tr: .*$", f"R0_rect: {row(turn)}\nTr_velo_to_cam: {row(turn.T @ TR)}")
    np.testing.assert_allclose(KittiCalibration(folder / "calib.txt").T_cam0_velodyne()[:3], TR, atol=1e-12)


def test_byte_order_marks_and_frames_without_pose(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path)
    poses(r"\A(.*\n)\S+", r"\1nan")(tmp_path, folder)
    for path in (folder / "calib.txt", folder / "times.txt", tmp_path / "poses" / "04.txt"):
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    kitti = open_kitti(tmp_path)
    truth = kitti.ground_truth()
    assert truth is not None
    assert truth.numbers.tolist() == [0, 2, 3]
    assert kitti.to_tell() == ("1 of 4 frames have no ground truth (NaN in the pose file)",)


def test_poses_and_times_of_different_lengths_are_told(tmp_path: Path) -> None:
    write_kitti(tmp_path)
    poses(r"\A(.*\n)", r"\1\1")(tmp_path, tmp_path)
    (told,) = open_kitti(tmp_path).to_tell()
    assert told.startswith("the sequence has 5 poses and 4 times: line k (from 0) is that of frame k")


def test_scans_of_ten_digits(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path)
    before = open_kitti(tmp_path).lidar_depth(2)
    for scan in list((folder / "velodyne").iterdir()):
        scan.rename(scan.with_name(f"0000{scan.name}"))
    np.testing.assert_array_equal(open_kitti(tmp_path).lidar_depth(2), before)


def test_half_size_images_are_told(tmp_path: Path) -> None:
    folder = write_kitti(tmp_path)
    for path in folder.glob("image_*/*.png"):
        cv2.imwrite(str(path), cv2.resize(cv2.imread(str(path)), None, fx=0.5, fy=0.5))
    (told,) = open_kitti(tmp_path).to_tell()
    assert "seems to be of images about 1.9 times as large" in told


@pytest.mark.parametrize("sequence", ["03", "06", "09"])
def test_nothing_is_told_of_the_real_sequences(kitti_root: Path, sequence: str) -> None:
    assert Kitti(KittiConfig(root=str(kitti_root), sequence=sequence)).to_tell() == ()
