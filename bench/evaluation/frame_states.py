"""How many frames were tracked well, weakly, by prediction alone or not at all, and where the lost ones are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt


def count_states(numbers: Sequence[int] | npt.NDArray[np.int64], states: Sequence[str]) -> dict[str, Any]:
    """``tracked``, ``ok``, ``weak``, ``predicted``, ``lost`` and ``lost_stretches`` of frames in order.

    ``states`` are those of ``numbers``. A stretch is ``[first, last]``, two frame numbers; frames that follow each
    other in the sequence belong together, also where their numbers step by more than one. Tracked = all that are not
    lost. Where states are "unknown" (another system's output without a trajectory), the counts are None.
    """
    count = Counter(states)
    if count["unknown"]:
        return dict.fromkeys(("tracked", "ok", "weak", "predicted", "lost")) | {"lost_stretches": []}
    return {
        "tracked": len(states) - count["lost"],
        "ok": count["ok"],
        "weak": count["weak"],
        "predicted": count["predicted"],
        "lost": count["lost"],
        "lost_stretches": stretches(numbers, np.array([state == "lost" for state in states], dtype=bool)),
    }


def stretches(numbers: Sequence[int] | npt.NDArray[np.int64], inside: npt.NDArray[np.bool_]) -> list[list[int]]:
    """``[first, last]`` number of every unbroken run of ``inside`` (N,), in order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    return [[int(numbers[first]), int(numbers[end - 1])] for first, end in edges.reshape(-1, 2)]


def describe_stretches(lost: Sequence[Sequence[int]]) -> str:
    """Stretches as a sentence part, for example ``"40 to 51, 80"`` (at most five of them)."""
    shown = ", ".join(str(first) if first == last else f"{first} to {last}" for first, last in lost[:5])
    return shown + (f" and {len(lost) - 5} more stretches" if len(lost) > 5 else "")
