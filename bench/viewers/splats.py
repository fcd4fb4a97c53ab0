"""A saved map as Gaussian splats for a viewer in the browser: which are sent, and since when each is there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.gaussians.levels import mean_projected_area
from bench.gaussians.map import GaussianMap
from bench.gaussians.parameters import NamedParameters
from bench.geometry.se3 import quaternion_to_rotation
from bench.io.foreign import reading
from bench.io.numpy_files import read_npy
from bench.runs.folder import MAP_KEYFRAMES_FILE
from bench.types import Float

_MOST_M = 240.0
"""The longest axis that is shown: viewers keep covariances as half floats, which end at 65504 square metres."""


@dataclass(frozen=True)
class Splats:
    """N Gaussians: ``centers`` (N, 3) metres, ``covariances`` (N, 3, 3) square metres, ``colors`` (N, 3) RGB of the
    constant harmonic and ``opacities`` (N, 1), both from 0 to 1, and ``keyframes`` (N,): to which each belongs, -1 for
    none, or None where the run did not save that. The first ``sky`` of them are the sky, as seen from the origin, which
    moves with the viewer. ``whole`` is how many the map has, and ``sh_degree`` that of its harmonics."""

    centers: Float
    covariances: Float
    colors: Float
    opacities: Float
    keyframes: npt.NDArray[np.int32] | None
    sky: int
    whole: int
    sh_degree: int

    def __len__(self) -> int:
        return len(self.centers)

    def arrays(self, which: slice | npt.NDArray[np.intp]) -> tuple[Float, Float, Float, Float]:
        """Centers, covariances, colours and opacities of some."""
        return self.centers[which], self.covariances[which], self.colors[which], self.opacities[which]


def read_splats(ply: Path, most: int) -> Splats:
    """The map in a run folder's ``ply``, at most ``most`` Gaussians of it: those that cover most; ``BenchError`` for a
    file that is no map, or of another map than ``map_keyframes.npy`` beside it."""
    gaussians = GaussianMap.load(ply)
    whole, keyframes = len(gaussians), _keyframes(ply.with_name(MAP_KEYFRAMES_FILE), len(gaussians))
    named = NamedParameters(gaussians.planes)
    scales, opacities = named.scales.double().numpy(), named.opacities.double().numpy()
    kept = np.arange(whole)
    if whole > most:
        kept = np.sort(np.argpartition(-opacities * mean_projected_area(scales), most - 1)[:most])
    turned = quaternion_to_rotation(np.roll(named.quaternions.numpy()[kept], -1, axis=1))
    axes = turned * scales[kept, None].clip(max=_MOST_M)
    return Splats(
        named.means.double().numpy()[kept],
        axes @ axes.transpose(0, 2, 1),
        named.colors.double().numpy()[kept].clip(max=1.0),
        opacities[kept, None],
        None if keyframes is None else keyframes[kept],
        int(np.searchsorted(kept, gaussians.sky)),
        whole,
        gaussians.sh_degree,
    )


def _keyframes(path: Path, count: int) -> npt.NDArray[np.int32] | None:
    """(N,) which keyframe each Gaussian belongs to; None for a run that did not save that."""
    if not path.is_file():
        return None
    with reading(path, "can't be read as numbers of keyframes", "Run again with rerun=true, or remove it."):
        keyframes = read_npy(path, 8 * count + 4096)
    if keyframes.shape != (count,) or keyframes.dtype != np.int32:
        raise BenchError(f"{path} belongs to another map than the one beside it. Remove it, or run again.")
    return np.asarray(keyframes)
