"""Settings of loop closing."""

from __future__ import annotations

from dataclasses import dataclass

from bench.errors import require_between, require_least


@dataclass(frozen=True)
class LoopSettings:
    """When two places count as the same."""

    place_spacing_m: float = 2.0
    """A tracker keyframe becomes a place after so many metres since the last place ..."""
    place_rotation_deg: float = 10.0
    """... or after this rotation."""
    training_places: int = 30
    """Without a vocabulary file, one is trained as soon as there are so many places."""
    min_similarity: float = 0.3
    """Least similarity of a candidate, as a share of the similarity with the place before (as in DBoW2)."""
    min_inliers: int = 30
    """Matched points that must agree on the pose between two places, in both directions."""
    min_matches: int = 3
    """Places in a row that must be found again, in agreement with the odometry, before a loop is closed."""
    min_way_m: float = 30.0
    """Shorter loops are not looked for: such places still see each other."""
    max_drift: float = 0.1
    """Loops that say that the odometry is off by more than this share of the way between are not believed."""

    def __post_init__(self) -> None:
        require_between("tracker.loops", self, 0, 1, "min_similarity", "max_drift")
        least = {"place_spacing_m": 0, "place_rotation_deg": 0, "min_way_m": 0}
        require_least("tracker.loops", self, **least, training_places=2, min_inliers=15, min_matches=1)
