"""What is printed on any terminal: letters that it lacks are replaced; one that takes nothing more is known."""

from __future__ import annotations

import codecs
import contextlib
import os
import sys
import unicodedata
from typing import TYPE_CHECKING

from bench.plain_text import plain_line

if TYPE_CHECKING:
    from rich.console import Console

_PLAIN = {
    **{
        "±": "+-",
        "·": ".",
        "…": "...",
        "\N{EN DASH}": "-",
        "\N{MULTIPLICATION SIGN}": "x",
        "†": "*",
        "✓": "+",
        "✗": "x",
    },
    **{"→": "->", "↑": "^", "↓": "v", "▶": ">", "▷": ">"},
}


def _plain(error: UnicodeError) -> tuple[str, int]:
    """Error handler of ``codecs``: ``±`` as ``+-``, ``ü`` as ``u``, what has no such form as ``?``."""
    assert isinstance(error, UnicodeEncodeError)
    letters = [_PLAIN.get(letter) or _base_of(letter) for letter in error.object[error.start : error.end]]
    return "".join(letters), error.end


def _base_of(letter: str) -> str:
    """The ASCII letter below the accents, else a question mark."""
    return unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode() or "?"


codecs.register_error("bgs_plain", _plain)


def print_anywhere() -> None:
    """From now on standard output and error show what their encoding lacks (``LC_ALL=C``) in plain letters."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # not where a test or a notebook has put something else in its place
            stream.reconfigure(errors="bgs_plain")


def tell(line: str) -> None:
    """Print a line of the program's own on standard error, as plain text, if that takes it."""
    with contextlib.suppress(OSError):
        print(f"bgs-bench: {plain_line(line)}", file=sys.stderr, flush=True)


def say(line: str, console: Console) -> None:
    """Print a line of plain text, which only the terminal breaks: no markup, colours or emoji codes."""
    console.print(plain_line(line), markup=False, highlight=False, emoji=False, soft_wrap=True)


def output_error(probe: bool = False) -> OSError | None:
    """Why standard output takes nothing more (a pipe whose reader has left, a full device), or None where it does.

    What it did not take is then dropped, so that the interpreter does not try again when it ends. ``probe`` writes an
    empty line to see, where nothing may be left that waits to be written.
    """
    if sys.stdout is None:
        return None
    try:
        if probe:
            sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError as error:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
        return error
    return None
