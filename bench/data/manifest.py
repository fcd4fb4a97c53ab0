"""Which data sets there are: from where, under which licence, and into which folders their files belong.

Addresses are those that public download scripts of each data set use. No publisher tells SHA-256 sums, so none stand
here: the sum of what came is recorded when a file is fetched first, and holds from then on.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

from bench.errors import BenchError, did_you_mean


@dataclass(frozen=True)
class Archive:
    """One file to download.

    ``anchor`` is a regular expression of the folder (or file) in the archive that belongs right below ``into``;
    what lies outside of such a folder is not unpacked, and neither are files called as in ``without``. ``inner`` is the
    anchor in zip files that the archive holds: they alone are taken, and unpacked where they lie. ``part`` is what the
    user asks for: "" comes always. ``sequences`` are those that it holds, where a data set comes in many archives;
    where it holds several, ``sequence_in`` finds, as its group, the one that a path belongs to. ``size`` is in bytes,
    where it is known exactly; ``about_gb`` is told beforehand. ``sha256`` is that which the publisher tells, or "".
    """

    file: str
    url: str
    anchor: str
    into: str = ""
    part: str = ""
    sequences: tuple[str, ...] = ()
    sequence_in: str = ""
    without: tuple[str, ...] = ()
    about_gb: float | None = None
    size: int | None = None
    sha256: str = ""
    inner: str = ""


@dataclass(frozen=True)
class DataSet:
    """A data set: the folder below $BGS_DATA that ``dataset=LOADER`` reads, and its archives in the order of unpacking.

    ``by_hand`` names the files of one that a person must fetch, and where in the folder they belong. ``parts`` are
    those that come when none is asked for. ``sequences`` are those that may be asked for.
    """

    name: str
    about: str
    loader: str
    folder: str
    page: str
    licence: str
    archives: tuple[Archive, ...] = ()
    parts: tuple[str, ...] = ()
    sequences: tuple[str, ...] = ()
    by_hand: tuple[str, ...] = ()

    def chosen(self, parts: Iterable[str], sequences: Iterable[str]) -> tuple[Archive, ...]:
        """The archives of these parts and sequences; ``BenchError`` for one that there is not."""
        parts, sequences = tuple(parts) or self.parts, tuple(sequences)
        known = list(dict.fromkeys(archive.part for archive in self.archives if archive.part))
        for part in parts:
            if part not in known:
                raise BenchError(
                    f"{self.name} has no part '{part}'; it has {', '.join(known)}.{did_you_mean(part, known)}"
                )
        there = ", ".join(self.sequences) or "none by name: leave --sequence out"
        for sequence in sequences:
            if sequence not in self.sequences:
                raise BenchError(
                    f"{self.name} has no sequence '{sequence}' to get; it has {there}."
                    f"{did_you_mean(sequence, self.sequences)}"
                )
        if not sequences and any(archive.sequences for archive in self.archives):
            raise BenchError(f"{self.name} comes by sequence: give --sequence, of {there}.")
        wanted = [archive for archive in self.archives if not archive.part or archive.part in parts]
        return tuple(archive for archive in wanted if not archive.sequences or {*archive.sequences} & {*sequences})


_S3 = "https://s3.eu-central-1.amazonaws.com"
_NC = "CC BY-NC-SA 3.0"
# The colour and grey archives carry a calib.txt without the LiDAR's Tr, and would overwrite the right one.
_OF_CALIB = ("calib.txt", "times.txt")
# KITTI raw's drives that are the odometry sequences; that of 03 is not offered.
_DRIVES = {
    **{"00": "2011_10_03_drive_0027", "01": "2011_10_03_drive_0042", "02": "2011_10_03_drive_0034"},
    **{"04": "2011_09_30_drive_0016", "05": "2011_09_30_drive_0018", "06": "2011_09_30_drive_0020"},
    **{"07": "2011_09_30_drive_0027", "08": "2011_09_30_drive_0028", "09": "2011_09_30_drive_0033"},
    "10": "2011_09_30_drive_0034",
}
_KITTI360_SEQUENCES = ("0000", "0002", "0003", "0004", "0005", "0006", "0007", "0009", "0010")
_EUROC_SEQUENCES = (
    *("MH_01_easy", "MH_02_easy", "MH_03_medium", "MH_04_difficult", "MH_05_difficult"),
    *("V1_01_easy", "V1_02_medium", "V1_03_difficult", "V2_01_easy", "V2_02_medium", "V2_03_difficult"),
)
_TUM = {
    "freiburg1": ("rgbd_dataset_freiburg1_desk", "rgbd_dataset_freiburg1_xyz", "rgbd_dataset_freiburg1_room"),
    "freiburg2": ("rgbd_dataset_freiburg2_xyz", "rgbd_dataset_freiburg2_desk"),
    "freiburg3": ("rgbd_dataset_freiburg3_long_office_household",),
}


def _odometry(what: str, anchor: str = "sequences", part: str = "", gb: float | None = None) -> Archive:
    file = f"data_odometry_{what}.zip"
    return Archive(
        file,
        f"{_S3}/avg-kitti/{file}",
        anchor,
        part=part,
        sequence_in=r"(?:^|/)sequences/(\d\d)/" if part else "",
        without=_OF_CALIB if part else (),
        about_gb=gb,
    )


def _kitti_raw() -> tuple[Archive, ...]:
    base, dates = f"{_S3}/avg-kitti/raw_data", sorted({drive[:10] for drive in _DRIVES.values()})
    calibrations = (Archive(f"{date}_calib.zip", f"{base}/{date}_calib.zip", r"\d{4}_\d\d_\d\d") for date in dates)
    drives = (
        Archive(f"{drive}_sync.zip", f"{base}/{drive}/{drive}_sync.zip", r"\d{4}_\d\d_\d\d", sequences=(number,))
        for number, drive in _DRIVES.items()
    )
    return (*calibrations, *drives)


def _kitti360() -> tuple[Archive, ...]:
    base, drive = f"{_S3}/avg-projects/KITTI-360", r"2013_05_28_drive_\d{4}_sync"

    def one(place: str, anchor: str, into: str = "", part: str = "", sequence: str = "") -> Archive:
        return Archive(place.rpartition("/")[2], f"{base}/{place}", anchor, into, part, (sequence,) if sequence else ())

    images = (
        one(f"data_2d_raw/2013_05_28_drive_{each}_sync_image_{side}.zip", drive, "data_2d_raw", "images", each)
        for each in _KITTI360_SEQUENCES
        for side in ("00", "01")
    )
    scans = (
        one(f"data_3d_raw/2013_05_28_drive_{each}_sync_velodyne.zip", drive, "data_3d_raw", "velodyne", each)
        for each in _KITTI360_SEQUENCES
    )
    return (
        one(
            "384509ed5413ccc81328cf8c55cc6af078b8c444/calibration.zip",
            r"(?:perspective|calib_\w+)\.txt|image_0[23]\.yaml",
            "calibration",
        ),
        one("89a6bae3c8a6f789e12de4807fc1e8fdcf182cf4/data_poses.zip", drive, "data_poses"),
        one("data_2d_raw/data_timestamps_perspective.zip", drive, "data_2d_raw"),
        *images,
        *scans,
    )


def _euroc(room: str, begins: str, bitstream: str, size: int) -> Archive:
    url = f"https://www.research-collection.ethz.ch/server/api/core/bitstreams/{bitstream}/content"
    sequence = r"[MV][H12]_\d\d_[a-z]+"
    return Archive(
        f"{room}.zip",
        url,
        sequence,
        sequences=tuple(each for each in _EUROC_SEQUENCES if each.startswith(begins)),
        sequence_in=rf"(?:^|/)({sequence})/",
        about_gb=round(size / 1e9, 1),
        size=size,
        inner="mav0",
    )


def _vkitti2(what: str, ending: str = "tar", gb: float | None = None) -> Archive:
    file = f"vkitti_2.0.3_{what}.{ending}"
    url = f"https://download.europe.naverlabs.com//virtual_kitti_2.0.3/{file}"
    return Archive(file, url, r"Scene\d\d", sequence_in=r"(?:^|/)(Scene\d\d)/", about_gb=gb)


def _tum() -> tuple[Archive, ...]:
    base = "https://cvg.cit.tum.de/rgbd/dataset"
    return tuple(
        Archive(f"{name}.tgz", f"{base}/{camera}/{name}.tgz", name, sequences=(name,))
        for camera, names in _TUM.items()
        for name in names
    )


@lru_cache(maxsize=1)
def manifest() -> tuple[DataSet, ...]:
    """All data sets that the project knows, in the order in which ``bgs-bench data list`` shows them."""
    return (
        DataSet(
            "kitti",
            "KITTI odometry, sequences 00 to 21",
            "kitti",
            "kitti_odometry",
            "https://www.cvlibs.net/datasets/kitti/eval_odometry.php",
            _NC,
            (
                _odometry("calib", gb=0.001),
                _odometry("poses", "poses", gb=0.004),
                _odometry("color", part="color", gb=65),
                _odometry("gray", part="gray", gb=22),
                _odometry("velodyne", part="velodyne", gb=80),
            ),
            parts=("color",),
            sequences=tuple(f"{number:02d}" for number in range(22)),
        ),
        DataSet(
            "kitti_raw",
            "KITTI raw, the drives of the odometry sequences",
            "kitti_raw",
            "kitti_raw",
            "https://www.cvlibs.net/datasets/kitti/raw_data.php",
            _NC,
            _kitti_raw(),
            sequences=tuple(_DRIVES),
        ),
        DataSet(
            "kitti2015",
            "KITTI Stereo 2015, single pairs with true disparities",
            "kitti2015",
            "kitti2015",
            "https://www.cvlibs.net/datasets/kitti/eval_scene_flow.php?benchmark=stereo",
            _NC,
            tuple(
                Archive(f"data_scene_flow{what}.zip", f"{_S3}/avg-kitti/data_scene_flow{what}.zip", "training")
                for what in ("", "_calib")
            ),
        ),
        DataSet(
            "kitti360",
            "KITTI-360, rectified colour pair; 0008 is withheld by the authors",
            "kitti360",
            "kitti360",
            "https://www.cvlibs.net/datasets/kitti-360/download.php",
            _NC,
            _kitti360(),
            parts=("images",),
            sequences=_KITTI360_SEQUENCES,
        ),
        DataSet(
            "vkitti2",
            "Virtual KITTI 2.0.3, with exact depth",
            "vkitti2",
            "vkitti2",
            "https://europe.naverlabs.com/research/computer-vision/proxy-virtual-worlds-vkitti-2/",
            _NC,
            (
                _vkitti2("textgt", "tar.gz", 0.03),
                _vkitti2("rgb", gb=7),
                _vkitti2("depth", gb=8),
                _vkitti2("classSegmentation", gb=1),
            ),
            sequences=("Scene01", "Scene02", "Scene06", "Scene18", "Scene20"),
        ),
        DataSet(
            "tum_rgbd",
            "TUM RGB-D",
            "tum_rgbd",
            "tum_rgbd",
            "https://cvg.cit.tum.de/data/datasets/rgbd-dataset/download",
            "CC BY 4.0",
            _tum(),
            sequences=tuple(name for names in _TUM.values() for name in names),
        ),
        DataSet(
            "replica",
            "Replica as NICE-SLAM renders it, eight rooms",
            "replica",
            "replica",
            "https://github.com/cvg/nice-slam",
            "Replica Research Terms: research only",
            (
                Archive(
                    "Replica.zip",
                    "https://cvg-data.inf.ethz.ch/nice-slam/data/Replica.zip",
                    r"(?:office|room)\d",
                    sequence_in=r"(?:^|/)((?:office|room)\d)/",
                    about_gb=12.4,
                ),
            ),
            sequences=(*(f"office{number}" for number in range(5)), *(f"room{number}" for number in range(3))),
        ),
        DataSet(
            "euroc",
            "EuRoC MAV, grey stereo with an IMU",
            "euroc",
            "euroc",
            "https://doi.org/10.3929/ethz-b-000690084",
            "free for research",
            (
                _euroc("machine_hall", "MH", "7b2419c1-62b5-4714-b7f8-485e5fe3e5fe", 12683729426),
                _euroc("vicon_room1", "V1", "02ecda9a-298f-498b-970c-b7c44334d880", 6042263426),
                _euroc("vicon_room2", "V2", "ea12bc01-3677-4b4c-853d-87c7870b8c44", 6013384949),
            ),
            sequences=_EUROC_SEQUENCES,
        ),
        DataSet(
            "tartanair",
            "TartanAir (v1), rendered stereo with exact depth",
            "tartanair",
            "tartanair",
            "https://theairlab.org/tartanair-dataset/",
            "CC BY 4.0",
            by_hand=(
                "of an environment and difficulty image_left.zip, image_right.zip and depth_left.zip: unpack them to "
                "ENVIRONMENT/Easy/P000/image_left and so on, with pose_left.txt beside",
            ),
        ),
    )


def entry(name: str) -> DataSet:
    """The data set of this name; raises ``BenchError`` that lists the names there are."""
    known = {one.name: one for one in manifest()}
    if name not in known:
        raise BenchError(
            f"There is no data set called '{name}'; there are {', '.join(known)}.{did_you_mean(name, known)}"
        )
    return known[name]
