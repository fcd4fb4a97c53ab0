"""A run folder may come from a stranger: code that its config names is run only where the command line names it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bench.cli import main
from tests.evaluation.tiny_run import write_tiny_run

pytestmark = pytest.mark.usefixtures("clean_registry")

PLUGIN = """
from pathlib import Path
from bench.contracts.evaluator import Evaluator
from bench.registry import register

Path(__file__).with_name("proof").touch()


@register("evaluator", "{name}")
class Theirs(Evaluator):
    "Says so."

    def __init__(self, config):
        pass

    def evaluate(self, run):
        return {{"theirs": 7}}
"""
CONFIG: dict[str, Any] = {
    "system": "bgs_slam",
    "seed": 0,
    "protocol": {"name": "default", "lpips": False},
    "dataset": {"name": "tiny_for_tests"},
}


def made_with_a_plugin(tmp_path: Path, name: str, **sections: Any) -> tuple[Path, Path]:
    """A run whose config names a folder of plugins, and that folder; importing its file leaves a proof."""
    folder = tmp_path / "their plugins"
    folder.mkdir()
    (folder / "theirs.py").write_text(PLUGIN.format(name=name))
    config = CONFIG | {"plugins": [str(folder)], "evaluator": {name: {"name": name}}} | sections
    return write_tiny_run(tmp_path / "run", config), folder


def refused(arguments: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    assert main(arguments) == 2
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    return error


def test_evaluate_takes_plugins_from_the_command_line_alone(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run, folder = made_with_a_plugin(tmp_path, "theirs_a")
    error = refused(["evaluate", str(run)], capfd)
    assert f"{run} was made with evaluator=theirs_a, a plugin of the folder {folder} that its config names" in error
    assert f"give --plugins '{folder}'" in error
    error = refused(["evaluate", str(run), "protocol.alignment=none"], capfd)
    assert f"give --plugins '{folder}'" in error
    assert not (folder / "proof").exists()
    assert main(["evaluate", str(run), "--plugins", str(folder)]) == 0
    assert (folder / "proof").exists()
    assert '"theirs": 7' in (run / "metrics.json").read_text()


def test_evaluate_takes_the_override_too(tmp_path: Path) -> None:
    run, folder = made_with_a_plugin(tmp_path, "theirs_b")
    assert main(["evaluate", str(run), f"plugins=['{folder}']"]) == 0
    assert '"theirs": 7' in (run / "metrics.json").read_text()


@pytest.mark.parametrize(
    ("command", "section", "kind"),
    [
        (
            ["evaluate"],
            {"dataset": {"name": "theirs_c"}, "evaluator": {"image": {"name": "image"}}},
            "dataset=theirs_c",
        ),
        (["map"], {"mapper": {"name": "theirs_c"}}, "mapper=theirs_c"),
        (["map"], {"mapper": {"name": "gaussian", "rasterizer": {"name": "theirs_c"}}}, "rasterizer=theirs_c"),
    ],
)
def test_other_plugins_of_a_run_are_no_different(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], command: list[str], section: dict[str, Any], kind: str
) -> None:
    run, folder = made_with_a_plugin(tmp_path, "theirs_c", **section)
    view = ["--view", "10", "--out", str(tmp_path / "x.png")] if "rasterizer" in kind else []
    error = refused([*command, str(run), *view], capfd)
    assert f"was made with {kind}, a plugin of the folder {folder}" in error
    assert main(["table", str(run)]) == 0
    assert not (folder / "proof").exists()


def test_a_run_with_the_projects_plugins_needs_no_folder(tmp_path: Path) -> None:
    """Its folder may be long gone."""
    config = CONFIG | {"plugins": ["/not/there"], "evaluator": {"ate": {"name": "ate"}}}
    assert main(["evaluate", str(write_tiny_run(tmp_path / "run", config))]) == 0


@pytest.mark.parametrize("section", ["protocol", "dataset", "evaluator"])
def test_sections_that_are_none(tmp_path: Path, capfd: pytest.CaptureFixture[str], section: str) -> None:
    run = write_tiny_run(tmp_path / "run", CONFIG | {section: ["a"]})
    assert "one of its sections has no settings" in refused(["evaluate", str(run)], capfd)


def test_a_run_folder_reads_nothing_outside_of_itself(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = write_tiny_run(tmp_path / "run", CONFIG | {"evaluator": {"ate": {"name": "ate"}}})
    (tmp_path / "secret.json").write_text('{"state": "done", "reason": "secret"}')
    (run / "status.json").unlink()
    (run / "status.json").symlink_to(tmp_path / "secret.json")
    assert "status.json is a link that leads out of the run folder" in refused(["evaluate", str(run)], capfd)
    assert main(["table", str(run)]) == 0
    shown = capfd.readouterr().out
    assert "leads out of the run folder" in shown
    assert "secret" not in shown
