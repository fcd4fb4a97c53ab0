"""The one exception a user sees as a plain sentence, and the did-you-mean part of it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from bench.plain_text import plain_line

_LONGEST_QUOTE = 500


class BenchError(Exception):
    """Wrong input or configuration: the message says what, where, and what to do.

    The command line prints it as one line and exits with ``exit_code``; no traceback.
    """

    exit_code = 2


def did_you_mean(wrong: str, accepted: Iterable[str]) -> str:
    """Return ``" Did you mean 'x'?"`` for the nearest accepted name, or an empty string."""
    near = difflib.get_close_matches(wrong, list(accepted), n=1, cutoff=0.5)
    return f" Did you mean '{near[0]}'?" if near else ""


def require_choice(what: str, value: str, accepted: Iterable[str]) -> str:
    """Return ``value`` if it is one of ``accepted``; raise a readable ``BenchError`` otherwise.

    ``what`` names the setting as the user types it, for example ``"dataset.camera"``.
    """
    names = list(accepted)
    if value not in names:
        raise BenchError(f"{what}={value!r} is not one of {', '.join(names)}.{did_you_mean(str(value), names)}")
    return value


def first_line(error: BaseException) -> str:
    """What to quote of another library's error: the first line of its text, without its full stop, else its type.

    With the second line where the first only announces it. An exception that is no more than a type or a place
    (``KeyError: 3``, ``MemoryError``) is named.
    """
    first, *others = str(error).strip().split("\n")
    text = f"{first} {others[0].strip()}" if first.endswith(":") and others else first
    text = plain_line(text, _LONGEST_QUOTE).rstrip(".")
    bare = not text or isinstance(error, (KeyError, IndexError, AttributeError, RecursionError, MemoryError))
    return f"{type(error).__name__}{': ' if text else ''}{text}" if bare else text


def require_least(where: str, config: object, **least: float) -> None:
    """Raise a readable ``BenchError`` for the first setting of ``config`` that is below its least value, or NaN.

    ``where`` is how the user begins the setting's name, for example ``"tracker"``.
    """
    for name, value in least.items():
        if not getattr(config, name) >= value:
            raise BenchError(f"{where}.{name}={getattr(config, name)} is too small; the least is {value:g}.")


def require_between(where: str, config: object, low: float, high: float, *names: str) -> None:
    """Raise a readable ``BenchError`` for the first of these settings that is below ``low``, above ``high``, or NaN."""
    for name in names:
        if not low <= getattr(config, name) <= high:
            raise BenchError(f"{where}.{name}={getattr(config, name)} must lie between {low:g} and {high:g}.")
