"""The trajectory's picture: what is drawn, read back from the figure and from the file."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from bench.evaluation.trajectory import AteResult, absolute_trajectory_error
from bench.report.trajectory_plot import trajectory_figure, write_trajectory_plot
from bench.types import Trajectory


def _path(positions: np.ndarray) -> Trajectory:
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, 3] = positions
    return Trajectory(poses, np.arange(len(positions)), 0.1 * np.arange(len(positions)))


def test_the_estimate_is_drawn_on_the_ground_truth_after_alignment() -> None:
    truth = np.array([[0, 0, 0], [0, 0, 4], [3, 0, 4], [3, 1, 9]], float)
    # The same path seen from another world: turned by 90 degrees about y, and shifted.
    turned = np.stack([truth[:, 2] + 5.0, truth[:, 1] - 2.0, 7.0 - truth[:, 0]], 1)
    ate = absolute_trajectory_error(_path(turned), _path(truth), "se3")
    assert isinstance(ate, AteResult)
    figure = trajectory_figure(_path(turned), _path(truth), ate, aligned=True)
    drawn = np.asarray(figure.axes[0].lines[1].get_xydata())
    np.testing.assert_allclose(drawn, truth[:, [0, 2]], atol=1e-9)
    raw = trajectory_figure(_path(turned), _path(truth), ate, aligned=False)
    np.testing.assert_allclose(np.asarray(raw.axes[0].lines[1].get_xydata()), turned[:, [0, 2]], atol=1e-12)


def test_the_file_is_a_picture(tmp_path: Path) -> None:
    path = _path(np.array([[0, 0, 0], [0, 0, 1], [1, 0, 2]], float))
    ate = absolute_trajectory_error(path, path, "se3")
    assert isinstance(ate, AteResult)
    write_trajectory_plot(tmp_path / "trajectory.png", path, path, ate, aligned=True)
    picture = cv2.imread(str(tmp_path / "trajectory.png"))
    assert picture.shape[1] > 2 * picture.shape[0] > 400
    assert picture.std() > 5
    assert [file.name for file in tmp_path.iterdir()] == ["trajectory.png"]
