"""Runs of verified places that tell the same story: what it takes to believe in a loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bench.geometry import se3
from bench.io.torch_files import from_state, to_state
from bench.tracking.loops.verification import Verified, close
from bench.types import Float

_MAX_MISSED = 2
"""Places in a row that may fail to verify before a run ends."""
_TOLERANCE_M, _TOLERANCE_SHARE, _TOLERANCE_DEG = 0.3, 0.02, 2.0
"""How far a match may lie from where odometry puts it: metres, plus a share of the way since the last match; angle."""
_RIVAL_M = 1.0
_RIVAL_SHARE = 0.5
"""A run that moves the camera more than this elsewhere, with at least this share of the inliers, is a rival."""


@dataclass(frozen=True)
class Match:
    """Old place number ``old`` seen again from new place number ``new`` (their keyframes may have other numbers)."""

    old: int
    new: int
    verified: Verified


@dataclass
class Run:
    """Matches of successive new places that agree with the odometry between them, on both roads."""

    matches: list[Match]
    """In the order of their new places."""
    closed: bool = False
    """Whether the run's matches are in the pose graph already."""
    waiting: int = 0
    """Matches, counted from the end, that are not in the pose graph yet."""
    wanted: int = 0
    """Matches that it takes before the pose graph is asked, after it refused the run once."""

    @property
    def last(self) -> Match:
        """The newest match."""
        return self.matches[-1]

    def inliers(self) -> int:
        """Inliers of the last few matches together."""
        return sum(match.verified.inliers for match in self.matches[-3:])

    def alive(self, new: int) -> bool:
        """Whether place ``new`` may still go on with the run."""
        return new - self.last.new <= _MAX_MISSED + 1

    def predicted(self, T_world_places: Float, new: int) -> Float:
        """Pose (4, 4) of place ``new`` in the world of the old road: from the last match on by odometry."""
        step = se3.inverse(T_world_places[self.last.new]) @ T_world_places[new]
        return T_world_places[self.last.old] @ self.last.verified.T_old_new @ step

    def continues_with(self, match: Match, T_world_places: Float, way: float) -> bool:
        """Whether a match agrees with this run; ``way`` is the length in metres of the road since the last match."""
        measured = T_world_places[match.old] @ match.verified.T_old_new
        difference = se3.inverse(self.predicted(T_world_places, match.new)) @ measured
        return close(difference, _TOLERANCE_M + _TOLERANCE_SHARE * way, _TOLERANCE_DEG)

    def append(self, match: Match) -> None:
        """Go on with a match."""
        self.matches.append(match)
        self.waiting += 1

    def state(self) -> dict[str, Any]:
        """For a checkpoint."""
        matches = [{"old": m.old, "new": m.new, "verified": to_state(vars(m.verified))} for m in self.matches]
        return {"matches": matches, "closed": self.closed, "waiting": self.waiting, "wanted": self.wanted}

    @classmethod
    def of_state(cls, state: dict[str, Any]) -> Run:
        """The run that gave ``state``."""
        matches = [
            Match(match["old"], match["new"], Verified(**from_state(match["verified"]))) for match in state["matches"]
        ]
        return cls(matches, state["closed"], state["waiting"], state["wanted"])


def rival_of(run: Run, runs: list[Run], T_world_places: Float) -> bool:
    """Whether another run says, on evidence that is not much weaker, that the camera is somewhere else."""
    here = run.predicted(T_world_places, run.last.new)
    for other in runs:
        if other is run or not other.alive(run.last.new):
            continue
        there = other.predicted(T_world_places, run.last.new)
        apart = not close(se3.inverse(here) @ there, _RIVAL_M, 180.0)
        if apart and other.inliers() >= _RIVAL_SHARE * run.inliers():
            return True
    return False
