"""A user's own stereo pairs: two folders of images, two videos, or one video with both images side by side.

What they have in common: ``numbers`` (frames chosen), ``rows`` (M,), the place of each chosen pair's left image in
``named``, all left images in order; ``size`` (width, height) of one image, ``rate_hz`` where a file tells it, and
``remarks``.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.io.frame_names import NamedFiles, in_order, join
from bench.io.frame_poses import poses_of_images, read_times
from bench.io.frame_range import describe, parse_frame_range, select_frames
from bench.io.images import IMAGE_SUFFIXES, ImageSequence, describe_files
from bench.io.trajectories import values_per_line
from bench.io.videos import Video
from bench.types import Float, Image

_RATE_HZ = 10.0
"""Without times of their own images count as recorded at this rate."""


class OwnPairs(Protocol):
    """See the module; ``pair`` decodes the left and right image (H, W, 3) of one chosen position."""

    numbers: tuple[int, ...]
    rows: npt.NDArray[np.intp]
    named: NamedFiles
    size: tuple[int, int]
    rate_hz: float | None
    remarks: tuple[str, ...]

    def pair(self, position: int) -> tuple[Image, Image]: ...


class FolderPairs:
    """Pairs by the number, time or name of their files in two folders."""

    rate_hz: float | None = None

    def __init__(self, left: str, right: str, frames: str) -> None:
        """``frames`` is the setting. Raises ``BenchError`` for what is missing, cut, or no pair."""
        self.named, others = in_order(_images("left", left)), in_order(_images("right", right))
        joined = join(self.named, others)
        counted = self.named.counted()
        self.numbers = _select(frames, counted, joined.left, left)
        chosen = np.isin(counted[joined.left], self.numbers)
        self.rows = joined.left[chosen]
        self._left = [self.named.files[row] for row in self.rows]
        self._right = [others.files[row] for row in joined.right[chosen]]
        chosen_files = [path for pair in zip(self._left, self._right, strict=True) for path in pair]
        self._images = ImageSequence(chosen_files, [*self.named.files, *others.files])
        self.size = self._images.size
        self.remarks = (*joined.remarks, *_about_gaps(self.named, counted), *self._images.remarks)

    def pair(self, position: int) -> tuple[Image, Image]:
        """Decode one pair; raises ``BenchError`` if an image turns out to be damaged."""
        return self._images.read(self._left[position]), self._images.read(self._right[position])


class VideoPairs:
    """Pairs of the same frame number of two videos, or the halves of one video's frames."""

    def __init__(self, left: str, right: str, frames: str) -> None:
        """``right`` empty: both halves are in ``left``. Raises ``BenchError`` for what can't be read or is no pair."""
        self._videos = [Video(Path(path).expanduser()) for path in (left, right) if path]
        first, last = self._videos[0], self._videos[-1]
        if first.size != last.size:
            raise BenchError(
                f"{first.path} is {first.size[0]}x{first.size[1]} pixels, and {last.path} is "
                f"{last.size[0]}x{last.size[1]}. Record both at one size."
            )
        if not right and first.size[0] % 2:
            raise BenchError(f"{left} is {first.size[0]} pixels wide, which is no two images side by side.")
        self.size = first.size if right else (first.size[0] // 2, first.size[1])
        count = min(video.count for video in self._videos)
        self.numbers = select_frames(frames, range(count), left)
        self.rows = np.array(self.numbers, dtype=np.intp)
        self.rate_hz = first.rate_hz
        numbers = tuple(map(Decimal, range(count)))
        self.named = NamedFiles((first.path,) * count, tuple((number,) for number in numbers), "number", numbers)
        self.remarks: tuple[str, ...] = ()
        if first.count != last.count:
            told = (
                f"the left video has {first.count} frames and the right one {last.count}: the first {count} are pairs"
            )
            self.remarks = (told,)

    def pair(self, position: int) -> tuple[Image, Image]:
        """Decode one pair; raises ``BenchError`` where a video can't be decoded there."""
        images = [video.read(self.numbers[position]) for video in self._videos]
        if len(images) == 2:
            return images[0], images[1]
        half = self.size[0]
        return images[0][:, :half], images[0][:, half:]


@dataclass(frozen=True)
class TimesAndPoses:
    """Times (N,) in seconds of the chosen pairs, and T_world_left (N, 4, 4), NaN where unknown, or None."""

    times: Float
    poses: Float | None
    remarks: tuple[str, ...]


def times_and_poses(
    pairs: OwnPairs, poses: str | None, times: str | None, rate_hz: float | None = None
) -> TimesAndPoses:
    """Of the files that the settings ``dataset.poses`` and ``dataset.times`` name, else of the images' names, else by a
    constant rate: ``rate_hz``, the videos', or 10 Hz. Raises ``BenchError`` for files that do not fit."""
    known, told = _times(pairs.named, poses, times)
    T: Float | None = None
    if poses:
        found = poses_of_images(Path(poses).expanduser(), pairs.named, known)
        T, told = found.T_world_cam[pairs.rows], told + found.remarks
        known = known if found.times is None else found.times
        unknown = [number for number, each in zip(pairs.numbers, T, strict=True) if not np.isfinite(each).all()]
        if unknown:
            told += (f"{len(unknown)} of {len(pairs.numbers)} frames have no ground truth: {describe(unknown)}",)
    rate = rate_hz or pairs.rate_hz or _RATE_HZ
    return TimesAndPoses(np.array(pairs.numbers) / rate if known is None else known[pairs.rows], T, told)


def _times(left: NamedFiles, poses: str | None, times: str | None) -> tuple[Float | None, tuple[str, ...]]:
    """Times (N,) of the left images in seconds, or None where nothing tells them, and what to say of that."""
    if times:
        return read_times(Path(times).expanduser(), left)
    beside = left.files[0].parent.parent / "times.txt"
    if left.times is not None or not poses or not beside.is_file():
        return left.times, ()
    if values_per_line(Path(poses).expanduser(), "pose file") != 8:
        return None, ()
    return read_times(beside, left)


def _images(side: str, folder: str) -> list[Path]:
    if not folder:
        raise BenchError(f"dataset.{side} is not set. Give the folder of the {side} images, dataset.{side}=FOLDER.")
    path = Path(folder).expanduser()
    if not path.is_dir():
        raise BenchError(f"dataset.{side}={folder}: this folder does not exist. Give the folder of the {side} images.")
    files = [file for file in path.iterdir() if file.is_file() and not file.name.startswith(".")]
    images = [file for file in files if file.suffix.lower() in IMAGE_SUFFIXES]
    if not images:
        raise BenchError(
            f"dataset.{side}={folder} holds no PNG or JPEG image, but {describe_files(files)}. Give the folder of the "
            f"{side} images, as PNG of 8 or 16 bits or JPEG."
        )
    return images


def _select(text: str, counted: npt.NDArray[np.int64], paired: npt.NDArray[np.intp], where: str) -> tuple[int, ...]:
    """The numbers among the pairs' that the setting ``frames`` asks for; those without a partner are left out."""
    there = counted[paired].tolist()
    wanted = parse_frame_range(text)
    if wanted is None:
        return tuple(there)
    first, end, step = wanted
    chosen = tuple(number for number in there if number >= first and (number - first) % step == 0)
    chosen = tuple(number for number in chosen if end is None or number < end)
    if not chosen or (end is not None and end > counted[-1] + 1):
        return select_frames(text, there, where)
    return chosen


def _about_gaps(left: NamedFiles, counted: npt.NDArray[np.int64]) -> list[str]:
    skipped = int(counted[-1]) + 1 - len(counted)
    if not skipped:
        return []
    after = left.files[int(np.argmax(np.diff(counted) > 1))]
    return [f"the numbers in the names of {after.parent.name} skip {skipped} frames, the first after {after.name}"]
