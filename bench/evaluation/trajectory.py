"""Absolute trajectory error of camera centres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.types import Float, Trajectory

MINIMUM_FRAMES = 3


@dataclass(frozen=True)
class AteResult:
    """Errors of the camera centres after alignment, in metres; ``errors_m[i]`` belongs to frame ``numbers[i]``."""

    rmse_m: float
    mean_m: float
    median_m: float
    max_m: float
    errors_m: Float
    numbers: npt.NDArray[np.int64]

    @property
    def n(self) -> int:
        """How many frames were compared."""
        return len(self.numbers)


def umeyama_se3(estimate: Float, reference: Float) -> tuple[Float, Float]:
    """Rotation R (3, 3) and translation t (3,) minimising sum ||R estimate_i + t - reference_i||^2, without scale.

    Points are (N, 3), in metres. Where all points of one side lie on a line or in one place, R is one of several best
    ones; the errors are the same for each of them.
    Source: Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991.
    """
    mean_estimate, mean_reference = estimate.mean(axis=0), reference.mean(axis=0)
    covariance = (reference - mean_reference).T @ (estimate - mean_estimate) / len(estimate)
    U, _, Vt = np.linalg.svd(covariance)
    handedness = np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    R = U @ handedness @ Vt
    return R, mean_reference - R @ mean_estimate


def absolute_trajectory_error(estimate: Trajectory, ground_truth: Trajectory, alignment: str) -> AteResult | str:
    """ATE over the frames (matched by number) that both trajectories have, or the reason why there is none.

    ``alignment`` is "se3" (estimate moved onto the ground truth by ``umeyama_se3``) or "none". Centres are the
    translations of ``T_world_cam``. Lost frames are absent from the estimate: they don't enter, and are counted
    elsewhere. Source: Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", IROS 2012, Sec. V.
    """
    numbers, of_estimate, of_truth = np.intersect1d(
        estimate.numbers, ground_truth.numbers, assume_unique=True, return_indices=True
    )
    if len(numbers) < MINIMUM_FRAMES:
        return f"only {len(numbers)} tracked frames have ground truth; at least {MINIMUM_FRAMES} are needed"
    centres = estimate.T_world_cam[of_estimate, :3, 3]
    truth = ground_truth.T_world_cam[of_truth, :3, 3]
    finite = np.isfinite(centres).all(axis=1) & np.isfinite(truth).all(axis=1)
    if not finite.all():
        return f"the pose of frame {numbers[~finite][0]} is not finite"
    if alignment == "se3":
        R, t = umeyama_se3(centres, truth)
        centres = centres @ R.T + t
    errors = np.linalg.norm(centres - truth, axis=1)
    return AteResult(
        rmse_m=float(np.sqrt(np.mean(errors**2))),
        mean_m=float(errors.mean()),
        median_m=float(np.median(errors)),
        max_m=float(errors.max()),
        errors_m=errors,
        numbers=numbers,
    )
