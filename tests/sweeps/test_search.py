"""A search with Optuna: seeded, resumed as if nothing had happened, its best in a file; runs are fakes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from bench.cli import main
from bench.errors import BenchError
from bench.runs.config_file import write_config
from bench.sweeps.plan import Plan, PlannedRun
from bench.sweeps.search import trials
from bench.sweeps.search.settings import SearchConfig, sought_metric, split_search
from bench.sweeps.search.space import split_space

pytest.importorskip("optuna")

SEARCH = (
    "run",
    "-m",
    "sweeper=optuna",
    "sweeper.metric=psnr_db",
    "sweeper.trials=5",
    "mapper.iterations=interval(1,40)",
)


class Fakes:
    """In place of runs: the PSNR is best at 20 iterations. ``killed_at`` is the number of the run that ends it all."""

    def __init__(self) -> None:
        self.made: list[int] = []
        self.killed_at = 10**6
        self.fails = False

    def make(self, plan: Plan, *_: Any) -> None:
        for run in plan.runs:
            if len(self.made) == self.killed_at:
                self.killed_at = 10**6
                raise KeyboardInterrupt
            self.made.append(run.config.values["mapper"]["iterations"])
            self.write(run)

    def write(self, run: PlannedRun) -> None:
        run.folder.mkdir(exist_ok=True)
        write_config(run.folder, run.config.values, run.config.hash)
        psnr_db = 30.0 - abs(run.config.values["mapper"]["iterations"] - 20)
        state = "failed" if self.fails else "done"
        (run.folder / "status.json").write_text(json.dumps({"state": state, "reason": "no luck"}))
        (run.folder / "metrics.json").write_text(json.dumps({"views": {"left": {"psnr_db": psnr_db}}}))


@pytest.fixture
def fakes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fakes:
    monkeypatch.chdir(tmp_path)
    made = Fakes()
    monkeypatch.setattr(trials, "make_runs", made.make)
    return made


@pytest.mark.slow
def test_a_search_that_is_stopped_goes_on_as_if_it_had_not_been(
    fakes: Fakes, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*SEARCH, "output=unbroken"]) == 0
    unbroken = list(fakes.made)
    assert len(set(unbroken)) > 2
    fakes.killed_at = len(fakes.made) + 2
    assert main([*SEARCH, "output=stopped"]) == 130
    assert main([*SEARCH, "output=stopped"]) == 0
    assert fakes.made == unbroken * 2
    capsys.readouterr()
    assert main([*SEARCH, "output=stopped"]) == 0
    assert fakes.made == unbroken * 2
    closest = min(unbroken, key=lambda iterations: abs(iterations - 20))
    (file,) = Path("stopped").glob("search-*/best.json")
    best = json.loads(file.read_text())
    assert (best["value"], best["varied"]) == (30.0 - abs(closest - 20), {"mapper.iterations": closest})
    assert (best["metric"], best["direction"], best["of"]) == ("views.left.psnr_db", "maximize", 5)
    said = capsys.readouterr().out
    assert (
        f"best of {len(set(unbroken))}: PSNR {best['value']:g}, trial {best['trial']}, mapper.iterations={closest}"
        in said
    )
    assert f"wrote {file}" in said


def test_a_search_of_failures_says_so(fakes: Fakes, capsys: pytest.CaptureFixture[str]) -> None:
    fakes.fails = True
    assert main([*SEARCH[:4], "sweeper.trials=1", *SEARCH[5:]]) == 1
    assert "no run has views.left.psnr_db" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("given", "kind", "low", "high"),
    [
        ("mapper.iterations=interval(1,4)", "IntDistribution", 1, 4),
        ("mapper.color_rate=interval(0.1,0.5)", "FloatDistribution", 0.1, 0.5),
        ("mapper.iterations=range(2,9,3)", "IntDistribution", 2, 8),
        ("mapper.color_rate=range(0.1,0.35,0.1)", "FloatDistribution", 0.1, 0.3),
    ],
)
def test_a_space_by_the_type_of_the_setting(given: str, kind: str, low: float, high: float) -> None:
    fixed, space = split_space([given, "seed=3"])
    (distribution,) = space.values()
    assert (fixed, type(distribution).__name__) == (["seed=3"], kind)
    assert (distribution.low, distribution.high) == pytest.approx((low, high))  # type: ignore[attr-defined]


def test_choices_and_logarithmic_intervals() -> None:
    _, space = split_space(["stereo=sgbm,lidar", "mapper.color_rate=tag(log,interval(1e-3,1e-1))"])
    assert space["stereo"].choices == ("sgbm", "lidar")  # type: ignore[attr-defined]
    assert space["mapper.color_rate"].log  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["seed=0,1"], "a search does not vary seed. Give one value."),
        (["seed=0"], "A search needs something to vary"),
        (["mapper.iterations=interval(4,1)"], "Write interval(LOW,HIGH)"),
        (["experiment=ablation", "mapper.iterations=1,2"], "not the rows of a table"),
    ],
)
def test_spaces_that_cannot_be(given: list[str], message: str) -> None:
    with pytest.raises(BenchError) as error:
        split_space(given)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["sweeper=ax"], "sweeper='ax' is not one of basic, optuna."),
        (["sweeper.trials=3"], "has no settings. Add sweeper=optuna."),
        (["sweeper=optuna", "sweeper.trial=3"], "no setting 'trial'; it has metric, trials, direction, seed. Did you"),
        (["sweeper=optuna", "sweeper.trials=0"], "sweeper.trials=0 must be at least 1."),
        (["sweeper=optuna", "sweeper.trials=x"], "'x' of type 'str' could not be converted to Integer."),
    ],
)
def test_settings_that_cannot_be(given: list[str], message: str) -> None:
    with pytest.raises(BenchError) as error:
        split_search(given)
    assert message in str(error.value)


def test_any_metric_can_be_sought_and_others_are_answered_with_the_list() -> None:
    for name, path, direction in (
        ("psnr_db", "views.left.psnr_db", "maximize"),
        ("views.heldout.lpips", "views.heldout.lpips", "minimize"),
        ("trajectory.ate_rmse_m", "trajectory.ate_rmse_m", "minimize"),
    ):
        metric, found = sought_metric(SearchConfig(metric=name))
        assert (metric.path, found) == (path, direction)
    with pytest.raises(
        BenchError, match=r"is no metric; there are ate_rmse_m \(trajectory\.ate_rmse_m\), .*Did you mean"
    ):
        sought_metric(SearchConfig(metric="psnr"))
    with pytest.raises(BenchError, match=r"add sweeper\.direction=maximize or minimize"):
        sought_metric(SearchConfig(metric="gaussians"))
