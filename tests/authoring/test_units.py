"""The likely mistake behind wrong disparities, from numbers worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from bench.authoring.units import Medians, explain_sizes, explain_units, is_accurate
from bench.authoring.verdict import ContractBrokenError

TRUE = np.array([5.0, 17.0, 41.0])


@pytest.mark.parametrize(
    ("answered", "says", "mend"),
    [
        (-TRUE, "the sign is wrong", "return -d"),
        (TRUE / 4, "a quarter", "multiply by 4"),
        (TRUE / 2 + 0.05, "half", "multiply by 2"),
        (TRUE * 16, "16 times", "divide by 16"),
        (TRUE * 256, "256 times", "divide by 256"),
        (TRUE / 480, "share of the image's width", "multiply by the width"),
        (TRUE / 8, "an eighth", "multiply by 8"),
        (-TRUE / 4, "the sign is wrong, and it is a quarter", "return -d, and multiply by 4"),
        (TRUE / 192, "normalised to 0 to 1", "multiply by 192"),
        (np.array([1.0, 1.0, 1.0]), "the same whatever the true one is: normalised", "Return pixels"),
        (np.array([33.0, 33.0, 33.1]), "the same whatever the true one is", "weights loaded"),
        (TRUE * 1.3, "1.3 times the true one", "multiply by 0.7692"),
        (85 / TRUE, "this is depth", "return the disparity"),
        (TRUE + 8, r"off by \+8\.0 px everywhere", "padding"),
        (np.array([5.0, 17.0, 3.0]), "no simple relation", "largest disparity"),
        (np.array([40.0, 5.0, 20.0]), "no simple relation", "right order"),
    ],
)
def test_what_it_looks_like(answered: np.ndarray, says: str, mend: str) -> None:
    with pytest.raises(ContractBrokenError, match=says) as caught:
        explain_units(Medians(TRUE, answered, (256, 480)))
    assert mend in caught.value.mend
    assert caught.value.method == "disparity"


@pytest.mark.parametrize(
    ("answered", "gain", "mend"),
    [
        (-TRUE, 1.0, "set stereo.gain=-1"),
        (TRUE / 4, -0.5, "set stereo.gain=-2"),
        (TRUE / 480, 1.0, "stereo.unit=width"),
    ],
)
def test_the_setting_that_mends_it(answered: np.ndarray, gain: float, mend: str) -> None:
    with pytest.raises(ContractBrokenError) as caught:
        explain_units(Medians(TRUE, answered, (256, 480)), gain)
    assert mend in caught.value.mend


@pytest.mark.parametrize(
    ("answered", "accurate"),
    [(TRUE, True), (TRUE + 1.4, True), (TRUE * 1.03, True), (np.array([5.06, 16.6, 37.5]), False)],
)
def test_a_matchers_ordinary_error_passes(answered: np.ndarray, accurate: bool) -> None:
    """(The last one is what a small published network says.)"""
    medians = Medians(TRUE, answered, (256, 480))
    explain_units(medians)
    assert is_accurate(medians) == accurate


def test_a_forgotten_rescaling_shows_in_two_widths() -> None:
    """Images of 417 px fed at 448, the next multiple of 32, without scaling back; 480 is such a multiple."""
    first, second = Medians(TRUE, TRUE, (256, 480)), Medians(TRUE, TRUE * 448 / 417, (261, 417))
    explain_sizes(first, Medians(TRUE, TRUE * 1.02, (261, 417)))
    with pytest.raises(ContractBrokenError, match=r"1\.000 times the true ones at width 480, 1\.074 at 417") as caught:
        explain_sizes(first, second)
    assert "the image's width / the width fed" in caught.value.mend
