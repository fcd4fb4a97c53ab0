"""Contract of what follows a run while it is made: viewers, which show it, and loggers, which keep its numbers."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any

from bench.contracts.map_view import MapView
from bench.runs.folder import CHECKSUM_COLUMN
from bench.types import Float, Keyframe, StereoCamera, StereoFrame, Trajectory

# Cells of a frame's row that measure nothing.
_NO_MEASURE = ("number", "timestamp", CHECKSUM_COLUMN)


@dataclass(frozen=True)
class RunBegins:
    """A run that is about to begin, or to be resumed.

    ``config`` is resolved, plain data, and ``config_hash`` its hash; ``numbers`` are those of all frames, and ``first``
    is the position of the first that comes: those before it were done before a break. ``ground_truth``: where known.
    """

    folder: Path
    config: Mapping[str, Any]
    config_hash: str
    camera: StereoCamera
    numbers: Sequence[int]
    first: int = 0
    ground_truth: Trajectory | None = None

    @property
    def name(self) -> str:
        """The run in a few words."""
        return f"{self.config.get('system') or 'run'} {self.folder.name}"

    @property
    def first_number(self) -> int:
        """Number of the first frame that comes, or one that none has where all are done."""
        return self.numbers[self.first] if self.first < len(self.numbers) else max(self.numbers, default=0) + 1


@dataclass(frozen=True)
class FrameDone:
    """A frame that has been tracked and, if it is a keyframe, mapped.

    ``row`` is its line of ``frames.csv``. ``T_world_cam`` (4, 4) is None for a lost frame. Of a keyframe that was
    mapped there are also ``keyframe`` with its depth and sky, ``losses`` by name, ``trajectory`` with all poses as they
    are now, and ``map``, which is good until the call returns (None: the mapper offers no view of it).
    """

    frame: StereoFrame
    T_world_cam: Float | None
    row: Mapping[str, Any]
    keyframe: Keyframe | None = None
    losses: Mapping[str, float] | None = None
    trajectory: Trajectory | None = None
    map: MapView | None = None

    def scalars(self) -> dict[str, float]:
        """The numbers of its row, and its losses as ``loss/NAME``."""
        cells = {key: value for key, value in self.row.items() if key not in _NO_MEASURE}
        return numbers_in(cells | {"loss": self.losses or {}})


def leaves(values: Mapping[str, Any], between: str = ".", prefix: str = "") -> Iterator[tuple[str, Any]]:
    """All values of nested mappings by names as ``mapper.seeding.stride``."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from leaves(value, between, f"{prefix}{key}{between}")
        else:
            yield f"{prefix}{key}", value


def numbers_in(values: Mapping[str, Any]) -> dict[str, float]:
    """The finite numbers of nested plain data, for example of ``metrics.json``, by names as ``views/left/psnr_db``."""
    numbers = {key: value for key, value in leaves(values, "/") if isinstance(value, Real)}
    return {key: float(value) for key, value in numbers.items() if not isinstance(value, bool) and math.isfinite(value)}


class Observer(ABC):
    """Follows one run. It looks, and changes nothing: arrays stay as they are, global random states too, and the run's
    bits are the same without it. One that raises is told once and asked no more; the run goes on.

    All calls come from the thread that maps. A call should cost little of a frame's time.
    """

    def begin(self, run: RunBegins) -> None:  # noqa: B027 - nothing to prepare for some
        """Called once, before the first frame. Frames after ``run.first`` may come a second time after a kill."""

    @abstractmethod
    def frame(self, done: FrameDone) -> None:
        """Called after each frame, in order."""

    def optimised(self, trajectory: Trajectory, map: MapView | None) -> None:  # noqa: B027
        """Called after the last optimisation, with the final poses, and the map until the call returns."""

    def scored(self, metrics: Mapping[str, Any]) -> None:  # noqa: B027
        """Called with what ``metrics.json`` holds, where the run is scored at once."""

    def end(self) -> None:  # noqa: B027
        """Called last, also after a run that failed: send what is waiting, close what is open."""


class ScalarLogger(Observer):
    """A logger of numbers by frame."""

    def frame(self, done: FrameDone) -> None:
        """Log the frame's numbers."""
        self.log(done.row["number"], done.scalars())

    @abstractmethod
    def log(self, frame: int, values: Mapping[str, float]) -> None:
        """Keep numbers of the frame with this number."""
