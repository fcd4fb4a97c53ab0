"""The trajectory's picture: what is drawn, read back from the figure and from the file."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from bench.evaluation.rpe import RpeResult, relative_pose_error
from bench.evaluation.trajectory import AteResult, absolute_trajectory_error
from bench.report.trajectory_plot import trajectory_figure, write_trajectory_plot
from bench.types import Trajectory


def _path(positions: np.ndarray, numbers: np.ndarray | None = None) -> Trajectory:
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, 3] = positions
    numbers = np.arange(len(positions)) if numbers is None else numbers
    return Trajectory(poses, numbers, 0.1 * numbers)


def _scored(estimate: Trajectory, truth: Trajectory, alignment: str) -> tuple[AteResult, RpeResult]:
    ate, rpe = absolute_trajectory_error(estimate, truth, alignment), relative_pose_error(estimate, truth)
    assert isinstance(ate, AteResult)
    assert isinstance(rpe, RpeResult)
    return ate, rpe


def test_the_estimate_is_drawn_on_the_ground_truth_after_alignment() -> None:
    truth = np.array([[0, 0, 0], [0, 0, 4], [3, 0, 4], [3, 1, 9]], float)
    # The same path seen from another world: turned by 90 degrees about y, and shifted.
    turned = np.stack([truth[:, 2] + 5.0, truth[:, 1] - 2.0, 7.0 - truth[:, 0]], 1)
    for alignment, expected in (("se3", truth[:, [0, 2]]), ("none", turned[:, [0, 2]])):
        figure = trajectory_figure(_scored(_path(turned), _path(truth), alignment)[0], _path(truth), None)
        np.testing.assert_allclose(np.asarray(figure.axes[0].lines[1].get_xydata()), expected, atol=1e-9)
        assert len(figure.axes) == 2


def test_errors_are_drawn_at_their_frames_and_lost_ones_left_open() -> None:
    """One metre a frame along z, 0.5 m too many from frame 13 on; frames 10 to 18, 14 and 15 lost."""
    numbers = np.arange(10, 19)
    truth = np.outer(numbers, [0.0, 0.0, 1.0])
    drifted = truth + np.outer(numbers >= 13, [0.0, 0.0, 0.5])
    kept = (numbers != 14) & (numbers != 15)
    ate, rpe = _scored(_path(drifted[kept], numbers[kept]), _path(truth, numbers), "none")
    figure = trajectory_figure(ate, _path(truth, numbers), rpe)
    above, position, translation, rotation = figure.axes
    nan, step = np.nan, 0.5
    for axes, values in (
        (position, [0, 0, 0, step, nan, nan, step, step, step]),
        (translation, [nan, 0, 0, step, nan, nan, nan, 0, 0]),
        (rotation, [nan, 0, 0, 0, nan, nan, nan, 0, 0]),
    ):
        drawn = np.asarray(axes.lines[0].get_xydata())
        np.testing.assert_allclose(drawn, np.column_stack([numbers, values]), atol=1e-9)
        (marked,) = axes.patches
        assert (marked.get_x(), marked.get_width()) == (13.5, 2.0)  # type: ignore[attr-defined]
    labels = [text.get_text() for text in above.get_legend().get_texts()]
    assert labels == ["ground truth", "estimate, 7 frames", "lost, 2 frames"]


def test_the_file_is_a_picture(tmp_path: Path) -> None:
    path = _path(np.array([[0, 0, 0], [0, 0, 1], [1, 0, 2]], float))
    write_trajectory_plot(tmp_path / "trajectory.png", _scored(path, path, "se3")[0], path, None)
    picture = cv2.imread(str(tmp_path / "trajectory.png"))
    assert picture.shape[1] > 2 * picture.shape[0] > 400
    assert picture.std() > 5
    assert [file.name for file in tmp_path.iterdir()] == ["trajectory.png"]
