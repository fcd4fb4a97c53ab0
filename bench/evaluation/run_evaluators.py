"""Score a saved run: all its evaluators, one ``metrics.json`` and one ``per_frame.csv``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench import registry
from bench.contracts.evaluator import Evaluator, ViewEvaluator
from bench.errors import BenchError
from bench.evaluation.frame_states import count_states
from bench.evaluation.gaps import about_gaps
from bench.evaluation.metrics import DECLARED, brought_with
from bench.evaluation.saved_run import ProgressReport, SavedRunFolder
from bench.evaluation.score_views import score_views
from bench.io.atomic import write_json, write_text
from bench.plugin_config import plugin_config_from
from bench.runs.endings import how_it_ended, terminate_as_interrupt
from bench.runs.folder import METRICS_FILE, PER_FRAME_FILE, PROVENANCE_FILE, RESOURCES_FILE, SCORES_FILE, map_size
from bench.runs.provenance import describe_weights
from bench.runs.status import SCORING, read_json, without_scores, write_status
from bench.runs.system_name import external_name


def evaluate_run(path: Path, on_progress: ProgressReport | None = None) -> dict[str, Any]:
    """Score the run folder at ``path`` with the evaluators of its config; write and return the metrics.

    ``on_progress(what, done, total)`` is called while images are scored. A run that failed or was interrupted is scored
    as far as it got; a scoring that was stopped or killed goes on where it was. An evaluator that can't run here leaves
    a note instead of its numbers. Plugins that the run needs are loaded before: the folders of plugins that its config
    names are not looked into. Raises ``BenchError`` for a plugin that is not there, a folder that is no run, is
    incomplete or damaged, and when two evaluators disagree about the same number; where a run has no scores yet, its
    status then says what came in between, and that only its scores are missing.
    """
    run = SavedRunFolder(path)
    run.on_progress = on_progress
    with _told_in_status(run):
        return _scored(run)


def _scored(run: SavedRunFolder) -> dict[str, Any]:
    chosen = run.config.get("evaluator") or {}
    for name in chosen:
        run.require("evaluator", str(name))
    metrics: dict[str, Any] = {"protocol": run.protocol.stamp() | {"right_images_mapped": _learned_from_right(run)}}
    evaluators = {name: _evaluator(name, mapping or {}) for name, mapping in chosen.items()}
    of_views = {name: evaluator for name, evaluator in evaluators.items() if isinstance(evaluator, ViewEvaluator)}
    scores = score_views(run, of_views)
    for name, evaluator in evaluators.items():
        if isinstance(evaluator, ViewEvaluator):
            merge(metrics, evaluator.finish(scores.pop(name)))
        else:
            merge(metrics, evaluator.evaluate(run) if isinstance(evaluator, Evaluator) else evaluator)
    merge(metrics, {"map": _map_size(run), "frames": _frame_counts(run)})
    if brought := brought_with(chosen):
        metrics[DECLARED] = brought
    gaps = about_gaps(run.frames)
    merge(metrics, {"notes": {"output": gaps}} if gaps else {})
    merge(metrics, {"notes": {"warning": "; ".join(run.status.warnings)}} if run.status.warnings else {})
    _record_weights(run)
    write_text(run.path / PER_FRAME_FILE, run.per_frame().to_csv(index=False))
    if run.status.stage == SCORING:
        write_status(run.path, replace(run.status, state="done", reason="", stage=""))
    write_json(run.path / METRICS_FILE, metrics)
    (run.path / SCORES_FILE).unlink(missing_ok=True)
    return metrics


@contextmanager
def _told_in_status(run: SavedRunFolder) -> Iterator[None]:
    try:
        with terminate_as_interrupt():
            yield
    except BaseException as error:
        if run.status.is_complete and not (run.path / METRICS_FILE).is_file():
            write_status(run.path, without_scores(run.status, *how_it_ended(error)))
        raise


def _evaluator(name: str, mapping: Mapping[str, Any]) -> Evaluator | dict[str, Any]:
    """The evaluator, or a note in the form of ``metrics.json`` on why it can't run here."""
    reason = registry.lookup("evaluator", name).unavailable_reason()
    if reason is not None:
        return {"notes": {name: reason}}
    evaluator = registry.build(plugin_config_from("evaluator", {"name": name, **mapping}), "evaluator")
    assert isinstance(evaluator, Evaluator)
    return evaluator


def merge(into: dict[str, Any], part: dict[str, Any], where: str = "") -> None:
    """Put a nested dict into another one, key by key; ``BenchError`` when both have different values for one key."""
    for key, value in part.items():
        present = into.get(key)
        if isinstance(present, dict) and isinstance(value, dict):
            merge(present, value, f"{where}{key}.")
        elif key in into and present != value:
            raise BenchError(
                f"Two evaluators give {where}{key} as {present!r} and {value!r}; leave one of them out of the config."
            )
        else:
            into[key] = value


def _record_weights(run: SavedRunFolder) -> None:
    """Add the weights that scoring used to ``provenance.json``, where the run has one."""
    path = run.path / PROVENANCE_FILE
    if run.weights and path.is_file():
        provenance = read_json(path)
        provenance["weights"] = provenance.get("weights", {}) | describe_weights(run.weights)
        write_json(path, provenance)


def _frame_counts(run: SavedRunFolder) -> dict[str, Any]:
    return {
        # An interrupted run has rows for what it did; the status knows how many frames there were to do.
        "total": max(len(run.frames), run.status.frames_total),
        **count_states(run.frames["number"].tolist(), run.frames["state"].tolist()),
        "mapped": int(run.frames["mapped"].sum()),
    }


def _learned_from_right(run: SavedRunFolder) -> bool | None:
    """Whether mapping saw right images; None where nobody here knows: right views of another system."""
    if external_name(run.config) is not None and run.rendered("right"):
        return None
    return run.right_images_mapped


def _map_size(run: SavedRunFolder) -> dict[str, Any]:
    return map_size(run.resources if (run.path / RESOURCES_FILE).is_file() else {})
