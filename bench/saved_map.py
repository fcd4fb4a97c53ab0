"""A saved map of Gaussians, of a run or of a PLY file, and what it shows from any place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from bench import registry
from bench.contracts.mapper import Mapper
from bench.contracts.rasterizer import Rasterizer
from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.gaussians.map import GaussianMap
from bench.gaussians.map_view import GaussianMapView
from bench.io.frame_range import describe
from bench.plugin_config import plugin_config_from
from bench.types import Float, PinholeView, RenderedView, StereoCamera, Trajectory

_ROTATION_TOLERANCE = 1e-4


@dataclass(frozen=True)
class SavedMap:
    """A map with what draws it; ``camera`` and ``trajectory`` are the run's, None for a PLY file.

    It is the whole map: a run in chunks (``mapper.live_m``) has joined those on disk in its file, and all of it is in
    memory here. The run's own renders leave out what is beyond ``mapper.far_m`` and draw far chunks in fewer Gaussians,
    and they have the exposure of their frame, which these renders have not.
    """

    path: Path
    gaussians: GaussianMap
    rasterizer: Rasterizer
    camera: StereoCamera | None = None
    trajectory: Trajectory | None = None

    def __len__(self) -> int:
        return len(self.gaussians)

    def render(
        self,
        view: PinholeView | npt.ArrayLike,
        width: int | None = None,
        height: int | None = None,
        K: npt.ArrayLike | None = None,
    ) -> RenderedView:
        """The map from a view, as numpy arrays: ``color`` (H, W, 3) float32 in [0, 1] without background, ``depth``
        (H, W) float32 = sum d a T in metres (divide by alpha for the mean depth), ``alpha`` (H, W) float32.

        ``view``: a ``PinholeView``, or ``T_world_cam`` (4, 4), camera to world in metres, OpenCV axes (x right, y down,
        z forward). With a pose, ``width`` and ``height`` are in pixels and ``K`` (3, 3) has the intrinsics of that size
        with pixel centres at integers; all three or none, which is the run's camera. ``BenchError`` for anything else.
        """
        if not isinstance(view, PinholeView):
            view = self._view(np.asarray(view, np.float64), width, height, K)
        elif (width, height, K) != (None, None, None):
            raise BenchError("A PinholeView has its width, height and K; give these with a pose only.")
        return GaussianMapView(self.gaussians, self.rasterizer).render(view)

    def view_of(self, number: int, right: bool = False) -> PinholeView:
        """The left or right camera of the run at its pose of frame ``number``; ``BenchError`` where it has none."""
        if self.camera is None or self.trajectory is None:
            raise BenchError(f"{self.path} has no frames; give a run folder, or a pose of your own.")
        pose = self.trajectory.pose_of(number)
        if pose is None:
            there = describe(self.trajectory.numbers.tolist())
            raise BenchError(f"{self.path} has no pose of frame {number}; it has those of {there}.")
        return PinholeView.of(self.camera, pose @ self.camera.T_left_right if right else pose)

    def _view(self, pose: Float, width: int | None, height: int | None, K: npt.ArrayLike | None) -> PinholeView:
        """A view that is checked: a wrong pose would give a picture all the same."""
        if pose.shape != (4, 4) or not np.isfinite(pose).all() or not np.allclose(pose[3], [0, 0, 0, 1]):
            raise BenchError("The pose must be T_world_cam, a (4, 4) matrix of finite numbers that ends in 0 0 0 1.")
        R = pose[:3, :3]
        if not np.allclose(R @ R.T, np.eye(3), atol=_ROTATION_TOLERANCE) or np.linalg.det(R) < 0:
            raise BenchError("The pose's upper left (3, 3) part is no rotation. Give T_world_cam in metres.")
        if width is None and height is None and K is None:
            if self.camera is None:
                raise BenchError(f"{self.path} has no camera of its own: give width, height and K with the pose.")
            return PinholeView.of(self.camera, pose)
        if width is None or height is None or K is None:
            raise BenchError("Give all of width, height and K, or none of them for the run's camera.")
        k = np.asarray(K, np.float64)
        if k.shape != (3, 3) or min(width, height, k[0, 0], k[1, 1]) <= 0:
            raise BenchError(
                "K must be (3, 3) with positive focal lengths, width and height positive numbers of pixels."
            )
        if not np.array_equal(k * [[0, 1, 0], [1, 0, 0], [1, 1, 1]], [[0, 0, 0], [0, 0, 0], [0, 0, 1]]):
            raise BenchError("K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]: the renderer knows no skew.")
        return PinholeView(pose, k[0, 0], k[1, 1], k[0, 2], k[1, 2], int(width), int(height))


def load_map(source: str | Path | SavedRunFolder, *, plugins: Sequence[str] = (), rasterizer: str = "cpu") -> SavedMap:
    """The map of a run folder, drawn by the run's rasterizer, or of a PLY in 3DGS's layout, drawn by ``rasterizer``.

    ``plugins``: folders with plugins that the run needs; those that the run folder names are not looked into. Raises
    ``BenchError`` for what is no map, and for a run that has none (yet).
    """
    load_plugins(plugins)
    if isinstance(source, (str, Path)):
        source = Path(source)
        if not source.is_dir():
            drawn_by = registry.build(plugin_config_from("rasterizer", {"name": rasterizer}), "rasterizer")
            return SavedMap(source, GaussianMap.load(source, drawn_by.device), drawn_by)
        source = SavedRunFolder(source)
    path, settings = map_file(source), source.config["mapper"].get("rasterizer")
    if not isinstance(settings, dict):
        raise BenchError(f"The mapper of {source.path} has no rasterizer to render its map with.")
    source.require("rasterizer", str(settings.get("name", "")))
    drawn_by = registry.build(plugin_config_from("rasterizer", settings), "rasterizer")
    gaussians = GaussianMap.load(path, drawn_by.device)
    return SavedMap(source.path, gaussians, drawn_by, source.dataset.camera, source.trajectory)


def map_file(saved: SavedRunFolder) -> Path:
    """The map that the run's mapper saved; ``BenchError`` for a mapper that saves none, and a run that has none yet."""
    name = (saved.config.get("mapper") or {}).get("name")
    if name:
        saved.require("mapper", str(name))
    mapper = registry.lookup("mapper", str(name)).cls if name else Mapper
    assert issubclass(mapper, Mapper)
    if mapper.map_file is None:
        raise BenchError(f"The run {saved.path} has no map: its mapper ({name or 'unknown'}) saves none.")
    path = saved.path / mapper.map_file
    if not path.is_file() and not saved.status.is_complete:
        raise BenchError(f"The run {saved.path} has no map yet: it is not finished. Resume it by the same command.")
    return path
