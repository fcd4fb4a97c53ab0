"""JSON that others wrote: numbers that a float can hold, and a depth that the rest of the program can walk through."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.io.foreign import MOST_TEXT, read_plain_text

_DEEPEST = 50
"""Lists in lists; no file of this kind has more than 8."""
_LONGEST_WHOLE = 19
"""Digits of a whole number that fits 64 bits."""


def load_json(path: Path, constant: Callable[[str], Any] = float, most: float = MOST_TEXT) -> Any:
    """What a JSON file holds; ``constant`` makes a value of NaN and Infinity, which JSON proper doesn't have.

    Raises ``BenchError`` for what is no plain file, ``OSError`` for one that is missing, and ``ValueError`` or
    ``RecursionError`` for content that is damaged, nested without measure, or has numbers beyond all measure.
    """
    text = read_plain_text(path, most)
    content = json.loads(text, parse_int=_whole, parse_float=_real, parse_constant=constant)
    _require_shallow(content)
    return content


def _whole(digits: str) -> int:
    if len(digits.lstrip("-")) > _LONGEST_WHOLE:
        raise ValueError(f"it holds a whole number of {len(digits)} digits")
    return int(digits)


def _real(digits: str) -> float:
    value = float(digits)
    if value in (float("inf"), float("-inf")):
        raise ValueError(f"it holds a number that is too large ({digits[:20]})")
    return value


def _require_shallow(content: Any) -> None:
    level, depth = [content], 0
    while level:
        if depth > _DEEPEST:
            raise ValueError(f"it is nested more than {_DEEPEST} deep")
        inside = (each.values() if isinstance(each, dict) else each for each in level if isinstance(each, (dict, list)))
        level = [value for values in inside for value in values]
        depth += 1
