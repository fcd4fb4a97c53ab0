"""The ``frames`` setting of data sets: ``"a:b"`` or ``"a:b:step"``, half-open, in frame numbers."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from bench.errors import BenchError

_HOW = "write {0}first:end or first:end:step (end is left out), for example {0}0:10"


def parse_frame_range(text: str, setting: str = "dataset.frames=") -> tuple[int, int | None, int] | None:
    """``(first, end, step)`` of ``"a:b"`` or ``"a:b:step"``, or None for an empty text (all frames).

    ``first`` may be left out (0) and so may ``end`` (None: up to the last there is). Raises ``BenchError`` otherwise,
    which calls the range as the user typed it: ``setting`` and the text.
    """
    text = text.strip()
    if not text:
        return None
    parts = text.split(":")
    if len(parts) not in (2, 3) or not all(part.strip().isdecimal() or not part.strip() for part in parts):
        raise BenchError(f"{setting}{text!r} is no range of frames: {_HOW.format(setting)}.")
    first = int(parts[0] or 0)
    end = int(parts[1]) if parts[1].strip() else None
    step = int(parts[2]) if len(parts) == 3 and parts[2].strip() else 1
    if step < 1 or (end is not None and end <= first):
        raise BenchError(f"{setting}{text!r} holds no frame: {_HOW.format(setting)}.")
    return first, end, step


def select_frames(text: str, there: Sequence[int], where: str) -> tuple[int, ...]:
    """Frame numbers asked for by ``text`` among those that are ``there`` (increasing); ``where`` is for messages.

    An empty text means all of them, which must then be without a gap. Raises ``BenchError`` that says which are there.
    """
    if not there:
        raise BenchError(f"{where} holds no image. Check dataset.root and dataset.sequence.")
    wanted = parse_frame_range(text)
    if wanted is None:
        gap = next((a for a, b in itertools.pairwise(there) if b != a + 1), None)
        if gap is not None:
            raise BenchError(
                f"Frame {gap + 1} is missing in {where}, which holds {describe(there)}. Restore it, or choose a range "
                f"without a gap, for example dataset.frames={there[0]}:{gap + 1}."
            )
        return tuple(there)
    first, end, step = wanted
    numbers = range(first, there[-1] + 1 if end is None else end, step)
    known = set(there)
    missing = next((n for n in numbers if n not in known), None)
    if missing is not None or not numbers:
        what = f"frame {missing} is missing" if missing is not None else f"there is no frame {first}"
        raise BenchError(
            f"dataset.frames={text}: {what} in {where}, which holds {describe(there)}. Choose a range that is there."
        )
    return tuple(numbers)


def describe(numbers: Sequence[int]) -> str:
    """Runs of frame numbers as a sentence part, for example ``"frames 0 to 9, 12"`` (at most five runs)."""
    runs: list[str] = []
    for _, group in itertools.groupby(enumerate(numbers), key=lambda pair: pair[1] - pair[0]):
        run = [number for _, number in group]
        runs.append(str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}")
    shown = ", ".join(runs[:5]) + (f" and {len(runs) - 5} more runs" if len(runs) > 5 else "")
    return f"frame{'s' if len(numbers) > 1 else ''} {shown}"
