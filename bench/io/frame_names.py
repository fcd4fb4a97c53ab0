"""What the names of image files say: the number or the time of each frame, and so which files belong together."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from bench.errors import BenchError
from bench.types import Float

_NUMBER = re.compile(r"(?<![^\W_])\d+\.\d+|\d+")
"""Digits, or a decimal number that no letter or digit touches on the left: ``0.25``, ``t_0.25``, not ``cam0.12``."""
_EPOCH = ((10**18, Decimal("1e-9")), (10**15, Decimal("1e-6")), (10**12, Decimal("1e-3")))
"""Numbers from here to ten times as much count ns, us or ms since 1970: 2001 to 2286. Dates (20210304090559) don't."""
_STEP = ((10**6, Decimal("1e-9")), (5000, Decimal("1e-6")))
"""From which median step on smaller numbers count ns or us: cameras take 1 to 200 pictures a second, which is 5e6 to
1e9 ns or 5e3 to 1e6 us, and nobody keeps every 5000th frame."""
_TOO_LARGE = 2**63
"""What no frame number is: codes of digits give an order at most."""
_TOGETHER = 0.25
"""Left and right time stamps belong together up to this share of the time from one frame to the next."""


@dataclass(frozen=True)
class NamedFiles:
    """Files in the order of what their names say, and what that is.

    ``kind`` is "number" or "time" (then ``values`` are the numbers, or the seconds), "numbers" where several parts of
    the names count, or "name" where none has a digit. Files of two folders with equal ``keys`` belong together.
    """

    files: tuple[Path, ...]
    keys: tuple[tuple[Decimal, ...] | str, ...]
    kind: Literal["number", "time", "numbers", "name"]
    values: tuple[Decimal, ...] = ()

    @property
    def numbers(self) -> npt.NDArray[np.int64] | None:
        """The numbers (N,) in the names, increasing; None where they have none, several, or times."""
        return np.array([int(value) for value in self.values], dtype=np.int64) if self.kind == "number" else None

    @property
    def times(self) -> Float | None:
        """The times (N,) in the names, in seconds, increasing; None where they have none."""
        return np.array([float(value) for value in self.values]) if self.kind == "time" else None

    def counted(self) -> npt.NDArray[np.int64]:
        """Frame numbers (N,) from 0: the names' own steps, so that a gap in them stays one, else 0, 1, 2 ..."""
        numbers = self.numbers
        if numbers is None or len(numbers) < 2:
            return np.arange(len(self.files))
        return (numbers - numbers[0]) // math.gcd(*np.diff(numbers).tolist())


def in_order(files: Sequence[Path], advice: str = "Keep one of them, or rename it.") -> NamedFiles:
    """Order files by the number or time in their names; names without any digit by the alphabet.

    Of several numbers in a name those count that differ from file to file; in names that are not built alike the first
    where they begin alike, else the last.
    Raises ``BenchError`` for a file without a number among others that have one, and for one number twice; ``advice``
    says what to do about the latter.
    """
    found = [[Decimal(number) for number in _NUMBER.findall(file.stem)] for file in files]
    if not any(found):
        by_name = sorted(files, key=lambda file: file.stem)
        _require_unique([file.stem for file in by_name], by_name, advice)
        return NamedFiles(tuple(by_name), tuple(file.stem for file in by_name), "name")
    for file, numbers in zip(files, found, strict=True):
        if not numbers:
            raise BenchError(
                f"{file} has no number in its name, and other files beside it have. Rename it, or move it away."
            )
    if len({len(numbers) for numbers in found}) == 1:
        columns = list(zip(*found, strict=True))
        keys = list(zip(*[column for column in columns if len(set(column)) > 1] or columns[-1:], strict=True))
    else:
        # Behind one common beginning the frame's number comes first, and what follows may be anything.
        at = 0 if len({_NUMBER.split(file.stem)[0] for file in files}) == 1 else -1
        keys = [(numbers[at],) for numbers in found]
    order = sorted(range(len(files)), key=lambda at: keys[at])
    sorted_files, sorted_keys = [files[at] for at in order], [keys[at] for at in order]
    _require_unique(sorted_keys, sorted_files, advice)
    if len(sorted_keys[0]) > 1 or sorted_keys[-1][0] >= _TOO_LARGE:
        return NamedFiles(tuple(sorted_files), tuple(sorted_keys), "numbers")
    values = [key[0] for key in sorted_keys]
    unit = _unit(values)
    if unit is None:
        return NamedFiles(tuple(sorted_files), tuple(sorted_keys), "number", tuple(values))
    return NamedFiles(tuple(sorted_files), tuple(sorted_keys), "time", tuple(value * unit for value in values))


def _require_unique(keys: Sequence[tuple[Decimal, ...] | str], files: Sequence[Path], advice: str) -> None:
    for (one, first), (other, second) in itertools.pairwise(zip(keys, files, strict=True)):
        if one == other:
            what = f"the number {' '.join(map(str, one))}" if isinstance(one, tuple) else f"the name {one}"
            raise BenchError(f"{first} and {second.name} both have {what}. {advice}")


def _unit(values: Sequence[Decimal]) -> Decimal | None:
    """Seconds of one unit where the increasing ``values`` are times; None where they count frames."""
    if any(value.as_tuple().exponent for value in values):
        return Decimal(1)
    unit = seconds_per_unit(values)
    return None if unit == 1 else unit


def seconds_per_unit(times: Sequence[Decimal] | Float) -> Decimal:
    """Seconds of one unit of increasing ``times`` (N,): ns, us and ms are told from seconds by their size and steps."""
    steps = sorted(b - a for a, b in itertools.pairwise(times))
    of_epoch = (unit for least, unit in _EPOCH if least <= times[-1] < 10 * least)
    of_step = (unit for least, unit in _STEP if steps and steps[len(steps) // 2] >= least)
    return next(itertools.chain(of_epoch, of_step), Decimal(1))


@dataclass(frozen=True)
class Joined:
    """Rows of two lists of files that belong together, (M,) each, and ``remarks``: what a user should know of it."""

    left: npt.NDArray[np.intp]
    right: npt.NDArray[np.intp]
    remarks: tuple[str, ...]


def join(left: NamedFiles, right: NamedFiles) -> Joined:
    """Which left and right files are pairs: by number, time or name; by order only where no name says anything.

    A file without its partner is left out, and told. Raises ``BenchError`` where nothing tells which belong together.
    """
    if left.kind == right.kind == "time":
        rows, partners = _nearest_in_time(left, right)
    else:
        place = {key: row for row, key in enumerate(right.keys)}
        rows = np.array([row for row, key in enumerate(left.keys) if key in place], dtype=np.intp)
        partners = np.array([place[left.keys[row]] for row in rows], dtype=np.intp)
        if not len(rows) and left.kind == right.kind == "name" and len(left.files) == len(right.files):
            rows = partners = np.arange(len(left.files))
    if not len(rows):
        raise BenchError(
            f"No image of {left.files[0].parent} belongs to one of {right.files[0].parent} by the number, time or name "
            f"of its file ({_shown(left)}; {_shown(right)}). Give both images of a pair the same number."
        )
    return Joined(rows, partners, (*_alone(left, rows, right), *_alone(right, partners, left)))


def _nearest_in_time(left: NamedFiles, right: NamedFiles) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Rows of the pairs that are each other's nearest in time; differences are taken from exact numbers."""
    start = left.values[0]  # float64 would round seconds since 1970 to 0.2 us
    times, others = (np.array([float(value - start) for value in each.values]) for each in (left, right))
    partner, back = nearest(others, times), nearest(times, others)
    mutual = back[partner] == np.arange(len(times))
    step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    rows = np.flatnonzero(mutual & (np.abs(others[partner] - times) <= _TOGETHER * step))
    return rows, partner[rows]


def nearest(times: Float, wanted: Float) -> npt.NDArray[np.intp]:
    """Place of the nearest of the increasing ``times`` (N,) to each of ``wanted`` (M,)."""
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    before, after = after - 1, np.minimum(after, len(times) - 1)
    return np.where(np.abs(times[after] - wanted) < np.abs(times[before] - wanted), after, before)


def _alone(named: NamedFiles, rows: npt.NDArray[np.intp], other: NamedFiles) -> list[str]:
    alone = sorted(set(range(len(named.files))) - set(rows.tolist()))
    if not alone:
        return []
    names = ", ".join(named.files[row].name for row in alone[:5]) + (", ..." if len(alone) > 5 else "")
    return [
        f"{len(alone)} of {len(named.files)} images in {named.files[0].parent.name} have no partner in "
        f"{other.files[0].parent.name} and are left out: {names}"
    ]


def _shown(named: NamedFiles) -> str:
    first, last = named.files[0].name, named.files[-1].name
    return first if first == last else f"{first} to {last}"
