"""SplaTAM's rhythm: every frame is mapped, and every fifth is kept to be learned from again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bench.contracts.keyframer import Keyframer
from bench.errors import require_least
from bench.registry import PluginConfig, register
from bench.types import KeyframeDecision, StereoFrame, TrackingResult


@dataclass(frozen=True)
class SplatamKeyframerConfig(PluginConfig):
    """How often; the defaults are those of all of SplaTAM's configs."""

    map_every: int = 1
    """The first frame is mapped, and of all frames each n-th one."""
    keyframe_every: int = 5
    """The first frame is kept, and of all frames each n-th one that is mapped."""

    def __post_init__(self) -> None:
        require_least("keyframer", self, map_every=1, keyframe_every=1)


@register("keyframer", "splatam", config=SplatamKeyframerConfig)
class SplatamKeyframer(Keyframer):
    """SplaTAM's rhythm: maps each ``map_every``-th frame and keeps each ``keyframe_every``-th for ever.

    Its window holds all that are kept, and the new frame; ``mapper=splatam`` draws those from it that overlap with the
    new frame. Frames that are lost or held out are not counted. The last but one frame is kept by SplaTAM as well, for
    the last one's mapping alone: here it is not, since a keyframer does not know which frame is the last.
    """

    def __init__(self, config: SplatamKeyframerConfig) -> None:
        self._config = config
        self._frames = 0
        self._kept: list[int] = []

    def update(self, frame: StereoFrame, tracking: TrackingResult) -> KeyframeDecision:
        """Decide by the number of frames so far."""
        c = self._config
        self._frames += 1
        mapped = self._frames == 1 or self._frames % c.map_every == 0
        if not mapped:
            return KeyframeDecision(False, f"not one of every {c.map_every} frames", tuple(self._kept))
        window = (*self._kept, frame.number)
        if self._frames == 1 or self._frames % c.keyframe_every == 0:
            self._kept.append(frame.number)
            return KeyframeDecision(True, "mapped and kept", window)
        return KeyframeDecision(True, "mapped", window)

    def state(self) -> dict[str, Any]:
        """Frames so far and those kept."""
        return {"frames": self._frames, "kept": list(self._kept)}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state``."""
        self._frames, self._kept = state["frames"], list(state["kept"])
