"""MonoGS's keyframes: little overlap of the Gaussians seen, or a motion that is long for the depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from bench.contracts.keyframer import Keyframer
from bench.contracts.map_view import MapView
from bench.errors import require_between, require_least
from bench.registry import PluginConfig, register
from bench.types import Float, KeyframeDecision, Mask, PinholeView, StereoCamera, StereoFrame, TrackingResult

_OPAQUE = 0.95
_NEWEST_KEPT = 2
"""So many of the newest keyframes, the one that comes included, never leave the window."""


@dataclass(frozen=True)
class MonoGSKeyframerConfig(PluginConfig):
    """Settings of MonoGS's rule; the defaults are those for Replica."""

    interval: int = 4
    """Frames between two keyframes at least; while the window is not full, and with ``interval_always`` ever after."""
    interval_always: bool = True
    """As in the original's single-process variant."""
    translation: float = 0.04
    """A frame this far from the last keyframe becomes one, as a share of the median depth."""
    min_translation: float = 0.02
    """A frame with less overlap than ``overlap`` must at least be so far, as a share of the median depth."""
    overlap: float = 0.95
    """Intersection over union of the Gaussians that a frame and the last keyframe see."""
    cutoff: float = 0.4
    """A keyframe leaves the window when it shares no more of what it or the newest one sees, whichever is fewer."""
    window_size: int = 10
    """Keyframes in the window."""

    def __post_init__(self) -> None:
        require_between("keyframer", self, 0, 1, "overlap", "cutoff")
        require_least("keyframer", self, interval=1, window_size=_NEWEST_KEPT, translation=0, min_translation=0)


@register("keyframer", "monogs", config=MonoGSKeyframerConfig)
class MonoGSKeyframer(Keyframer):
    """MonoGS's keyframe rule and window, by the Gaussians that frames see in the map of now.

    Seen is what is blended somewhere while more than half of the light is left; the original counts what leaves half
    of it. What keyframes see is asked anew, since Gaussians come and go.
    """

    uses_map = True

    def __init__(self, config: MonoGSKeyframerConfig) -> None:
        self.config = config
        self._window: list[tuple[int, Float]] = []  # newest first
        self._since = 0

    def start(self, camera: StereoCamera) -> None:
        self._camera = camera

    def use_map(self, view: MapView) -> None:
        view.require_images()
        self._map = view

    def update(self, frame: StereoFrame, tracking: TrackingResult) -> KeyframeDecision:
        """Decide on one tracked frame; the first one is always a keyframe."""
        assert tracking.T_world_cam is not None
        pose = tracking.T_world_cam
        self._since += 1
        if not self._window:
            return self._admit(frame.number, pose, "first frame")
        seen, last = self._seen(pose), self._pose(0)
        share = overlap(seen, self._seen(last))
        distance = float(np.linalg.norm(pose[:3, 3] - last[:3, 3]))
        reason = self._reason(share, distance, self._median_depth(pose))
        if reason is None:
            return KeyframeDecision(False, f"overlap {share:.2f}, moved {distance:.3f} m", self._numbers())
        return self._admit(frame.number, pose, reason)

    def _reason(self, share: float, distance: float, depth: float) -> str | None:
        """In words, why this is a keyframe; None if it is none. ``depth``: NaN where the map shows nothing."""
        c = self.config
        little = share < c.overlap
        in_time = self._since >= c.interval
        if len(self._window) < c.window_size:
            return f"overlap {share:.2f}, window not full" if little and in_time else None
        if c.interval_always and not in_time:
            return None
        if distance > c.translation * depth:
            return f"moved {distance:.3f} m, with {depth:.2f} m median depth"
        if little and not distance <= c.min_translation * depth:  # also where the depth is not known
            return f"overlap {share:.2f}, moved {distance:.3f} m"
        return None

    def _admit(self, number: int, pose: Float, reason: str) -> KeyframeDecision:
        self._window = [(number, pose), *((n, self._pose(place)) for place, (n, _) in enumerate(self._window))]
        sights = [self._seen(each) for _, each in self._window]
        gone = leaves_window(sights, self.config.cutoff)
        if gone is not None:
            self._window.pop(gone)
        if len(self._window) > self.config.window_size:
            self._window.pop(most_crowded([each[:3, 3] for _, each in self._window]))
        self._since = 0
        return KeyframeDecision(True, reason, self._numbers())

    def _pose(self, place: int) -> Float:
        """Of a keyframe of the window, as it is known now."""
        number, pose = self._window[place]
        refined = self._map.refined_pose(number)
        return pose if refined is None else refined

    def _numbers(self) -> tuple[int, ...]:
        return tuple(number for number, _ in reversed(self._window))

    def _seen(self, T_world_cam: Float) -> Mask:
        return np.asarray(self._map.seen(PinholeView.of(self._camera, T_world_cam)) > 0)

    def _median_depth(self, T_world_cam: Float) -> float:
        rendered = self._map.render(PinholeView.of(self._camera, T_world_cam))
        known = rendered.depth[(rendered.depth > 0) & (rendered.alpha > _OPAQUE)]
        return float(np.median(known)) if len(known) else float("nan")

    def state(self) -> dict[str, Any]:
        return {
            "window": [(number, torch.from_numpy(pose.copy())) for number, pose in self._window],
            "since": self._since,
        }

    def restore(self, state: dict[str, Any]) -> None:
        self._window = [(number, pose.numpy()) for number, pose in state["window"]]
        self._since = state["since"]


def overlap(one: Mask, other: Mask) -> float:
    """Intersection over union of what two views see, (N,) each; 0 where neither sees anything."""
    union = int((one | other).sum())
    return int((one & other).sum()) / union if union else 0.0


def leaves_window(sights: Sequence[Mask], cutoff: float) -> int | None:
    """The oldest of the keyframes, newest first, that shares at most ``cutoff`` of the smaller sight with the newest;
    None where all share more. The first two stay."""
    newest = sights[0]
    for place in range(len(sights) - 1, _NEWEST_KEPT - 1, -1):
        fewer = min(int(newest.sum()), int(sights[place].sum()))
        if int((newest & sights[place]).sum()) <= cutoff * fewer:
            return place
    return None


def most_crowded(centres: Sequence[Float]) -> int:
    """Which of the camera centres (3,) in metres, newest first, to leave out: far from the newest and near to others.

    The one with the largest sqrt(distance to the newest) times the sum of 1 / (distance + 1e-6) to the others that may
    leave, which are all but the first two.
    """
    old = np.stack(centres[_NEWEST_KEPT:])
    apart = np.linalg.norm(old[:, None] - old[None], axis=2) + 1e-6
    np.fill_diagonal(apart, np.inf)
    near = (1 / apart).sum(1)
    return _NEWEST_KEPT + int(np.argmax(np.sqrt(np.linalg.norm(old - centres[0], axis=1)) * near))
