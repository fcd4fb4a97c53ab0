"""Numbers for MLflow."""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.contracts.observer import RunBegins, ScalarLogger, leaves, numbers_in
from bench.registry import PluginConfig, register

_LONGEST = 6000  # letters of a parameter, for the server
_TAG = "bgs_run_folder"
_SEND_S = 5.0


@dataclass(frozen=True)
class MlflowConfig(PluginConfig):
    """Where its store is."""

    uri: str = "sqlite:///results/mlflow.db"
    """The tracking store, by default a file below the current folder: `mlflow ui --backend-store-uri URI` shows it."""
    experiment: str = "bgs-slam-bench"
    """The experiment that runs belong to."""


@register("logger", "mlflow", config=MlflowConfig)
class Mlflow(ScalarLogger):
    """MLflow, in a local file unless uri names a server."""

    def __init__(self, config: MlflowConfig) -> None:
        self.config = config
        self._waiting: list[Any] = []
        self._sent = 0.0

    @classmethod
    def unavailable_reason(cls) -> str | None:
        """None, or that a package is missing and how to get it."""
        missing = [name for name in ("mlflow", "sqlalchemy", "alembic") if importlib.util.find_spec(name) is None]
        return f"{missing[0]} is not installed. Run: pip install 'bgs-slam-bench[mlflow]'" if missing else None

    def begin(self, run: RunBegins) -> None:
        """A run of MLflow; a resumed run goes on in the one that the folder had."""
        os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
        from mlflow.entities import Param  # takes seconds
        from mlflow.tracking import MlflowClient

        uri = self.config.uri
        if uri.startswith("sqlite:///"):
            Path(uri.removeprefix("sqlite:///")).parent.mkdir(parents=True, exist_ok=True)
        self._client = MlflowClient(tracking_uri=uri)
        found = self._client.get_experiment_by_name(self.config.experiment)
        experiment = found.experiment_id if found else self._client.create_experiment(self.config.experiment)
        folder = str(run.folder.absolute())
        before = self._client.search_runs([experiment]) if run.first else []  # the newest first
        known = [each.info.run_id for each in before if each.data.tags.get(_TAG) == folder]
        if known:
            self._id = known[0]
        else:
            self._id = self._client.create_run(experiment, run_name=run.name, tags={_TAG: folder}).info.run_id
            params = [Param(key, str(value)[:_LONGEST]) for key, value in leaves(run.config)]
            for first in range(0, len(params), 100):  # the most at once
                self._client.log_batch(self._id, params=params[first : first + 100])

    def log(self, frame: int, values: Mapping[str, float]) -> None:
        """Points of curves, sent every few seconds."""
        from mlflow.entities import Metric

        now = int(1000 * time.time())
        self._waiting += [Metric(name, value, now, frame) for name, value in values.items()]
        if time.monotonic() - self._sent > _SEND_S:
            self._send()

    def scored(self, metrics: Mapping[str, Any]) -> None:
        """Each metric as a curve of one point."""
        self.log(0, numbers_in({"metrics": metrics}))

    def end(self) -> None:
        """Send what is waiting."""
        self._send()
        self._client.set_terminated(self._id)

    def _send(self) -> None:
        for first in range(0, len(self._waiting), 500):
            self._client.log_batch(self._id, metrics=self._waiting[first : first + 500])
        self._waiting, self._sent = [], time.monotonic()
