"""What `new-plugin` writes: where, under which names, clean, and passing its own check; and what it refuses."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from bench.authoring import scaffold
from bench.authoring.check import check_plugin
from bench.authoring.scaffold import write_plugin
from bench.authoring.verdict import failures
from bench.errors import BenchError
from bench.registry import KINDS

ROOT = Path(__file__).parents[2]


def files_below(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_new_plugin_passes_its_check(kind: str, tmp_path: Path) -> None:
    place = write_plugin(kind, "brand_new", tmp_path / "mine")
    assert files_below(tmp_path) == [place.file, place.test]
    findings = check_plugin(f"{kind}=brand_new", folders=[str(tmp_path / "mine")])
    assert failures(findings) == []
    assert len(findings) >= 8
    assert not any(finding.title == "not checked" for finding in findings)


def test_all_of_them_are_clean(tmp_path: Path) -> None:
    for kind in KINDS:
        write_plugin(kind, f"new_{kind}", tmp_path)
    config = ("--config", str(ROOT / "pyproject.toml"))
    for command in (["check", "--no-cache"], ["format", "--check", "--no-cache"]):
        ruff = [sys.executable, "-m", "ruff", *command, *config, str(tmp_path)]
        process = subprocess.run(ruff, capture_output=True, text=True, check=False, timeout=60)
        assert process.returncode == 0, process.stdout


def test_a_stereo_backbone_is_at_most_30_lines(tmp_path: Path) -> None:
    assert len(write_plugin("stereo", "short_one", tmp_path).file.read_text().splitlines()) <= 30


@pytest.mark.parametrize(
    ("name", "cls"),
    [("my_net", "MyNet"), ("map", "MapPlugin"), ("stereo_backbone", "StereoBackbonePlugin"), ("a2", "A2")],
)
def test_class_names(name: str, cls: str, tmp_path: Path) -> None:
    """A class may not hide what the file imports: bench.types.Map, the base class."""
    text = write_plugin("stereo", name, tmp_path).file.read_text()
    assert f"\nclass {cls}(StereoBackbone):" in text
    assert f"\nclass {cls}Config(PluginConfig):" in text
    assert f'@register("stereo", "{name}", config={cls}Config)' in text


def test_in_a_checkout_the_files_go_beside_their_like(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scaffold, "checkout_root", lambda: tmp_path)
    place = write_plugin("loss", "my_term")
    assert place.own_folder is None
    assert place.file == tmp_path / "plugins" / "losses" / "my_term.py"
    assert place.test == tmp_path / "tests" / "losses" / "test_my_term_loss.py"
    assert "folders=" not in place.test.read_text()


def test_the_folders_of_the_kinds_are_those_of_the_checkout() -> None:
    for kind in KINDS:
        assert scaffold.place_for(kind, "x", None).file.parent.is_dir()
    assert scaffold.checkout_root() == ROOT


def test_an_installed_package_writes_below_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scaffold, "checkout_root", lambda: None)
    monkeypatch.chdir(tmp_path)
    place = write_plugin("sky", "my_sky")
    assert [str(path) for path in (place.file, place.test)] == [
        "my_plugins/my_sky.py",
        "my_plugins/tests/test_my_sky_sky.py",
    ]
    assert place.own_folder == Path("my_plugins")


@pytest.mark.parametrize(
    ("kind", "name", "says"),
    [
        ("sterio", "x", r"kind='sterio' is not one of .* Did you mean 'stereo'"),
        ("stereo", "my-net", r"'my-net' can't be a plugin's name: .* for example my_net\.$"),
        ("stereo", "2fast", r"'2fast' can't be a plugin's name: use letters, digits and _, a letter first\.$"),
        ("stereo", "../up", r"'\.\./up' can't be a plugin's name: .* for example up\.$"),
        ("stereo", "class", r"'class' can't be a plugin's name"),
        ("stereo", "", r"'' can't be a plugin's name"),
        ("stereo", "_x", r"'_x' can't be a plugin's name"),
        ("sky", "null", r"'null' can't be a plugin's name: sky=null means something else"),
        ("stereo", "sgbm", r"There is a stereo 'sgbm' already, in .*plugins/stereo/sgbm\.py\. Choose another name\.$"),
        ("mapper", "gaussian_fast", r"There is a preset mapper=gaussian_fast already, in .*gaussian_fast\.yaml"),
    ],
)
def test_what_is_refused(kind: str, name: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=says):
        write_plugin(kind, name, tmp_path)
    assert files_below(tmp_path) == []


@pytest.mark.parametrize("there", ["mine.py", "tests/test_mine_sky.py"])
def test_nothing_is_overwritten(there: str, tmp_path: Path) -> None:
    (tmp_path / there).parent.mkdir(exist_ok=True)
    (tmp_path / there).write_text("mine")
    with pytest.raises(BenchError, match=rf"{there} is there already and is not overwritten"):
        write_plugin("sky", "mine", tmp_path)
    assert [path.read_text() for path in files_below(tmp_path)] == ["mine"]


def test_a_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(BenchError, match=r"Can't make the folder .*file.* Give another --folder"):
        write_plugin("sky", "mine", tmp_path / "file" / "below")
