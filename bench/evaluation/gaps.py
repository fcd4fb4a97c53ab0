"""Of how many frames a scored output had pictures: said wherever it was not all of them."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

_KINDS = {"left_color": "renders", "right_color": "right renders", "left_depth": "depth"}


def about_not_rendered(not_rendered: Mapping[str, Mapping[int, str]]) -> str | None:
    """For example ``"left views of 2 frames could not be rendered (12, 14): no depth"``; None where all could."""
    found = []
    for view, reasons in not_rendered.items():
        for reason in dict.fromkeys(reasons.values()):
            numbers = [number for number, why in reasons.items() if why == reason]
            where = ", ".join(map(str, numbers[:5])) + (" ..." if len(numbers) > 5 else "")
            found.append(f"{view} views of {len(numbers)} frames could not be rendered ({where}): {reason}")
    return "; ".join(found) or None


def about_gaps(frames: pd.DataFrame) -> str | None:
    """For example ``"renders of 8 of 10 frames; no depth"``, from the table ``frames.csv``; None where all is there.

    Empty columns are of kinds that the system did not write at all; of those only depth is told: the evaluators say the
    rest. Without the columns it is a run of ours.
    """
    found = []
    for column, what in _KINDS.items():
        there = int(frames[column].sum()) if column in frames else 0
        if column == "left_depth" and column in frames and not there:
            found.append("no depth")
        elif 0 < there < len(frames):
            found.append(f"{what} of {there} of {len(frames)} frames")
    return "; ".join(found) or None
