"""Which frames numbered files and poses are of: worked out by hand, with numbers that fit one way, both or none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.errors import BenchError
from bench.external.numbering import (
    in_frame_order,
    places_of_lines,
    places_of_names,
    places_of_numbers,
    places_of_times,
)

EVERY_OTHER = (10, 12, 14, 16)


TIMES = np.array([0.0, 0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("names", "mode", "positions"),
    [
        (["v2_gs_0003.png", "frame00001_left.png", "2.npy"], "auto", [1, 2, 3]),
        (["frame_3_10.png", "frame_0_10.png"], "auto", [0, 3]),
        (["9_2.png", "8_1.png"], "auto", [1, 2]),
        (["0.201.png", "0.001.png"], "auto", [0, 2]),
        (["100000000.png", "200000000.png", "300000000.png"], "auto", [1, 2, 3]),
    ],
)
def test_names_tell_the_number_or_the_time(names: list[str], mode: str, positions: list[int]) -> None:
    named = in_frame_order([Path(name) for name in names])
    assert places_of_names(named, range(4), TIMES, mode, 0.01, "renders").positions.tolist() == positions


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["a1.png", "mean.png"], r"mean\.png has no number"),
        (["mean.png"], r"mean\.png has no number"),
        (["a_001.png", "b_1.png"], "both have the number 1"),
        (["1.png", f"{10**30}.png"], "has too large a number for a frame"),
        (["8_1.png", "9_1.png", "9_2.png"], "the last number is the same in several names"),
    ],
)
def test_names_without_or_with_the_same_number(names: list[str], message: str) -> None:
    with pytest.raises(BenchError, match=message):
        places_of_names(in_frame_order([Path(name) for name in names]), range(4), TIMES, "auto", 0.01, "renders")


@pytest.mark.parametrize(
    ("found", "frames", "mode", "positions", "by"),
    [
        ([0, 2], (0, 1, 2), "auto", [0, 2], "frame number"),
        ([12, 16], EVERY_OTHER, "auto", [1, 3], "frame number"),
        ([0, 3], EVERY_OTHER, "auto", [0, 3], "position"),
        ([9, 12, 13], EVERY_OTHER, "frame", [-1, 1, -1], "frame number"),
        ([0, 1], (0, 2, 4), "position", [0, 1], "position"),
        ([0, 2, 4], (0, 2, 4), "auto", [0, 1, 2], "frame number"),
    ],
)
def test_numbers(found: list[int], frames: tuple[int, ...], mode: str, positions: list[int], by: str) -> None:
    places = places_of_numbers(np.array(found), frames, mode, "renders")
    assert (places.positions.tolist(), places.by, places.left_out) == (positions, by, positions.count(-1))


@pytest.mark.parametrize(
    ("found", "frames", "mode", "message"),
    [
        ([0, 2], (0, 2, 4), "auto", r"fit the data set's frame numbers \(0 to 4\) and its positions 0 to 2\. Say"),
        ([1, 2, 3], (0, 1, 2), "auto", r"number 3 is beyond the data set's 3 frames \(0 to 2\)"),
        ([100], EVERY_OTHER, "auto", "number 100 is beyond"),
        ([0, 1], EVERY_OTHER, "frame", "no number is one of the data set's frames"),
        ([4], EVERY_OTHER, "position", "number 4 is beyond"),
    ],
)
def test_numbers_that_do_not_fit(found: list[int], frames: tuple[int, ...], mode: str, message: str) -> None:
    with pytest.raises(BenchError, match=message):
        places_of_numbers(np.array(found), frames, mode, "renders")


@pytest.mark.parametrize(
    ("count", "frames", "mode", "positions"),
    [
        (4, EVERY_OTHER, "auto", [0, 1, 2, 3]),
        (17, EVERY_OTHER, "auto", [-1] * 10 + [0, -1, 1, -1, 2, -1, 3]),
        (5, (0, 1, 2), "frame", [0, 1, 2, -1, -1]),
        (2, (0, 1, 2), "position", [0, 1]),
    ],
)
def test_lines(count: int, frames: tuple[int, ...], mode: str, positions: list[int]) -> None:
    assert places_of_lines(count, frames, mode, "est.txt").positions.tolist() == positions


@pytest.mark.parametrize(
    ("count", "frames", "mode", "message"),
    [
        (5, (0, 1, 2), "auto", r"has 5 poses, more than the data set's 3 frames \(0 to 2\)\. Say --numbers frame"),
        (2, (0, 1, 2), "auto", r"has 2 poses, fewer than .* dataset\.frames=0:N"),
        (12, EVERY_OTHER, "auto", "has 12 poses, more"),
        (5, EVERY_OTHER, "position", "has 5 poses, more"),
    ],
)
def test_lines_that_do_not_fit(count: int, frames: tuple[int, ...], mode: str, message: str) -> None:
    with pytest.raises(BenchError, match=message):
        places_of_lines(count, frames, mode, "est.txt")


def test_times_go_to_the_nearest_frame_once() -> None:
    """0.104 and 0.108 are both nearest to the frame at 0.1; only the nearer one gets it, and 0.25 is near none."""
    places = places_of_times(np.array([0.001, 0.104, 0.108, 0.25]), np.array([0.0, 0.1, 0.2, 0.3]), 0.01, "est.txt")
    assert places.positions.tolist() == [0, 1, -1, -1]


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.0, 1.0, 2.0, 3.0], "0, 1, ... look like frame numbers, not seconds. Say --numbers frame"),
        ([1e9 + 0.05, 1e9 + 0.15], "nowhere within 0.01 s of the data set's frames, 0.000 to 0.300 s"),
    ],
)
def test_times_of_another_clock(times: list[float], message: str) -> None:
    with pytest.raises(BenchError, match=message):
        places_of_times(np.array(times), np.array([0.0, 0.1, 0.2, 0.3]), 0.01, "est.txt")
