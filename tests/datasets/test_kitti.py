"""KITTI: known facts of the real sequences, and every way in which a root can be wrong."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from kitti_disk import CX, CY, FX, T_CAM, TR, write_image, write_kitti

from bench.errors import BenchError
from plugins.datasets.kitti import Kitti, KittiConfig


def open_kitti(root: Path, **settings: str) -> Kitti:
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
    "no calibration": (drop("calib.txt"), {}, "calib.txt is missing"),
    "eleven numbers": (calibration(r"^(P2:.*) \S+$", r"\1"), {}, r"calib.txt, line 3: 11 numbers, expected 12"),
    "not a number": (calibration(r"^P2: \S+", "P2: abc"), {}, r"calib.txt, line 3: 'abc' is not a number"),
    "few poses": (poses(r"^.*\n\Z", ""), {}, r"04.txt has 3 poses, too few for frame 3"),
    "NaN pose": (poses(r"\A(.*\n)\S+", r"\1nan"), {}, r"04.txt, line 2: NaN"),
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
    monkeypatch.setattr("plugins.datasets.kitti.read_rgb", lambda *_: pytest.fail("decoded an image"))
    with pytest.raises(BenchError, match=message) as caught:
        open_kitti(tmp_path, **settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("make", "message"), [("", "is not set"), ("gone", "does not exist"), ("empty", "no folder 'seq")]
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
