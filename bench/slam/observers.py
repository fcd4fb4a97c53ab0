"""Who follows a run: the viewer and the loggers of its config, none of which can spoil it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bench import registry
from bench.config import RunConfig
from bench.contracts.observer import FrameDone, Observer, RunBegins
from bench.errors import BenchError
from bench.registry import OBSERVERS
from bench.slam.front_end import Seen
from bench.slam.system import System
from bench.terminal import tell

log = logging.getLogger(__name__)


class Observers:
    """All of them as one; one that fails is told once and left out from then on. They are ended with the block."""

    def __init__(self, observers: dict[str, Observer]) -> None:
        self._observers = observers
        self._begun = False

    @classmethod
    def of(cls, config: RunConfig) -> Observers:
        """Those that the config names; raises ``BenchError`` for one that can't work on this machine."""
        chosen = [(kind, each) for kind in OBSERVERS for each in config.several(kind)]
        return cls({f"{kind}={each.name}": registry.build(each, kind) for kind, each in chosen})

    def begin(self, folder: Path, config: RunConfig, system: System, first: int) -> None:
        """The frames of the run in ``folder`` from position ``first`` on are to come."""
        if self._observers:
            self._begun, data = True, system.dataset
            about = (folder, config.values, config.hash, data.camera, data.numbers, first, data.ground_truth())
            self._tell(Observer.begin, RunBegins(*about))

    def frame(self, system: System, seen: Seen, losses: dict[str, float] | None) -> None:
        """A frame is done; ``losses`` are those of a keyframe that was mapped."""
        if self._observers:
            of_keyframe = () if losses is None else (seen.keyframe, losses, seen.trajectory, system.mapper.view())
            self._tell(Observer.frame, FrameDone(seen.frame, seen.T_world_cam, dict(seen.row), *of_keyframe))

    def optimised(self, system: System) -> None:
        """The last optimisation is over."""
        if self._observers:
            self._tell(Observer.optimised, system.tracker.trajectory(), system.mapper.view())

    def scored(self, metrics: Mapping[str, Any]) -> None:
        """The run has been scored."""
        self._tell(Observer.scored, metrics)

    def __enter__(self) -> Observers:
        return self

    def __exit__(self, *exception: object) -> None:
        self._tell(Observer.end)

    def _tell(self, moment: Callable[..., None], *what: Any) -> None:
        """Call this method of each, if the run has begun: one that was done already is followed by nobody."""
        for name, observer in list(self._observers.items()) if self._begun else ():
            try:
                getattr(observer, moment.__name__)(*what)
            except (Exception, SystemExit) as error:  # the border to code that is no part of the run
                del self._observers[name]
                said = str(error) if isinstance(error, BenchError) else f"{type(error).__name__}: {error}"
                log.warning("%s failed and is left out from here on", name, exc_info=error)
                tell(f"{name} failed and is left out from here on; the run goes on. {' '.join(said.split())}")
