"""TUM RGB-D (Sturm et al., IROS 2012) and every data set in its layout: rgb.txt, depth.txt, groundtruth.txt."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.contracts.dataset import Dataset, SequenceOnDisk
from bench.data.places import existing_root
from bench.errors import BenchError, require_between, require_least
from bench.io.frame_poses import poses_at_times
from bench.io.frame_range import select_frames
from bench.io.rgbd import Intrinsics, RgbdImages, own_or
from bench.io.text_files import read_text
from bench.io.trajectories import known_poses, read_tum_lines
from bench.registry import PluginConfig, register
from bench.types import Float, Map, StereoFrame, Trajectory

_SIZE = (640, 480)
_PUBLISHED = {
    "1": Intrinsics(517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633), _SIZE),
    "2": Intrinsics(520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172), _SIZE),
    "3": Intrinsics(535.4, 539.2, 320.1, 247.6, size=_SIZE),
}
"""Of the three cameras, as the data set's page gives them; the third one's images are straightened already."""
_FURTHEST_S = 0.02
"""A colour and a depth image farther apart in time are not of one moment."""


@dataclass(frozen=True)
class TumRgbdConfig(PluginConfig):
    """Which sequence; the camera's numbers where it is none of TUM's."""

    root: str = field(default="", metadata={"path": True, "data": "tum_rgbd"})
    """Folder of the sequences, or of the only one; empty: tum_rgbd in $BGS_DATA."""
    sequence: str = ""
    """Folder of the sequence in ``root``, such as rgbd_dataset_freiburg1_desk; empty: ``root`` itself."""
    frames: str = ""
    """Frame numbers ``a:b`` or ``a:b:step``, counted over the colour images that have a depth image; empty: all."""
    scale: float = 1.0
    """Sides of the images as they are used over the stored ones."""
    depth_factor: float = 5000.0
    """Stored depth per metre."""
    fx: float = 0.0
    """Focal length along x in pixels; 0 here and in the next three: that of TUM's camera which the folder names."""
    fy: float = 0.0
    """Focal length along y in pixels."""
    cx: float = 0.0
    """Principal point along x in pixels."""
    cy: float = 0.0
    """Principal point along y in pixels."""
    distortion: list[float] | None = None
    """k1, k2, p1, p2, k3 of the colour images, which are straightened (the depth is not, as in SplaTAM); []: none;
    null: TUM's of the camera which the folder names, none with a camera of your own."""

    def __post_init__(self) -> None:
        require_between("dataset", self, 0.05, 1.0, "scale")
        require_least("dataset", self, fx=0, fy=0, cx=0, cy=0, depth_factor=1e-6)
        if self.distortion and len(self.distortion) not in (4, 5):
            raise BenchError(
                f"dataset.distortion={list(self.distortion)} must be [k1, k2, p1, p2, k3], or [] for none."
            )


@register("dataset", "tum_rgbd", config=TumRgbdConfig)
class TumRgbd(Dataset):
    """A sequence in TUM's layout: colour and depth images joined by time, poses of the colour camera."""

    has_right = False

    def __init__(self, config: TumRgbdConfig) -> None:
        folder = _existing(config)
        color, depth = (_read_list(folder / name) for name in ("rgb.txt", "depth.txt"))
        rows, partners = associate(color.times, depth.times)
        if not len(rows):
            raise BenchError(
                f"{folder}: no image of rgb.txt ({color.times[0]:.3f} to {color.times[-1]:.3f} s) has one of depth.txt "
                f"({depth.times[0]:.3f} to {depth.times[-1]:.3f} s) within {_FURTHEST_S} s. Use one clock for both."
            )
        self.label = f"tum/{folder.resolve().name.removeprefix('rgbd_dataset_')}"
        self.numbers = select_frames(config.frames, range(len(rows)), str(folder))
        chosen = np.array(self.numbers)
        self._times = color.times[rows[chosen]]
        self._images = RgbdImages(
            [color.files[row] for row in rows[chosen]],
            [depth.files[row] for row in partners[chosen]],
            _intrinsics(folder, config),
            config.depth_factor,
            config.scale,
        )
        self.camera = self._images.camera
        self._poses = _read_poses(folder / "groundtruth.txt", self._times)
        alone = len(color.times) - len(rows)
        left_out = f"{alone} of {len(color.times)} colour images have no depth image within {_FURTHEST_S} s: left out"
        self.remarks = (*self._images.remarks, *([left_out] if alone else []), *self._about_poses())

    @classmethod
    def sequences_in(cls, root: Path) -> Iterator[SequenceOnDisk]:
        """Each folder with a ``rgb.txt``, ``root`` itself included."""
        for folder in (root, *sorted(entry for entry in root.iterdir() if entry.is_dir())):
            if (folder / "rgb.txt").is_file():
                sequence = "" if folder == root else folder.name
                yield SequenceOnDisk({"sequence": sequence}, (folder / "rgb", folder / "depth"))

    def lacks(self) -> tuple[str, ...]:
        """The ground truth, where it is not here."""
        return () if self._poses is not None else ("no ground truth (groundtruth.txt)",)

    def frame(self, position: int) -> StereoFrame:
        """Decode one colour image; raises ``BenchError`` if it turns out to be damaged."""
        return StereoFrame(self.numbers[position], float(self._times[position]), self._images.color(position))

    def sensor_depth(self, position: int) -> Map:
        """The depth image of this frame."""
        return self._images.depth(position)

    def ground_truth(self) -> Trajectory | None:
        """Poses of the colour camera at the times of the images, between two of the file where it has none of its own;
        None without groundtruth.txt."""
        if self._poses is None:
            return None
        known = known_poses(self._poses)
        return Trajectory(self._poses[known], np.array(self.numbers, dtype=np.int64)[known], self._times[known])

    def _about_poses(self) -> list[str]:
        unknown = 0 if self._poses is None else int((~known_poses(self._poses)).sum())
        return [f"{unknown} of {len(self)} frames have no ground truth at their time"] if unknown else []


@dataclass(frozen=True)
class _List:
    """Times (N,) in seconds, increasing, and files of a list of images."""

    times: Float
    files: tuple[Path, ...]


def associate(times: Float, others: Float) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Rows of two lists of increasing times in seconds that belong together: nearest pairs first, each row once.

    Pairs farther apart than 0.02 s are none (TUM's own rule).
    """
    first, end = (np.searchsorted(others, times + shift) for shift in (-_FURTHEST_S, _FURTHEST_S))
    pairs = [(abs(times[row] - others[at]), row, at) for row in range(len(times)) for at in range(first[row], end[row])]
    partner: dict[int, int] = {}
    taken: set[int] = set()
    for _, row, at in sorted(pairs):
        if row not in partner and at not in taken:
            partner[row] = at
            taken.add(at)
    rows = np.array(sorted(partner), dtype=np.intp)
    return rows, np.array([partner[row] for row in rows], dtype=np.intp)


def _existing(config: TumRgbdConfig) -> Path:
    folder = existing_root(config.root, "tum_rgbd", "the sequences") / config.sequence
    if not folder.is_dir():
        raise BenchError(f"{folder} does not exist. Check dataset.root and dataset.sequence.")
    if not (folder / "rgb.txt").is_file():
        there = sorted(entry.parent.name for entry in folder.glob("*/rgb.txt"))
        hint = (
            f"Choose dataset.sequence={there[0]}, for example" if there else "Check dataset.root and dataset.sequence"
        )
        raise BenchError(f"{folder} holds no rgb.txt, which lists TUM's colour images. {hint}.")
    return folder


def _read_list(path: Path) -> _List:
    """The images of rgb.txt or depth.txt: lines of a time in seconds and a file below the folder."""
    times, files = [], []
    for number, line in enumerate(read_text(path, "list of images").splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        time, name = words if len(words) == 2 else ("", "")
        if not re.fullmatch(r"[-+]?\d{1,20}\.?\d*", time) or Path(name).is_absolute() or ".." in Path(name).parts:
            raise BenchError(
                f"{path}, line {number}: expected a time in seconds and a file beside the list: 1.25 rgb/1.png"
            )
        times.append(float(time))
        files.append(path.parent / name)
    if not times:
        raise BenchError(f"{path} lists no image. Expected lines of a time in seconds and a file.")
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        raise BenchError(f"{path}: the time of {files[late[0] + 1].name} is not after the one before. Sort it by time.")
    return _List(np.array(times), tuple(files))


def _intrinsics(folder: Path, config: TumRgbdConfig) -> Intrinsics:
    named = re.search(r"(?:freiburg|fr)([123])", folder.resolve().name)
    published = _PUBLISHED[named[1]] if named else None
    own = Intrinsics(config.fx, config.fy, config.cx, config.cy)
    where = f"The name of {folder} tells none of TUM's cameras (freiburg1, freiburg2, freiburg3)"
    found = own_or(published, own, where)
    if config.distortion is None:
        return found
    return replace(found, distortion=tuple(config.distortion))


def _read_poses(path: Path, times: Float) -> Float | None:
    """Poses (N, 4, 4) at the images' times, NaN where there is none; None without the file."""
    return poses_at_times(path, *read_tum_lines(path), times) if path.is_file() else None
