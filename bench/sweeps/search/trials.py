"""A search with Optuna: which run is made next follows from the scores of those before; resumed after a kill."""

from __future__ import annotations

import hashlib
import json
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from rich.console import Console

from bench.errors import BenchError
from bench.hydra_settings import as_value
from bench.io.atomic import write_json
from bench.runs.folder import METRICS_FILE
from bench.runs.status import read_json
from bench.sweeps.claim import Claim, claimed_by
from bench.sweeps.combinations import planned_run, require_writable
from bench.sweeps.launchers.choice import LauncherChoice
from bench.sweeps.launchers.make import make_runs
from bench.sweeps.lookup import look_up
from bench.sweeps.plan import Plan, PlannedRun
from bench.sweeps.search.settings import SearchConfig, sought_metric
from bench.sweeps.search.space import split_space
from bench.sweeps.sweep import Choice
from bench.sweeps.view import SweepView
from bench.tables.named.definitions import Cell
from bench.terminal import say

if TYPE_CHECKING:
    from optuna import Study

BEST_FILE = "best.json"
_STORAGE_FILE = "optuna.log"
# On a cluster, which decides how many runs are made at once: so many trials are begun together, as many as Optuna tries
# at random before it learns.
_AT_ONCE_ON_A_CLUSTER = 10
_NOWHERE = Cell("", "", ())


@dataclass(frozen=True)
class Best:
    """The best trial of a search, its value of the metric, and its run."""

    number: int
    value: float
    run: PlannedRun


class Search:
    """The trials of a search and their runs. ``folder``, among the run folders, keeps the trials and the best of them.

    Which folder that is follows from what is varied, sought and shared, not from how many trials are wanted. Raises
    ``BenchError`` for wrong settings and overrides.
    """

    def __init__(self, overrides: Sequence[str], config: SearchConfig) -> None:
        self.config = config
        self._fixed, self._space = split_space(overrides)
        self.metric, self.direction = sought_metric(config)
        first = planned_run(_NOWHERE, self._fixed, [])
        self.root = first.folder.parent
        what = {
            "shared": first.config.hash,
            "space": {key: repr(distribution) for key, distribution in self._space.items()},
            "metric": self.metric.path or self.metric.key,
            "direction": self.direction,
            "seed": config.seed,
        }
        digest = hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:12]
        self.folder = self.root / f"search-{digest}"
        self._runs: dict[tuple[int, str], PlannedRun] = {}

    @cached_property
    def first(self) -> PlannedRun:
        """The run of the first trial, so that a wrong override is known before anything is written."""
        import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        return self._planned(*self._ask(optuna.create_study(direction=self.direction)))

    def run(self, launcher: LauncherChoice, console: Console) -> list[PlannedRun]:
        """Make the trials that are not there yet; the runs of all. Raises ``KeyboardInterrupt`` on Ctrl-C.

        A trial that was begun when the search was killed is taken up again, with the run's own checkpoint.
        """
        from optuna.trial import TrialState

        require_writable(self.folder)
        with self._alone():
            study = self._study()
            while True:
                trials = study.get_trials(deepcopy=False)
                begun = {each.number: each.params for each in trials if each.state == TrialState.RUNNING}
                at_once = (launcher.at_once or _AT_ONCE_ON_A_CLUSTER) - len(begun)
                for _ in range(min(self.config.trials - len(trials), at_once)):
                    number, params = self._ask(study)
                    begun[number] = params
                if not begun:
                    break
                self._make(study, begun, launcher, console)
            runs = {(run := self._planned(each.number, each.params)).folder: run for each in study.trials}
            self._write_best(study)
        return list(runs.values())

    def best(self) -> Best | None:
        """The best trial so far; None where no run has the metric."""
        from optuna.trial import TrialState

        study = self._study()
        if not study.get_trials(deepcopy=False, states=[TrialState.COMPLETE]):
            return None
        found = study.best_trial
        assert found.value is not None
        return Best(found.number, found.value, self._planned(found.number, found.params))

    def _study(self) -> Study:
        import optuna
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        file = str(self.folder / _STORAGE_FILE)
        storage = JournalStorage(JournalFileBackend(file, lock_obj=JournalFileOpenLock(file)))
        return optuna.create_study(storage=storage, study_name="search", direction=self.direction, load_if_exists=True)

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Two searches of the same folder would try the same twice."""
        claim = Claim.attempt(self.folder)
        if claim is None:
            raise BenchError(f"{claimed_by(self.folder)} makes this search already. Wait for it; runs are shared.")
        try:
            yield
        finally:
            claim.release()

    def _ask(self, study: Study) -> tuple[int, dict[str, Any]]:
        """The next trial and what it tries.

        That depends on the search's seed, the trial's number and the trials before, so that a search that was killed
        goes on as it would have.
        """
        from optuna.samplers import TPESampler

        study.sampler = TPESampler(seed=(self.config.seed * 1_000_003 + len(study.trials)) % 2**32)
        trial = study.ask(self._space)
        return trial.number, dict(trial.params)

    def _planned(self, number: int, params: Mapping[str, Any]) -> PlannedRun:
        chosen = [f"{key}={value if isinstance(value, str) else as_value(value)}" for key, value in params.items()]
        key = (number, " ".join(chosen))
        if key not in self._runs:
            self._runs[key] = planned_run(Cell(f"trial {number}", "", ()), [*self._fixed, *chosen], list(params))
        return self._runs[key]

    def _make(
        self, study: Study, trials: Mapping[int, Mapping[str, Any]], launcher: LauncherChoice, console: Console
    ) -> None:
        """Make the runs of some trials, together, and tell the study how good each is; one without a score failed."""
        from optuna.trial import TrialState

        runs = {number: self._planned(number, params) for number, params in trials.items()}
        # Trials that try the same are one run.
        planned = tuple({run.folder: run for run in runs.values()}.values())
        view = SweepView(console, f"search, {self.config.trials} trials", planned, launcher.at_once)
        make_runs(Plan(planned, (), self.root), launcher, Choice(), view)
        for number, run in runs.items():
            value = self._score(run)
            if value is None or not math.isfinite(value):
                study.tell(number, state=TrialState.FAIL)
            else:
                study.tell(number, value)
                name = self.metric.path or self.metric.key
                say(f"{run.cell.row}: {name} {value:g}", console)

    def _score(self, run: PlannedRun) -> float | None:
        if look_up(run.folder).progress != "finished":
            return None
        return self.metric.value_in(read_json(run.folder / METRICS_FILE))

    def _write_best(self, study: Study) -> None:
        best = self.best()
        if best is None:
            return
        content = {
            "metric": self.metric.path or self.metric.key,
            "direction": self.direction,
            "value": best.value,
            "trial": best.number,
            "of": len(study.trials),
            "varied": study.best_trial.params,
            "run": best.run.folder.name,
            "command": shlex.join(["bgs-bench", "run", *best.run.overrides]),
        }
        write_json(self.folder / BEST_FILE, content)
