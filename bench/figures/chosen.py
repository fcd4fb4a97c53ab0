"""Which runs and which of their views a figure shows, checked: they must show the same images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bench.contracts.saved_run import VIEW_OF_GROUP
from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.io.frame_range import describe
from bench.plain_text import plain_line
from bench.runs.folder import CHECKSUM_COLUMN, View
from bench.runs.system_name import system_name

Views = Literal["left", "right", "heldout"]
VIEWS: tuple[Views, ...] = ("left", "right", "heldout")


@dataclass(frozen=True)
class Method:
    """A run under the name by which a figure calls it."""

    name: str
    run: SavedRunFolder


@dataclass(frozen=True)
class Shown:
    """One camera's view of one frame."""

    camera: View
    number: int


def methods_of(given: Sequence[str]) -> list[Method]:
    """The runs of ``RUN`` or ``NAME=RUN``. Without a name it is the system's, with the folder's where two are the same.

    Raises ``BenchError`` for what is no run folder, and for a name that is given twice.
    """
    named: list[tuple[str, SavedRunFolder]] = []
    for text in given:
        name, equals, path = text.partition("=")
        is_named = equals and not Path(text).exists()
        named.append((plain_line(name) if is_named else "", SavedRunFolder(Path(path if is_named else text))))
    systems = [system_name(run.config) or run.path.resolve().name for name, run in named]
    unnamed = [system for system, (name, _) in zip(systems, named, strict=True) if not name]
    methods = []
    for system, (name, run) in zip(systems, named, strict=True):
        usual = system if unnamed.count(system) == 1 else f"{system}, {run.path.resolve().name}"
        methods.append(Method(name or plain_line(usual), run))
    names = [method.name for method in methods]
    for name in names:
        if names.count(name) > 1:
            raise BenchError(f"Two runs are called {name}. Give them names: NAME=RUN_FOLDER.")
    return methods


def shown_of(
    methods: Sequence[Method], views: Sequence[Views], numbers: Sequence[int], default: int
) -> tuple[list[Shown], str]:
    """The views to show, by frame, and what to tell of them: frames ``numbers``, or ``default`` of those that all have.

    Raises ``BenchError`` for a frame of which a run has no render, and where runs are of different images.
    """
    there = {each: [_there(method, each) for method in methods] for each in views}
    common = {each: set.intersection(*map(set, of_runs)) for each, of_runs in there.items()}
    both = sorted(set.intersection(*common.values()))
    for number in numbers:
        for each in views:
            lacking = next((k for k, has in enumerate(there[each]) if number not in has), None)
            if lacking is not None:
                raise BenchError(
                    f"{methods[lacking].run.path} has no {each} render of frame {number}. "
                    f"{_all_have(both, views)} Choose with --frames and --views."
                )
    if not both:
        which = "; ".join(
            f"{method.run.path} has {each} renders of {describe(there[each][k]) if there[each][k] else 'no frame'}"
            for k, method in enumerate(methods)
            for each in views
        )
        raise BenchError(f"There is no frame that all runs show: {which}. Make the runs with the same dataset.frames.")
    count = min(default, len(both))
    chosen = list(numbers) or [both[(2 * k + 1) * len(both) // (2 * count)] for k in range(count)]
    _require_same_images(methods, chosen)
    cameras = list(dict.fromkeys(VIEW_OF_GROUP[each] for each in views))
    return [Shown(camera, number) for number in chosen for camera in cameras], _all_have(both, views)


def is_held_out(method: Method, number: int) -> bool:
    """Whether the run kept the frame out of mapping."""
    frames = method.run.frames
    return bool(frames.loc[frames["number"] == number, "heldout"].any())


def _there(method: Method, views: Views) -> list[int]:
    """Frames of which the run has a render of this kind."""
    rendered = method.run.rendered(VIEW_OF_GROUP[views])
    return [number for number in rendered if views != "heldout" or is_held_out(method, number)]


def _all_have(both: Sequence[int], views: Sequence[Views]) -> str:
    return f"All runs have {' and '.join(views)} views of {describe(both) if both else 'no frame'}."


def _require_same_images(methods: Sequence[Method], numbers: Sequence[int]) -> None:
    """By the checksums of what the runs read, where both kept them; else by the name of their sequence."""
    first, *others = methods
    known = _checksums(first)
    for method in others:
        checksums = _checksums(method)
        for number in numbers:
            if number in known and number in checksums:
                differ = known[number] != checksums[number]
            else:
                differ = first.run.dataset.label != method.run.dataset.label
            if differ:
                raise BenchError(
                    f"{first.run.path} and {method.run.path} were made from different images: frame {number} is not "
                    "the same in both. Choose runs with the same sequence, camera and dataset.scale."
                )


def _checksums(method: Method) -> dict[int, int]:
    frames = method.run.frames
    if CHECKSUM_COLUMN not in frames:
        return {}
    return dict(zip(frames["number"].tolist(), frames[CHECKSUM_COLUMN].tolist(), strict=True))
