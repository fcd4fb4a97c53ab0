"""What a backbone's answers for walls of known disparity say about its units: the likely mistake, in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.authoring.verdict import ContractBrokenError
from bench.types import Float

# Units are wrong by more than this; networks that are merely inaccurate on made-up walls are within it.
_TOLERANCE_PX, _TOLERANCE_SHARE = 1.5, 0.15
# What two image sizes may differ by: an error of the network is the same in both, a forgotten rescaling is not.
_SIZE_TOLERANCE = 0.04
_ACCURATE_SHARE = 0.05
_EXPECTED = "pixels of the full-size image, positive: left[y, x] is right[y, x - d]"


@dataclass(frozen=True)
class Medians:
    """Median disparity ``answered`` (K,) for walls at ``true`` (K,) pixels in images of ``size`` (height, width)."""

    true: Float
    answered: Float
    size: tuple[int, int]


def explain_units(medians: Medians) -> None:
    """Raise ``ContractBrokenError`` with the likely mistake unless every median is near the true disparity."""
    true, answered = medians.true, medians.answered
    if (np.abs(answered - true) <= np.maximum(_TOLERANCE_PX, _TOLERANCE_SHARE * true)).all():
        return
    height, width = medians.size
    seen = f"walls at {_listed(true)} px have disparity {_listed(answered)} at {width}x{height}"
    raise ContractBrokenError(f"{seen}: {_reason(medians)[0]}", _EXPECTED, _reason(medians)[1], "disparity")


def explain_sizes(first: Medians, second: Medians) -> None:
    """Raise ``ContractBrokenError`` where disparities are scaled otherwise in images of another width."""
    ratios = [float(np.median(medians.answered / medians.true)) for medians in (first, second)]
    if abs(ratios[1] / ratios[0] - 1) <= _SIZE_TOLERANCE:
        return
    widths = [medians.size[1] for medians in (first, second)]
    raise ContractBrokenError(
        f"disparities are {ratios[0]:.3f} times the true ones at width {widths[0]}, {ratios[1]:.3f} at {widths[1]}",
        _EXPECTED,
        "where images are resized for the network: multiply by the image's width / the width fed",
        "disparity",
    )


def is_accurate(medians: Medians) -> bool:
    """Whether every median is within 1.5 px or 5 % of the true disparity."""
    error = np.abs(medians.answered - medians.true)
    return bool((error <= np.maximum(_TOLERANCE_PX, _ACCURATE_SHARE * medians.true)).all())


def _reason(medians: Medians) -> tuple[str, str]:
    """What it looks like, and how to mend it."""
    true, answered, width = medians.true, medians.answered, medians.size[1]
    ratio = float(true @ answered / (true @ true))
    proportional = np.abs(answered - ratio * true).max() <= 0.1 * abs(ratio) * true.max()
    known = {
        -1.0: ("the sign is wrong", "return -d"),
        1 / 16: ("a sixteenth of the true one", "multiply by 16: is it counted in cells of a map at 1/16 size?"),
        0.25: ("a quarter of the true one", "multiply by 4: a disparity at 1/4 size counts pixels four times as wide"),
        0.5: ("half of the true one", "multiply by 2: a disparity at half size counts pixels twice as wide"),
        2.0: ("twice the true one", "divide by 2"),
        4.0: ("four times the true one", "divide by 4"),
        16.0: ("16 times the true one", "divide by 16: OpenCV's matchers count in sixteenths of a pixel"),
        1 / width: ("a share of the image's width", "multiply by the width in pixels"),
        256.0: ("256 times the true one", "divide by 256, as KITTI's PNG files are coded"),
    }
    if proportional:
        for value, words in known.items():
            if abs(ratio - value) < 0.06 * abs(value):
                return words
        return (
            f"{ratio:.3g} times the true one",
            f"multiply by {1 / ratio:.4g}: the width fed to the network is not the image's width?",
        )
    if (np.diff(answered) < 0).all() and np.ptp(answered * true) < 0.1 * np.abs(answered * true).max():
        return "this is depth, which falls as disparity grows", "return the disparity, or override depth() instead"
    if np.ptp(answered - true) <= 2 * _TOLERANCE_PX:
        return f"off by {np.mean(answered - true):+.1f} px everywhere", "are padding or a smallest disparity left over?"
    return (
        "no simple relation to the true one",
        "are the images fed in the right order, normalised as in training, and is the largest disparity large enough?",
    )


def _listed(values: Float) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
