"""A run folder as evaluators see it: what was saved, checked while it is read."""

from __future__ import annotations

import shlex
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import pandas as pd

from bench import registry
from bench.contracts.dataset import Dataset
from bench.contracts.saved_run import VIEW_OF_GROUP, Group, LpipsMetric, SavedRun, SavedView
from bench.errors import BenchError
from bench.evaluation.saved_view import ViewOfFolder
from bench.io.csv_files import read_csv
from bench.io.foreign import read_plain, reading
from bench.io.images import image_size
from bench.plugin_config import plugin_config_from
from bench.protocol import Protocol
from bench.runs.config_file import CONFIG_FILE, read_config
from bench.runs.folder import (
    CHECKSUM_COLUMN,
    DEPTH_SCALE,
    FRAME_COLUMNS,
    FRAMES_FILE,
    GROUND_TRUTH_FILE,
    RESOURCES_FILE,
    TRAJECTORY_FILE,
    View,
    picture_path,
    require_own_files,
)
from bench.runs.status import STATUS_FILE, RunStatus, read_json, read_status
from bench.runs.trajectory_csv import read_trajectory_csv
from bench.types import Image, Map, StereoFrame, Trajectory

ProgressReport = Callable[[str, int, int], None]
"""Called with what is being done, how many are done, and how many there are."""

_PICTURE_COLUMNS = ("left_color", "right_color", "left_depth")


class SavedRunFolder(SavedRun):
    """Reads the run folder at ``path``; files are read when first asked for."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        if not self.path.is_dir():
            raise BenchError(
                f"There is no run folder {self.path}. Check the path; runs lie in results/runs by default."
            )
        require_own_files(self.path)
        known = read_config(self.path)
        if known is None:
            raise BenchError(f"{self.path} is no run folder: it has no {CONFIG_FILE} that `bgs-bench run` wrote.")
        self.config, self.config_hash = known
        self._require_sections()
        self.on_progress: ProgressReport | None = None
        self._per_frame: dict[tuple[str, int], dict[str, Any]] = {}
        self.weights: dict[str, Path] = {}
        self.one_at_a_time = threading.Lock()
        """Held while the data set is asked: nobody promised that several threads may ask it at once."""

    def _require_sections(self) -> None:
        """Raise ``BenchError`` where a section of the config that scoring reads is none."""
        evaluators = self.config.get("evaluator")
        sections = [self.config.get(name) for name in ("protocol", "dataset", "mapper")]
        sections += [evaluators, *(evaluators.values() if isinstance(evaluators, dict) else ())]
        if not all(section is None or isinstance(section, dict) for section in sections):
            raise BenchError(
                f"{self.path / CONFIG_FILE} is not what `bgs-bench run` writes: one of its sections has no settings. "
                "Delete the run folder and run again."
            )

    def require(self, kind: str, name: str) -> None:
        """Raise ``BenchError`` for a plugin that nobody has loaded; where the config names folders of plugins, with
        them and the command that loads them: what a run folder names is never run by itself."""
        folders = self.config.get("plugins")
        if name in registry.names(kind) or not isinstance(folders, list) or not folders:
            registry.lookup(kind, name)
            return
        named = " ".join(f"--plugins {shlex.quote(str(folder))}" for folder in folders)
        raise BenchError(
            f"{self.path} was made with {kind}={name}, a plugin of the folder {', '.join(map(str, folders))} that its "
            f"config names. Code that a run folder names is not run by itself; if you trust it, give {named}."
        )

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
        self.require("dataset", str(mapping.get("name", "")))
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
        """``frames.csv``, checked; columns of yes and no are boolean."""
        path = self.path / FRAMES_FILE
        table = read_csv(path, FRAME_COLUMNS)
        with reading(path, "can't be read as frames with numbers", "Run again with rerun=true."):
            table["number"] = table["number"].to_numpy(dtype=np.int64)
        for column in ("mapped", "heldout", "right_mapped", *_PICTURE_COLUMNS):
            if column not in table:
                continue
            # An empty cell (the run stopped there) is no.
            table[column] = table[column].astype(str).str.lower().isin(["true", "1", "1.0"])
        return table

    @property
    def right_images_mapped(self) -> bool:
        """Whether mapping saw right images of keyframes (an optional column of ``frames.csv``)."""
        return "right_mapped" in self.frames and bool(self.frames["right_mapped"].any())

    @cached_property
    def resources(self) -> dict[str, Any]:
        """What ``resources.json`` holds."""
        return read_json(self.path / RESOURCES_FILE)

    @cached_property
    def lpips(self) -> LpipsMetric:
        """The LPIPS metric; ``BenchError`` for a weights file that is given and is not there, or is damaged."""
        from bench.evaluation.run_lpips import lpips_of  # torch takes a while to load

        return lpips_of(self)

    @cached_property
    def _position_of(self) -> dict[int, int]:
        return {number: position for position, number in enumerate(self.dataset.numbers)}

    def numbers(self, view: View, group: Group) -> list[int]:
        """Frame numbers of a group's images that come from the camera ``view``, in order."""
        if VIEW_OF_GROUP[group] != view:
            return []
        wanted = self._should_have(f"{view}_color")
        if view == "left":
            wanted = wanted | self._should_have("left_depth")
        if group == "train":
            wanted &= self.frames["mapped"]
        elif group == "heldout" or (group == "right" and self.right_images_mapped):
            wanted = wanted & self.frames["heldout"]
        return [int(number) for number in self.frames.loc[wanted, "number"]]

    def rendered(self, view: View, what: Literal["color", "depth"] = "color") -> list[int]:
        """Numbers of the tracked frames with a saved render; ``BenchError`` where a finished run lacks some.

        A run of ours saves colour and depth together; of another system's output ``what`` says which of them.
        """
        if f"{view}_{what}" not in self.frames:
            what = "color"
        wanted = self._should_have(f"{view}_{what}")
        expected = [int(number) for number in self.frames.loc[wanted, "number"]]
        there = [number for number in expected if picture_path(self.path, view, what, number).is_file()]
        if there and len(there) < len(expected) and self.status.is_complete:
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

    def views(self) -> Iterator[SavedView]:
        """The saved views one by one; ``BenchError`` for a render of a frame that the data set does not have."""
        for number, cameras in self.viewed().items():
            yield from self.views_of(number, cameras)

    def viewed(self) -> dict[int, list[View]]:
        """Which cameras' views are scored, by frame number, in order."""
        cameras: dict[View, set[int]] = {"left": {*self.rendered("left"), *self.rendered("left", "depth")}}
        cameras["right"] = set(self.rendered("right")) if self.protocol.right_view else set()
        if self.right_images_mapped:
            cameras["right"] &= set(self.numbers("right", "right"))
        numbers = sorted(cameras["left"] | cameras["right"])
        return {number: [camera for camera, there in cameras.items() if number in there] for number in numbers}

    def views_of(self, number: int, cameras: Sequence[View]) -> list[SavedView]:
        """The views of one frame, which share its decoded images; raises as ``views``."""
        frame = cache(lambda: self.frame(self.position_of(number)))
        return [ViewOfFolder(self, camera, number, frame) for camera in cameras]

    def position_of(self, number: int) -> int:
        """Position in the data set of the frame with this number; ``BenchError`` where it has none."""
        if number not in self._position_of:
            raise BenchError(
                f"{self.path} holds a render of frame {number}, which its data set {self.dataset.label} does not have. "
                "Check that the data set's files are those of the run."
            )
        return self._position_of[number]

    def frame(self, position: int) -> StereoFrame:
        """The data set's frame; ``BenchError`` where its images are no longer those that the run read."""
        with self.one_at_a_time:
            frame = self.dataset.frame(position)
        return self._unchanged(frame)

    @cached_property
    def _checksums(self) -> dict[int, int]:
        """Of the images that the run read, by frame number; empty where it kept none."""
        if CHECKSUM_COLUMN not in self.frames:
            return {}
        return dict(zip(self.frames["number"].tolist(), self.frames[CHECKSUM_COLUMN].tolist(), strict=True))

    def _unchanged(self, frame: StereoFrame) -> StereoFrame:
        read_by_run = self._checksums.get(frame.number)
        if read_by_run is not None and read_by_run != frame.checksum():
            raise BenchError(
                f"The images of frame {frame.number} of {self.dataset.label} have changed since the run read them. Put "
                "the old ones back, or run again with rerun=true."
            )
        return frame

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
        try:
            image_size(path)
        except BenchError as error:
            raise BenchError(f"{path} is damaged and can't be decoded. Run again with rerun=true.") from error
        with reading(path, "is damaged", "Run again with rerun=true."):
            # Bytes are read here: OpenCV prints its own warnings about files that it can't open.
            picture = cv2.imdecode(np.frombuffer(read_plain(path), np.uint8), flags)
        if picture is None or picture.dtype != dtype or (dtype is np.uint16 and picture.ndim != 2):
            raise BenchError(f"{path} is damaged and can't be decoded. Run again with rerun=true.")
        return picture
