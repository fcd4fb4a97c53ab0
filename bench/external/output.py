"""Reading a folder of another system's output: everything is checked here, before anything is written."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.external.hints import about_convention, check_depth_unit
from bench.external.numbering import (
    Places,
    in_frame_order,
    places_of_lines,
    places_of_names,
    places_of_numbers,
    places_of_times,
)
from bench.external.pictures import DepthFormat, NotMetricError, check_content, check_depth_pictures, check_sizes
from bench.external.poses import WrittenPoses, read_written_poses
from bench.external.search import Pictures, search
from bench.external.settings import ScoreSettings
from bench.io.foreign import read_plain
from bench.io.torch_files import MOST_BYTES
from bench.io.trajectories import known_poses
from bench.runs.config_file import CONFIG_FILE, read_config
from bench.types import Float, Trajectory


@dataclass(frozen=True)
class ExternalOutput:
    """What was found; files by the position of their frame in the data set.

    ``times`` (N,) are the frames' in seconds, ``mapped`` the positions that the system says it mapped. ``about`` says
    what was found and what not, one line each; ``sources`` says where it lay, by what it is.
    """

    times: Float
    trajectory: Trajectory | None = None
    left: Mapping[int, Path] = field(default_factory=dict)
    right: Mapping[int, Path] = field(default_factory=dict)
    depth: Mapping[int, Path] = field(default_factory=dict)
    depth_format: DepthFormat = field(default_factory=lambda: DepthFormat(None, False))
    mapped: frozenset[int] = frozenset()
    sources: Mapping[str, str] = field(default_factory=dict)
    content: str = ""
    about: tuple[str, ...] = ()


def read_output(folder: Path, settings: ScoreSettings, dataset: Dataset) -> ExternalOutput:
    """Find and check what ``folder`` holds of a system's run on ``dataset``.

    Raises ``BenchError`` for a folder with nothing to score (unless the run is said to have failed), a run folder of
    the bench's own, and everything in it that can't be scored.
    """
    _require_external(folder)
    contents = search(folder, settings)
    times = frame_times(dataset)
    reader = _Reader(folder, settings, dataset, times)
    reader.read_trajectory(contents.trajectory, contents.outside)
    left = reader.pictures("renders", contents.renders)
    right = reader.pictures("right renders", contents.renders_right)
    form = DepthFormat(settings.depth_scale, settings.depth_scale is not None)
    depth = reader.depth(contents.depth, form)
    if settings.status == "done" and not reader.sources:
        raise BenchError(
            f"{folder} holds nothing to score: no trajectory, renders or depth was found{reader.unopened}. Say where "
            "they lie with --trajectory, --renders (. for the folder itself), --depth or in a score.yaml; say --status "
            "if the system's run failed."
        )
    return ExternalOutput(
        times=times,
        trajectory=reader.trajectory,
        left=left,
        right=right,
        depth=depth,
        depth_format=form,
        mapped=frozenset(reader.mapped),
        sources=reader.sources,
        content=reader.digest.hexdigest(),
        about=tuple(reader.about),
    )


def frame_times(dataset: Dataset) -> Float:
    """Times of all frames (N,) in seconds; where not each has ground truth, frames have to be decoded for them."""
    truth = dataset.ground_truth()
    if truth is not None and len(truth) == len(dataset):
        return truth.timestamps
    return np.array([dataset.frame(position).timestamp for position in range(len(dataset))])


def _require_external(folder: Path) -> None:
    if not folder.is_dir():
        raise BenchError(f"There is no folder {folder}. Give the one with the system's output.")
    if (folder / CONFIG_FILE).is_file() and read_config(folder) is not None:
        raise BenchError(
            f"{folder} is a run folder of this bench; `bgs-bench evaluate {folder}` scores it again, also under "
            "another protocol."
        )


class _Reader:
    """Collects what is found, its digest, and what to tell."""

    def __init__(self, folder: Path, settings: ScoreSettings, dataset: Dataset, times: Float) -> None:
        self._folder, self._settings, self._dataset, self._times = folder, settings, dataset, times
        self.trajectory: Trajectory | None = None
        self.mapped: list[int] = []
        self.sources: dict[str, str] = {}
        self.about: list[str] = []
        self.unopened = ""
        self.digest = hashlib.sha256()

    def read_trajectory(self, path: Path | None, outside: Sequence[Path]) -> None:
        """Read the poses and find their frames."""
        if path is None:
            unopened = ", ".join(str(link.relative_to(self._folder)) for link in outside[:5])
            why = f"; not opened, as it leads out of the folder: {unopened}. Put a copy there" if outside else ""
            self.unopened = why
            self.about.append(f"trajectory: none found{why}")
            return
        written, frames = read_written_poses(path), self._dataset.numbers
        places = self._places(written, str(path))
        rows = np.flatnonzero((places.positions >= 0) & known_poses(written.T))
        rows = rows[np.argsort(places.positions[rows], kind="stable")]
        at = places.positions[rows]
        T = written.camera_to_world(self._settings.convention, self._settings.axes)[rows]
        numbers = np.array(frames, dtype=np.int64)[at]
        self.trajectory = Trajectory(T, numbers, self._times[at])
        self._remember("trajectory", path.relative_to(self._folder), [path])
        shown = f"{len(rows)} poses" if len(rows) == len(frames) else f"poses of {len(rows)} of {len(frames)} frames"
        others = f", {places.left_out} of other frames left out" if places.left_out else ""
        where = path.relative_to(self._folder)
        self.about.append(f"trajectory: {where}, {written.form}, {shown} by {places.by}{others}")
        hint = about_convention(written, self.trajectory, rows, self._dataset.ground_truth())
        self.about += [f"hint: {hint}"] if hint is not None else []
        self._remember_keyframes(written, places)

    def _places(self, written: WrittenPoses, what: str) -> Places:
        frames, mode = self._dataset.numbers, self._settings.numbers
        if written.numbers is not None:
            return places_of_numbers(written.numbers, frames, mode, what)
        if written.times is None:
            # A system that stopped early did the first frames.
            stopped = self._settings.status != "done" and len(written.T) < len(frames)
            mode = "position" if mode == "auto" and stopped else mode
            return places_of_lines(len(written.T), frames, mode, what)
        if mode == "auto":
            return places_of_times(written.times, self._times, self._settings.max_time_difference_s, what)
        counted = np.rint(written.times)
        if np.abs(written.times - counted).max() > 0:
            raise BenchError(f"{what}: --numbers {mode} needs whole numbers in place of times. Leave --numbers out.")
        return places_of_numbers(counted.astype(np.int64), frames, mode, what)

    def _remember_keyframes(self, written: WrittenPoses, places: Places) -> None:
        if written.keyframes is None:
            return
        if written.numbers is not None:
            positions = places.positions[np.isin(written.numbers, written.keyframes)]
        else:
            inside = written.keyframes[(written.keyframes >= 0) & (written.keyframes < len(places.positions))]
            positions = places.positions[inside]
        self.mapped = sorted({int(position) for position in positions if position >= 0})
        self.about.append(f"keyframes: {len(self.mapped)}, as the trajectory's file says")

    def pictures(self, kind: str, found: Pictures | None) -> dict[int, Path]:
        """The renders of one camera by position, all of the right size."""
        if found is None:
            self.about.append(f"{kind}: none found")
            return {}
        check_sizes(found.files, self._size)
        return self._placed(kind, found)

    def depth(self, found: Pictures | None, form: DepthFormat) -> dict[int, Path]:
        """The depth files by position; pictures that are for looking at are left out, unless the user named them."""
        if found is None:
            self.about.append("depth: none found")
            return {}
        try:
            check_sizes(found.files, self._size)
            check_depth_pictures(found.files)
        except NotMetricError as error:
            if found.asked:
                raise
            self.about.append(f"depth: not scored; {error}")
            return {}
        files = self._placed("depth", found)
        hint = check_depth_unit(files, form, self._dataset)
        self.about += [f"hint: {hint}"] if hint is not None else []
        return files

    @property
    def _size(self) -> tuple[int, int]:
        return self._dataset.camera.width, self._dataset.camera.height

    def _placed(self, kind: str, found: Pictures) -> dict[int, Path]:
        named, frames = in_frame_order(found.files), self._dataset.numbers
        mode, tolerance_s = self._settings.numbers, self._settings.max_time_difference_s
        what = str(self._folder / found.where)
        places = places_of_names(named, frames, self._times, mode, tolerance_s, what)
        files = {int(at): file for at, file in zip(places.positions, named.files, strict=True) if at >= 0}
        self._remember(kind, found.where, [files[at] for at in sorted(files)])
        outside = f", {places.left_out} of other frames left out" if places.left_out else ""
        lossy = ", JPEG (lossy)" if any(file.suffix.lower() in (".jpg", ".jpeg") for file in found.files) else ""
        self.about.append(f"{kind}: {found.where}, {len(files)} of {len(frames)} frames by {places.by}{outside}{lossy}")
        return files

    def _remember(self, kind: str, where: str | Path, files: list[Path]) -> None:
        self.sources[kind] = str(where)
        for file in files:
            content = read_plain(file, MOST_BYTES)
            check_content(file, content)
            its_hash = hashlib.sha256(content).hexdigest()
            self.digest.update(f"{kind} {file.relative_to(self._folder)} {its_hash}\n".encode())
