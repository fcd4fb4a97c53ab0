"""What file names say, with names as cameras, tools and data sets write them; orders and pairs are written by hand."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from bench.errors import BenchError
from bench.io.frame_names import NamedFiles, in_order, join


def named(*names: str, folder: str = "L") -> NamedFiles:
    return in_order([Path(folder) / name for name in names])


def stems(files: NamedFiles) -> list[str]:
    return [file.stem for file in files.files]


@pytest.mark.parametrize(
    ("ordered", "kind"),
    [
        (["0", "1", "2", "10", "11"], "number"),
        (["frame_2", "frame_009", "frame_10"], "number"),
        (["left_000", "left_001", "left_100"], "number"),
        (["cam0_000007", "cam0_000008"], "number"),
        (["000046_10", "000047_10"], "number"),
        (["a (1)", "a (2)", "a (10)"], "number"),
        (["3_front", "20_front"], "number"),
        (["v2_gs_3", "gs_12"], "number"),
        (["shot2_8fa3", "shot10_b7c"], "number"),
        (["20210304090559", "20210304090600"], "number"),
        (["9.5", "10.25", "10.3"], "time"),
        (["1305031102.175304", "1305031102.211214"], "time"),
        (["1403636579763555584", "1403636579813555456"], "time"),
        (["99966666", "133333333", "166666666"], "time"),
        (["9_1", "10_0", "10_2"], "numbers"),
        (["7", "9" * 40], "numbers"),
        (["2021-03-04_09-05-59", "2021-03-04_10-00-01"], "numbers"),
        (["alpha", "beta", "gamma"], "name"),
    ],
)
def test_order_and_kind(ordered: list[str], kind: str) -> None:
    files = named(*(f"{stem}.png" for stem in sorted(ordered, reverse=True)))
    assert (stems(files), files.kind) == (ordered, kind)


@pytest.mark.parametrize(
    ("names", "seconds"),
    [
        (["0.5.png", "0.75.png"], [0.5, 0.75]),
        (["1403636579763555584.png", "1403636579813555456.png"], [1403636579.763555584, 1403636579.813555456]),
        (["1403636579763555.png", "1403636579813555.png"], [1403636579.763555, 1403636579.813555]),
        (["33333333.png", "66666666.png"], [0.033333333, 0.066666666]),
        (["33333.png", "66666.png"], [0.033333, 0.066666]),
    ],
)
def test_times(names: list[str], seconds: list[float]) -> None:
    times = named(*names).times
    assert times is not None
    np.testing.assert_allclose(times, seconds, rtol=1e-15)


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["4.png", "5.png", "6.png"], [0, 1, 2]),
        (["0.png", "5.png", "15.png"], [0, 1, 3]),
        (["1.png", "2.png", "5.png"], [0, 1, 4]),
        (["a.png", "b.png"], [0, 1]),
        (["7.png"], [0]),
    ],
)
def test_frame_numbers_count_from_0_and_keep_gaps(names: list[str], numbers: list[int]) -> None:
    assert named(*names).counted().tolist() == numbers


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["1.png", "01.png"], "both have the number 1"),
        (["000001.png", "000001.jpg"], "both have the number 1"),
        (["left_3.png", "right_3.png"], "both have the number 3"),
        (["a.png", "a.jpg"], "both have the name a"),
        (["img.png", "img1.png"], "img.png has no number in its name, and other files beside it have"),
    ],
)
def test_names_that_do_not_tell(names: list[str], message: str) -> None:
    with pytest.raises(BenchError, match=re.escape(message)):
        named(*names)


@pytest.mark.parametrize(
    ("left", "right", "pairs"),
    [
        (["left_1", "left_2", "left_10"], ["right_01", "right_02", "right_10"], ["1 01", "2 02", "10 10"]),
        (["1", "2", "3"], ["1", "3"], ["1 1", "3 3"]),
        (["0", "1", "2"], ["1", "2", "3"], ["1 1", "2 2"]),
        (["0.10", "0.20", "0.30"], ["0.105", "0.305"], ["0.10 0.105", "0.30 0.305"]),
        (
            ["1403636579763555584", "1403636579813555456"],
            ["1403636579763557000", "1403636579813550000"],
            ["1403636579763555584 1403636579763557000", "1403636579813555456 1403636579813550000"],
        ),
        (["a", "b", "c"], ["a", "c"], ["a a", "c c"]),
        (["one", "two"], ["uno", "zwei"], ["one uno", "two zwei"]),
        (["9_1", "10_0"], ["9_1", "10_0"], ["9_1 9_1", "10_0 10_0"]),
    ],
)
def test_pairs(left: list[str], right: list[str], pairs: list[str]) -> None:
    a, b = named(*(f"{stem}.png" for stem in left)), named(*(f"{stem}.png" for stem in right), folder="R")
    joined = join(a, b)
    found = [f"{a.files[i].stem} {b.files[j].stem}" for i, j in zip(joined.left, joined.right, strict=True)]
    assert [re.sub("left_|right_", "", pair) for pair in found] == pairs
    alone = len(left) + len(right) - 2 * len(pairs)
    assert sum(int(remark.split()[0]) for remark in joined.remarks) == alone


def test_who_has_no_partner_is_told() -> None:
    joined = join(named("0.png", "1.png", "2.png"), named("1.png", "2.png", folder="R"))
    assert joined.remarks == ("1 of 3 images in L have no partner in R and are left out: 0.png",)


@pytest.mark.parametrize(
    ("left", "right"),
    [
        (["0.png", "1.png"], ["100.png", "101.png"]),
        (["0.png", "1.png"], ["a.png", "b.png"]),
        (["a.png", "b.png"], ["c.png"]),
        (["0.png", "1.png"], ["0.50.png", "0.75.png"]),
        (["0.10.png", "0.20.png"], ["0.15.png", "0.25.png"]),
    ],
)
def test_pairs_that_nothing_tells_are_refused(left: list[str], right: list[str]) -> None:
    with pytest.raises(BenchError, match=r"No image of L belongs to one of R by the number, time or name of its file"):
        join(named(*left), named(*right, folder="R"))
