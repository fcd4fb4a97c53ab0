"""A backbone from `new-plugin` by each of the three routes, in fresh processes: a file in a checkout, an installed
package, a folder. No other file is edited."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from fresh_process import bgs_bench, python

from bench.authoring.scaffold import write_plugin
from bench.cli import main

ROOT = Path(__file__).parents[2]
_LISTED = r"stereo +{} +available +Block matching until your network stands here\."
# Runs bgs-bench with the `plugins` package of another checkout: argv[1] is its root.
_IN_CHECKOUT = """
import importlib.util, sys
root = sys.argv.pop(1)
spec = importlib.util.spec_from_file_location(
    "plugins", f"{root}/plugins/__init__.py", submodule_search_locations=[f"{root}/plugins"]
)
class Elsewhere:
    # The finder of an editable install, but for the plugins.
    def __init__(self, finder):
        self.finder = finder
    def find_spec(self, name, path=None, target=None):
        return None if name.startswith("plugins.") else self.finder.find_spec(name, path, target)
sys.meta_path[:] = [Elsewhere(f) if "editable" in type(f).__module__ else f for f in sys.meta_path]
sys.modules["plugins"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(sys.modules["plugins"])
from bench.cli import main
sys.exit(main())
"""


@pytest.fixture(scope="module")
def without_any(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What is listed where no plugin comes by any route."""
    return bgs_bench("list", "stereo", cwd=tmp_path_factory.mktemp("empty"))


@pytest.mark.slow
def test_a_file_in_a_checkout(tmp_path: Path, without_any: str) -> None:
    shutil.copytree(ROOT / "plugins", tmp_path / "plugins", ignore=shutil.ignore_patterns("__pycache__"))
    write_plugin("stereo", "route_file", tmp_path / "plugins" / "stereo")
    listing = python(["-c", _IN_CHECKOUT, str(tmp_path), "list", "stereo"], tmp_path)
    assert re.search(_LISTED.format("route_file"), listing)
    assert re.search(r"stereo +sgbm +available", listing)
    assert "broken" not in listing
    assert "route_file" not in without_any


@pytest.mark.slow
def test_a_folder(
    tmp_path: Path, without_any: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_plugin("stereo", "route_folder", tmp_path / "mine")
    assert re.search(_LISTED.format("route_folder"), bgs_bench("list", "stereo", "--plugins", "mine", cwd=tmp_path))
    assert "route_folder" not in without_any
    monkeypatch.chdir(tmp_path)
    assert main(["run", "stereo=route_folder", "plugins=[mine]", "--print-config"]) == 0
    assert "max_disparity: 96" in capsys.readouterr().out


@pytest.mark.slow
def test_an_installed_package(tmp_path: Path, without_any: str) -> None:
    """Built and installed by pip (setuptools, no network) into a folder."""
    source, target = tmp_path / "source", tmp_path / "site"
    file = write_plugin("stereo", "route_package", source / "acme_stereo").file
    shutil.rmtree(source / "acme_stereo" / "tests")
    (source / "acme_stereo" / "__init__.py").touch()
    (source / "pyproject.toml").write_text(
        '[build-system]\nrequires = ["setuptools"]\nbuild-backend = "setuptools.build_meta"\n'
        '[project]\nname = "acme-stereo"\nversion = "1.0"\n'
        f'[project.entry-points."bgs_bench.plugins"]\nroute_package = "acme_stereo.{file.stem}"\n'
        '[tool.setuptools]\npackages = ["acme_stereo"]\n'
    )
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check"]
    python(["-m", "pip", "install", *options, "--target", str(target), str(source)], tmp_path)
    verdict = bgs_bench("check-plugin", "stereo=route_package", cwd=tmp_path, PYTHONPATH=str(target))
    assert "site/acme_stereo/route_package.py" in verdict
    assert re.search(r"all \d+ checks passed", verdict)
    assert "route_package" not in without_any


@pytest.mark.slow
def test_its_own_test_runs(tmp_path: Path) -> None:
    place = write_plugin("stereo", "route_test", tmp_path / "mine")
    said = python(["-m", "pytest", "-q", "-p", "no:cacheprovider", str(place.test)], tmp_path)
    assert "2 passed" in said
