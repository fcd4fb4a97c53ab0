"""A sweep's figures and paired differences, against numbers worked out by hand and by scipy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from bench.contracts.metric import Metric
from bench.report.pages.paired import difference, pairs_of
from bench.report.pages.shown_run import read_shown_run
from bench.report.pages.sweeps import Sweep, against_settings, against_two, pareto, sweeps_of, unbeaten
from tests.tables.fake_runs import config, make_run, metrics

PSNR = Metric("psnr_db", "PSNR", "dB", "higher", 2)
# By iterations and stereo: PSNR of the seeds 0 and 1, and seconds a frame.
VALUES = {(30, "sgbm"): (20.0, 22.0, 1.0), (60, "sgbm"): (23.0, 24.0, 2.0), (30, "psmnet"): (19.0, 20.0, 3.0),
          (60, "psmnet"): (25.0, 28.0, 4.0)}  # fmt: skip


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> tuple[Sweep, list[str]]:
    folder: Path = tmp_path_factory.mktemp("sweep")
    runs = []
    for (iterations, stereo), (*scores, seconds) in VALUES.items():
        for seed, psnr in enumerate(scores):
            made = config(seed=seed, stereo=stereo, mapper__iterations=iterations)
            scored = metrics(1101, psnr_db=psnr, mapping_s_per_frame=seconds)
            runs.append(make_run(folder / f"{stereo}_{iterations}_{seed}", made, scored))
    made = config(seed=2, mapper__iterations=60)
    runs.append(make_run(folder / "killed", made, metrics(3, psnr_db=99.0), state="interrupted", frames=3))
    found, left_out = sweeps_of([read_shown_run(run) for run in runs])
    assert len(found) == 1
    return found[0], left_out


def test_runs_that_are_not_done_take_no_part(sweep: tuple[Sweep, list[str]]) -> None:
    assert sweep[1] == ["killed"]
    assert len(sweep[0].groups) == 4
    assert {title for _, title in sweep[0].keys} == {"stereo", "mapper.iterations"}


def test_a_metric_against_a_setting_is_mean_and_sample_deviation(sweep: tuple[Sweep, list[str]]) -> None:
    made = next(each.figure for each in against_settings(sweep[0]) if each.title == "PSNR against mapper.iterations")
    lines = {trace.name: trace for trace in made.data}
    assert set(lines) == {"stereo=sgbm", "stereo=psmnet"}
    assert lines["stereo=sgbm"].x == (30.0, 60.0)
    assert lines["stereo=sgbm"].y == (21.0, 23.5)
    assert lines["stereo=sgbm"].error_y.array == pytest.approx([np.std([20, 22], ddof=1), np.std([23, 24], ddof=1)])


def test_two_settings_make_a_matrix(sweep: tuple[Sweep, list[str]]) -> None:
    made = next(each.figure for each in against_two(sweep[0]) if each.title.startswith("PSNR:")).data[0]
    cells = {
        (str(x), str(y)): z for y, row in zip(made.y, made.z, strict=True) for x, z in zip(made.x, row, strict=True)
    }
    expected = {(str(iterations), stereo): np.mean(scores[:2]) for (iterations, stereo), scores in VALUES.items()}
    assert cells in ({key: pytest.approx(value) for key, value in expected.items()},
                     {key[::-1]: pytest.approx(value) for key, value in expected.items()})  # fmt: skip
    assert any("21.00 ± 1.41 (n=2)" in text for row in made.text for text in row)


def test_the_pareto_line_leaves_out_what_is_beaten(sweep: tuple[Sweep, list[str]]) -> None:
    made = next(each.figure for each in pareto(sweep[0]) if each.title.startswith("PSNR"))
    # sgbm 30 at 1 s, sgbm 60 at 2 s, psmnet 60 at 4 s; psmnet 30 is slower and worse than both of sgbm.
    assert made.data[0].x.tolist() == [1.0, 2.0, 4.0]
    assert made.data[0].y.tolist() == [21.0, 23.5, 26.5]
    assert made.data[2].x.tolist() == [3.0]


def test_equal_points_do_not_beat_each_other() -> None:
    assert unbeaten(np.array([[1.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.5, 3.0]])).tolist() == [True, True, False, True]


def test_pairs_differ_in_one_setting_alone(sweep: tuple[Sweep, list[str]]) -> None:
    pairs = list(pairs_of(sweep[0]))
    assert len(pairs) == 4
    one = next(pair for pair in pairs if pair.title == "mapper.iterations: 30 and 60 (stereo=sgbm)")
    assert one.seeds == (0, 1)
    psnr = next(each for each in one.differences if each.metric.key == "psnr_db")
    assert (psnr.mean, psnr.n) == (2.5, 2)


def test_the_interval_is_students_t() -> None:
    first, second = [20.0, 21.0, 19.5, 20.5], [20.6, 21.9, 20.1, 21.2]
    found = difference(PSNR, first, second)
    gaps = np.array(second) - first
    half = stats.t.ppf(0.975, 3) * gaps.std(ddof=1) / 2.0
    assert (found.low, found.high) == (pytest.approx(gaps.mean() - half), pytest.approx(gaps.mean() + half))
    assert found.verdict == "second better"
    assert difference(PSNR, second, first).verdict == "first better"
    assert difference(PSNR, [1.0, 2.0], [2.0, 1.0]).verdict == "no difference shown"


@pytest.mark.parametrize(("first", "second", "verdict"), [([1.0], [9.0], "one seed tells no spread"),
                                                          ([1.0, 2.0], [1.0, 2.0], "no difference shown")])  # fmt: skip
def test_one_seed_or_no_spread_makes_no_wrong_interval(first: list[float], second: list[float], verdict: str) -> None:
    found = difference(PSNR, first, second)
    assert found.verdict == verdict
    assert "nan" not in " ".join(found.line())
