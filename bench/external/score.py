"""From a folder of another system's output to a scored run folder."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench import registry
from bench.config import compose_run, hash_of
from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.evaluation.run_evaluators import evaluate_run
from bench.evaluation.saved_run import ProgressReport
from bench.external.output import read_output
from bench.external.run_folder import is_there, write_run
from bench.external.settings import ScoreSettings, read_settings
from bench.runs.config_file import RUNS_FOLDER
from bench.runs.system_name import SECTION

_PARTS = ("dataset", "protocol", "evaluator", "plugins", "seed", "output")
"""What of a run's config can be said about another system's output."""


@dataclass(frozen=True)
class Scored:
    """The run folder, its metrics, and whether it held this very output before."""

    path: Path
    metrics: Mapping[str, Any]
    was_there: bool


def score_folder(
    folder: Path,
    overrides: Sequence[str],
    options: Mapping[str, Any],
    tell: Callable[[str], None],
    on_progress: ProgressReport,
) -> Scored:
    """Read ``folder``, write it as a run folder and score that with the evaluators of the config.

    ``overrides`` are those of ``bgs-bench run`` for data set, protocol and evaluators; ``options`` the settings of
    ``ScoreSettings`` that the command line has. ``tell`` gets one line for each thing found, or looked for in vain.
    Raises ``BenchError`` for bad input before anything is written.
    """
    _require_scoring_parts(overrides)
    composed = compose_run(overrides)
    settings = read_settings(folder, options)
    if not settings.name:
        raise BenchError("The system has no name. Say --name NAME: tables call it so.")
    dataset = registry.build(composed.plugin("dataset"), "dataset")
    assert isinstance(dataset, Dataset)
    for each in composed.several("evaluator"):
        registry.lookup("evaluator", each.name)
    output = read_output(folder, settings, dataset)
    config = {key: composed.values[key] for key in _PARTS}
    config[SECTION] = _section(settings, output.sources, output.content)
    config_hash = hash_of(config)
    path = Path(config["output"] or RUNS_FOLDER / config_hash)
    if path.resolve().is_relative_to(folder.resolve()):
        raise BenchError(f"--output {path} lies in the folder that is scored. Give another place.")
    was_there = is_there(path, config, config_hash)
    for line in (*output.about, *(f"warning: {text}" for text in dataset.to_tell())):
        tell(line)
    if settings.status == "done" and composed.protocol.holdout_every and not settings.held_out:
        tell("held-out frames: not scored apart; say --held-out if the system's map never saw them")
    if not was_there:
        write_run(path, config, config_hash, output, dataset, settings, on_progress)
    return Scored(path, evaluate_run(path, on_progress), was_there)


def _section(settings: ScoreSettings, sources: Mapping[str, str], content: str) -> dict[str, Any]:
    """What the config says of the system; no path of this machine."""
    return {
        "name": settings.name,
        "content": content,
        "files": dict(sources),
        "read_as": settings.recorded(),
        "resources": dict(settings.resources),
        "status": settings.status,
        "reason": settings.reason,
    }


def _require_scoring_parts(overrides: Sequence[str]) -> None:
    """Raise ``BenchError`` for an override of something that another system's run does not have."""
    for override in overrides:
        part = re.split(r"[=.@/]", override.lstrip("+~"), maxsplit=1)[0]
        if part not in _PARTS:
            raise BenchError(
                f"{override}: another system's output has no {part} of ours; it takes {', '.join(_PARTS)}, as in "
                "dataset.sequence=06 or protocol=paper."
            )
    if not any(re.match(r"dataset[=.]", override) for override in overrides):
        raise BenchError("Say on which data set the system was run, for example dataset=kitti dataset.root=DIR.")
