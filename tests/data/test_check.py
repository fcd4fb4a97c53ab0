"""``data check`` on KITTI roots that are damaged one by one, and on the street written as KITTI's files."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.data.check import CheckOptions, Verdict, check_folder
from bench.data.kitti_layout import write_kitti as write_as_kitti
from bench.errors import BenchError
from plugins.datasets.kitti import Kitti, KittiConfig
from plugins.datasets.street import Street, StreetConfig
from tests.datasets.kitti360_disk import write_kitti360
from tests.datasets.kitti_disk import write_kitti
from tests.datasets.kitti_raw_disk import write_raw
from tests.datasets.rgbd_disk import replica, tum
from tests.datasets.test_euroc import write_euroc


def checked(root: Path, loader: str = "kitti", **options: object) -> list[Verdict]:
    return list(check_folder(root, loader, CheckOptions(**options)))  # type: ignore[arg-type]


def cut(path: Path, size: int) -> None:
    path.write_bytes(path.read_bytes()[:size])


def test_a_whole_sequence(tmp_path: Path) -> None:
    write_kitti(tmp_path)
    (verdict,) = checked(tmp_path)
    assert (verdict.name, verdict.about, verdict.wrong) == ("kitti 04 color", "frames 0 to 3, 64x24, 4 poses", ())
    # The images are noise, and the published sequence has 271 frames.
    assert verdict.told[0].endswith("no corner of one image is found in the other; rows can't be judged")
    assert verdict.told[1] == "4 of the 271 published frames are here"


@pytest.mark.parametrize(
    ("damage", "wrong"),
    [
        (lambda f: (f / "image_3" / "000002.png").unlink(), [r"image_3 lacks frame 2"]),
        (lambda f: cut(f / "image_2" / "000001.png", 500), [r"image_2/000001\.png is truncated"]),
        (lambda f: (f / "image_2" / "000003.png").write_text("<html>"), [r"image_2/000003\.png is not a PNG"]),
        (lambda f: [cut(f / "velodyne" / f"00000{n}.bin", 20) for n in (1, 2)],
         [r"velodyne/000001\.bin has 20 bytes", r"velodyne/000002\.bin has 20 bytes"]),
        (lambda f: (f / "calib.txt").unlink(), [r"calib\.txt does not exist"]),
        (lambda f: (f / "times.txt").write_text("0.0\n0.1\n"), [r"times\.txt has 2 times, too few for frame 3"]),
        (lambda f: [cut(f / "image_2" / f"00000{n}.png", 40) for n in range(4)] +
                   [cut(f / "image_3" / f"00000{n}.png", 40) for n in range(4)],
         [r"image_2/000000\.png is truncated"] + [r"truncated"] * 4 + [r"8 images are at fault; the first 5 are told"]),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_by_file(tmp_path: Path, damage: Callable[[Path], None], wrong: list[str]) -> None:
    damage(write_kitti(tmp_path))
    write_kitti(tmp_path, sequence="05")
    first, second = checked(tmp_path)
    assert len(first.wrong) == len(wrong), first.wrong
    for said, pattern in zip(first.wrong, wrong, strict=True):
        assert re.search(pattern, said), said
    assert second.wrong == ()


@pytest.mark.parametrize(
    ("make", "name", "wrong"),
    [
        (write_raw, "kitti_raw 2011_09_26_drive_0005 color", ""),
        (write_kitti360, "kitti360 0002", ""),
        (tum, "tum_rgbd rgbd_dataset_handheld", "tells none of TUM's cameras"),
        (replica, "replica office7", "the published camera is of 1200x680"),
        (write_euroc, "euroc V9_01_made_up", ""),
    ],
)
def test_each_layout_is_known_by_its_loader_alone(
    make: Callable[[Path], Path], name: str, wrong: str, tmp_path: Path
) -> None:
    make(tmp_path)
    (verdict,) = checked(tmp_path, "")
    assert (verdict.name, bool(verdict.wrong)) == (name, bool(wrong))
    assert wrong in " ".join(verdict.wrong)


def test_unrectified_drives_are_of_the_wrong_kind(tmp_path: Path) -> None:
    folder = write_raw(tmp_path)
    folder.rename(folder.with_name(folder.name.replace("_sync", "_extract")))
    (verdict,) = checked(tmp_path, "kitti_raw")
    assert "0005_extract holds unrectified images. Download 2011_09_26_drive_0005_sync.zip" in verdict.wrong[0]


def test_all_decodes_what_the_middle_hides(tmp_path: Path) -> None:
    """A byte in the pixels of a frame that is neither first, middle nor last."""
    folder = write_kitti(tmp_path, frames=8)
    image = folder / "image_2" / "000005.png"
    content = bytearray(image.read_bytes())
    content[content.index(b"IDAT") + 60] ^= 0xFF
    image.write_bytes(content)
    assert [verdict.wrong for verdict in checked(tmp_path)] == [()]
    ((wrong,),) = [verdict.wrong for verdict in checked(tmp_path, decode=True)]
    assert "image_2/000005.png" in wrong


def test_what_is_no_data_set(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match="holds no sequence in the layout of any data set"):
        checked(tmp_path, "")
    with pytest.raises(BenchError, match=r"gone does not exist or is no folder"):
        checked(tmp_path / "gone")
    with pytest.raises(BenchError, match="Unknown dataset 'kiti'"):
        checked(tmp_path, "kiti")


@pytest.fixture(scope="module")
def street() -> Street:
    return Street(StreetConfig(frames=2, width=160, height=64))


@pytest.fixture(scope="module")
def as_kitti(street: Street, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("street")
    write_as_kitti(street, root, "00")
    return root


def test_the_street_as_files_is_the_street(street: Street, as_kitti: Path) -> None:
    files = Kitti(KittiConfig(root=str(as_kitti), sequence="00"))
    assert len(files) == len(street)
    for name in ("fx", "fy", "cx", "cy", "baseline", "width", "height"):
        assert getattr(files.camera, name) == pytest.approx(getattr(street.camera, name), rel=1e-10)
    truth, read = street.ground_truth(), files.ground_truth()
    assert truth is not None
    assert read is not None
    np.testing.assert_allclose(read.T_world_cam, truth.T_world_cam, atol=1e-6)
    for position in range(len(street)):
        ours, theirs = street.frame(position), files.frame(position)
        np.testing.assert_array_equal(theirs.left, ours.left)
        np.testing.assert_array_equal(theirs.right, ours.right)
        np.testing.assert_allclose(street.lidar_depth(position), files.lidar_depth(position), rtol=1e-5)
    with pytest.raises(BenchError, match=r"sequences/00 holds a sequence already"):
        write_as_kitti(street, as_kitti, "00")


def test_matched_rows_and_their_picture(as_kitti: Path, tmp_path: Path) -> None:
    root = tmp_path / "moved"
    shutil.copytree(as_kitti, root)
    for image in (root / "sequences" / "00" / "image_3").iterdir():
        pixels = cv2.imread(str(image))
        assert pixels is not None
        cv2.imwrite(str(image), np.roll(pixels, 4, axis=0))
    (good,), (bad,) = (checked(each, pictures=tmp_path / "pictures" / each.name) for each in (as_kitti, root))
    assert good.wrong == ()
    (wrong,) = bad.wrong
    assert float(wrong.split(" differ by ")[1].split(" px")[0]) == pytest.approx(4.0, abs=0.2)
    for each, is_red in ((as_kitti, False), (root, True)):
        picture = cv2.imread(str(tmp_path / "pictures" / each.name / "kitti_00_color.png"))
        assert picture is not None
        assert picture.shape == (64, 320, 3)
        blue, green, red = (picture[..., i].astype(int) for i in range(3))
        lines = {True: (red > green + 120) & (red > blue + 120), False: (green > red + 100) & (green > blue + 80)}
        assert lines[is_red].sum() > 10 * lines[not is_red].sum()
        assert lines[is_red].sum() > 100
