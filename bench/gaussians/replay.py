"""The keyframes that mapping learns from again: their views, and what renders of these are compared with."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch

from bench.gaussians.keyframe_store import KeyframeStore
from bench.gaussians.mapping_config import GaussianMapperConfig
from bench.io.array_store import ArrayStore
from bench.supervision.target import Target, right_target_of, target_of
from bench.types import Float, Mask, PinholeView, StereoCamera, Trajectory

Correct = Callable[[int, Float], Float]
"""From a keyframe's number and the tracker's pose to the pose that mapping has refined."""


class Replay:
    """Keyframes by number, in memory or on disk; views are made once per pose, and the last targets are kept.

    ``correct``: the refined pose (4, 4) of a keyframe. ``ignored``: the mask (H, W) of what its colours do not show of
    the map, or None.
    """

    def __init__(
        self,
        camera: StereoCamera,
        config: GaussianMapperConfig,
        store: ArrayStore,
        correct: Correct,
        ignored: Callable[[int], Mask | None],
        device: torch.device,
    ) -> None:
        self.use_store(store)
        self._camera, self._config, self._device = camera, config, device
        self._correct, self._ignored = correct, ignored
        self._before: Trajectory | None = None
        self._views: dict[tuple[int, bool], PinholeView] = {}
        self._targets: OrderedDict[tuple[int, bool, bool], Target] = OrderedDict()
        self._learned_at: dict[int, int] = {}

    def use_store(self, store: ArrayStore) -> None:
        """Where keyframes go that are let go; before the first one."""
        self.keyframes = KeyframeStore(store)

    def place(self, number: int) -> Float:
        """Where the tracker has the camera of a keyframe now, (3,) metres."""
        return self.keyframes.pose(number)[:3, 3]

    def follow(self, trajectory: Trajectory) -> None:
        """Take over the poses of keyframes that differ from those of the trajectory before."""
        before, self._before = self._before, trajectory
        changed = np.ones(len(trajectory), bool)
        if before is not None and np.array_equal(before.numbers, trajectory.numbers[: len(before)]):
            changed[: len(before)] = (before.T_world_cam != trajectory.T_world_cam[: len(before)]).any(axis=(1, 2))
        for number, pose in zip(trajectory.numbers[changed].tolist(), trajectory.T_world_cam[changed], strict=True):
            if number in self.keyframes:
                self.keyframes.set_pose(number, pose)
                self.forget_view(number)

    def view(self, number: int, right: bool = False) -> PinholeView:
        """The view of a keyframe's left or right camera."""
        if (number, right) not in self._views:
            T_world_cam = self._correct(number, self.keyframes.pose(number))
            T_world_cam = T_world_cam @ self._camera.T_left_right if right else T_world_cam
            self._views[number, right] = PinholeView.of(self._camera, T_world_cam)
        return self._views[number, right]

    def target(self, number: int, half: bool, right: bool = False) -> Target:
        """The target of a keyframe at half or full resolution; of those kept the least recently used one is dropped."""
        key = (number, right, half)
        target = self._targets.pop(key, None)
        if target is None:
            full = self._targets.get((number, right, False)) or self._made(number, right)
            target = full.halved() if half else full
        self._targets[key] = target
        while sum(1 if of_half else 4 for *_, of_half in self._targets) > 4 * self._config.cached_targets:
            self._targets.popitem(last=False)
        return target

    def _made(self, number: int, right: bool) -> Target:
        keyframe, view, c = self.keyframes[number], self.view(number, right), self._config
        if right:
            return right_target_of(keyframe, view, c.depth_range_m, self._device)
        return target_of(keyframe, view, c.depth_range_m, self._device, c.color_pixels, self._ignored(number))

    def learned(self, number: int, step: int) -> None:
        """Step ``step`` of the optimizer learned from this keyframe."""
        self._learned_at[number] = step

    def older(self, among: Sequence[int], step: int, random: np.random.Generator) -> int:
        """One of these keyframes by ``mapper.older_views``; ``step`` is that of the optimizer now."""
        if self._config.older_views == "uniform":
            return among[int(random.integers(len(among)))]
        ages = np.array([step + 1 - self._learned_at.get(number, 0) for number in among], float)
        return among[int(random.choice(len(among), p=ages / ages.sum()))]

    def forget_ages_but(self, live: Sequence[int]) -> None:
        """Of these alone it still matters when they were last learned from."""
        self._learned_at = {number: self._learned_at[number] for number in live if number in self._learned_at}

    def let_go(self, number: int) -> None:
        """A keyframe goes to disk, from where it comes back when it is asked for; ``BenchError`` if it can't be
        written."""
        self.keyframes.let_go(number)
        self.forget_view(number)
        self.forget_target(number)

    def forget_view(self, number: int) -> None:
        """The view is to be made again."""
        self._views.pop((number, False), None)
        self._views.pop((number, True), None)

    def forget_target(self, number: int) -> None:
        """The targets are to be made again."""
        for key in [key for key in self._targets if key[0] == number]:
            del self._targets[key]

    def state(self) -> dict[str, Any]:
        """For a checkpoint; ``stored``: names in the store."""
        return self.keyframes.state() | {"learned_at": dict(self._learned_at)}

    def restore(self, state: dict[str, Any]) -> None:
        """Resume from what ``state`` gave."""
        self.keyframes.restore(state)
        self._learned_at = dict(state["learned_at"])
