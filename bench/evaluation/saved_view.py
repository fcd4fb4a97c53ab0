"""One view of a saved run folder beside what the data set knows of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

from bench.contracts.saved_run import SavedView
from bench.errors import BenchError
from bench.runs.folder import View
from bench.types import Image, Map, Mask, StereoFrame

if TYPE_CHECKING:
    from bench.evaluation.saved_run import SavedRunFolder


class ViewOfFolder(SavedView):
    """A view of a run folder; each part is read when first asked for, and kept as long as the view is."""

    def __init__(self, run: SavedRunFolder, camera: View, number: int, frame: Callable[[], StereoFrame]) -> None:
        """``frame`` decodes the data set's frame, once for all views of it."""
        self.run, self.camera, self.number = run, camera, number
        self.position = run.position_of(number)
        self._frame = frame

    @cached_property
    def render(self) -> Image | None:
        """The saved render; ``BenchError`` where it is not of the data set's size."""
        render, size = self.run.render(self.camera, self.number), self.run.dataset.camera_of(self.position)
        if render is not None and render.shape[:2] != (size.height, size.width):
            raise BenchError(
                f"The {self.camera} render of frame {self.number} in {self.run.path} is "
                f"{render.shape[1]}x{render.shape[0]} pixels, the data set's image {size.width}x{size.height}. "
                "Are its files those of the run?"
            )
        return render

    @cached_property
    def depth(self) -> Map | None:
        """The saved depth in metres."""
        return self.run.depth(self.camera, self.number)

    @property
    def image(self) -> Image:
        """The data set's image."""
        frame = self._frame()
        if self.camera == "left":
            return frame.left
        return frame.pair("The score of right views", "protocol.right_view=false")[1]

    @cached_property
    def lidar(self) -> Map | None:
        """LiDAR returns in the left image."""
        with self.run.one_at_a_time:
            return self.run.dataset.lidar_depth(self.position) if self.camera == "left" else None

    @cached_property
    def sensor_depth(self) -> Map | None:
        """What a depth camera saw in the left image."""
        with self.run.one_at_a_time:
            return self.run.dataset.sensor_depth(self.position) if self.camera == "left" else None

    @cached_property
    def true_depth(self) -> Map | None:
        """Exact depth of the left image."""
        with self.run.one_at_a_time:
            return self.run.dataset.true_depth(self.position) if self.camera == "left" else None

    @cached_property
    def true_sky(self) -> Mask | None:
        """Exact sky of the left image."""
        with self.run.one_at_a_time:
            return self.run.dataset.true_sky(self.position) if self.camera == "left" else None

    @cached_property
    def lpips(self) -> float | None:
        """LPIPS of the whole images."""
        distance = self.run.lpips.distance
        return None if distance is None or self.render is None else distance([self.render], [self.image])[0]
