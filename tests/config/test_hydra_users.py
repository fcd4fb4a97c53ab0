"""What Hydra's users type: their own experiments, Hydra's flags and settings, globs, terms left out."""

from __future__ import annotations

from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from bench.cli import main
from bench.config import compose_run
from bench.errors import BenchError
from bench.hydra_settings import as_value, search_path
from bench.sweeps.combinations import expand_globs, plan_combinations
from bench.swept_values import combinations

MINE = "# @package _global_\ndefaults:\n  - override /mapper: gaussian_fast\n  - override /sky: none\nseed: 3\n"


@pytest.fixture
def conf(tmp_path: Path) -> Path:
    """A folder of configs of a user's, at an odd place."""
    folder = tmp_path / "it's my, {conf}"
    (folder / "experiment").mkdir(parents=True)
    (folder / "experiment" / "mine.yaml").write_text(f"{MINE}mapper:\n  iterations: 7\n")
    (folder / "mapper").mkdir()
    (folder / "mapper" / "quick.yaml").write_text("defaults:\n  - gaussian\niterations: 2\n")
    return folder


def test_an_experiment_of_ones_own_is_composed_before_the_command_lines_values(conf: Path) -> None:
    path = search_path(conf)
    by_hand = ["mapper=gaussian_fast", "sky=none", "seed=3", "mapper.iterations=7"]
    assert compose_run([path, "+experiment=mine"]).hash == compose_run(by_hand).hash
    assert (
        compose_run([path, "experiment=mine", "seed=5"]).hash == compose_run([*by_hand[:2], "seed=5", by_hand[3]]).hash
    )
    assert compose_run([path, "mapper=quick"]).hash == compose_run(["mapper.iterations=2"]).hash
    plan = plan_combinations([path, "+experiment=mine", "seed=0,1"])
    # The process of each run composes the same.
    assert [run.config.hash for run in plan.runs] == [compose_run(run.overrides).hash for run in plan.runs]


@pytest.mark.parametrize(
    ("text", "given", "message"),
    [
        (MINE, "+experiment=mien", r"experiment='mien' is not one of mine\. Did you mean 'mine'\?"),
        (f"{MINE}mapper:\n  iteratons: 7\n", "+experiment=mine", r"In 'experiment/mine': .* Key 'iteratons' not in"),
        ("seed: 7\n", "+experiment=mine", r"In 'experiment/mine': .*must begin with '# @package _global_'\.$"),
        (f"{MINE}x: [\n", "+experiment=mine", r"A config of yours is no YAML: .*mine\.yaml.*line"),
        (f"{MINE}plugins: [evil]\n", "+experiment=mine", r"names the plugin folder evil; give it on the command line"),
    ],
)
def test_experiments_that_cannot_be_are_one_sentence(conf: Path, text: str, given: str, message: str) -> None:
    (conf / "experiment" / "mine.yaml").write_text(text)
    with pytest.raises(BenchError, match=message) as error:
        compose_run([search_path(conf), given])
    assert "\n" not in str(error.value)


def test_without_a_folder_there_is_no_experiment() -> None:
    with pytest.raises(BenchError, match=r"no experiment/mine\.yaml of yours\. Give --config-dir FOLDER"):
        compose_run(["+experiment=mine"])


@pytest.mark.parametrize(
    ("setting", "instead"),
    [
        ("hydra.run.dir=x", "output=FOLDER"),
        ("hydra.sweep.dir=x", "output=FOLDER"),
        ("hydra.sweep.subdir=x", "the folder of each run is printed"),
        ("hydra/launcher=joblib", "launcher=NAME"),
        ("hydra/sweeper=optuna", "sweeper=optuna"),
        ("hydra.sweeper.n_trials=3", "sweeper.trials"),
        ("hydra.job.chdir=true", "never changes the current folder"),
        ("hydra.job.name=x", "leave it out"),
        ("hydra.verbose=true", "log.txt"),
        ("hydra.searchpath=[/not/there]", "--config-dir"),
    ],
)
def test_hydras_own_settings_are_answered_with_what_to_type(setting: str, instead: str) -> None:
    with pytest.raises(BenchError) as error:
        compose_run([setting])
    assert instead in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "--info"], "--info: `bgs-bench list run`"),
        (["run", "-cn", "x"], "-cn: the root config is the bench's own"),
        (["run", "--config-path=x"], "--config-path: the root config"),
        (["run", "-sc", "install=bash"], "-sc: `bgs-bench completion` prints"),
        (["reproduce", "ablation", "--hydra-help"], "--hydra-help: `bgs-bench run --help`"),
        (["run", "--cfg", "hydra"], "--cfg hydra: a run has no config of Hydra's own; --cfg job prints the run's."),
        (["run", "--resolve"], "--resolve goes with --print-config or --cfg job."),
        (["run", "--config-dir", "/not/there"], "There is no folder /not/there with configs of yours"),
        (["run", "sweeper=optuna"], "launcher=, sweeper= and --jobs are for many runs; add -m."),
    ],
)
def test_flags_that_do_something_else_here(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = main(arguments)
    except SystemExit as end:  # of argparse
        code = int(end.code or 0)
    assert code == 2
    assert f"bgs-bench: {said}" in capsys.readouterr().err


def test_configs_are_printed_and_nothing_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", "--cfg", "job", "--resolve", "--package", "mapper.seeding"]) == 0
    assert capsys.readouterr().out.startswith("# @package mapper.seeding\nstride: 4\n")
    assert main(["run", "-m", "--print-config", "-p", "seed", "seed=0,1"]) == 0
    assert capsys.readouterr().out.count("# @package seed\n") == 2
    assert main(["run", "-m", "--dry-run", "seed=0,1"]) == 0
    folders = [compose_run([f"seed={seed}"]).output for seed in (0, 1)]
    lines = [f"run  missing: seed {seed}, {folder}\n" for seed, folder in enumerate(folders)]
    assert capsys.readouterr().out == "".join(lines)
    assert list(tmp_path.iterdir()) == []


def test_a_term_is_left_out_by_null_and_by_a_tilde() -> None:
    hashes = {compose_run([way]).hash for way in ("loss=[rgb,mse,ssim]", "~loss.geo", "loss.geo=null")}
    assert len(hashes) == 1


def test_globs_are_choices_and_intervals_are_for_searches() -> None:
    expanded, skipped = expand_globs(["mapper=glob([gauss*],exclude=[*paper,*letter])", "seed=1"])
    assert (expanded, skipped) == (["mapper=gaussian,gaussian_best,gaussian_fast", "seed=1"], [])
    expanded, skipped = expand_globs(["tracker=glob(*)"])
    told = expanded[0].removeprefix("tracker=").split(",") + [
        each.cell.row.removeprefix("tracker=") for each in skipped
    ]
    assert {"groundtruth", "stereo_orb", "orbslam3", "trajectory_file"} <= set(told)
    for given, message in {
        "seed=glob(*)": "chooses plugins and presets",
        "stereo=glob(xx*)": "fits nothing that can run here; there are anynet",
    }.items():
        with pytest.raises(BenchError, match=message):
            expand_globs([given])
    with pytest.raises(BenchError, match=r"an interval is searched, not enumerated\. Add sweeper=optuna"):
        combinations(["mapper.iterations=interval(1,3)"])
    assert ["stereo=sgbm"] in combinations(["stereo=glob(s*)"])
    rates = combinations(["mapper.color_rate=range(0.1,0.35,0.1)"])
    assert rates == [[f"mapper.color_rate={rate}"] for rate in ("0.1", "0.2", "0.3")]


@pytest.mark.parametrize(
    "value", ["it's", "a,b", "[x", "{y}", "k=v", "ü ö", "$5", "back\\slash\\", "", None, True, 1e-05]
)
def test_any_value_can_be_written_as_an_override(value: object) -> None:
    (parsed,) = OverridesParser.create().parse_overrides([f"a={as_value({'k': [value]})}"])
    assert parsed.value() == {"k": [value]}
