"""The verdict on a plugin: one finding a check, with the line to mend; whatever the plugin raises becomes one too."""

from __future__ import annotations

import ast
import inspect
import textwrap
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from bench import registry
from bench.authoring.cures import cure_of
from bench.config import RunConfig
from bench.errors import BenchError
from bench.registry import Plugin, PluginConfig

State = Literal["ok", "FAILED", "note"]
S = TypeVar("S")

# What an author writes where a base class has the method itself.
_WRITTEN_BY_AUTHORS = {
    "disparity": ("match", "predict"),
    "evaluate": ("loss",),
    "loss": ("evaluate",),
    "render": ("splat",),
    "backward": ("splat",),
}


@dataclass(frozen=True)
class Finding:
    """One line of the verdict: what was seen and, of a failure, what was expected, how to mend it and where."""

    title: str
    state: State
    seen: str
    expected: str = ""
    mend: str = ""
    place: str = ""
    traceback: str = ""

    def lines(self) -> list[str]:
        """The finding as plain text, its failure's details below it."""
        details = (("expected", self.expected), ("to mend", self.mend), ("where", self.place))
        return [
            f"{self.state:<6}  {self.title:<19}  {self.seen}",
            *(f"        {what:<19}  {text}" for what, text in details if text),
        ]


class ContractBrokenError(Exception):
    """A check saw something else than the contract says; ``method`` is the plugin's method that said it."""

    def __init__(self, seen: str, expected: str, mend: str, method: str = "") -> None:
        super().__init__(seen)
        self.seen, self.expected, self.mend, self.method = seen, expected, mend, method


@dataclass(frozen=True)
class Note:
    """What a check wants to say without a judgement."""

    text: str


@dataclass(frozen=True)
class Candidate:
    """The plugin under test, its config, and the config of the run that the other parts come from.

    ``names_data``: the author named a data set or its settings; else it is the built-in street.
    """

    plugin: Plugin
    config: PluginConfig
    run: RunConfig
    names_data: bool = False

    def build(self) -> Any:
        """A fresh instance; raises what the constructor raises."""
        return registry.build(self.config, self.plugin.kind)

    def other(self, kind: str) -> Any:
        """A fresh instance of another kind of plugin, as the run's config has it."""
        return registry.build(self.run.plugin(kind), kind)


@dataclass(frozen=True)
class Check(Generic[S]):
    """A check of a subject: returns what it saw in words (or a ``Note``), raises ``ContractBrokenError`` otherwise.

    After the failure of an ``essential`` check the ones after it make no sense and are left out.
    """

    title: str
    run: Callable[[S], str | Note]
    essential: bool = False


def run_checks(plugin: Plugin, subject: S, checks: Sequence[Check[S]]) -> Iterator[Finding]:
    """The findings, one after the other, as they are made. Whatever the plugin raises becomes a failure."""
    for done, check in enumerate(checks, 1):
        finding = _finding(plugin, subject, check)
        yield finding
        if finding.state == "FAILED" and check.essential:
            left_out = ", ".join(other.title for other in checks[done:])
            if left_out:
                yield Finding("not checked", "note", f"{left_out}: first mend what failed above")
            return


def _finding(plugin: Plugin, subject: S, check: Check[S]) -> Finding:
    try:
        seen = check.run(subject)
    except ContractBrokenError as broken:
        place = place_of(plugin, broken.method)
        return Finding(check.title, "FAILED", broken.seen, broken.expected, broken.mend, place)
    except Exception as error:  # the border to an author's code: all that it can raise is a finding
        return failure_of(plugin, check.title, error)
    return Finding(check.title, "note", seen.text) if isinstance(seen, Note) else Finding(check.title, "ok", seen)


def failure_of(plugin: Plugin, title: str, error: Exception) -> Finding:
    """The finding for an exception: its type and message, and the line of the plugin's file that it came through."""
    text = " ".join(str(error).split())
    seen = text if isinstance(error, BenchError) else f"{type(error).__name__}: {text}".rstrip(": ")
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if Path(frame.filename) == Path(plugin.file)]
    # What a base class refuses is what the plugin's own method had returned to it.
    method = "disparity" if isinstance(error, BenchError) and title != "construction" else ""
    place = f"{own[-1].filename}:{own[-1].lineno}" if own else place_of(plugin, method)
    full = "".join(traceback.format_exception(error))
    unknown = "" if isinstance(error, BenchError) else "see the line named here; --traceback shows how it came there"
    mend = cure_of(error) or unknown
    return Finding(title, "FAILED", seen, "no exception", mend, place, full)


def place_of(plugin: Plugin, method: str) -> str:
    """``file:line`` of the last ``return`` of the method, or of what it calls, in the plugin's file; else its class."""
    for name in (method, *_WRITTEN_BY_AUTHORS.get(method, ())):
        function = getattr(plugin.cls, name, None)
        if not inspect.isfunction(function) or inspect.getsourcefile(function) != plugin.file:
            continue
        source, first = inspect.getsourcelines(function)
        return f"{plugin.file}:{first + _last_return(source)}"
    source, first = inspect.getsourcelines(plugin.cls)
    # Decorators come before the line that says `class`.
    decorators = next((at for at, line in enumerate(source) if line.lstrip().startswith("class ")), 0)
    return f"{plugin.file}:{first + decorators}"


def _last_return(source: list[str]) -> int:
    """Lines from the first one to the last ``return`` of a function; 0 where it has none."""
    tree = ast.parse(textwrap.dedent("".join(source)))
    return max((node.lineno for node in ast.walk(tree) if isinstance(node, ast.Return)), default=1) - 1


def failures(findings: Iterable[Finding]) -> list[str]:
    """The failed findings as text, for ``assert failures(...) == []`` in a test."""
    return ["\n".join(finding.lines()) for finding in findings if finding.state == "FAILED"]
