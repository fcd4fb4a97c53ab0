"""What looks wrong where an estimate meets its ground truth: hints beside the numbers, which stay as they are."""

from __future__ import annotations

import numpy as np

from bench.evaluation.trajectory import common_frames, umeyama
from bench.geometry.pose_readings import alike, other_reading
from bench.types import Float, Trajectory

_UNITS = {1e3: "millimetres", 1e2: "centimetres", 1 / 0.3048: "feet"}
_SAME_UNIT = 1.1
"""A scale that is off a unit's by less than this factor is taken for that unit."""
_OTHER_SIZE = 2.0
"""Stereo trackers are off by a few percent of scale; a factor above this is a unit, a baseline or a focal length."""
_LEAST_FRAMES, _LEAST_EXTENT_M = 6, 0.1
"""Fewer points have no shape, and those of a camera that stands are noise."""
_SAME_SHAPE = 0.1
"""Trajectories have one shape when the RMS error after scaling is below this share of the ground truth's extent."""


def hints(estimate: Trajectory, ground_truth: Trajectory) -> dict[str, str]:
    """What looks wrong with a pair of trajectories, by subject ("convention", "scale"); empty where nothing does."""
    _, of_estimate, of_truth = common_frames(estimate, ground_truth)
    T, truth = estimate.T_world_cam[of_estimate], ground_truth.T_world_cam[of_truth]
    finite = np.isfinite(T).all(axis=(1, 2)) & np.isfinite(truth).all(axis=(1, 2))
    found = {"convention": about_convention(T[finite], truth[finite]), "scale": about_scale(T[finite], truth[finite])}
    return {subject: text for subject, text in found.items() if text is not None}


def about_convention(T: Float, truth: Float) -> str | None:
    """A hint that of two trajectories (N, 4, 4) one is not camera to world in our axes, or None.

    Which of the two can't always be told: then both are named.
    """
    tried = {"estimate": other_reading(T, truth), "ground truth": other_reading(truth, T)}
    found = {who: each for who, each in tried.items() if each is not None}
    if not found:
        return None
    # A file in another convention has a plain reading; seen from the other file it may be an odd one.
    best = min(each.error for each in found.values())
    fitting = {who: each for who, each in found.items() if alike(each.error, best)}
    changes = min(each.changes for each in fitting.values())
    likely = [f"the {who} read {each.words}" for who, each in fitting.items() if each.changes == changes]
    now = next(iter(fitting.values())).error_as_is
    return (
        f"estimate and ground truth seem to be written in different conventions: with {' or '.join(likely)} their "
        f"steps differ by {best:.1%} of their length, as they are by {now:.0%}. Convert the file if that is so"
    )


def about_scale(T: Float, truth: Float) -> str | None:
    """A hint that two trajectories (N, 4, 4) have the same shape and very different sizes, or None."""
    if len(T) < _LEAST_FRAMES:
        return None
    centres, wanted = T[:, :3, 3], truth[:, :3, 3]
    R, t, scale = umeyama(centres, wanted, with_scale=True)
    if not scale > 0 or 1 / _OTHER_SIZE < scale < _OTHER_SIZE:
        return None
    left_over = np.linalg.norm(scale * centres @ R.T + t - wanted, axis=1)
    extent = float(np.sqrt(((wanted - wanted.mean(axis=0)) ** 2).sum(axis=1).mean()))
    stands = extent * max(1.0, 1.0 / scale) < _LEAST_EXTENT_M
    if stands or float(np.sqrt((left_over**2).mean())) > _SAME_SHAPE * extent:
        return None
    larger, factor = ("estimate", 1 / scale) if scale < 1 else ("ground truth", scale)
    unit = next((name for size, name in _UNITS.items() if 1 / _SAME_UNIT < factor / size < _SAME_UNIT), None)
    why = f"Is it in {unit}?" if unit else "Check the unit of both, and the calibration's focal length and baseline."
    if unit and larger == "estimate":
        why = f"Is it, or the baseline that it was made with, in {unit}?"
    return f"the {larger} has the shape of the other trajectory and is {factor:.4g} times as large. {why}"
