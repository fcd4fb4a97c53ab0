"""One run as tables see it, wherever it was read from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from bench.contracts.metric import Metric
from bench.evaluation.metrics import DECLARED, declared_metrics, metrics_from
from bench.runs.system_name import system_name

VIEW_GROUPS = {
    "left": "all left views",
    "heldout": "left views that mapping never saw",
    "right": "right views",
}
"""Whose image and depth metrics a table may show, and how it says so."""
_LEFT = "views.left."


@dataclass(frozen=True)
class RunRecord:
    """One run, without anything about where it lay: ``name`` is that of its folder.

    ``source`` is what a table links to: the run folder, or a record file with ``#L`` and the run's line in it.
    ``state`` is that of ``status.json`` in words ("done", "out of memory", "killed" ...), ``date`` its day. ``metrics``
    are those of ``metrics.json`` but for ``protocol``, their stamp; ``provenance`` is that of ``read_provenance``.
    ``views`` says whose PSNR, SSIM, LPIPS and Depth-L1 are its ``values``: "left" (all left images), "heldout" or
    "right". Only a folder knows what a run that was not scored had ``measured``, in the form of metrics, and what of
    itself can't be read (``damage``).
    """

    name: str
    source: Path
    config: Mapping[str, Any]
    state: str
    reason: str = ""
    frames_done: int = 0
    frames_total: int = 0
    date: str = ""
    metrics: Mapping[str, Any] = field(default_factory=dict)
    protocol: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    views: str = "left"
    measured: Mapping[str, Any] = field(default_factory=dict)
    damage: tuple[str, ...] = ()

    @property
    def seed(self) -> int:
        """The run's seed; 0 where its config has none."""
        seed = self.config.get("seed")
        return seed if isinstance(seed, int) else 0

    @property
    def system(self) -> str | None:
        """What tables call the system; None where the config has none."""
        return system_name(self.config)

    @property
    def dataset(self) -> str | None:
        """Data set and sequence, as "kitti/06"."""
        dataset, name = self.config.get("dataset"), self.plugin("dataset")
        sequence = dataset.get("sequence") if isinstance(dataset, Mapping) else None
        return f"{name}/{sequence}" if sequence not in (None, "") else name

    def plugin(self, kind: str) -> str | None:
        """Name of the plugin of a kind in the config, or None."""
        part = self.config.get(kind)
        name = part.get("name") if isinstance(part, Mapping) else part
        return str(name) if name not in (None, "") else None

    @cached_property
    def frames(self) -> int:
        """How many frames the run got through."""
        total = self.part("frames").get("total")
        if self.state in ("done", "no status") and isinstance(total, int):
            return total
        # An interrupted run's metrics name the frames that there were to do.
        return self.frames_done

    @cached_property
    def own_metrics(self) -> tuple[Metric, ...]:
        """Metrics that no evaluator of the project declares: those of the user's evaluators, and sizes of the map."""
        known = {metric.key for metric in declared_metrics()}
        named = [key for key in self.part("map") if key.isidentifier()]
        sizes = [Metric(key, key.capitalize(), "", None, None, f"map.{key}", order=70) for key in named]
        return tuple(
            metric for metric in (*metrics_from(self.metrics.get(DECLARED)), *sizes) if metric.key not in known
        )

    @cached_property
    def values(self) -> dict[str, float]:
        """Numbers by metric key, only those that are known; image metrics are those of ``views``."""
        found = {}
        for metric in (*declared_metrics(), *self.own_metrics):
            if self.views != "left" and metric.path.startswith(_LEFT):
                metric = replace(metric, path=f"views.{self.views}.{metric.path.removeprefix(_LEFT)}")
            value = metric.value_in(self.metrics)
            if value is not None:
                found[metric.key] = value
        return found

    @cached_property
    def is_scored(self) -> bool:
        """Whether a number is known but for the map's size, which is no score."""
        sizes = {metric.key for metric in (*declared_metrics(), *self.own_metrics) if metric.path.startswith("map.")}
        return bool(self.values.keys() - sizes)

    @property
    def notes(self) -> tuple[str, ...]:
        """Why numbers are missing."""
        return tuple(f"{name}: {reason}" for name, reason in self.part("notes").items())

    @property
    def static_camera_m(self) -> float | None:
        """The ATE in metres of a camera that never moves, on this run's frames."""
        static = self.part("trajectory").get("static_camera_ate_rmse_m")
        return static if is_number(static) else None

    def part(self, name: str) -> dict[str, Any]:
        """A part of the metrics ("trajectory", "views", ...); empty where there is none."""
        part = self.metrics.get(name)
        return part if isinstance(part, dict) else {}


def is_number(value: Any) -> bool:
    """Whether it is an int or a float, and no bool."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def what_no_run_writes(run: RunRecord) -> str:
    """What in a record is of a type that tables could not work with, in words; empty where all is well."""
    texts = {"name": run.name, "state": run.state, "reason": run.reason, "date": run.date}
    wrong = [what for what, value in texts.items() if not isinstance(value, str)]
    counts = {"frames_done": run.frames_done, "frames_total": run.frames_total}
    wrong += [what for what, value in counts.items() if not isinstance(value, int) or isinstance(value, bool)]
    parts = {"config": run.config, "metrics": run.metrics, "protocol": run.protocol, "provenance": run.provenance}
    wrong += [what for what, value in parts.items() if not isinstance(value, Mapping) or not _has_names(value)]
    return f"its {wrong[0]} is not what a run writes" if wrong else ""


def _has_names(value: Any) -> bool:
    """Whether all keys are text, at any depth: YAML has others."""
    if isinstance(value, Mapping):
        return all(isinstance(key, str) and _has_names(each) for key, each in value.items())
    return all(map(_has_names, value)) if isinstance(value, (list, tuple)) else True
