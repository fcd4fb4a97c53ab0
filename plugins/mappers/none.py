"""No map at all: for runs that are about tracking alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from bench.contracts.loss import LossTerm
from bench.contracts.mapper import Mapper
from bench.errors import BenchError
from bench.registry import PluginConfig, register
from bench.types import Keyframe, Map, MappingReport, PinholeView, RenderedView, StereoCamera, Trajectory


@register("mapper", "none")
class NoMapper(Mapper):
    """Builds nothing, so that trackers can be compared in seconds; stereo and sky are not computed either."""

    wants_keyframes = False

    def __init__(self, config: PluginConfig) -> None:
        self.config = config

    def start(self, camera: StereoCamera, losses: Sequence[LossTerm], seed: int) -> None:
        """Nothing to prepare."""

    def add_keyframe(self, keyframe: Keyframe, window: Sequence[int]) -> MappingReport:
        """Nothing is learnt."""
        return MappingReport(float("nan"))

    def update_poses(self, trajectory: Trajectory) -> None:
        """There is nothing that could move."""

    def finish(self) -> None:
        """Nothing is left to do."""

    def state(self) -> dict[str, Any]:
        """Nothing to keep: so that tracking alone has checkpoints."""
        return {}

    def restore(self, state: dict[str, Any], keyframes: Iterable[Keyframe]) -> None:
        """Nothing to take over."""

    def render(self, view: PinholeView, depth: Map | None = None) -> RenderedView:
        """There is nothing to see; raises ``BenchError``."""
        raise BenchError("mapper=none has no map to render; choose another mapper, for example mapper=gaussian.")
