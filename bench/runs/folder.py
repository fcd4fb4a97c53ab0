"""The folder of one run: what a running system writes into it. ``SavedRun`` reads it again."""

from __future__ import annotations

import logging
import math
import os
import re
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt
import pandas as pd

from bench.errors import BenchError
from bench.io.atomic import TEMPORARY_PATTERN, atomic_path, write_image, write_json, write_text
from bench.io.trajectories import write_kitti, write_tum
from bench.runs.config_file import CONFIG_FILE, differing_keys, read_config, write_config
from bench.runs.events import EVENTS_FILE, write_events
from bench.runs.status import STATUS_FILE, RunStatus, current_status, read_status, write_status
from bench.runs.trajectory_csv import as_csv
from bench.types import Event, Image, Map, Mask, RenderedView, Trajectory

View = Literal["left", "right"]

VIEWS: tuple[View, ...] = ("left", "right")
FRAMES_FILE = "frames.csv"
TRAJECTORY_FILE = "trajectory.csv"
GROUND_TRUTH_FILE = "ground_truth.csv"
RESOURCES_FILE = "resources.json"
PROVENANCE_FILE = "provenance.json"
METRICS_FILE = "metrics.json"
PER_FRAME_FILE = "per_frame.csv"
SCORES_FILE = "scores.jsonl"
"""What a scoring that is not finished has so far: one line a frame."""
MAP_KEYFRAMES_FILE = "map_keyframes.npy"
"""(N,) int32: the number of the keyframe that each element of the map's file belongs to, -1 for none."""
LOG_FILE = "log.txt"
PLOT_FILE = "trajectory.png"

FRAME_COLUMNS = ["number", "timestamp", "state", "mapped", "heldout"]
"""What each row of ``frames.csv`` has at least."""
CHECKSUM_COLUMN = "images_crc32"
"""And in a run of ours: the checksum of the images that the run read."""

OTHER_FILES = (
    STATUS_FILE,
    FRAMES_FILE,
    EVENTS_FILE,
    TRAJECTORY_FILE,
    "trajectory_kitti.txt",
    "trajectory_tum.txt",
    GROUND_TRUTH_FILE,
    "ground_truth_kitti.txt",
    RESOURCES_FILE,
    PROVENANCE_FILE,
    METRICS_FILE,
    PER_FRAME_FILE,
    SCORES_FILE,
    MAP_KEYFRAMES_FILE,
    LOG_FILE,
    PLOT_FILE,
)
"""What a run writes but its map and the views."""
_PICTURE = re.compile(r"\d{6,}\.png")
# Depth PNGs hold metres * 256 as uint16, like KITTI's own depth maps; 0 = no depth.
DEPTH_SCALE = 256.0
_TELL_S = 1.0


def require_own_files(folder: Path) -> None:
    """Raise ``BenchError`` where a file of the run folder is a link that leads out of it: reading and writing it would
    read and write what nobody named."""
    for name in (CONFIG_FILE, *OTHER_FILES):
        path = folder / name
        if path.is_symlink() and not path.resolve().is_relative_to(folder.resolve()):
            raise BenchError(f"{path} is a link that leads out of the run folder. Put the file itself there.")


def map_size(resources: Mapping[str, Any]) -> dict[str, Any]:
    """Size of the map in named numbers, from what ``resources.json`` holds: its ``size`` says which numbers those are.

    Runs that say nothing of it are of Gaussian maps.
    """
    named = resources.get("size", ("gaussians",))
    return {name: resources.get(name) for name in named if isinstance(name, str)}


def picture_path(folder: Path, view: View, what: str, number: int) -> Path:
    """Where a run folder keeps the picture of a frame: ``views/left/color/000012.png``."""
    return folder / "views" / view / what / f"{number:06d}.png"


def color_to_8bit(color: npt.NDArray[np.float32]) -> Image:
    """(H, W, 3) float32 clamped to [0, 1] and rounded to uint8; this is what image metrics see."""
    # One saturating, rounding pass: twice as fast as clip, multiply, round and cast.
    return np.asarray(cv2.addWeighted(color, 255.0, color, 0.0, 0.0, dtype=cv2.CV_8U), dtype=np.uint8)


def depth_to_16bit(depth: Map) -> npt.NDArray[np.uint16]:
    """(H, W) metres to metres * 256 in uint16, rounded; NaN and what is not positive become 0, far depth 65535."""
    # nan_to_num first: what a cast makes of NaN differs between machines.
    known = np.nan_to_num(depth, nan=0.0, posinf=65535.0, neginf=0.0)
    return np.asarray(cv2.addWeighted(known, DEPTH_SCALE, known, 0.0, 0.0, dtype=cv2.CV_16U), dtype=np.uint16)


class _LogFile(logging.FileHandler):
    """A log that a full disk does not make noisy: what ended the run is told by its status and its exit."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Leave out a line that can't be written; any other error is a mistake of ours, and is shown."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handleError(record)

    def close(self) -> None:
        """Close it; what a full disk did not take is lost."""
        with suppress(OSError):
            super().close()


class RunFolder:
    """Writes one run's files, each whole or not at all. Made by ``RunFolder.create``.

    ``already_done`` is True when the folder holds this very run, finished: there is nothing to do. ``warnings`` are the
    run's so far; its status has them from then on.
    """

    def __init__(self, path: Path, already_done: bool) -> None:
        self.path = path
        self.already_done = already_done
        self.warnings: Sequence[str] = ()
        self._started = ""
        self._told = -math.inf
        # Colour and depth are compressed beside each other, and beside the rendering of the next view.
        self._writers = ThreadPoolExecutor(max_workers=2, thread_name_prefix="view-png")

    @classmethod
    def create(
        cls,
        path: Path,
        config: dict[str, Any],
        config_hash: str,
        rerun: bool,
        to_resume: bool = False,
        map_file: str | None = None,
    ) -> RunFolder:
        """Make or open the folder and write ``config.yaml``; older outputs of the same config are removed.

        A finished run of the same config is left as it is (``already_done``) unless ``rerun``; ``to_resume`` keeps log
        and views of one that may be resumed, and ``map_file`` names the file of the map. Raises ``BenchError`` when the
        path is a file, can't be written, holds something else or a run of another config, or is being written by a live
        process.
        """
        if path.exists() and not path.is_dir():
            raise BenchError(f"output={path} is a file. Name a folder that is empty or not there yet.")
        if path.is_dir():
            require_own_files(path)
            known = _known_run(path)
            if known is not None:
                _require_same_config(path, known, config, config_hash)
                if _is_done(path) and not rerun:
                    return cls(path, already_done=True)
                _remove_old_outputs(path, map_file, to_resume)
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BenchError(
                f"Can't make the run folder {path}: {error.strerror}. Give output= a place that you may write to."
            ) from error
        write_config(path, config, config_hash)
        return cls(path, already_done=False)

    def set_status(
        self,
        state: str,
        reason: str = "",
        frames_done: int = 0,
        frames_total: int = 0,
        lost: Sequence[Sequence[int]] = (),
        stage: str = "",
    ) -> None:
        """Write ``status.json``; ``state`` is running, done, failed, out_of_memory or interrupted.

        ``lost`` holds [first, last] frame number of every stretch without a pose; ``stage`` says what a running run is
        about.
        """
        status = self.status_now(state, reason, frames_done, frames_total, lost, stage)
        self._started = status.started
        self._told = time.monotonic()
        write_status(self.path, status)

    def status_now(
        self,
        state: str,
        reason: str,
        frames_done: int,
        frames_total: int,
        lost: Sequence[Sequence[int]],
        stage: str = "",
    ) -> RunStatus:
        """The status that ``set_status`` would write."""
        return current_status(state, reason, frames_done, frames_total, lost, self._started, stage, self.warnings)

    def tell_progress(self, frames_done: int, frames_total: int, stage: str) -> None:
        """Keep ``status.json`` of a running run current, for those who watch it: about once a second."""
        if time.monotonic() - self._told > _TELL_S:
            self.set_status("running", "", frames_done, frames_total, stage=stage)

    def write_view(self, view: View, number: int, view_data: RenderedView, depth: Map) -> None:
        """Save a render of frame ``number``: the colour of ``view_data``, and ``depth`` (H, W) in metres.

        ``depth`` is the one that the protocol names (raw or normalised by alpha), NaN where nothing was rendered.
        """
        for picture in self.begin_view(view, number, view_data, depth):
            picture.result()

    def begin_view(self, view: View, number: int, view_data: RenderedView, depth: Map) -> list[Future[None]]:
        """As ``write_view``, in the background: each picture's end, or what went wrong with it."""
        pictures: dict[str, npt.NDArray[Any]] = {
            "color": color_to_8bit(view_data.color),
            "depth": depth_to_16bit(depth),
        }
        return [self._writers.submit(self._write_picture, view, what, number, p) for what, p in pictures.items()]

    def _write_picture(self, view: View, what: str, number: int, picture: npt.NDArray[Any]) -> None:
        path = picture_path(self.path, view, what, number)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_image(path, picture)

    def has_view(self, view: View, number: int) -> bool:
        """Whether both pictures of a view are there; each is written whole or not at all."""
        return all(picture_path(self.path, view, what, number).is_file() for what in ("color", "depth"))

    def remove_views(self) -> None:
        """Remove all pictures of views, those of masks too."""
        for file in _pictures(self.path):
            file.unlink()

    def write_mask(self, what: str, number: int, mask: Mask) -> None:
        """Save a mask (H, W) of the left image of frame ``number`` in the folder ``views/left/WHAT``."""
        self._write_picture("left", what, number, np.uint8(255) * mask)

    def write_trajectory(self, trajectory: Trajectory, ground_truth: Trajectory | None) -> None:
        """Save the estimated poses (CSV with frame numbers, KITTI, TUM) and the ground truth (CSV, KITTI)."""
        write_text(self.path / TRAJECTORY_FILE, as_csv(trajectory))
        with atomic_path(self.path / "trajectory_kitti.txt") as temporary:
            write_kitti(temporary, trajectory.T_world_cam)
        with atomic_path(self.path / "trajectory_tum.txt") as temporary:
            write_tum(temporary, trajectory)
        if ground_truth is not None:
            write_text(self.path / GROUND_TRUTH_FILE, as_csv(ground_truth))
            with atomic_path(self.path / "ground_truth_kitti.txt") as temporary:
                write_kitti(temporary, ground_truth.T_world_cam)

    def write_frames(self, rows: list[dict[str, Any]]) -> None:
        """Save what happened to each frame as ``frames.csv``: ``FRAME_COLUMNS`` and what else the run measured."""
        table = pd.DataFrame(rows, columns=None if rows else FRAME_COLUMNS)
        write_text(self.path / FRAMES_FILE, table.to_csv(index=False))

    def write_events(self, events: Sequence[Event]) -> None:
        """Save what happened, in order, as ``events.jsonl``."""
        write_events(self.path, events)

    def write_map_keyframes(self, keyframes: npt.NDArray[np.int32]) -> None:
        """Save which keyframe each element of the map's file belongs to."""
        with atomic_path(self.path / MAP_KEYFRAMES_FILE) as temporary, open(temporary, "wb") as file:
            np.save(file, keyframes, allow_pickle=False)

    def write_json(self, name: str, obj: Any) -> None:
        """Save a JSON file, for example ``resources.json``; NaN becomes null."""
        write_json(self.path / name, obj)

    @contextmanager
    def attach_log(self) -> Iterator[None]:
        """Send what the project logs (INFO and up), and other packages' warnings, to ``log.txt`` meanwhile."""
        handler = _LogFile(self.path / LOG_FILE, encoding="utf-8")
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        own = [logging.getLogger(name) for name in ("bench", "plugins")]
        levels = [logger.level for logger in own]
        logging.getLogger().addHandler(handler)
        for logger in own:
            logger.setLevel(logging.INFO)
        try:
            yield
        finally:
            logging.getLogger().removeHandler(handler)
            handler.close()
            for logger, level in zip(own, levels, strict=True):
                logger.setLevel(level)


def _known_run(path: Path) -> tuple[dict[str, Any], str] | None:
    """Config and hash of the run that lies in ``path``; None where nothing does; an error where something else does."""
    known = read_config(path)
    # Hidden entries (.hydra, .DS_Store) belong to nobody's results.
    if known is None and any(not entry.name.startswith(".") for entry in path.iterdir()):
        raise BenchError(
            f"The folder {path} is not empty and holds no run ({CONFIG_FILE} is not there or not ours). "
            "Give output= another folder, or empty this one."
        )
    return known


def _require_same_config(path: Path, known: tuple[dict[str, Any], str], config: dict[str, Any], new_hash: str) -> None:
    old_config, old_hash = known
    if old_hash == new_hash:
        return
    keys = differing_keys(old_config, config)
    shown = ", ".join(keys[:5]) + (f" and {len(keys) - 5} more" if len(keys) > 5 else "")
    raise BenchError(
        f"The folder {path} holds a run of another config (it differs in {shown or 'values edited by hand'}). "
        "Give output= another folder, or delete this one."
    )


def _is_done(path: Path) -> bool:
    status = read_status(path)
    if status is not None and status.is_alive() and status.pid != os.getpid():
        raise BenchError(f"The run in {path} is being written by process {status.pid}. Wait for it, or stop it first.")
    return status is not None and status.is_complete


def _remove_old_outputs(path: Path, map_file: str | None, to_resume: bool) -> None:
    """Remove the files that a run writes, and nothing else that may lie in the folder; log and views stay for one that
    is to be resumed."""
    for name in (*OTHER_FILES, *([map_file] if map_file else [])):
        if not (to_resume and name == LOG_FILE):
            (path / name).unlink(missing_ok=True)
    for picture in _pictures(path):
        if not to_resume or picture.match(TEMPORARY_PATTERN):
            picture.unlink()
    for leftover in path.glob(TEMPORARY_PATTERN):
        leftover.unlink()


def _pictures(path: Path) -> list[Path]:
    """The views and masks of a run folder, half-written ones too, and nothing else that may lie there."""
    files = [file for view in VIEWS for file in (path / "views" / view).glob("*/*")]
    return [file for file in files if _PICTURE.fullmatch(file.name) or file.match(TEMPORARY_PATTERN)]
