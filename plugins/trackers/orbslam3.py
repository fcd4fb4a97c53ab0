"""A real ORB-SLAM3 (package pyorbslam3, GPL-3) as tracker, in a process of its own."""

from __future__ import annotations

import importlib.util
import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.contracts.dataset import Dataset
from bench.errors import BenchError, require_least
from bench.peers.cached_vocabulary import dbow2_vocabulary_of
from bench.peers.tracker import PeerLimits, PeerTracker
from bench.registry import PluginConfig, register

_OWN_VARIABLE = "PYORBSLAM3_VOCAB"


@dataclass(frozen=True)
class OrbSlam3Config(PluginConfig):
    """ORB-SLAM3's settings for KITTI 04-12, but for th_depth, which is that of its other stereo examples."""

    features: int = 2000
    """ORB keypoints per image."""
    scale_factor: float = 1.2
    """Size of an octave of the image pyramid relative to the next."""
    octaves: int = 8
    """Levels of the image pyramid."""
    fast_threshold: int = 12
    """Least FAST contrast, grey values 0-255 ..."""
    fast_threshold_low: int = 7
    """... and in cells of the image where that finds nothing."""
    th_depth: float = 40.0
    """Points nearer than this many baselines count as close: stereo alone places them."""
    frame_rate_hz: float = 10.0
    """At the latest after as many frames ORB-SLAM3 makes a keyframe."""
    vocabulary: str = field(default="", metadata={"path": True})
    """DBoW2 text file; empty: $PYORBSLAM3_VOCAB, else one trained from the data set's own frames and kept in the
    user's cache folder."""
    start_timeout_s: float = 180.0
    """To load the vocabulary (the official one takes tens of seconds), and to hand over the final poses."""
    timeout_s: float = 20.0
    """Without an answer for a frame after this time, the process is killed and the frame is lost."""
    restarts: int = 3
    """After so many crashes and one more, all further frames are lost."""

    def __post_init__(self) -> None:
        require_least("tracker", self, features=100, octaves=1, fast_threshold_low=1, restarts=0)
        if self.fast_threshold < self.fast_threshold_low:
            raise BenchError(
                f"tracker.fast_threshold={self.fast_threshold} is below tracker.fast_threshold_low="
                f"{self.fast_threshold_low}; 12 and 7 are usual."
            )
        if not self.scale_factor > 1:
            raise BenchError(f"tracker.scale_factor={self.scale_factor} must be above 1; 1.2 is usual.")
        for key in ("th_depth", "frame_rate_hz", "start_timeout_s", "timeout_s"):
            if not getattr(self, key) > 0:
                raise BenchError(f"tracker.{key}={getattr(self, key)} must be above 0.")


@register("tracker", "orbslam3", config=OrbSlam3Config)
class OrbSlam3(PeerTracker):
    """Real ORB-SLAM3 in its own process, as peer of stereo_orb; not deterministic, so take the median of 3 runs."""

    def __init__(self, config: OrbSlam3Config) -> None:
        self._config = config
        limits = PeerLimits(config.start_timeout_s, config.timeout_s, config.restarts)
        super().__init__("orbslam3", [sys.executable, "-P", "-m", f"{__package__}.orbslam3_process"], limits)

    @classmethod
    def unavailable_reason(cls) -> str | None:
        """None, or that the package is missing and how to get it."""
        if importlib.util.find_spec("pyorbslam3") is None:
            return "pyorbslam3 (GPL-3; Linux x86-64) is not installed. Run: pip install 'bgs-slam-bench[orbslam3]'"
        return None

    def peer_settings(self, dataset: Dataset) -> dict[str, Any]:
        """Camera, extractor settings and vocabulary; trains a vocabulary when none is named."""
        camera, config = dataset.camera, self._config
        return {
            "vocabulary": str(self._vocabulary(dataset)),
            "fx": camera.fx,
            "fy": camera.fy,
            "cx": camera.cx,
            "cy": camera.cy,
            "width": camera.width,
            "height": camera.height,
            "baseline_m": camera.baseline,
            "features": config.features,
            "scale_factor": config.scale_factor,
            "octaves": config.octaves,
            "fast_threshold": config.fast_threshold,
            "fast_threshold_low": config.fast_threshold_low,
            "th_depth": config.th_depth,
            "frame_rate_hz": config.frame_rate_hz,
        }

    def _vocabulary(self, dataset: Dataset) -> Path:
        for named, by in (
            (self._config.vocabulary, "tracker.vocabulary"),
            (os.environ.get(_OWN_VARIABLE, ""), f"${_OWN_VARIABLE}"),
        ):
            if named:
                path = Path(named).expanduser()
                _check_dbow2(path, by)
                return path
        return dbow2_vocabulary_of(dataset)


def _check_dbow2(path: Path, by: str) -> None:
    """Raise ``BenchError`` unless the file begins like a DBoW2 text file; ORB-SLAM3 itself reads anything."""
    advice = "Write one with `bgs-bench vocabulary --format dbow2 --out FILE dataset=...`, or leave the setting empty."
    try:
        with path.open("rb") as file:
            words = file.readline(100).split()
    except OSError as error:
        raise BenchError(f"{by}={path} can't be read ({error.strerror}). {advice}") from error
    if len(words) != 4 or not all(word.isdigit() for word in words):
        raise BenchError(f"{by}={path} is no DBoW2 text vocabulary: its first line is not four whole numbers. {advice}")
