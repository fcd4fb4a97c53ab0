"""The contract of viewers and loggers: they follow a run, resumed ones too, and leave it as it is."""

from __future__ import annotations

import random
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from bench.authoring.verdict import Candidate, Check, ContractBrokenError
from bench.contracts.map_view import MapPoints, MapView
from bench.contracts.observer import FrameDone, Observer, RunBegins
from bench.types import DepthMap, Keyframe, PinholeView, RenderedView, Trajectory

_FRAMES = 4


class _Points(MapView):
    """A map of 10 points, and nothing else."""

    def points(self, most: int) -> MapPoints:
        count = min(10, most)
        places = np.arange(3 * count, dtype=np.float32).reshape(-1, 3)
        return MapPoints(places, np.zeros((count, 3), np.uint8), np.ones(count, np.float32))

    def render(self, view: PinholeView) -> RenderedView:
        blank = np.zeros((view.height, view.width), np.float32)
        return RenderedView(np.zeros((*blank.shape, 3), np.float32), blank, blank.copy())

    def differentiate(self, view: PinholeView, loss: Any) -> Any:
        raise NotImplementedError

    def seen(self, view: PinholeView) -> Any:
        return np.zeros(10, np.int32)

    def median_depth(self, view: PinholeView) -> Any:
        return np.full((view.height, view.width), np.nan, np.float32)


@dataclass
class Subject:
    """The viewer or logger under test, and a run to follow: a keyframe, a frame, a lost one, a keyframe."""

    candidate: Candidate

    @cached_property
    def frames(self) -> list[FrameDone]:
        dataset = self.candidate.other("dataset")
        count = min(_FRAMES, len(dataset))
        poses = np.tile(np.eye(4), (count, 1, 1))
        poses[:, 2, 3] = np.arange(count)
        numbers = np.array(dataset.numbers[:count])
        frames = [dataset.frame(position) for position in range(count)]
        trajectory = Trajectory(poses, numbers, np.array([frame.timestamp for frame in frames]))
        found = []
        for position, (frame, pose) in enumerate(zip(frames, poses, strict=True)):
            row = {"number": frame.number, "timestamp": frame.timestamp, "state": "ok", "tracking_s": 0.1}
            done = FrameDone(frame, pose, row | {"is_keyframe": False})
            if position == 2:
                done = replace(done, T_world_cam=None, row=row | {"state": "lost"})
            elif position != 1:
                depth = DepthMap(np.full(frame.left.shape[:2], 5.0, np.float32), "check-plugin")
                depth.depth[0] = np.nan
                measured = {"mapped": True, "psnr_while_mapping": 20.0, "gaussians": 10, "loss": float("nan")}
                keyframe = Keyframe(replace(frame, depth=depth), depth, None, pose)
                done = FrameDone(frame, pose, row | measured, keyframe, {"rgb": 0.1}, trajectory, _Points())
            found.append(done)
        return found

    @contextmanager
    def begun(self, first: int = 0) -> Iterator[tuple[Observer, Path]]:
        """A fresh one that has been told of a run in a temporary folder; it is told of its end, too."""
        run, dataset = self.candidate.run, self.candidate.other("dataset")
        with tempfile.TemporaryDirectory() as place:
            observer: Observer = self.candidate.build()
            numbers = dataset.numbers[:_FRAMES]
            about = RunBegins(Path(place), run.values, run.hash, dataset.camera, numbers, first, dataset.ground_truth())
            observer.begin(about)
            yield observer, Path(place)
            observer.end()


def _follows(subject: Subject) -> str:
    with subject.begun() as (observer, _):
        for done in subject.frames:
            observer.frame(done)
        observer.optimised(_last_trajectory(subject.frames), _Points())
        observer.scored({"views": {"left": {"psnr_db": 20.0, "lpips": None}}, "notes": {"lpips": "none"}})
    return "begin, frame, optimised, scored, end; with a lost frame, and values that are no numbers"


def _stops_early(subject: Subject) -> str:
    with subject.begun():
        pass
    with subject.begun() as (observer, _):
        observer.frame(replace(subject.frames[0], map=None))
    return "a run without a frame; one that broke after the first, of a mapper that shows no map"


def _resumes(subject: Subject) -> str:
    with subject.begun(first=1) as (observer, _):
        for done in subject.frames[1:]:
            observer.frame(done)
    return "a run that goes on after its first frame"


def _leaves_alone(subject: Subject) -> str:
    """Arrays and the random states that a run could use are the same afterwards."""
    before, random_before = [array.copy() for array in _arrays(subject.frames)], _random_states()
    _follows(subject)
    if not all(np.array_equal(a, b, equal_nan=True) for a, b in zip(before, _arrays(subject.frames), strict=True)):
        raise ContractBrokenError(
            "an image, a depth map or a pose was changed in place",
            "what the run has stays as it is",
            "work on a copy: image.copy()",
            "frame",
        )
    if random_before != _random_states():
        raise ContractBrokenError(
            "a global random state is not what it was",
            "the same, for the run's bits to be the same",
            "draw from a generator of your own: np.random.default_rng()",
            "frame",
        )
    return "images, depth and poses as they were; so are the random states of torch, NumPy and Python"


def _arrays(frames: Sequence[FrameDone]) -> list[np.ndarray]:
    found: list[np.ndarray] = [done.frame.left for done in frames]
    for done in frames:
        if done.keyframe is not None and done.trajectory is not None:
            found += [done.keyframe.depth.depth, done.keyframe.T_world_cam, done.trajectory.T_world_cam]
    return found


def _random_states() -> tuple[object, ...]:
    return torch.get_rng_state().numpy().tobytes(), repr(np.random.get_state()), random.getstate()


def _last_trajectory(frames: Sequence[FrameDone]) -> Trajectory:
    return next(done.trajectory for done in reversed(frames) if done.trajectory is not None)


_CHECKS: tuple[tuple[str, Callable[[Subject], str]], ...] = (
    ("a whole run", _follows),
    ("stopped early", _stops_early),
    ("resumed", _resumes),
    ("leaves it alone", _leaves_alone),
)


def checks_of(subject: Subject) -> list[Check[Subject]]:
    """All checks of the kind."""
    return [Check(title, check) for title, check in _CHECKS]
