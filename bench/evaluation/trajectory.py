"""Absolute trajectory error of camera centres, the alignment before it, and that of a camera that never moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.types import Float, Trajectory

MINIMUM_FRAMES = 3
ALIGNMENTS = ("se3", "sim3", "none")
"""Those of a run's protocol lack "sim3": a stereo system has a scale, and fitting one would hide its error."""


@dataclass(frozen=True)
class AteResult:
    """Errors of the camera centres after alignment, in metres; ``errors_m[i]`` belongs to frame ``numbers[i]``.

    ``aligned`` is the estimate after that alignment, with its frames that have no ground truth too; ``scale`` is what
    it was multiplied by (1 but for the alignment "sim3").
    """

    rmse_m: float
    mean_m: float
    median_m: float
    max_m: float
    errors_m: Float
    numbers: npt.NDArray[np.int64]
    aligned: Trajectory
    scale: float

    @property
    def n(self) -> int:
        """How many frames were compared."""
        return len(self.numbers)

    def metrics(self) -> dict[str, Any]:
        """The ATE's keys of ``metrics.json``'s ``trajectory``."""
        return {
            "ate_rmse_m": self.rmse_m,
            "ate_mean_m": self.mean_m,
            "ate_median_m": self.median_m,
            "ate_max_m": self.max_m,
            "n": self.n,
        } | ({} if self.scale == 1.0 else {"scale": self.scale})


def umeyama(estimate: Float, reference: Float, with_scale: bool = False) -> tuple[Float, Float, float]:
    """Rotation R (3, 3), translation t (3,) and scale s minimising sum ||s R estimate_i + t - reference_i||^2.

    Points are (N, 3), in metres; s is 1 unless ``with_scale``. Where all points of one side lie on a line or in one
    place, R is one of several best ones; the errors are the same for each of them. An estimate all in one place has no
    scale: s is then NaN.
    Source: Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991.

    >>> corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> R, t, scale = umeyama(corner, 2 * corner + [5, 0, 0], with_scale=True)
    >>> bool(np.allclose(R, np.eye(3))), t.round(6).tolist(), round(scale, 6)
    (True, [5.0, 0.0, 0.0], 2.0)
    """
    mean_estimate, mean_reference = estimate.mean(axis=0), reference.mean(axis=0)
    centred = estimate - mean_estimate
    covariance = (reference - mean_reference).T @ centred / len(estimate)
    U, D, Vt = np.linalg.svd(covariance)
    handedness = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    R = (U * handedness) @ Vt
    scale = 1.0
    if with_scale:
        variance = float((centred**2).sum() / len(estimate))
        scale = float(D @ handedness) / variance if variance > 0.0 else float("nan")
    return R, mean_reference - scale * (R @ mean_estimate), scale


def align(estimate: Trajectory, ground_truth: Trajectory, alignment: str) -> tuple[Trajectory, float] | str:
    """The estimate moved onto the ground truth, and the scale it was multiplied by; or the reason why it can't be.

    ``alignment`` is "se3" (rotation and translation), "sim3" (and one scale for the whole path, for estimates that have
    none of their own, such as a single camera's) or "none". It is found from the centres of the frames, matched by
    number, that both trajectories have; at least ``MINIMUM_FRAMES`` of them, all finite.
    """
    numbers, of_estimate, of_truth = common_frames(estimate, ground_truth)
    if len(numbers) < MINIMUM_FRAMES:
        return f"only {len(numbers)} tracked frames have ground truth; at least {MINIMUM_FRAMES} are needed"
    T_estimate, T_truth = estimate.T_world_cam[of_estimate], ground_truth.T_world_cam[of_truth]
    finite = np.isfinite(T_estimate).all(axis=(1, 2)) & np.isfinite(T_truth).all(axis=(1, 2))
    if not finite.all():
        return f"the pose of frame {numbers[~finite][0]} is not finite"
    if alignment == "none":
        return estimate, 1.0
    R, t, scale = umeyama(T_estimate[:, :3, 3], T_truth[:, :3, 3], alignment == "sim3")
    if not np.isfinite(scale):
        return "the estimate never moves, so that no scale can be found for it"
    T = estimate.T_world_cam.copy()
    T[:, :3, :3] = R @ T[:, :3, :3]
    T[:, :3, 3] = scale * T[:, :3, 3] @ R.T + t
    return Trajectory(T, estimate.numbers, estimate.timestamps), scale


def absolute_trajectory_error(estimate: Trajectory, ground_truth: Trajectory, alignment: str) -> AteResult | str:
    """ATE over the frames (matched by number) that both trajectories have, or the reason why there is none.

    ``alignment`` as in ``align``. Centres are the translations of ``T_world_cam``. Lost frames are absent from the
    estimate: they don't enter, and are counted elsewhere.
    Source: Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", IROS 2012, Sec. V.

    >>> T = np.tile(np.eye(4), (4, 1, 1))
    >>> T[:, 2, 3] = [0, 1, 2, 3]  # forward, a metre per frame
    >>> truth = Trajectory(T.copy(), np.arange(4), np.arange(4.0))
    >>> T[:, 1, 3] = [0.3, -0.3, 0.3, -0.3]  # and 0.3 m up and down
    >>> absolute_trajectory_error(Trajectory(T, truth.numbers, truth.timestamps), truth, "none").rmse_m
    0.3
    """
    found = align(estimate, ground_truth, alignment)
    if isinstance(found, str):
        return found
    aligned, scale = found
    numbers, of_estimate, of_truth = common_frames(aligned, ground_truth)
    difference = aligned.T_world_cam[of_estimate, :3, 3] - ground_truth.T_world_cam[of_truth, :3, 3]
    errors = np.linalg.norm(difference, axis=1)
    return AteResult(
        rmse_m=float(np.sqrt(np.mean(errors**2))),
        mean_m=float(errors.mean()),
        median_m=float(np.median(errors)),
        max_m=float(errors.max()),
        errors_m=errors,
        numbers=numbers,
        aligned=aligned,
        scale=scale,
    )


def static_camera_metrics(ground_truth: Trajectory, compared: npt.NDArray[np.int64] | None) -> dict[str, float | None]:
    """What a camera that never moves would get, in metres: a mark that every estimate should stay far below.

    ``static_camera_ate_rmse_m`` is over all frames of the ground truth, so that it is a property of the data alone.
    Where the ATE is over fewer of them (``compared``: its frame numbers), the easier mark over just those is
    ``static_camera_compared_ate_rmse_m``.
    """
    metrics = {"static_camera_ate_rmse_m": _rms_from_mean(ground_truth)}
    if compared is not None and len(compared) < len(ground_truth):
        here = np.isin(ground_truth.numbers, compared)
        part = Trajectory(ground_truth.T_world_cam[here], ground_truth.numbers[here], ground_truth.timestamps[here])
        metrics["static_camera_compared_ate_rmse_m"] = _rms_from_mean(part)
    return metrics


def common_frames(
    estimate: Trajectory, ground_truth: Trajectory
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Numbers of the frames that both have, in order, and where they are in the one and in the other."""
    return np.intersect1d(estimate.numbers, ground_truth.numbers, assume_unique=True, return_indices=True)


def _rms_from_mean(trajectory: Trajectory) -> float | None:
    """RMS distance of the centres to their mean: the ATE of any constant position after the best shift."""
    centres = trajectory.T_world_cam[:, :3, 3]
    centres = centres[np.isfinite(centres).all(axis=1)]
    if not len(centres):
        return None
    return float(np.sqrt(((centres - centres.mean(axis=0)) ** 2).sum(axis=1).mean()))
