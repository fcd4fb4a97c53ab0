"""The images of a stereo sequence on disk: found by number, left and right, of one size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.errors import BenchError
from bench.io.frame_range import describe
from bench.io.images import IMAGE_SUFFIXES, ImageSequence, describe_files, shrunk
from bench.types import StereoCamera, StereoFrame


def images_by_number(folder: Path, before: str = "", behind: str = "") -> dict[int, Path]:
    """PNG and JPEG images of a folder by the number in their names, in its order; with any number of digits.

    ``before`` and ``behind`` are what stands around the number: "rgb_", "_left". Raises ``BenchError`` where there is
    no such image, and where two have one number.
    """
    if not folder.is_dir():
        raise BenchError(f"The folder {folder} does not exist. Unpack it there, or check dataset.sequence.")
    images: dict[int, Path] = {}
    files = sorted(file for file in folder.iterdir() if file.is_file() and not file.name.startswith("."))
    for file in files:
        text = file.stem.removeprefix(before).removesuffix(behind)
        if file.suffix.lower() not in IMAGE_SUFFIXES or file.stem != f"{before}{text}{behind}" or not text.isdecimal():
            continue
        number = int(text)
        if number in images:
            raise BenchError(f"{images[number]} and {file.name} both are image {number}. Move one of them away.")
        images[number] = file
    if not images:
        raise BenchError(
            f"{folder} holds no PNG or JPEG image whose name is its number, as {before}000000{behind}.png (it holds "
            f"{describe_files(files)}). Check dataset.root and dataset.sequence."
        )
    return dict(sorted(images.items()))


class StereoImages:
    """Left and right images of the frames ``numbers``: both there, none cut, all of one ``size`` (width, height).

    ``remarks`` says what a user should know of how they are read.
    """

    def __init__(self, left: Mapping[int, Path], right: Mapping[int, Path], numbers: Sequence[int]) -> None:
        """``left`` and ``right`` are all images of the sequence. Raises ``BenchError`` for what is missing or cut."""
        self._left, self._right = left, right
        if missing := [number for number in numbers if number not in right]:
            folders = next(iter(right.values())).parent, left[numbers[0]].parent
            raise BenchError(
                f"{folders[0]} lacks {describe(missing)}, whose left images are in {folders[1]} ({len(left)} left and "
                f"{len(right)} right images). Restore the right images, or choose dataset.frames without them."
            )
        chosen = [side[number] for number in numbers for side in (left, right)]
        self._images = ImageSequence(chosen, [*left.values(), *right.values()])
        self.size, self.remarks = self._images.size, self._images.remarks

    def frame(self, number: int, time: float, camera: StereoCamera) -> StereoFrame:
        """Decode one pair, shrunk to the camera's size; raises ``BenchError`` if an image turns out to be damaged."""
        left, right = (self._images.read(side[number]) for side in (self._left, self._right))
        size = (camera.width, camera.height)
        return StereoFrame(number, time, shrunk(left, size), shrunk(right, size))
