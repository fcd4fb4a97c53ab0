"""``run --from RUN_FOLDER``: a run's config composes to the same hash again, and takes the command line's changes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bench.cli import main
from bench.config import compose_run
from bench.errors import BenchError
from bench.runs.config_file import write_config
from bench.saved_config import overrides_of

MADE = (
    *("system=bgs_slam_paper", "mapper.iterations=3", "mapper.depth_range_m=[1,50]", "loss=[rgb,geo]", "seed=4"),
    *("loss.geo.weight=0.25", "stereo.num_disparities=96", "protocol=heldout", "protocol.ssim=3dgs", "threads=2"),
    "logger=[tensorboard,wandb]",
)


def saved(folder: Path, *overrides: str) -> Path:
    config = compose_run(overrides)
    folder.mkdir()
    write_config(folder, config.values | {"output": str(folder)}, config.hash)
    return folder


@pytest.mark.slow
def test_the_same_config_and_changes_of_it(tmp_path: Path) -> None:
    run = saved(tmp_path / "a", *MADE)
    again = compose_run(overrides_of(run, []))
    assert (again.hash, again.values["output"], again.values["threads"]) == (compose_run(MADE).hash, None, 2)
    # Whoever followed that run is not asked to follow this one.
    assert (again.values["viewer"], again.values["logger"]) == (None, {})
    for change, by_hand in {
        "seed=5": [*MADE, "seed=5"],
        "stereo=lidar": [*(each for each in MADE if not each.startswith("stereo")), "stereo=lidar"],
        "mapper.rasterizer=cpu": list(MADE),
        "~loss.geo": [*(each for each in MADE if not each.startswith("loss")), "loss=[rgb]"],
        "system=bgs_slam_fast": ["system=bgs_slam_fast", *MADE[4:5], *MADE[6:]],
    }.items():
        assert compose_run(overrides_of(run, [change])).hash == compose_run(by_hand).hash, change


def test_code_that_a_run_folder_names_is_never_imported(tmp_path: Path) -> None:
    evil = tmp_path / "evil"
    evil.mkdir()
    (evil / "mine.py").write_text(f"open({str(tmp_path / 'imported')!r}, 'w')\n")
    run = saved(tmp_path / "a")
    text = (run / "config.yaml").read_text()
    (run / "config.yaml").write_text(text.replace("plugins: []", f"plugins: [{evil}]"))
    assert compose_run(overrides_of(run, [])).values["plugins"] == []
    (run / "config.yaml").write_text((run / "config.yaml").read_text().replace("name: sgbm", "name: my_net"))
    with pytest.raises(BenchError, match=r"there is no stereo 'my_net' here\..* repeat plugins=\[FOLDER\]\."):
        overrides_of(run, [])
    assert not (tmp_path / "imported").exists()


@pytest.mark.parametrize("setting", ["checkout: /their/code", "python: /their/python", "trust_pickle: true"])
def test_a_setting_that_runs_code_is_said_again(tmp_path: Path, setting: str) -> None:
    run = saved(tmp_path / "a", "stereo=igev", "stereo.weights=/w.pth")
    key, _, value = setting.partition(": ")
    text = (run / "config.yaml").read_text()
    (run / "config.yaml").write_text(re.sub(rf"  {key}: .*", f"  {setting}", text))
    with pytest.raises(BenchError, match=rf"stereo\.{key}=\S+ would run code that the run folder names\. .* repeat"):
        overrides_of(run, [])
    said = overrides_of(run, [f"stereo.{key}={value}"])
    assert f"stereo.{key}={value}" in said


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("hydra: {searchpath: [/evil]}", "a setting 'hydra', which no run has"),
        ("'plugins ': [/evil]", "a setting 'plugins ', which no run has"),
        ("+plugins: [/evil]", r"a setting '\+plugins', which no run has"),
    ],
)
def test_a_config_sets_nothing_but_a_runs_settings(tmp_path: Path, line: str, message: str) -> None:
    run = saved(tmp_path / "a")
    with (run / "config.yaml").open("a") as file:
        file.write(f"{line}\n")
    with pytest.raises(BenchError, match=message):
        overrides_of(run, [])


def test_settings_below_a_plugin_have_plain_names(tmp_path: Path) -> None:
    run = saved(tmp_path / "a")
    text = (run / "config.yaml").read_text()
    (run / "config.yaml").write_text(text.replace("  name: sgbm\n", "  name: sgbm\n  'x=1 plugins': [/evil]\n"))
    with pytest.raises(BenchError, match=r"a setting stereo\.'x=1 plugins', which is no name"):
        overrides_of(run, [])


def test_a_finished_run_is_made_again_beside_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run = saved(tmp_path / "a", "seed=4")
    name = compose_run(["seed=4"]).hash
    usual = tmp_path / "results" / "runs" / name
    assert main(["run", "--from", "a", "--dry-run"]) == 0
    assert capsys.readouterr().out == f"run  missing: results/runs/{name}\n"
    usual.parent.mkdir(parents=True)
    run.rename(usual)
    (usual / "status.json").write_text('{"state": "done"}')
    (usual / "metrics.json").write_text("{}")
    assert main(["run", "--from", str(usual), "--dry-run"]) == 0
    assert capsys.readouterr().out == f"run  missing: results/runs/{name}-2\n"
    assert main(["run", "--from", str(usual), "output=b", "--dry-run"]) == 0
    assert capsys.readouterr().out == "run  missing: b\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "there is no such folder"),
        ("", "holds no config.yaml of a run"),
        ("# bgs-bench run, config hash 0\nforeign: {name: MonoGS}\n", "another system's output, scored"),
        ("# bgs-bench run, config hash 0\nseed: 1\nstereo: 3\n", "has no settings of dataset"),
    ],
)
def test_what_is_no_run_is_refused(tmp_path: Path, text: str | None, message: str) -> None:
    if text is not None:
        (tmp_path / "a").mkdir()
        (tmp_path / "a" / "config.yaml").write_text(text)
    with pytest.raises(BenchError, match=message):
        overrides_of(tmp_path / "a", [])
