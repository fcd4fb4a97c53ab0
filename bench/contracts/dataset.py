"""Contract of a data set: a sequence of rectified stereo pairs, or of left images alone (RGB-D)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.errors import BenchError
from bench.geometry.principal_point import doubt_about_size
from bench.types import Map, Mask, StereoCamera, StereoFrame, Trajectory


@dataclass(frozen=True)
class SequenceOnDisk:
    """A sequence that lies in a folder: the settings that choose it beside ``root``, and the folders of its files."""

    settings: Mapping[str, str]
    folders: tuple[Path, ...]


class Dataset(ABC):
    """A sequence of rectified stereo frames, addressed by position 0 .. len-1.

    The constructor reads the calibration and checks what it can without decoding images; it raises ``BenchError``
    (what, where, what to do) before anything has been written.
    """

    label: str
    """How tables call the sequence, for example ``"kitti/06"``."""
    camera: StereoCamera
    numbers: tuple[int, ...]
    """Frame numbers as in the data set, strictly increasing; ``frame(i)`` has number ``numbers[i]``."""
    is_sequence: bool = True
    """False for a collection of single pairs: neighbours are of different scenes, and may have cameras of their own."""
    has_right: bool = True
    """False for frames without a right image (RGB-D): their depth then comes from a plugin such as stereo=sensor, which
    asks the data set, and the camera's baseline says nothing."""

    remarks: tuple[str, ...] = ()
    """What a user should know of how the files were read: frames left out, poses joined by number, a scale.
    It is told on the terminal and in status.json, without paths."""

    def __len__(self) -> int:
        return len(self.numbers)

    def to_tell(self) -> tuple[str, ...]:
        """``remarks``, and a doubt where the camera does not go with the size of the images."""
        doubt = doubt_about_size(self.camera)
        return self.remarks if doubt is None else (*self.remarks, doubt)

    def require_right(self, part: str, instead: str) -> None:
        """Raise ``BenchError`` that names ``part`` and what to choose instead, where frames have no right image."""
        if not self.has_right:
            raise BenchError(f"{part} needs right images, and {self.label} has none. Choose {instead}.")

    @classmethod
    def sequences_in(cls, root: Path) -> Iterable[SequenceOnDisk]:
        """The sequences in a ``root`` of this data set's layout, whole or not, for ``bgs-bench data check``; none where
        it is of another layout."""
        return ()

    def lacks(self) -> tuple[str, ...]:
        """What the sequence lacks of what its publishers give, for ``bgs-bench data check``."""
        return ()

    @abstractmethod
    def frame(self, position: int) -> StereoFrame:
        """Decode one frame. Called from a background thread."""

    def camera_of(self, position: int) -> StereoCamera:
        """The camera of one frame: ``self.camera``, but in a collection of single pairs, which may differ in size."""
        return self.camera

    def ground_truth(self) -> Trajectory | None:
        """Ground-truth poses of the left camera of the pair in use, of the frames that have one, in order; or None."""
        return None

    def lidar_depth(self, position: int) -> Map | None:
        """LiDAR returns projected into the left image: (H, W) float32 metres, NaN where there is no return; or None."""
        return None

    def sensor_depth(self, position: int) -> Map | None:
        """What a depth camera saw in the left image: (H, W) float32 metres, NaN where it missed; or None."""
        return None

    def true_depth(self, position: int) -> Map | None:
        """Exact dense depth (H, W) float32 metres where a data set knows it (NaN in the sky), else None."""
        return None

    def true_disparity(self, position: int) -> Map | None:
        """True disparity of the left image (H, W) float32 px, NaN where unknown; None where a data set has none.

        Derived from ``true_depth`` as f b / z; a data set that comes with disparities overrides it. LiDAR is no such
        truth: scans reach behind what the camera sees.
        """
        depth = self.true_depth(position)
        if depth is None:
            return None
        camera = self.camera_of(position)
        return (np.float32(camera.fx * camera.baseline) / depth).astype(np.float32)

    def true_sky(self, position: int) -> Mask | None:
        """Exact sky mask (H, W) where a data set knows it, else None."""
        return None
