"""The contract of an evaluator, on a small saved run: numbers that JSON can hold, and the run stays as it was."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.authoring import probes
from bench.authoring.verdict import Candidate, Check, ContractBrokenError, Note
from bench.contracts.evaluator import ViewEvaluator
from bench.evaluation.run_evaluators import merge
from bench.evaluation.saved_run import SavedRunFolder
from bench.runs.folder import RESOURCES_FILE, RunFolder
from bench.types import RenderedView, Trajectory

_FRAMES = 4
# Filled by the framework; what an evaluator put there would clash.
_TAKEN = ("protocol", "map", "frames")


@dataclass
class Subject:
    """The evaluator under test."""

    candidate: Candidate

    @contextmanager
    def saved_run(self, complete: bool = True) -> Iterator[SavedRunFolder]:
        """A run of a few frames in a temporary folder; an incomplete one was stopped before it rendered anything."""
        dataset = self.candidate.other("dataset")
        probes.require_frames(dataset, _FRAMES)
        with tempfile.TemporaryDirectory() as place:
            folder = RunFolder.create(Path(place) / "run", self.candidate.run.values, "check-plugin", rerun=False)
            _write_run(folder, dataset, complete)
            yield SavedRunFolder(folder.path)

    def scores(self, run: SavedRunFolder) -> dict[str, Any]:
        """What a fresh instance says about the run, checked for its form."""
        scores = self.candidate.build().evaluate(run)
        if not isinstance(scores, dict):
            raise ContractBrokenError(
                f"evaluate() returned {type(scores).__name__}",
                "a nested dict",
                'return {"mine": {"score": 1.0}}',
                "evaluate",
            )
        _require_plain(scores, "")
        return scores


def _write_run(folder: RunFolder, dataset: Any, complete: bool) -> None:
    """Renders are the true images, brighter by 4 grey levels; the estimated poses are off by 1 cm per frame."""
    numbers = list(dataset.numbers[:_FRAMES])
    state = "done" if complete else "interrupted"
    truth = dataset.ground_truth()
    truth = truth if truth is not None and len(truth) == len(dataset) else None
    poses = np.tile(np.eye(4), (_FRAMES, 1, 1)) if truth is None else truth.T_world_cam[:_FRAMES].copy()
    times, rows = [], []
    for position, number in enumerate(numbers):
        frame = dataset.frame(position)
        times.append(frame.timestamp)
        rows.append({"number": number, "timestamp": frame.timestamp, "state": "ok", "mapped": True, "heldout": False})
        depth = dataset.true_depth(position)
        depth = np.full(frame.left.shape[:2], 10.0, np.float32) if depth is None else depth
        for view, image in (("left", frame.left), ("right", frame.right)) if complete else ():
            if image is None:
                continue
            color = np.minimum(image.astype(np.float32) + 4, 255) / np.float32(255)
            folder.write_view(view, number, RenderedView(color, depth, np.ones_like(depth)), depth)  # type: ignore[arg-type]
    estimate = poses.copy()
    estimate[:, 0, 3] += 0.01 * np.arange(_FRAMES)
    exact = None if truth is None else Trajectory(poses, np.array(numbers), np.array(times))
    folder.write_trajectory(Trajectory(estimate, np.array(numbers), np.array(times)), exact)
    folder.write_frames(rows)
    if complete:
        folder.write_json(RESOURCES_FILE, {"peak_memory_gb": 0.5, "gaussians": 1000, "frames": _FRAMES})
    folder.set_status(state, frames_done=_FRAMES, frames_total=_FRAMES)


def _require_plain(value: Any, where: str) -> None:
    """Raise ``ContractBrokenError`` for a key or value that JSON can't hold."""
    if isinstance(value, dict):
        for key, part in value.items():
            if not isinstance(key, str):
                raise ContractBrokenError(
                    f"the key {key!r} in {where or 'the dict'}", "strings", f"str({key!r})", "evaluate"
                )
            _require_plain(part, f"{where}.{key}".lstrip("."))
    elif isinstance(value, list | tuple):
        for index, part in enumerate(value):
            _require_plain(part, f"{where}[{index}]")
    elif not (value is None or type(value) in (bool, int, float, str)):
        raise ContractBrokenError(
            f"{where} is {type(value).__name__}",
            "int, float, str, bool, None, or lists of them",
            "float(value)",
            "evaluate",
        )
    elif isinstance(value, float) and not np.isfinite(value):
        raise ContractBrokenError(
            f"{where} is {value}",
            "a finite number",
            f'None, with the reason in {{"notes": {{"{where}": "..."}}}}',
            "evaluate",
        )


def _form(subject: Subject) -> str:
    with subject.saved_run() as run:
        scores = subject.scores(run)
        json.dumps(scores, allow_nan=False)
        taken = [key for key in scores if key in _TAKEN]
        if taken:
            raise ContractBrokenError(
                f"the key '{taken[0]}' is the framework's own", "a key of your own, or one of views, trajectory, notes",
                "put the numbers under the plugin's name", "evaluate",
            )  # fmt: skip
        merge({}, scores)
    return _listed(scores)


def _listed(scores: dict[str, Any]) -> str:
    leaves = [
        f"{place} {value:.4g}" if isinstance(value, float) else f"{place} {value}"
        for place, value in _leaves(scores, "")
    ]
    return ", ".join(leaves[:5]) + (f" and {len(leaves) - 5} more" if len(leaves) > 5 else "")


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _metrics(subject: Subject) -> str | Note:
    declared = subject.candidate.plugin.cls.metrics  # type: ignore[attr-defined]
    if not declared:
        return Note("declares no metrics: its numbers stand in metrics.json, and tables don't show them")
    with subject.saved_run() as run:
        there = {place for place, _ in _leaves(subject.scores(run), "")}
    missing = [".".join(place) for metric in declared for place in metric.places if ".".join(place) not in there]
    if len(missing) == sum(len(metric.places) for metric in declared):
        raise ContractBrokenError(
            f"no declared metric is where it should be: {missing[0]} is not in the scores",
            f"a metric's path to lead to a number in what evaluate() returns ({', '.join(sorted(there)[:3])})",
            f'Metric("{declared[0].key}", "{declared[0].title}", path="{min(there, default="mine.score")}")',
            "evaluate",
        )
    about = ", ".join(f"{metric.title}{f' [{metric.unit}]' if metric.unit else ''}" for metric in declared[:5])
    return about + (f"; not in this run: {', '.join(missing[:3])}" if missing else "")


def _leaves(value: Any, where: str) -> Iterator[tuple[str, Any]]:
    """Dotted place and value of each number, text or list in a nested dict."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _leaves(part, f"{where}.{key}".lstrip("."))
    else:
        yield where, value


def _changes_nothing(subject: Subject) -> str:
    with subject.saved_run() as run:
        before = _fingerprints(run.path)
        subject.scores(run)
        after = _fingerprints(run.path)
    changed = [name for name, digest in before.items() if after.get(name) != digest]
    if changed:
        raise ContractBrokenError(
            f"{changed[0]} of the run was changed or removed",
            "what a run saved stays as it is: others score it too",
            "write new files under other names; per-frame values go to run.add_per_frame",
            "evaluate",
        )
    new = sorted(set(after) - set(before))
    return f"the run stays as it was{'; adds ' + ', '.join(new) if new else ''}"


def _fingerprints(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def _repeats(subject: Subject) -> str:
    with subject.saved_run() as run:
        first, second = subject.scores(run), subject.scores(SavedRunFolder(run.path))
        rows = run.per_frame()
        other_order = _in_other_order(subject, run)
    if first != second:
        raise ContractBrokenError(
            "the same run twice gave different scores", "equal scores", "no randomness", "evaluate"
        )
    if other_order not in (None, first):
        raise ContractBrokenError(
            "views in another order, their scores kept as JSON, gave different scores",
            "equal scores: frames are scored by several threads, and those of a stopped scoring come from a file",
            "keep nothing in view(): return its scores as numbers by name, and add them up in finish()",
            "view",
        )
    columns = [column for column in rows.columns if column not in ("view", "number")]
    return "twice the same scores" + (f"; per frame: {', '.join(columns)}" if columns else "")


def _in_other_order(subject: Subject, run: SavedRunFolder) -> dict[str, Any] | None:
    """What an evaluator of pictures says when the last view comes first, and its scores have been in a file."""
    evaluator = subject.candidate.build()
    if not isinstance(evaluator, ViewEvaluator):
        return None
    evaluator.start(run)
    backwards = {(view.camera, view.number): evaluator.view(view) for view in reversed(list(run.views()))}
    read = {view: json.loads(json.dumps(scores)) for view, scores in reversed(backwards.items()) if scores is not None}
    return evaluator.finish(read)


def _stopped_run(subject: Subject) -> str | Note:
    with subject.saved_run(complete=False) as run:
        scores = subject.scores(run)
    return f"a run that stopped before it rendered: {_listed(scores) or 'nothing to say'}"


def checks_of(subject: Subject) -> tuple[Check[Subject], ...]:
    """All checks of an evaluator."""
    return (
        Check("scores", _form, essential=True),
        Check("metrics", _metrics),
        Check("run untouched", _changes_nothing),
        Check("determinism", _repeats),
        Check("stopped run", _stopped_run),
    )
