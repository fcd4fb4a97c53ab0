"""What crosses the border of a stereo plugin: triangulation, what counts as unknown, the words for what is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from bench.contracts.stereo import StereoBackbone
from bench.errors import BenchError
from bench.types import Image, Map, StereoCamera, StereoFrame

CAMERA = StereoCamera(4, 2, fx=100.0, fy=100.0, cx=2.0, cy=1.0, right_position=(0.5, 0.0, 0.0))
FRAME = StereoFrame(17, 0.0, np.zeros((2, 4, 3), np.uint8), np.zeros((2, 4, 3), np.uint8))


class Given(StereoBackbone):
    """Returns what it was made with."""

    def __init__(self, answer: object) -> None:
        self._answer = answer

    def disparity(self, left: Image, right: Image) -> Map:
        return self._answer  # type: ignore[return-value]


def test_depth_is_focal_length_times_baseline_by_disparity() -> None:
    disparity = np.array([[50, 25, 10, 1], [0, -3, np.nan, np.inf]], np.float32)
    depth = Given(disparity).depth(FRAME, 0, CAMERA)
    np.testing.assert_allclose(depth.depth[0], [1, 2, 5, 50])
    # Zero, negative, unknown and infinite disparities have no depth; an infinite one is not "at 0 m".
    assert np.isnan(depth.depth[1]).all()
    assert depth.depth.dtype == np.float32


def test_a_frame_without_any_match_has_no_depth() -> None:
    assert not Given(np.full((2, 4), np.nan, np.float32)).depth(FRAME, 0, CAMERA).known.any()


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ([[1.0]], r"Frame 17: Given\.disparity returned list; return a float32 numpy array of shape \(2, 4\)\."),
        (
            np.ones((4, 2), np.float32),
            r"shape \(4, 2\); expected \(2, 4\), the image's height and width: .* transpose it",
        ),
        (np.ones((1, 2, 4), np.float32), r"shape \(1, 2, 4\); expected \(2, 4\)"),
        (np.ones((2, 4)), r"returned dtype float64; expected float32 \(add \.astype\(np\.float32\)\)"),
        (
            np.full((2, 4), -7.5, np.float32),
            r"no disparity above zero \(they reach from -7\.5 to -7\.5 px\)\. Is its sign wrong \(return -d\)",
        ),
        (np.zeros((2, 4), np.float32), r"no disparity above zero, only 0\. Return NaN where nothing is known"),
    ],
)
def test_wrong_answers_are_named(answer: object, message: str) -> None:
    with pytest.raises(BenchError, match=message):
        Given(answer).depth(FRAME, 0, CAMERA)


def test_defaults_of_a_source() -> None:
    source = Given(None)
    assert (source.weights(), source.worth_caching, source.temporal) == ({}, False, False)
