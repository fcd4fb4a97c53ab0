"""What the manifest says of each data set, against paths in the archives as their publishers lay them out."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from urllib.parse import urlsplit

import pytest

from bench import registry
from bench.data.fetch import placing
from bench.data.manifest import DataSet, entry, manifest
from bench.errors import BenchError

DATA_SETS = [pytest.param(data, id=data.name) for data in manifest()]


@pytest.mark.parametrize("data", DATA_SETS)
def test_an_entry_is_consistent(data: DataSet) -> None:
    assert data.loader in registry.names("dataset")
    assert bool(data.archives) != bool(data.by_hand)
    assert data.page.startswith("https://")
    assert data.licence
    files = [archive.file for archive in data.archives]
    assert len(set(files)) == len(files)
    for archive in data.archives:
        url = urlsplit(archive.url)
        assert url.scheme == "https"
        assert PurePosixPath(url.path).name == ("content" if data.name == "euroc" else archive.file)
        re.compile(archive.anchor)
        assert not archive.sequence_in or re.compile(archive.sequence_in).groups == 1
        assert set(archive.sequences) <= set(data.sequences)
    assert set(data.parts) <= {archive.part for archive in data.archives}


def test_no_two_share_a_folder() -> None:
    folders = [data.folder for data in manifest()]
    assert len(set(folders)) == len(folders)


@pytest.mark.parametrize(
    ("name", "file", "sequence", "inside", "placed"),
    [
        ("kitti", "data_odometry_color.zip", "06", "dataset/sequences/06/image_2/000000.png",
         "sequences/06/image_2/000000.png"),
        ("kitti", "data_odometry_color.zip", "06", "dataset/sequences/05/image_2/000000.png", None),
        ("kitti", "data_odometry_color.zip", "06", "dataset/sequences/06/calib.txt", None),
        ("kitti", "data_odometry_calib.zip", "06", "dataset/sequences/06/calib.txt", "sequences/06/calib.txt"),
        ("kitti", "data_odometry_poses.zip", "11", "dataset/poses/06.txt", "poses/06.txt"),
        ("kitti_raw", "2011_09_30_drive_0020_sync.zip", "06",
         "2011_09_30/2011_09_30_drive_0020_sync/image_02/data/0000000000.png",
         "2011_09_30/2011_09_30_drive_0020_sync/image_02/data/0000000000.png"),
        ("kitti_raw", "2011_09_30_calib.zip", "06", "2011_09_30/calib_cam_to_cam.txt",
         "2011_09_30/calib_cam_to_cam.txt"),
        ("kitti360", "calibration.zip", "0007", "calibration/perspective.txt", "calibration/perspective.txt"),
        ("kitti360", "calibration.zip", "0007", "perspective.txt", "calibration/perspective.txt"),
        ("kitti360", "data_poses.zip", "0007", "data_poses/2013_05_28_drive_0007_sync/poses.txt",
         "data_poses/2013_05_28_drive_0007_sync/poses.txt"),
        ("kitti360", "2013_05_28_drive_0007_sync_image_00.zip", "0007",
         "2013_05_28_drive_0007_sync/image_00/data_rect/0000000000.png",
         "data_2d_raw/2013_05_28_drive_0007_sync/image_00/data_rect/0000000000.png"),
        ("vkitti2", "vkitti_2.0.3_rgb.tar", "Scene06", "./Scene06/clone/frames/rgb/Camera_0/rgb_00000.jpg",
         "Scene06/clone/frames/rgb/Camera_0/rgb_00000.jpg"),
        ("vkitti2", "vkitti_2.0.3_rgb.tar", "Scene06", "Scene01/clone/frames/rgb/Camera_0/rgb_00000.jpg", None),
        ("tum_rgbd", "rgbd_dataset_freiburg1_desk.tgz", "rgbd_dataset_freiburg1_desk",
         "rgbd_dataset_freiburg1_desk/rgb.txt", "rgbd_dataset_freiburg1_desk/rgb.txt"),
        ("replica", "Replica.zip", "office0", "Replica/office0/results/frame000000.jpg",
         "office0/results/frame000000.jpg"),
        ("replica", "Replica.zip", "office0", "__MACOSX/Replica/._office0", None),
        ("euroc", "machine_hall.zip", "MH_01_easy", "machine_hall/MH_01_easy/MH_01_easy.zip",
         "MH_01_easy/MH_01_easy.zip"),
        ("euroc", "machine_hall.zip", "MH_01_easy", "machine_hall/MH_01_easy/MH_01_easy.bag", None),
        ("euroc", "machine_hall.zip", "MH_01_easy", "machine_hall/MH_02_easy/MH_02_easy.zip", None),
        ("kitti2015", "data_scene_flow.zip", "", "training/image_2/000000_10.png", "training/image_2/000000_10.png"),
        ("kitti2015", "data_scene_flow.zip", "", "testing/image_2/000000_10.png", None),
    ],
)  # fmt: skip
def test_where_a_member_goes(name: str, file: str, sequence: str, inside: str, placed: str | None) -> None:
    archive = next(each for each in entry(name).archives if each.file == file)
    wanted = placing(archive, [sequence] if sequence else [])(PurePosixPath(inside))
    assert (None if wanted is None else str(wanted)) == placed


def files(name: str, parts: list[str], sequences: list[str]) -> list[str]:
    return [archive.file for archive in entry(name).chosen(parts, sequences)]


def test_what_is_chosen() -> None:
    base = ["data_odometry_calib.zip", "data_odometry_poses.zip"]
    assert files("kitti", [], ["06"]) == [*base, "data_odometry_color.zip"]
    assert files("kitti", ["gray", "velodyne"], []) == [*base, "data_odometry_gray.zip", "data_odometry_velodyne.zip"]
    assert files("kitti_raw", [], ["08"])[-1:] == ["2011_09_30_drive_0028_sync.zip"]
    images = [f"2013_05_28_drive_0007_sync_image_{side}.zip" for side in ("00", "01")]
    assert files("kitti360", [], ["0007"])[-2:] == images
    assert files("euroc", [], ["V1_01_easy", "V1_02_medium"]) == ["vicon_room1.zip"]
    assert files("euroc", [], ["V2_01_easy", "MH_01_easy"]) == ["machine_hall.zip", "vicon_room2.zip"]
    for name, parts, sequences, message in (
        ("kitti", ["colour"], [], r"kitti has no part 'colour'; it has color, gray, velodyne\. Did you mean 'color'"),
        ("kitti", [], ["6"], r"kitti has no sequence '6' to get; it has 00, 01"),
        ("kitti_raw", [], ["03"], r"no sequence '03' to get"),
        ("kitti_raw", [], [], r"comes by sequence: give --sequence, of 00, 01, 02, 04"),
        ("kitti360", [], ["0008"], r"no sequence '0008' to get"),
        ("kitti2015", [], ["1"], r"it has none by name: leave --sequence out"),
    ):
        with pytest.raises(BenchError, match=message):
            entry(name).chosen(parts, sequences)
    with pytest.raises(BenchError, match=r"no data set called 'kiti'; there are kitti, .*Did you mean 'kitti'"):
        entry("kiti")
