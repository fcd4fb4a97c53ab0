"""EuRoC MAV (Burri et al., IJRR 2016): unrectified grey pairs of a drone, in the ASL layout."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.contracts.dataset import Dataset, SequenceOnDisk
from bench.data.places import existing_root
from bench.errors import BenchError, require_between
from bench.geometry import se3
from bench.geometry.rectification import Rectification
from bench.io.frame_poses import poses_at_times
from bench.io.frame_range import select_frames
from bench.io.images import ImageSequence, shrunk
from bench.io.rig_calibration import read_sensor
from bench.io.text_files import read_text
from bench.io.trajectories import known_poses
from bench.registry import PluginConfig, register
from bench.types import Float, StereoFrame, Trajectory

_CAMERAS = ("cam0", "cam1")
_TRUTH = "state_groundtruth_estimate0"
_POSE_COLUMNS = [f"p_RS_R_{axis}" for axis in "xyz"] + [f"q_RS_{axis}" for axis in "xyzw"]
_DOCUMENTED = ["timestamp"] + [f"p_RS_R_{axis}" for axis in "xyz"] + [f"q_RS_{axis}" for axis in "wxyz"]
"""Columns of a file without a header."""
_LEAST_NS = 10**15
"""Whole numbers from here on are ns since 1970; others are seconds, as copies by way of ROS have them."""
_ROTATION_TOLERANCE = 1e-2


@dataclass(frozen=True)
class EurocConfig(PluginConfig):
    """Which sequence of EuRoC, and at which size."""

    root: str = field(default="", metadata={"path": True, "data": "euroc"})
    """Folder that holds the sequences, or one of them; empty: euroc in $BGS_DATA."""
    sequence: str = "V1_01_easy"
    """Folder of the sequence, which holds ``mav0/``."""
    frames: str = ""
    """Frame numbers ``a:b`` or ``a:b:step``, counted over the pairs from 0; empty: all."""
    scale: float = 1.0
    """Sides of the rectified images as they are used over the stored ones."""

    def __post_init__(self) -> None:
        require_between("dataset", self, 0.05, 1.0, "scale")


@register("dataset", "euroc", config=EurocConfig)
class Euroc(Dataset):
    """EuRoC: cam0 and cam1, rectified by their sensor.yaml.

    Ground truth is that of the rectified left camera, at the images' times; the world is that camera in the first frame
    that has one.
    """

    def __init__(self, config: EurocConfig) -> None:
        folder = _existing(config)
        self.label = f"euroc/{folder.resolve().parent.name}"
        left, right = (_read_list(folder / camera) for camera in _CAMERAS)
        both = sorted(left.keys() & right.keys())
        if not both:
            raise BenchError(
                f"{folder}: no time of cam0/data.csv is one of cam1/data.csv. Restore both from one archive."
            )
        self.numbers = select_frames(config.frames, range(len(both)), str(folder))
        self._ns = np.array([both[number] for number in self.numbers], dtype=np.int64)
        self._files = [(left[ns], right[ns]) for ns in self._ns.tolist()]
        chosen = [path for pair in self._files for path in pair]
        self._images = ImageSequence(chosen, chosen)
        (of_left, T_body_left), (of_right, T_body_right) = (
            read_sensor(folder / camera / "sensor.yaml", self._images.size) for camera in _CAMERAS
        )
        self._rectification = Rectification(of_left, of_right, se3.inverse(T_body_right) @ T_body_left)
        self.camera = self._rectification.camera.scaled(config.scale)
        truth = folder / _TRUTH / "data.csv"
        self._poses: Float | None = None
        if truth.is_file():
            T_left_rect = se3.compose(self._rectification.R_rect_left.T, np.zeros(3))
            self._poses = _body_poses(truth, self._ns) @ T_body_left @ T_left_rect
        self.remarks = (*self._images.remarks, *self._about_gaps(len(left) - len(both), len(right) - len(both)))

    @classmethod
    def sequences_in(cls, root: Path) -> Iterator[SequenceOnDisk]:
        """Each folder with a ``mav0``, ``root`` itself included."""
        for folder in (root, *sorted(entry for entry in root.iterdir() if entry.is_dir())):
            if (folder / "mav0").is_dir():
                images = tuple(folder / "mav0" / camera / "data" for camera in _CAMERAS)
                yield SequenceOnDisk({"sequence": folder.resolve().name}, images)

    def lacks(self) -> tuple[str, ...]:
        """The ground truth, where it is not here."""
        return () if self._poses is not None else (f"no ground truth ({_TRUTH}/data.csv)",)

    def frame(self, position: int) -> StereoFrame:
        """Decode and rectify one pair; raises ``BenchError`` if an image turns out to be damaged."""
        left, right = self._rectification.pair(*(self._images.read(path) for path in self._files[position]))
        size = (self.camera.width, self.camera.height)
        time = float(self._ns[position]) * 1e-9
        return StereoFrame(self.numbers[position], time, shrunk(left, size), shrunk(right, size))

    def ground_truth(self) -> Trajectory | None:
        """Poses of the rectified left camera, of the frames within the time that they cover; None without the file."""
        if self._poses is None:
            return None
        known = known_poses(self._poses)
        T = self._poses[known]
        T = se3.inverse(T[0]) @ T
        T[0] = np.eye(4)  # but for rounding
        return Trajectory(T, np.array(self.numbers, dtype=np.int64)[known], self._ns[known].astype(np.float64) * 1e-9)

    def _about_gaps(self, left_alone: int, right_alone: int) -> list[str]:
        remarks = []
        if left_alone or right_alone:
            remarks.append(
                f"{left_alone} images of cam0 and {right_alone} of cam1 have no partner of the same time: left out"
            )
        unknown = 0 if self._poses is None else int((~known_poses(self._poses)).sum())
        if unknown:
            remarks.append(f"{unknown} of {len(self)} frames have no ground truth, which covers a part of the flight")
        return remarks


def _existing(config: EurocConfig) -> Path:
    root = existing_root(config.root, "euroc", "the sequences")
    folder = next((each / "mav0" for each in (root / config.sequence, root) if (each / "mav0").is_dir()), None)
    if folder is not None:
        return folder
    there = sorted(entry.parent.name for entry in root.glob("*/mav0"))
    raise BenchError(
        f"{root / config.sequence} holds no folder 'mav0'; {root} has {', '.join(there) or 'no sequence'}. Choose "
        "one by dataset.sequence, or unpack it there."
    )


def _ns(text: str, path: Path, line: int) -> int:
    """A time as whole ns, without a detour by floats: of ns, or of seconds since 1970."""
    time = Decimal(text) if re.fullmatch(r"\d{1,19}(\.\d+)?", text) else Decimal(-1)
    ns = int(time) if time >= _LEAST_NS else int(time * 10**9)
    if not 0 <= ns < 2**63:
        raise BenchError(f"{path}, line {line}: {text[:40]!r} is no time in ns or seconds. Restore the file.")
    return ns


def _rows(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Names in the header (none without one), and line number and values of each row."""
    header: list[str] = []
    rows = []
    for number, line in enumerate(read_text(path, "file").splitlines(), start=1):
        values = [value.strip() for value in line.split(",")]
        if line.startswith("#"):
            header = [value.removeprefix("#").split("[")[0].strip() for value in values]
        elif line.strip():
            rows.append((number, values))
    if not rows:
        raise BenchError(f"{path} has no rows. Restore the file.")
    return header, rows


def _read_list(camera: Path) -> dict[int, Path]:
    """The images of data.csv by their time in ns, which must increase."""
    path = camera / "data.csv"
    images: dict[int, Path] = {}
    last = -1
    for line, values in _rows(path)[1]:
        if len(values) != 2 or values[1] != Path(values[1]).name or not values[1]:
            raise BenchError(f"{path}, line {line}: expected a time and the name of an image in data/. Restore it.")
        ns = _ns(values[0], path, line)
        if ns <= last:
            raise BenchError(f"{path}, line {line}: the time is not after the one before. Restore the file.")
        images[ns] = camera / "data" / values[1]
        last = ns
    return images


def _body_poses(path: Path, wanted: npt.NDArray[np.int64]) -> Float:
    """T_world_body (N, 4, 4) at the ``wanted`` times in ns, NaN where the file covers none."""
    header, rows = _rows(path)
    header = header or _DOCUMENTED
    lacking = [name for name in _POSE_COLUMNS if name not in header]
    if lacking:
        raise BenchError(f"{path}: the header names no column {lacking[0]}. Restore the file.")
    columns = [header.index(name) for name in _POSE_COLUMNS]
    times, poses = [], []
    for line, values in rows:
        try:
            poses.append([float(values[column]) for column in columns])
        except (ValueError, IndexError):
            raise BenchError(f"{path}, line {line}: position or quaternion is no row of numbers. Restore it.") from None
        times.append(_ns(values[0], path, line))
    ns, table = np.array(times, dtype=np.int64), np.array(poses)
    if not (np.diff(ns) > 0).all():
        raise BenchError(f"{path}: the times do not increase. Restore the file.")
    length = np.linalg.norm(table[:, 3:], axis=1)
    if not (np.abs(length - 1) <= _ROTATION_TOLERANCE).all():
        line = rows[int(np.argmax(~(np.abs(length - 1) <= _ROTATION_TOLERANCE)))][0]
        raise BenchError(f"{path}, line {line}: the quaternion is not of length 1. Restore the file.")
    T = se3.compose(se3.quaternion_to_rotation(table[:, 3:]), table[:, :3])
    # Differences of whole ns: seconds since 1970 in a float are good to 0.2 us only.
    start = wanted[0]
    return poses_at_times(path, (ns - start) * 1e-9, T, (wanted - start) * 1e-9)
