"""The three routes by which plugins come, and what a bad plugin breaks: itself."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from bench import registry
from bench.cli import main
from bench.config import compose_run
from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.registry import PluginConfig, register

GOOD = '''
"""A stereo plugin of a user."""
from dataclasses import dataclass
import numpy as np
from bench.contracts.stereo import StereoBackbone
from bench.registry import PluginConfig, register

@dataclass(frozen=True)
class MineConfig(PluginConfig):
    disparity_px: float = 8.0

@register("stereo", "{name}", config=MineConfig)
class Mine(StereoBackbone):
    """Says the same disparity everywhere."""

    def __init__(self, config):
        self.config = config

    def disparity(self, left, right):
        return np.full(left.shape[:2], self.config.disparity_px, np.float32)
'''


def write(folder: Path, **files: str) -> Path:
    folder.mkdir(exist_ok=True)
    for stem, text in files.items():
        (folder / f"{stem}.py").write_text(text)
    return folder


@pytest.fixture
def no_output_left(clean_registry: None, capsys: pytest.CaptureFixture[str]) -> pytest.CaptureFixture[str]:
    capsys.readouterr()
    return capsys


def test_a_folder_of_ones_own(clean_registry: None, tmp_path: Path) -> None:
    folder = write(tmp_path / "mine", flat=GOOD.format(name="flat_a"))
    config = compose_run([f"plugins=[{folder}]", "stereo=flat_a", "stereo.disparity_px=4"])
    assert config.plugin("stereo").disparity_px == 4.0  # type: ignore[attr-defined]
    built = registry.build(config.plugin("stereo"), "stereo")
    assert type(built).__name__ == "Mine"
    load_plugins([str(folder)])  # as often as you like
    with pytest.raises(BenchError, match=r"has no setting 'disparity'; .*Did you mean 'disparity_px'"):
        compose_run([f"plugins=[{folder}]", "stereo=flat_a", "stereo.disparity=4"])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "import not_installed_anywhere\n",
            r"ModuleNotFoundError: .*'not_installed_anywhere' \(line 1 of",
        ),
        ("x = 1\ny = 1 / 0\n", r"ZeroDivisionError: division by zero \(line 2 of .*broken\.py\)"),
        ("def f(:\n    pass\n", r"SyntaxError: invalid syntax \(broken\.py, line 1\)$"),
    ],
)
def test_a_broken_file_breaks_nothing_else(
    no_output_left: pytest.CaptureFixture[str], tmp_path: Path, text: str, reason: str
) -> None:
    folder = write(tmp_path, broken=text, good=GOOD.format(name="flat_b"))
    assert main(["list", "stereo", "--plugins", str(folder)]) == 0
    lines = no_output_left.readouterr().out.splitlines()
    (broken,) = [line for line in lines if line.startswith("broken")]
    assert str(folder / "broken.py") in broken
    assert re.search(reason, broken)
    assert any(re.match(r"stereo +flat_b +available +Says the same disparity everywhere\.", line) for line in lines)
    assert any(re.match(r"stereo +sgbm +available", line) for line in lines)


def test_an_unknown_name_points_to_the_broken_file(clean_registry: None, tmp_path: Path) -> None:
    folder = write(tmp_path, my_net="import not_installed_anywhere\n")
    with pytest.raises(BenchError, match=r"Unknown stereo 'my_net'.*may define it failed to import: .*my_net\.py"):
        compose_run([f"plugins=[{folder}]", "stereo=my_net"])


def test_two_plugins_of_one_name(clean_registry: None, tmp_path: Path) -> None:
    folder = write(tmp_path, first=GOOD.format(name="flat_c"), second=GOOD.format(name="flat_c"))
    for _ in range(2):  # the second time as well
        with pytest.raises(BenchError, match=r"Two stereo plugins are called 'flat_c'") as caught:
            load_plugins([str(folder)])
        assert str(folder / "first.py") in str(caught.value)
        assert str(folder / "second.py") in str(caught.value)


def test_the_name_of_a_built_in_plugin_is_taken(clean_registry: None, tmp_path: Path) -> None:
    folder = write(tmp_path, mine=GOOD.format(name="sgbm"))
    with pytest.raises(BenchError, match=r"called 'sgbm': Sgbm in .*sgbm\.py and Mine in .*mine\.py"):
        load_plugins([str(folder)])


def test_two_classes_of_one_name_in_one_file(clean_registry: None) -> None:
    register("sky", "twice_for_tests")(type("One", (), {"__module__": __name__}))
    with pytest.raises(BenchError, match="Two sky plugins are called 'twice_for_tests'"):
        register("sky", "twice_for_tests")(type("Other", (), {"__module__": __name__}))


def test_register_refuses_an_unknown_kind_and_a_wrong_config() -> None:
    with pytest.raises(BenchError, match=r"Unknown plugin kind 'sterio'; .*Did you mean 'stereo'"):
        register("sterio", "x")
    with pytest.raises(BenchError, match=r"config of stereo plugin 'x' must be a dataclass that derives"):
        register("stereo", "x", config=dict)  # type: ignore[arg-type]


def test_a_plugin_that_can_not_run_here(no_output_left: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    lacking = (
        GOOD.format(name="needy")
        + """
    @classmethod
    def unavailable_reason(cls):
        return "the package needed is not installed.\\n Run: pip install needed"
"""
    )
    folder = write(tmp_path, needy=lacking)
    assert main(["list", "stereo", "--plugins", str(folder)]) == 0
    out = no_output_left.readouterr().out
    assert re.search(
        r"stereo +needy +unavailable +the package needed is not installed\. Run: pip install needed\n", out
    )
    with pytest.raises(BenchError, match=r"stereo=needy can't run here: the package needed"):
        registry.build(compose_run([f"plugins=[{folder}]", "stereo=needy"]).plugin("stereo"), "stereo")


@pytest.mark.parametrize("kind_folder", ["stereo", "sky", "losses", "loss"])
def test_a_folder_for_each_kind(kind_folder: str, clean_registry: None, tmp_path: Path) -> None:
    """As in plugins/; what a file registers, not its folder, says of which kind it is."""
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_it.py").write_text("raise RuntimeError('imported')")
    folder = write(tmp_path / kind_folder, __init__="", nested=GOOD.format(name=f"in_{kind_folder}"))
    load_plugins([str(tmp_path)])
    assert registry.lookup("stereo", f"in_{kind_folder}").file == str(folder / "nested.py")
    assert not any(str(tmp_path) in file for file in registry.broken_files)


def test_a_folder_without_plugins_is_named(clean_registry: None, tmp_path: Path) -> None:
    with pytest.raises(
        BenchError, match=rf"the folder {tmp_path} has no plugin files: .*\(datasets, stereo, .*new-plugin"
    ):
        load_plugins([str(tmp_path)])
    write(tmp_path / "nets", deep=GOOD.format(name="deep_net"))
    with pytest.raises(BenchError, match=rf"There is {tmp_path}/nets/deep\.py: name its folder"):
        load_plugins([str(tmp_path)])
    load_plugins([str(tmp_path / "nets")])
    registry.lookup("stereo", "deep_net")
    (tmp_path / "other" / "table").mkdir(parents=True)
    (tmp_path / "other" / "table" / "mine.yaml").write_text("title: x")
    load_plugins([str(tmp_path / "other")])


def test_missing_folder() -> None:
    with pytest.raises(BenchError, match=r"the folder /not/there does not exist"):
        load_plugins(["/not/there"])


def test_a_plugin_config_needs_no_name() -> None:
    assert PluginConfig().name == ""


@pytest.mark.slow
def test_an_installed_package(tmp_path: Path) -> None:
    """A real package with an entry point, built and installed by pip into a folder, found by a fresh process."""
    source = tmp_path / "source"
    (source / "flat_pkg").mkdir(parents=True)
    (source / "flat_pkg" / "__init__.py").write_text(GOOD.format(name="flat_installed"))
    (source / "pyproject.toml").write_text(
        '[build-system]\nrequires = ["setuptools"]\nbuild-backend = "setuptools.build_meta"\n'
        '[project]\nname = "flat-pkg"\nversion = "1.0"\n'
        '[project.entry-points."bgs_bench.plugins"]\nflat = "flat_pkg"\n'
        '[tool.setuptools]\npackages = ["flat_pkg"]\n'
    )
    target = tmp_path / "site"
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check"]
    command = [sys.executable, "-m", "pip", "install", *options, "--target", str(target), str(source)]
    subprocess.run(command, check=True, cwd=tmp_path, timeout=120)
    environment = os.environ | {"PYTHONPATH": str(target)}
    listing = subprocess.run(
        [sys.executable, "-m", "bench.cli", "list", "stereo"],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
        cwd=tmp_path,
        timeout=120,
    ).stdout
    assert re.search(r"stereo +flat_installed +available +Says the same disparity everywhere\.", listing)
