"""The original's geometry decoder, from the file that it ships."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.stereo.checkpoint import fit_state, load_state
from bench.weights import resolve

if TYPE_CHECKING:
    from bench.baselines.point_slam.decoders import GeometryDecoder

WEIGHTS = "nice_slam_middle"
_PART = "coarse."


def load_geometry(decoder: GeometryDecoder) -> None:
    """Load the tensors whose key contains "coarse" (NICE-SLAM's middle level) of ``middle_fine.pt``; others are left
    out. Raises ``BenchError`` where the file is missing or holds another network."""
    path = resolve(WEIGHTS)
    state = load_state(path)
    fit_state(decoder, {key.partition(_PART)[2]: value for key, value in state.items() if _PART in key}, path)
