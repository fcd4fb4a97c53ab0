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
# Disparities this small, beside the true ones, are shares of a largest disparity, which is above 30 px everywhere.
_NORMALISED = 1 / 30
_EXPECTED = "pixels of the full-size image, positive: left[y, x] is right[y, x - d]"


@dataclass(frozen=True)
class Medians:
    """Median disparity ``answered`` (K,) for walls at ``true`` (K,) pixels in images of ``size`` (height, width)."""

    true: Float
    answered: Float
    size: tuple[int, int]


def explain_units(medians: Medians, gain: float | None = None) -> None:
    """Raise ``ContractBrokenError`` with the likely mistake unless every median is near the true disparity.

    ``gain`` is the setting stereo.gain as it is now, None of a plugin without it.
    """
    true, answered = medians.true, medians.answered
    if (np.abs(answered - true) <= np.maximum(_TOLERANCE_PX, _TOLERANCE_SHARE * true)).all():
        return
    height, width = medians.size
    seen = f"walls at {_listed(true)} px have disparity {_listed(answered)} at {width}x{height}"
    reason, mend, factor = _reason(medians)
    if gain is not None and factor is not None:
        mend = f"set stereo.gain={gain * factor:.4g}"
    raise ContractBrokenError(f"{seen}: {reason}", _EXPECTED, mend, "disparity")


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


def _reason(medians: Medians) -> tuple[str, str, float | None]:
    """What it looks like, how to mend it, and the factor that mends it where one does at any size."""
    true, answered, width = medians.true, medians.answered, medians.size[1]
    ratio = float(true @ answered / (true @ true))
    if np.abs(answered - ratio * true).max() <= 0.1 * abs(ratio) * true.max():
        reason, mend, factor = _reason_of_factor(abs(ratio), width)
        if ratio > 0:
            return reason, mend, factor
        if factor == 1:
            return "the sign is wrong", "return -d (of an ONNX file: stereo.gain=-1)", -1
        return f"the sign is wrong, and it is {reason}", f"return -d, and {mend}", factor and -factor
    if np.ptp(answered) <= 0.02 * np.abs(answered).max():
        if np.abs(answered).max() <= 1:
            mend = "it is divided by the largest value of each image? Return pixels"
            return "the same whatever the true one is: normalised to 0 to 1", mend, None
        return "the same whatever the true one is", "are the weights loaded, and does it see the right image?", None
    if (np.diff(answered) < 0).all() and np.ptp(answered * true) < 0.1 * np.abs(answered * true).max():
        return (
            "this is depth, which falls as disparity grows",
            "return the disparity, or override depth() instead",
            None,
        )
    if np.ptp(answered - true) <= 2 * _TOLERANCE_PX:
        off = f"off by {np.mean(answered - true):+.1f} px everywhere"
        return off, "are padding or a smallest disparity left over?", None
    return (
        "no simple relation to the true one",
        "are the images fed in the right order, normalised as in training, and is the largest disparity large enough?",
        None,
    )


def _reason_of_factor(ratio: float, width: int) -> tuple[str, str, float | None]:
    """The same for disparities that are ``ratio`` times the true ones."""
    known: dict[float, tuple[str, str, float | None]] = {
        1.0: ("the true one", "leave it as it is", 1),
        1 / 16: ("a sixteenth of the true one", "multiply by 16: is it counted in cells of a map at 1/16 size?", 16),
        1 / 8: ("an eighth of the true one", "multiply by 8: is it counted in cells of a map at 1/8 size?", 8),
        0.25: ("a quarter of the true one", "multiply by 4: at 1/4 size a disparity counts pixels 4 times as wide", 4),
        0.5: ("half of the true one", "multiply by 2: a disparity at half size counts pixels twice as wide", 2),
        2.0: ("twice the true one", "divide by 2", 1 / 2),
        4.0: ("four times the true one", "divide by 4", 1 / 4),
        16.0: ("16 times the true one", "divide by 16: OpenCV's matchers count in sixteenths of a pixel", 1 / 16),
        256.0: ("256 times the true one", "divide by 256, as KITTI's PNG files are coded", 1 / 256),
        1 / width: (
            "a share of the image's width",
            "multiply by the width in pixels (of an ONNX file: stereo.unit=width)",
            None,
        ),
    }
    near = min(known, key=lambda value: abs(ratio / value - 1))
    if abs(ratio - near) < 0.06 * near:
        return known[near]
    if ratio < _NORMALISED:
        mend = f"multiply by {1 / ratio:.4g}, the largest disparity that it was divided by?"
        return f"{ratio:.3g} times the true one: normalised to 0 to 1", mend, 1 / ratio
    return (
        f"{ratio:.3g} times the true one",
        f"multiply by {1 / ratio:.4g}: the width fed to the network is not the image's width?",
        1 / ratio,
    )


def _listed(values: Float) -> str:
    return ", ".join(f"{value:.3g}" for value in values)
