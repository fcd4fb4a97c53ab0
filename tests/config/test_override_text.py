"""Values quoted once in the shell: whatever a path holds, it arrives."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from bench.config import check_overrides, compose_run
from bench.errors import BenchError
from bench.override_text import as_one_value, hydra_lines, quoted
from bench.swept_values import combinations

PATHS = [
    *("/data/Видео/L", "/data/Müller/é", "/data/[raw]/L", "/data/a (1)/L", "/data/a=b/L", "/data/#1/&2/L"),
    *("/data/it's/L", '/data/"x"/L', "/data/'x'/L", "/data/{a}/L", "/data/a~b/L", "/data/a;b!c^d/L", "/data/a b/L"),
    *("/data/a\\b/L", "/data/it's\\", "/data/x:y/L", "/data/100%/L", "/data/数据/L", "data ü", "=", "/data/a`b`/<c>"),
]


@pytest.mark.parametrize("path", PATHS)
def test_a_path_arrives_as_it_was_typed(path: str) -> None:
    left, output = check_overrides(hydra_lines([f"dataset.left={path}", f"output={path}"]))
    assert (left.value(), output.value()) == (path, path)
    (alone,) = combinations([f"output={path}"])
    assert check_overrides(alone)[0].value() == path


def test_it_arrives_in_the_config_too() -> None:
    config = compose_run(["dataset=folder", "dataset.left=Видео/it's [1]", "output=/data/it's [1]=#&\\x"])
    assert config.values["dataset"]["left"] == str(Path("Видео/it's [1]").absolute())
    assert config.values["output"] == "/data/it's [1]=#&\\x"


@pytest.mark.parametrize("path", [*PATHS, "/a,b", "null", "12", "/a\\'b", "\\\\"])
def test_quoted_is_read_back(path: str) -> None:
    (override,) = check_overrides([f"output={quoted(path)}"])
    assert override.value() == path
    (typed,) = shlex.split(as_one_value(f"output={path}"))
    assert check_overrides([typed])[0].value() == path


@pytest.mark.parametrize("path", ["2024_11_28", "1e3", "true", "007", "1.50"])
def test_a_path_that_looks_like_a_number_stays_one(path: str) -> None:
    assert [override.value() for override in check_overrides([f"dataset.left={path}", f"output={path}"])] == [path] * 2


def test_lists_of_paths(tmp_path: Path) -> None:
    folders = [tmp_path / "ü [1]", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        (folder / "notes.py").touch()  # a folder without plugin files is refused
    config = compose_run([f"plugins=[{folders[0]},{folders[1]}]"])
    assert config.values["plugins"] == [str(folder) for folder in folders]


def test_what_hydra_reads_is_left_alone() -> None:
    lines = ["stereo=sgbm", "seed=range(0,3)", "loss=[rgb,ssim]", "stereo.block_size=5,7", "~loss.geo", "output='ü'"]
    assert hydra_lines(lines) == lines


def test_commas_separate_values_of_any_letters() -> None:
    assert combinations(["output=/ü,/[b]"]) == [["output='/ü'"], ["output='/[b]'"]]
    with pytest.raises(BenchError, match=r"add -m to run them all\. One that has commas: \"output='/a,b'\"$"):
        compose_run(["output=/a,b"])


@pytest.mark.parametrize("wrong", ["stereo", "=", "-x", "seed=range(a)", "seed=foo(1)", "ключ=1", "stereo=[ü"])
def test_what_can_not_be_read_is_one_sentence_without_names_of_exceptions(wrong: str) -> None:
    with pytest.raises(BenchError) as raised:
        compose_run([wrong])
    said = str(raised.value)
    assert wrong in said
    assert "Exception" not in said
    assert "\n" not in said


@pytest.mark.parametrize(
    ("typed", "line"), [("~/b", "/h/b"), ("~", "/h"), ("[~/b,~/c]", "[/h/b,/h/c]"), ("/~/b", "'/~/b'")]
)
def test_home_folders(typed: str, line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/h")
    assert hydra_lines([f"output={typed}"]) == [f"output={line}"]


def test_a_home_folder_is_looked_up_only_where_it_is_meant(monkeypatch: pytest.MonkeyPatch) -> None:
    """An account that the system does not know, as in a container."""
    monkeypatch.delenv("HOME")
    monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)
    for name in ("BGS_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    assert compose_run(["stereo=sgbm"]).values["cache"]["folder"] == str(Path("results/cache/frames").absolute())
    for typed in ("output=~/b", "output=~nobody-of-that-name/b"):
        with pytest.raises(BenchError, match=rf"{typed}: there is no home folder ~"):
            hydra_lines([typed])
