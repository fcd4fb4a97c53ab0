"""What an evaluator gets: a saved run, and one by one the views that were saved with it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from bench.contracts.dataset import Dataset
from bench.protocol import Protocol
from bench.runs.folder import View
from bench.runs.status import RunStatus
from bench.types import Image, Map, Mask, Trajectory

Group = Literal["left", "train", "heldout", "right"]

GROUPS: tuple[Group, ...] = ("left", "train", "heldout", "right")
VIEW_OF_GROUP: dict[Group, View] = {"left": "left", "train": "left", "heldout": "left", "right": "right"}
"""Which camera the images of a group come from."""


@dataclass(frozen=True)
class LpipsMetric:
    """The LPIPS metric that a run's protocol asks for, or why there is none.

    ``distance(renders, images)`` gives one number per pair of uint8 images (H, W, 3). ``about`` is what
    ``metrics.json`` should say: checksum of the weights under ``protocol``, or the reason under ``notes``.
    """

    distance: Callable[[Sequence[Image], Sequence[Image]], list[float]] | None
    about: Mapping[str, Any] = field(default_factory=dict)


class SavedView(ABC):
    """One saved view and what the data set knows of it; each part is read when first asked for, once for all."""

    number: int
    """The frame's number in the data set."""
    position: int
    """The frame's position in the data set."""
    camera: View
    """Whose view it is: left or right."""

    @property
    @abstractmethod
    def render(self) -> Image | None:
        """The saved render, RGB uint8 (H, W, 3) of the data set's size, or None where none was saved."""

    @property
    @abstractmethod
    def depth(self) -> Map | None:
        """The saved depth, (H, W) float32 in metres, NaN where nothing was rendered; None where none was saved."""

    @property
    @abstractmethod
    def image(self) -> Image:
        """The data set's image of this camera, RGB uint8 (H, W, 3)."""

    @property
    @abstractmethod
    def lidar(self) -> Map | None:
        """LiDAR returns of the left image, as ``Dataset.lidar_depth``; None for right views."""

    @property
    @abstractmethod
    def sensor_depth(self) -> Map | None:
        """Depth of the left image by a depth camera, as ``Dataset.sensor_depth``; None for right views."""

    @property
    @abstractmethod
    def true_depth(self) -> Map | None:
        """Exact depth of the left image, as ``Dataset.true_depth``; None for right views."""

    @property
    @abstractmethod
    def true_sky(self) -> Mask | None:
        """Exact sky of the left image, as ``Dataset.true_sky``; None for right views."""

    @property
    @abstractmethod
    def lpips(self) -> float | None:
        """LPIPS of the whole render against the whole image; None where the run has no metric (``SavedRun.lpips``)."""


class SavedRun(ABC):
    """A saved run folder. Every damaged or missing file raises a ``BenchError`` that names it."""

    path: Path
    """The run folder; an evaluator may write files of its own into it."""
    config: dict[str, Any]
    """The resolved config that the run was made with, as plain data."""
    weights: dict[str, Path]
    """Files of network weights that scoring used, by what they are for: evaluators put theirs here."""

    @property
    @abstractmethod
    def status(self) -> RunStatus:
        """State of the run: done, or how far it got and why it stopped."""

    @property
    @abstractmethod
    def protocol(self) -> Protocol:
        """How the run asked to be scored."""

    @property
    @abstractmethod
    def dataset(self) -> Dataset:
        """The data set that the run used."""

    @property
    @abstractmethod
    def trajectory(self) -> Trajectory:
        """Estimated poses of the tracked frames."""

    @property
    @abstractmethod
    def ground_truth(self) -> Trajectory | None:
        """Ground-truth poses as they were saved with the run, or None."""

    @property
    @abstractmethod
    def frames(self) -> pd.DataFrame:
        """``frames.csv``: one row per frame that the run processed.

        mapped, heldout and, where a system learns from right images, right_mapped are boolean, and so are left_color,
        right_color and left_depth, which say what pictures there are of which frames where that is not all.
        """

    @property
    @abstractmethod
    def right_images_mapped(self) -> bool:
        """Whether mapping saw keyframes' right images: then only held-out frames have right views to score."""

    @property
    @abstractmethod
    def resources(self) -> dict[str, Any]:
        """``resources.json``: memory, seconds per frame, size of the map."""

    @property
    @abstractmethod
    def lpips(self) -> LpipsMetric:
        """The LPIPS metric, made once for all evaluators."""

    @abstractmethod
    def numbers(self, view: View, group: Group) -> list[int]:
        """Frame numbers of a group's images that come from the camera ``view``, in order.

        left: every tracked frame; train: mapped; heldout: kept out of mapping and tracked; right: every tracked frame,
        or the held-out ones where mapping saw right images;
        of all these only frames that should have pictures. A group has images of one camera only (``VIEW_OF_GROUP``);
        the list is empty for the other one.
        """

    @abstractmethod
    def rendered(self, view: View, what: Literal["color", "depth"] = "color") -> list[int]:
        """Numbers of the tracked frames of which the run saved a render.

        Raises ``BenchError`` when a finished run saved some but lacks others; a run that stopped early may lack any.
        """

    @abstractmethod
    def views(self) -> Iterator[SavedView]:
        """The saved views by frame number, the left one of a frame first; right ones that the protocol scores.

        Only the view at hand is kept in memory. ``ViewEvaluator`` shares one pass with all others of its kind.
        """

    @abstractmethod
    def add_per_frame(self, view: str, number: int, **values: Any) -> None:
        """Keep values of one image for ``per_frame.csv``; several evaluators fill the same row."""

    @abstractmethod
    def report_progress(self, what: str, done: int, total: int) -> None:
        """Tell whoever shows progress, if anyone does, that ``done`` of ``total`` are scored."""
