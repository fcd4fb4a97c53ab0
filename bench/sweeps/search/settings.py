"""The settings of a search: ``sweeper=optuna`` and ``sweeper.KEY=VALUE`` among the overrides of ``run -m``."""

from __future__ import annotations

import dataclasses
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from bench.config import check_overrides
from bench.contracts.metric import Metric
from bench.errors import BenchError, did_you_mean, first_line, require_choice
from bench.evaluation.metrics import declared_metrics

_LEFT = "views.left."
_OTHER_VIEWS = ("train", "heldout", "right")


@dataclass
class SearchConfig:
    """What is sought, and in how many runs."""

    metric: str = ""
    """The number that is sought: a metric's key (psnr_db) or its place in metrics.json (views.heldout.psnr_db)."""
    trials: int = 20
    """Runs in all; a search that is there already goes on up to so many."""
    direction: str = ""
    """maximize or minimize; empty: what is better for this metric."""
    seed: int = 0
    """Seed of the search; that of the runs is seed=."""

    def __post_init__(self) -> None:
        if self.trials < 1:
            raise BenchError(f"sweeper.trials={self.trials} must be at least 1.")
        if self.seed < 0:
            raise BenchError(f"sweeper.seed={self.seed} is negative; choose 0 or more.")
        require_choice("sweeper.direction", self.direction, ["", "maximize", "minimize"])


def split_search(overrides: Sequence[str]) -> tuple[list[str], SearchConfig | None]:
    """The overrides of the runs, and the settings of the search among them; None without ``sweeper=optuna``.

    Raises ``BenchError`` for another sweeper, an unknown setting, and where Optuna is not installed.
    """
    names = [each.partition("=")[2] for each in overrides if each.startswith("sweeper=")]
    settings = [each for each in overrides if each.lstrip("+").startswith("sweeper.")]
    rest = [each for each in overrides if not each.startswith("sweeper=") and each not in settings]
    if len(names) > 1:
        raise BenchError(f"{' '.join(f'sweeper={name}' for name in names)}: give one sweeper.")
    name = require_choice("sweeper", names[0] if names else "basic", ("basic", "optuna"))
    if name == "basic":
        if settings:
            raise BenchError(
                f"{settings[0]}: sweeper=basic, which makes every combination, has no settings. Add sweeper=optuna."
            )
        return rest, None
    if importlib.util.find_spec("optuna") is None:
        raise BenchError("sweeper=optuna is not installed: pip install 'bgs-slam-bench[optuna]'")
    return rest, _config(settings)


def _config(settings: Sequence[str]) -> SearchConfig:
    accepted = [setting.name for setting in dataclasses.fields(SearchConfig)]
    values = {}
    for parsed in check_overrides(settings):
        key = parsed.key_or_group.removeprefix("sweeper.")
        if key not in accepted:
            raise BenchError(
                f"{parsed.input_line}: sweeper=optuna has no setting '{key}'; it has {', '.join(accepted)}."
                f"{did_you_mean(key, accepted)}"
            )
        if parsed.is_sweep_override():
            raise BenchError(f"{parsed.input_line} names several values; a search's setting has one.")
        values[key] = parsed.value()
    try:
        config = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(SearchConfig), values))
    except OmegaConfBaseException as error:
        raise BenchError(f"{' '.join(settings)}: {first_line(error)}.") from error
    assert isinstance(config, SearchConfig)
    return config


def sought_metric(config: SearchConfig) -> tuple[Metric, Literal["maximize", "minimize"]]:
    """The metric and its direction; ``BenchError``, with all that there are, for one that no evaluator declares."""
    known: dict[str, Metric] = {}
    for metric in declared_metrics():
        known |= {metric.key: metric, metric.path or metric.key: metric}
        if metric.path.startswith(_LEFT):
            name = metric.path.removeprefix(_LEFT)
            known |= {f"views.{views}.{name}": replace(metric, path=f"views.{views}.{name}") for views in _OTHER_VIEWS}
    if config.metric not in known:
        listed = ", ".join(f"{m.key} ({m.path})" if m.path else m.key for m in declared_metrics())
        what = f"sweeper.metric={config.metric} is no metric" if config.metric else "A search needs sweeper.metric=NAME"
        raise BenchError(
            f"{what}; there are {listed}, and views.train, views.heldout and views.right in place of "
            f"views.left.{did_you_mean(config.metric, known)}"
        )
    metric = known[config.metric]
    if not config.direction and metric.better is None:
        raise BenchError(
            f"sweeper.metric={config.metric}: which values are better is not known; add sweeper.direction=maximize or "
            "minimize."
        )
    is_more_better = metric.better == "higher" if not config.direction else config.direction == "maximize"
    return metric, "maximize" if is_more_better else "minimize"
