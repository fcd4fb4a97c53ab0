"""The columns of a map against the layout of a 3DGS file."""

from __future__ import annotations

import pytest

from bench.errors import BenchError
from bench.gaussians.schema import COLOR, HARMONICS, MEAN, OPACITY_LOGIT, THRESHOLDS, column_names, degree_of, planes_of


@pytest.mark.parametrize(("degree", "planes"), [(0, 14), (1, 23), (2, 38), (3, 59)])
def test_number_of_planes_and_degree(degree: int, planes: int) -> None:
    """3DGS stores 59 numbers per Gaussian of degree 3."""
    assert planes_of(degree) == planes
    assert degree_of(planes) == degree


@pytest.mark.parametrize("planes", [0, 11, 13, 15, 58, 60, 86])
def test_other_numbers_of_planes_are_refused(planes: int) -> None:
    with pytest.raises(BenchError, match="it has 14, 23, 38, 59"):
        degree_of(planes)


@pytest.mark.parametrize("degree", [-1, 4])
def test_other_degrees_are_refused(degree: int) -> None:
    with pytest.raises(BenchError, match="must be 0 to 3"):
        planes_of(degree)


def test_names_of_the_columns() -> None:
    """3DGS numbers f_rest channel by channel: 15 of red, 15 of green, 15 of blue."""
    names = column_names(3)
    assert len(names) == len(set(names)) == 59
    assert names[MEAN] == ("x", "y", "z")
    assert names[OPACITY_LOGIT] == "opacity"
    assert names[COLOR] == ("f_dc_0", "f_dc_1", "f_dc_2")
    assert names[HARMONICS][:6] == ("f_rest_0", "f_rest_15", "f_rest_30", "f_rest_1", "f_rest_16", "f_rest_31")
    assert names[-1] == "f_rest_44"
    assert column_names(1)[HARMONICS][:4] == ("f_rest_0", "f_rest_3", "f_rest_6", "f_rest_1")
    assert column_names(0)[HARMONICS] == ()


def test_thresholds_are_those_of_gsplat() -> None:
    t = THRESHOLDS
    assert (t.near_m, t.low_pass_px2, t.alpha_min, t.alpha_max) == (0.2, 0.3, 1 / 255, 0.999)
    assert (t.transmittance_end, t.jacobian_margin) == (1e-4, 0.15)
