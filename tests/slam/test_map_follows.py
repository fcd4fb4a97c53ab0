"""A loop that is closed late: poses drift around the block, are corrected at once, and the map goes with them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.config import compose_run
from bench.geometry import se3
from bench.registry import register
from bench.slam.run import run_system
from bench.types import Float, StereoFrame, TrackingResult, Trajectory
from plugins.datasets.street import Street, StreetConfig
from plugins.trackers.groundtruth import GroundTruth, GroundTruthConfig

LAP = 30
STREET = {"frames": LAP + 6, "width": 128, "height": 48, "speed_m": 8.0, "circuit_m": 240}
# After one lap: 2 m to the right, 0.2 m up, 3 m ahead, and a turn of 5 degrees about the vertical.
DRIFT = np.array([2.0, -0.2, 3.0, 0.0, np.deg2rad(5.0), 0.0])


@dataclass(frozen=True)
class DriftingConfig(GroundTruthConfig):
    """``corrected_at``: the frame from which on all poses are right; -1 = all are right from the first."""

    corrected_at: int = -1


@register("tracker", "drifting_for_tests", config=DriftingConfig)
class Drifting(GroundTruth):
    """Ground truth with a drift that grows with the frame number until a loop is closed."""

    def __init__(self, config: DriftingConfig) -> None:
        super().__init__(config)
        self._corrected_at = config.corrected_at

    def track(self, frame: StereoFrame) -> TrackingResult:
        super().track(frame)
        return TrackingResult(self.trajectory().pose_of(frame.number), "ok")

    def trajectory(self) -> Trajectory:
        known = super().trajectory()
        if known.numbers[-1] >= self._corrected_at:
            return known
        drift: Float = se3.exp(known.numbers[:, None] / LAP * DRIFT)
        return Trajectory(drift @ known.T_world_cam, known.numbers, known.timestamps)


def psnr_of_first_lap(folder: Path) -> float:
    """Mean over the first lap but its two ends, where the second lap comes by: saved renders against the street."""
    street, values = Street(StreetConfig(**STREET)), []
    for number in range(6, LAP - 6, 2):
        render = cv2.imread(str(folder / f"views/left/color/{number:06d}.png"))[..., ::-1].astype(np.float64)
        error = (render - street.frame(number).left) / 255.0
        values.append(-10 * np.log10((error**2).mean()))
    return float(np.mean(values))


@pytest.mark.slow
def test_a_late_correction_leaves_the_map_as_good_as_one_without_drift(tmp_path: Path) -> None:
    psnr = {}
    for name, corrected_at, follow in (("truth", -1, 0.01), ("follows", LAP + 3, 0.01), ("stays", LAP + 3, 1e9)):
        overrides = [f"dataset.{key}={value}" for key, value in STREET.items()]
        overrides += ["tracker=drifting_for_tests", f"tracker.corrected_at={corrected_at}", "stereo=lidar"]
        overrides += ["mapper.iterations=4", "mapper.final_coarse_iterations=0", "mapper.final_iterations=0"]
        overrides += ["mapper.coarse_share=0.6", "mapper.scale_rate=1e-2", "mapper.exposure=false"]
        overrides += ["mapper.seeding.stride=2", "mapper.seeding.opacity=0.5", "protocol.lpips=false"]
        overrides += ["protocol.right_view=false"]
        overrides += [f"mapper.follow_corrections_m={follow}", f"mapper.follow_corrections_deg={follow}"]
        folder = run_system(compose_run([*overrides, f"output={tmp_path / name}"])).path
        psnr[name] = psnr_of_first_lap(folder)
    log = (tmp_path / "follows/log.txt").read_text()
    assert "the map follows corrected poses" in log
    assert psnr["follows"] > psnr["truth"] - 1.5
    assert psnr["stays"] < psnr["follows"] - 4.0
