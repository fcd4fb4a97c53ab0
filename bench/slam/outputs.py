"""How a run is saved: frames, trajectory, map, resources, renders."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, wait
from typing import Any

import numpy as np

from bench.contracts.dataset import Dataset
from bench.contracts.mapper import CannotRenderError
from bench.contracts.tracker import Tracker
from bench.errors import BenchError
from bench.io.atomic import atomic_path
from bench.protocol import Protocol
from bench.runs.folder import RESOURCES_FILE, VIEWS, RunFolder, View
from bench.runs.memory import PeakMemory
from bench.slam.progress import Progress
from bench.slam.system import System
from bench.types import Float, Map, PinholeView, RenderedView, Trajectory

log = logging.getLogger(__name__)

# How many pictures may wait to be written: those of two views.
_PICTURES_WAITING = 4


def save_views(system: System, folder: RunFolder, done: Progress, step: Callable[[], None]) -> None:
    """Render every tracked frame from its final pose, left and (if the protocol asks) right, and save it.

    Views that the folder has already are kept: it must hold none of another map. They are written beside the rendering.
    Views that the mapper can't show are left out; then the frames' rows say which there are, and why others are not.
    ``step`` is called after each.
    """
    if not system.mapper.wants_keyframes:
        return
    cameras: list[View] = ["left", "right"] if system.protocol.right_view and system.dataset.has_right else ["left"]
    trajectory = system.tracker.trajectory()
    absent: dict[View, dict[int, str]] = {camera: {} for camera in cameras}
    # Networks that go by the frame before must see every one.
    keep = not (system.mapper.needs_depth and system.stereo.temporal)
    with _Writing() as writing:
        for number, T_world_cam in zip(trajectory.numbers.tolist(), trajectory.T_world_cam, strict=True):
            for camera in cameras:
                if keep and folder.has_view(camera, number):
                    continue
                try:
                    rendered = _rendered(system, camera, number, T_world_cam)
                except CannotRenderError as error:
                    absent[camera][number] = str(error)
                else:
                    depth = _depth_to_save(rendered, system.protocol)
                    writing.add(folder.begin_view(camera, number, rendered, depth))
                step()
    if any(absent.values()):
        log.warning("views could not be rendered: %d left, %d right", *(len(absent.get(c, {})) for c in VIEWS))
        _note_absent(done.rows, set(trajectory.numbers.tolist()), absent)


class _Writing:
    """Pictures that are being written; those still waiting are written at the end of the block, also after an error."""

    def __enter__(self) -> _Writing:
        self._waiting: deque[Future[None]] = deque()
        return self

    def add(self, pictures: Iterable[Future[None]]) -> None:
        """Wait until few are left; raises what went wrong with an earlier one."""
        self._waiting += pictures
        while len(self._waiting) > _PICTURES_WAITING:
            self._waiting.popleft().result()

    def __exit__(self, error: type[BaseException] | None, *rest: object) -> None:
        wait(self._waiting)
        if error is None:
            for picture in self._waiting:
                picture.result()


def _note_absent(rows: list[dict[str, Any]], tracked: set[int], absent: dict[View, dict[int, str]]) -> None:
    """Columns of ``frames.csv``: which pictures there are of each frame, and why others are absent."""
    for row in rows:
        number = row["number"]
        for camera, reasons in absent.items():
            row[f"{camera}_color"] = number in tracked and number not in reasons
        row["left_depth"] = row["left_color"]
        row["absent"] = "; ".join(dict.fromkeys(reasons[number] for reasons in absent.values() if number in reasons))


def _rendered(system: System, camera: View, number: int, T_world_cam: Float) -> RenderedView:
    """The map from one camera of a frame's pair; raises ``CannotRenderError`` for what can't be shown."""
    view = PinholeView.of(
        system.dataset.camera, T_world_cam if camera == "left" else T_world_cam @ system.dataset.camera.T_left_right
    )
    if system.mapper.needs_depth and camera == "right":
        raise CannotRenderError("the mapper needs the depth of a view, and stereo gives none of right views")
    depth = _depth_of(system, number) if system.mapper.needs_depth else None
    rendered = system.mapper.render_frame(number, camera == "right", view, depth)
    if not np.isfinite(rendered.color).all():
        raise BenchError(
            f"{type(system.mapper).__name__}.render gave NaN in the colours of frame {number}, {camera} view: the map "
            "is spoilt. The log shows the losses of each keyframe."
        )
    return rendered


def _depth_of(system: System, number: int) -> Map:
    position = system.dataset.numbers.index(number)
    return system.stereo.depth(system.dataset.frame(position), position, system.dataset.camera).depth


def _depth_to_save(view: RenderedView, protocol: Protocol) -> np.ndarray:
    if protocol.rendered_depth == "raw":
        return view.depth
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(view.alpha > 1e-3, view.depth / view.alpha, np.nan).astype(np.float32)


def save_outputs(system: System, folder: RunFolder, done: Progress, memory: PeakMemory) -> None:
    """Everything but the renders; what there is of it, when the run ended early."""
    frames = max(len(done.rows), 1)
    folder.write_frames(done.rows)
    folder.write_events(done.events)
    folder.write_trajectory(_trajectory_so_far(system.tracker, done), _ground_truth_so_far(system.dataset, done))
    size = system.mapper.size()
    if system.mapper.map_file is not None and _holds_something(size, done):
        with atomic_path(folder.path / system.mapper.map_file) as temporary:
            system.mapper.save(temporary)
        keyframes = system.mapper.keyframes_of_map()
        if keyframes is not None:
            folder.write_map_keyframes(keyframes)
    for what, number, mask in system.mapper.pictures():
        folder.write_mask(what, number, mask)
    per_frame = {f"{stage}_s_per_frame": seconds / frames for stage, seconds in done.seconds.items()}
    folder.write_json(
        RESOURCES_FILE,
        {"peak_memory_gb": done.peak_memory_gb(memory), **size, "frames": len(done.rows), "size": list(size)}
        | {f"{what}_cached_frames": sum(row[f"{what}_cached"] for row in done.rows) for what in ("tracking", "stereo")}
        | per_frame
        | {"wall_s_per_frame": None if done.wall_s is None else done.wall_s / frames},
    )


def _holds_something(size: dict[str, int], done: Progress) -> bool:
    """Whether there is a map to save: an empty one, after a failure in the first keyframe, is none."""
    return any(size.values()) if size else any(row["mapped"] for row in done.rows)


def _trajectory_so_far(tracker: Tracker, done: Progress) -> Trajectory:
    """The poses of the frames that are done; the front end of an interrupted run may have been ahead of them."""
    trajectory = tracker.trajectory()
    return trajectory.of_frames([row["number"] for row in done.rows])


def _ground_truth_so_far(dataset: Dataset, done: Progress) -> Trajectory | None:
    truth = dataset.ground_truth()
    if truth is None:
        return None
    return truth.of_frames([row["number"] for row in done.rows])
