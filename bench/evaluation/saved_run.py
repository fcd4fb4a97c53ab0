"""A run folder as evaluators see it: what was saved, checked while it is read."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import pandas as pd

from bench import registry
from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.io.csv_files import read_csv
from bench.plugin_config import plugin_config_from
from bench.protocol import Protocol
from bench.runs.config_file import CONFIG_FILE, read_config
from bench.runs.folder import (
    DEPTH_SCALE,
    FRAME_COLUMNS,
    FRAMES_FILE,
    GROUND_TRUTH_FILE,
    RESOURCES_FILE,
    TRAJECTORY_FILE,
    View,
    picture_path,
)
from bench.runs.status import STATUS_FILE, RunStatus, read_json, read_status
from bench.runs.trajectory_csv import read_trajectory_csv
from bench.types import Image, Map, Trajectory

ProgressReport = Callable[[str, int, int], None]
"""Called with what is being done, how many are done, and how many there are."""

_PICTURE_COLUMNS = ("left_color", "right_color", "left_depth")

Group = Literal["left", "train", "heldout", "right"]

GROUPS: tuple[Group, ...] = ("left", "train", "heldout", "right")
VIEW_OF_GROUP: dict[Group, View] = {"left": "left", "train": "left", "heldout": "left", "right": "right"}
"""Which camera the images of a group come from."""


class SavedRun:
    """Reads the run folder at ``path``; files are read when first asked for.

    Every damaged or missing file raises a ``BenchError`` that names it.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        if not self.path.is_dir():
            raise BenchError(
                f"There is no run folder {self.path}. Check the path; runs lie in results/runs by default."
            )
        known = read_config(self.path)
        if known is None:
            raise BenchError(f"{self.path} is no run folder: it has no {CONFIG_FILE} that `bgs-bench run` wrote.")
        self.config, self.config_hash = known
        self.on_progress: ProgressReport | None = None
        self._per_frame: dict[tuple[str, int], dict[str, Any]] = {}
        # Files of network weights that scoring used, by what they are for: evaluators put theirs here.
        self.weights: dict[str, Path] = {}

    @cached_property
    def status(self) -> RunStatus:
        """State of the run; ``BenchError`` when ``status.json`` is missing or damaged."""
        status = read_status(self.path)
        if status is None:
            raise BenchError(f"{self.path} is incomplete: it has no {STATUS_FILE}. Run it again with rerun=true.")
        return status

    @cached_property
    def protocol(self) -> Protocol:
        """How the run asked to be scored."""
        return Protocol.from_mapping(self.config.get("protocol") or {})

    @cached_property
    def dataset(self) -> Dataset:
        """The data set that the run used, built from its config."""
        mapping = self.config.get("dataset")
        if not isinstance(mapping, dict):
            raise BenchError(f"{self.path / CONFIG_FILE} names no dataset, so the run can't be scored.")
        dataset = registry.build(plugin_config_from("dataset", mapping), "dataset")
        assert isinstance(dataset, Dataset)
        return dataset

    @cached_property
    def trajectory(self) -> Trajectory:
        """Estimated poses of the tracked frames."""
        return read_trajectory_csv(self.path / TRAJECTORY_FILE)

    @cached_property
    def ground_truth(self) -> Trajectory | None:
        """Ground-truth poses as they were saved with the run, or None."""
        path = self.path / GROUND_TRUTH_FILE
        return read_trajectory_csv(path) if path.is_file() else None

    @cached_property
    def frames(self) -> pd.DataFrame:
        """``frames.csv``: one row a frame that the run processed.

        mapped, heldout and, where a system learns from right images, right_mapped are boolean, and so are left_color,
        right_color and left_depth of another system's output, which say what pictures it has of which frames.
        """
        table = read_csv(self.path / FRAMES_FILE, FRAME_COLUMNS)
        for column in ("mapped", "heldout", "right_mapped", *_PICTURE_COLUMNS):
            if column not in table:
                continue
            # An empty cell (the run stopped there) is no.
            table[column] = table[column].astype(str).str.lower().isin(["true", "1", "1.0"])
        return table

    @cached_property
    def resources(self) -> dict[str, Any]:
        """``resources.json``: memory, seconds a frame, number of Gaussians."""
        return read_json(self.path / RESOURCES_FILE)

    def numbers(self, view: View, group: Group) -> list[int]:
        """Frame numbers of a group's images that come from the camera ``view``, in order.

        left: every tracked frame; train: mapped; heldout: kept out of mapping and tracked; right: every tracked frame.
        Of another system's output those are the frames of which it has pictures.
        A group has images of one camera only (``VIEW_OF_GROUP``); the list is empty for the other one.
        """
        if VIEW_OF_GROUP[group] != view:
            return []
        wanted = self._should_have(f"{view}_color")
        if view == "left":
            wanted = wanted | self._should_have("left_depth")
        if group == "train":
            wanted &= self.frames["mapped"]
        elif group == "heldout":
            wanted &= self.frames["heldout"]
        return [int(number) for number in self.frames.loc[wanted, "number"]]

    def rendered(self, view: View, what: Literal["color", "depth"] = "color") -> list[int]:
        """Numbers of the tracked frames of which the run saved a render.

        A run of ours saves colour and depth together; of another system's output ``what`` says which of them. Raises
        ``BenchError`` when a finished run saved some but lacks others; a run that stopped early may lack any.
        """
        if f"{view}_{what}" not in self.frames:
            what = "color"
        wanted = self._should_have(f"{view}_{what}")
        expected = [int(number) for number in self.frames.loc[wanted, "number"]]
        there = [number for number in expected if picture_path(self.path, view, what, number).is_file()]
        if there and len(there) < len(expected) and self.status.state == "done":
            lacking = picture_path(self.path, view, what, min(set(expected) - set(there)))
            raise BenchError(f"{lacking} is missing though the run is done. Run it again with rerun=true.")
        return there

    def render(self, view: View, number: int) -> Image | None:
        """The saved render, RGB uint8 (H, W, 3), or None where there is none."""
        return self._picture(picture_path(self.path, view, "color", number), cv2.IMREAD_COLOR_RGB, np.uint8)

    def depth(self, view: View, number: int) -> Map | None:
        """The saved depth, (H, W) float32 in metres, NaN where nothing was rendered; None where none was saved."""
        stored = self._picture(picture_path(self.path, view, "depth", number), cv2.IMREAD_UNCHANGED, np.uint16)
        if stored is None:
            return None
        metres = stored.astype(np.float32) / np.float32(DEPTH_SCALE)
        metres[stored == 0] = np.nan
        return metres

    def report_progress(self, what: str, done: int, total: int) -> None:
        """Tell whoever shows progress, if anyone does, that ``done`` of ``total`` are scored."""
        if self.on_progress is not None:
            self.on_progress(what, done, total)

    def add_per_frame(self, view: str, number: int, **values: Any) -> None:
        """Keep values of one image for ``per_frame.csv``; several evaluators fill the same row."""
        self._per_frame.setdefault((view, number), {}).update(values)

    def per_frame(self) -> pd.DataFrame:
        """The rows that evaluators added: view, number and their values, ordered by view and number."""
        rows = [{"view": view, "number": number} | values for (view, number), values in sorted(self._per_frame.items())]
        return pd.DataFrame(rows, columns=None if rows else ["view", "number"])

    def _should_have(self, column: str) -> Any:
        """Which rows of ``frames`` have a picture of this kind: those of tracked frames, or what the column says."""
        return self.frames[column] if column in self.frames else self.frames["state"] != "lost"

    def _picture(self, path: Path, flags: int, dtype: type) -> Any:
        if not path.is_file():
            return None
        # Bytes are read here: OpenCV prints its own warnings about files that it can't open.
        content = np.fromfile(path, dtype=np.uint8)
        picture = cv2.imdecode(content, flags) if content.size else None
        if picture is None or picture.dtype != dtype or (dtype is np.uint16 and picture.ndim != 2):
            raise BenchError(f"{path} is damaged and can't be decoded. Run again with rerun=true.")
        return picture
