"""Overrides as people type them, as lines that Hydra's grammar reads: its values have few letters beside ASCII's."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException, OverrideParseException

from bench.errors import BenchError

_ASSIGNMENT = re.compile(r"(\+{0,2}[A-Za-z_$][\w$.@/:-]*=)(.*)", re.DOTALL)
_HOME = re.compile(r"(?<=[=\[,])~[\w.-]*(?=[/,\]]|$)")
# How Hydra says that a function of its own (range, choice, glob) was given something wrong.
_EVALUATING = re.compile(r"while evaluating '.*?': (.*)")


def hydra_lines(overrides: Sequence[str]) -> list[str]:
    """Overrides whose values Hydra reads: those with letters that its grammar lacks (umlauts, brackets, ``#``, quotes)
    become the strings they stand for, and ``~`` and ``~NAME``, which shells leave there after ``=``, home folders.

    Commas separate values, as always. Raises ``BenchError`` where there is no such home folder.
    """
    return [_line(_with_home(override)) for override in overrides]


def parse_lines(lines: Sequence[str]) -> list[Override]:
    """Parse such lines; raises ``BenchError`` that shows the user's own value as Hydra would read it."""
    try:
        return _parser().parse_overrides(list(lines))
    except OverrideParseException as error:
        about = _EVALUATING.search(str(error))
        why = f" ({about[1]})" if about else ""
        raise BenchError(
            f"Can't read the override '{error.override}'{why}. Write key=value, for example "
            f"stereo=sgbm{_or_as_one_value(error.override)}."
        ) from error


def as_one_value(override: str) -> str:
    """The override as a shell takes it when its value is one string, whatever it holds; empty where it has no value."""
    assignment = _ASSIGNMENT.fullmatch(override)
    if assignment is None:
        return ""
    line = assignment[1] + quoted(assignment[2])
    return shlex.quote(line) if re.search(r'["$`\\!]', line) else f'"{line}"'


def quoted(text: str | Path) -> str:
    """A text as the value of an override, whatever letters it has."""
    # Backslashes count as such but before a quote.
    escaped = re.sub(r"(\\*)('|$)", lambda m: 2 * m[1] + ("\\'" if m[2] else ""), str(text))
    return f"'{escaped}'"


def _or_as_one_value(override: str) -> str:
    shown = as_one_value(override)
    return f"; a text that Hydra takes for something else has quotes of its own: {shown}" if shown else ""


def _with_home(override: str) -> str:
    def home(found: re.Match[str]) -> str:
        folder = os.path.expanduser(found[0])
        if folder == found[0]:
            raise BenchError(f"{override}: there is no home folder {folder} (is HOME set?). Write the whole path.")
        return folder

    return _HOME.sub(home, override)


def _line(override: str) -> str:
    assignment = _ASSIGNMENT.fullmatch(override)
    if assignment is None or _is_read(override):
        return override
    key, value = assignment.groups()
    if value.startswith("[") and value.count("[") != value.count("]"):
        return override  # a list that is not closed
    if value.startswith("[") and value.endswith("]"):
        return f"{key}[{_elements(value[1:-1])}]"
    return key + _elements(value)


def _elements(values: str) -> str:
    each = [element.strip() for element in values.split(",")]
    return ",".join(element if _is_read(f"key={element}") else quoted(element) for element in each)


def _is_read(line: str) -> bool:
    """Whether Hydra reads it, or understands it and finds it wrong."""
    try:
        _parser().parse_rule(line, "override")
    except HydraException as error:
        return _EVALUATING.search(str(error)) is not None
    return True


@cache
def _parser() -> OverridesParser:
    return OverridesParser.create()
