"""Of how many frames a scored output had pictures: said wherever it was not all of them."""

from __future__ import annotations

import pandas as pd

_KINDS = {"left_color": "renders", "right_color": "right renders", "left_depth": "depth"}


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
        elif column == "right_color" and "absent" in frames and not there:
            found.append("no right renders")
    if "absent" in frames:
        found += [str(reason) for reason in frames["absent"].dropna().unique()]
    return "; ".join(found) or None
