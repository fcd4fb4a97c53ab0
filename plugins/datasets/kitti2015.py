"""KITTI Stereo 2015 (Menze and Geiger, CVPR 2015): single pairs with disparities from an accumulated laser."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset, SequenceOnDisk
from bench.data.places import existing_root
from bench.errors import BenchError, require_choice
from bench.io.frame_range import describe, parse_frame_range
from bench.io.images import bits_in_use, image_size, read_16_bit, read_rgb
from bench.io.kitti_files import parse_numbers, read_lines
from bench.registry import PluginConfig, register
from bench.types import Float, Map, StereoCamera, StereoFrame

# Each scene has two moments; the disparities belong to the first.
_FIRST_MOMENT = "_10.png"
# Disparities are stored in 256ths of a pixel, 0 = unknown.
_DISPARITY_SCALE = np.float32(256.0)
_DISPARITIES = {"occ": "disp_occ_0", "noc": "disp_noc_0"}
# The colour pair of one of the recording days; the others differ by a few per cent.
_TYPICAL_K = np.array([[721.5377, 0.0, 609.5593], [0.0, 721.5377, 172.854], [0.0, 0.0, 1.0]])
_TYPICAL_BASELINE_M = 0.5327


@dataclass(frozen=True)
class Kitti2015Config(PluginConfig):
    """Which pairs of KITTI Stereo 2015, and which of their true disparities."""

    root: str = field(default="", metadata={"path": True, "data": "kitti2015"})
    """Folder that holds ``image_2/`` and ``image_3/``, or ``training/`` with them; empty: kitti2015 in $BGS_DATA."""
    frames: str = ""
    """Pair numbers ``a:b`` or ``a:b:step``; empty: all that are there."""
    disparity: str = "occ"
    """True disparities of all pixels (occ), or of those that both images see (noc)."""

    def __post_init__(self) -> None:
        require_choice("dataset.disparity", self.disparity, _DISPARITIES)


@register("dataset", "kitti2015", config=Kitti2015Config)
class Kitti2015(Dataset):
    """KITTI Stereo 2015: single pairs with true disparities, to score stereo; no sequence.

    Pairs differ in size and camera. Where ``calib_cam_to_cam`` is not unpacked, KITTI's typical camera stands in, which
    changes no disparity, but makes metres wrong by a few per cent. Time stamps are the pairs' numbers.
    """

    is_sequence = False

    def __init__(self, config: Kitti2015Config) -> None:
        folder = _DISPARITIES[config.disparity]
        root = _folder_with_images(config.root)
        self._left, self._right, self._disparity = root / "image_2", root / "image_3", root / folder
        self.numbers = _choose(config.frames, self._left)
        self.label = f"kitti2015/{config.disparity}"
        self._cameras = tuple(self._read_camera(number, root / "calib_cam_to_cam") for number in self.numbers)
        self.camera = self._cameras[0]
        files = [self._file(side, number) for number in self.numbers for side in (self._left, self._right)]
        self._bits, self.remarks = bits_in_use(files)
        for number in self.numbers if self._disparity.is_dir() else ():
            if not self._file(self._disparity, number).is_file():
                raise BenchError(
                    f"{self._file(self._disparity, number)} is missing. Restore it, or move {folder} away."
                )

    @classmethod
    def sequences_in(cls, root: Path) -> Iterator[SequenceOnDisk]:
        """The pairs, all in one, where their disparities lie beside them."""
        for folder in (root, root / "training"):
            if (folder / "image_2").is_dir() and (folder / _DISPARITIES["occ"]).is_dir():
                names = ("image_2", "image_3", *_DISPARITIES.values())
                yield SequenceOnDisk({}, tuple(folder / name for name in names))

    def camera_of(self, position: int) -> StereoCamera:
        """The camera of one pair."""
        return self._cameras[position]

    def frame(self, position: int) -> StereoFrame:
        """Decode one pair; raises ``BenchError`` if an image turns out to be damaged."""
        number, camera = self.numbers[position], self._cameras[position]
        size = (camera.width, camera.height)
        left, right = (read_rgb(self._file(side, number), size, self._bits) for side in (self._left, self._right))
        return StereoFrame(number, float(number), left, right)

    def true_disparity(self, position: int) -> Map | None:
        """Disparities (H, W) float32 px of the accumulated laser and of fitted car models, NaN where unknown.

        None where the folder of disparities is not there, as in the testing part. Raises ``BenchError`` for damage.
        """
        if not self._disparity.is_dir():
            return None
        path, camera = self._file(self._disparity, self.numbers[position]), self._cameras[position]
        stored = read_16_bit(path, (camera.width, camera.height), "KITTI stores disparities")
        disparity = stored.astype(np.float32) / _DISPARITY_SCALE
        disparity[stored == 0] = np.nan
        return disparity

    def _file(self, folder: Path, number: int) -> Path:
        return folder / f"{number:06d}{_FIRST_MOMENT}"

    def _read_camera(self, number: int, calibrations: Path) -> StereoCamera:
        left, right = self._file(self._left, number), self._file(self._right, number)
        size = image_size(left)
        if image_size(right) != size:
            raise BenchError(f"{left} and {right} differ in size; a rectified pair does not. Unpack them again.")
        if not calibrations.is_dir():
            return _camera(size, _TYPICAL_K, np.array([_TYPICAL_BASELINE_M, 0.0, 0.0]))
        return _camera(size, *_read_calibration(calibrations / f"{number:06d}.txt"))


def _folder_with_images(text: str) -> Path:
    root = existing_root(text, "kitti2015", "KITTI 2015's image_2/")
    for folder in (root, root / "training"):
        if (folder / "image_2").is_dir():
            if not (folder / "image_3").is_dir():
                raise BenchError(
                    f"dataset.root={text}: {folder} holds image_2, but no image_3. Unpack the right images."
                )
            return folder
    raise BenchError(
        f"dataset.root={text} holds no image_2, nor does a folder training in it. Give the folder into which KITTI's "
        "data_scene_flow.zip was unpacked."
    )


def _choose(text: str, left: Path) -> tuple[int, ...]:
    """The numbers among the left images that the setting ``frames`` asks for."""
    stems = (path.name.removesuffix(_FIRST_MOMENT) for path in left.glob(f"*{_FIRST_MOMENT}"))
    there = sorted(int(stem) for stem in stems if stem.isdecimal())
    if not there:
        raise BenchError(f"{left} holds no image called NUMBER{_FIRST_MOMENT}. Check dataset.root.")
    wanted = parse_frame_range(text)
    if wanted is None:
        return tuple(there)
    first, end, step = wanted
    chosen = tuple(number for number in there if number in range(first, there[-1] + 1 if end is None else end, step))
    if not chosen:
        raise BenchError(f"dataset.frames={text}: {left} holds {describe(there)}. Choose a range that is there.")
    return chosen


def _read_calibration(path: Path) -> tuple[Float, Float]:
    """K (3, 3) of the colour pair, and the right camera's place in the left one's frame, (3,) metres."""
    matrices: dict[str, Float] = {}
    for line, text in enumerate(read_lines(path), start=1):
        key, _, rest = text.partition(":")
        if key in ("P_rect_02", "P_rect_03"):
            matrices[key] = parse_numbers(rest, 12, path, line).reshape(3, 4)
    if len(matrices) < 2:
        raise BenchError(f"{path} lacks P_rect_02 or P_rect_03. Unpack KITTI's data_scene_flow_calib.zip again.")
    left, right = matrices["P_rect_02"], matrices["P_rect_03"]
    K = left[:, :3]
    if not (K[0, 0] > 0 and K[1, 1] > 0 and np.allclose(K, right[:, :3])):
        raise BenchError(f"{path}: P_rect_02 and P_rect_03 are not of one rectified pair. Unpack the file again.")
    place = np.linalg.solve(K, left[:, 3] - right[:, 3]).astype(np.float64)
    if place[0] <= 0:
        raise BenchError(f"{path}: the baseline is {place[0]:.4f} m, and must be positive. Unpack the file again.")
    return K, place


def _camera(size: tuple[int, int], K: Float, place: Float) -> StereoCamera:
    fx, fy, cx, cy = (float(K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    x, y, z = (float(value) for value in place)
    return StereoCamera(*size, fx=fx, fy=fy, cx=cx, cy=cy, right_position=(x, y, z))
