"""``bgs-bench new-plugin`` and ``check-plugin`` from the outside: what they print, their exit codes and errors; and
from nothing to a row of the table with one file."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from fresh_process import TINY, bgs_bench

from bench.cli import main


def new(kind: str, name: str, folder: Path) -> Path:
    assert main(["new-plugin", kind, name, "--folder", str(folder)]) == 0
    return folder / f"{name}.py"


@pytest.mark.slow
def test_from_nothing_to_a_row_of_the_table(tmp_path: Path) -> None:
    """Only the commands that `new-plugin` itself prints, each in a fresh process; the run is on the street."""
    written = bgs_bench("new-plugin", "stereo", "row_net", "--folder", "mine", cwd=tmp_path)
    assert written == (
        "wrote mine/row_net.py\nwrote mine/tests/test_row_net_stereo.py\nnext:\n"
        "  bgs-bench check-plugin stereo=row_net 'plugins=[mine]'\n"
        "  bgs-bench run stereo=row_net 'plugins=[mine]'\n"
        "  bgs-bench reproduce backbones stereo=row_net 'plugins=[mine]' dataset.root=KITTI\n"
        "  python -m pytest mine/tests/test_row_net_stereo.py\n"
    )
    before = (tmp_path / "mine" / "row_net.py").read_bytes()
    checked = bgs_bench("check-plugin", "stereo=row_net", "plugins=[mine]", cwd=tmp_path)
    assert checked.startswith("stereo=row_net  mine/row_net.py\n")
    assert re.search(r"\nall \d+ checks passed\n$", checked)
    bgs_bench("run", "stereo=row_net", "plugins=[mine]", *TINY, "output=run", cwd=tmp_path)
    assert "row_net" in (tmp_path / "run" / "config.yaml").read_text()
    assert json.loads((tmp_path / "run" / "status.json").read_text())["state"] == "done"
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["views"]["train"]["psnr_db"] > 10
    assert (tmp_path / "mine" / "row_net.py").read_bytes() == before


def test_a_failure_is_printed_with_the_line_to_mend(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = new("keyframer", "bad_rule", tmp_path)
    file.write_text(file.read_text().replace("return KeyframeDecision(due,", "return KeyframeDecision(False,"))
    line = 1 + next(n for n, text in enumerate(file.read_text().splitlines()) if "Decision(False" in text)
    capsys.readouterr()
    assert main(["check-plugin", "keyframer=bad_rule", f"plugins=[{tmp_path}]"]) == 1
    out = capsys.readouterr().out
    assert (
        "FAILED  decisions            the first tracked frame is no keyframe\n"
        "        expected             a keyframe: the map begins with it\n"
        "        to mend              make the first frame a keyframe whatever the rule says\n"
        f"        where                bad_rule.py:{line}\n"
        "note    not checked          reasons, other trackers, determinism, resumes, inputs: "
        "first mend what failed above\n"
        "1 of 5 checks FAILED\n"
    ) in out


LOOKS_AT_THE_MAP = """\
    uses_map = True

    def use_map(self, view):
        self.view = view
        self.drawn = []

    def state(self):
        return {"seen": self.seen, "window": list(self.window), "drawn": self.drawn}

    def restore(self, state):
        self.seen, self.window, self.drawn = state["seen"], tuple(state["window"]), state["drawn"]

    def update("""


@pytest.mark.parametrize(
    ("old", "new_text", "says"),
    [
        (
            '"drawn": self.drawn}',
            '"drawn": []}',
            r"FAILED  resumes .*that goes on from state\(\) after 4 frames decided",
        ),
        ("def state(", "def no_state(", r"note    resumes              it looks at the map and gives no state\(\)"),
    ],
)
def test_a_keyframer_that_looks_at_the_map_gets_one(
    old: str, new_text: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It wants a keyframe until three frames have seen a map, which is empty before the first keyframe."""
    file = new("keyframer", "looking", tmp_path)
    text = file.read_text().replace("    def update(", LOOKS_AT_THE_MAP, 1)
    text = text.replace(
        "due = self.seen % self.config.every == 0",
        "view = PinholeView(tracking.T_world_cam, 60.0, 60.0, 64.0, 32.0, 128, 64)\n"
        "        self.drawn = [*self.drawn, bool(self.view.seen(view).any())]\n"
        "        due = sum(self.drawn) < 3",
    ).replace("import KeyframeDecision,", "import KeyframeDecision, PinholeView,")
    file.write_text(text.replace(old, new_text, 1))
    capsys.readouterr()
    main(["check-plugin", "keyframer=looking", f"plugins=[{tmp_path}]"])
    out = capsys.readouterr().out
    assert re.search(says, out), out
    assert "keyframes 0, 1, 2 of 8 frames" in out


@pytest.mark.parametrize("traceback", [False, True])
def test_an_exception_is_one_line_unless_asked_for(
    traceback: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = new("keyframer", "raising", tmp_path)
    file.write_text(file.read_text().replace("due = self.seen %", "due = None %"))
    line = 1 + next(n for n, text in enumerate(file.read_text().splitlines()) if "due = None" in text)
    capsys.readouterr()
    options = ["--traceback"] if traceback else []
    assert main(["check-plugin", "keyframer=raising", f"plugins=[{tmp_path}]", *options]) == 1
    out = capsys.readouterr().out
    assert "FAILED  decisions            TypeError: unsupported operand type(s) for %: 'NoneType' and 'int'\n" in out
    assert f"where                {file}:{line}\n" in out
    assert ("Traceback (most recent call last)" in out) == traceback


def test_settings_and_constructor_errors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = new("keyframer", "picky", tmp_path)
    capsys.readouterr()
    assert main(["check-plugin", "keyframer=picky", "keyframer.every=0", f"plugins=[{tmp_path}]"]) == 1
    out = capsys.readouterr().out
    assert "FAILED  construction         keyframer.every and keyframer.window_size must be at least 1.\n" in out
    assert f"{file}:" in out
    assert "decisions" not in out


@pytest.mark.parametrize(
    ("old", "new_text", "says"),
    [
        ("(Keyframer):", ":", r"base class +OddOne does not derive from Keyframer\n"),
        ("def update(", "def renamed(", r"base class +OddOne lacks update\n"),
        (
            "    def update(",
            '    @classmethod\n    def unavailable_reason(cls):\n        return "no acme. Run: pip install acme"\n\n'
            "    def update(",
            r"construction +keyframer=odd_one can't run here: no acme\. Run: pip install acme\n",
        ),
        (
            "@dataclass(frozen=True)\nclass OddOneConfig(PluginConfig):",
            "@dataclass\nclass Thawed:\n    name: str = ''\n\n\n@dataclass\nclass OddOneConfig(Thawed):",
            "",
        ),
    ],
)
def test_what_holds_for_every_kind(
    old: str, new_text: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The base class, a missing method, a missing dependency; a config of another kind is not even registered."""
    file = new("keyframer", "odd_one", tmp_path)
    file.write_text(file.read_text().replace(old, new_text))
    capsys.readouterr()
    code = main(["check-plugin", "keyframer=odd_one", f"plugins=[{tmp_path}]"])
    out, error = capsys.readouterr()
    if says:
        assert code == 1
        assert re.search(rf"FAILED  {says}", out)
    else:
        assert code == 2
        assert "The config of keyframer plugin 'odd_one' must be a dataclass that derives from PluginConfig" in error


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["check-plugin"], r"Name the plugin to check as KIND=NAME, for example: bgs-bench check-plugin stereo=my_net"),
        (["check-plugin", "seed=3"], r"Name the plugin to check as KIND=NAME"),
        (["check-plugin", "stereo=sgmb"], r"Unknown stereo 'sgmb'\. Known: .*Did you mean 'sgbm'\?"),
        (["check-plugin", "stereo=sgbm,lidar"], r"stereo=sgbm,lidar names several plugins; check one at a time"),
        (["check-plugin", "loss=[rgb,ssim]"], r"loss=\[rgb,ssim\] names several plugins"),
        (["check-plugin", "stereo=sgbm", "stereo.blocksize=3"], r"no setting 'blocksize'.*Did you mean 'block_size'\?"),
        (["check-plugin", "stereo=sgbm", "plugins=[/not/there]"], r"the folder /not/there does not exist"),
        (["new-plugin", "sterio", "x"], r"kind='sterio' is not one of .*Did you mean 'stereo'\?"),
        (["new-plugin", "stereo", "my-net"], r"'my-net' can't be a plugin's name: .*for example my_net"),
        (["new-plugin", "stereo", "sgbm"], r"There is a stereo 'sgbm' already, in .*sgbm\.py\. Choose another name"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    says: str,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    out, error = capfd.readouterr()
    assert re.fullmatch(rf"bgs-bench: .*{says}.*\n", error), error
    assert out == ""
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_fails_to_import_names_its_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "half_net.py").write_text("import numpy\nimport not_installed_anywhere\n")
    assert main(["check-plugin", "stereo=half_net", f"plugins=[{tmp_path}]"]) == 2
    error = capfd.readouterr().err
    assert re.search(
        r"Unknown stereo 'half_net'.* failed to import: .*half_net\.py \(ModuleNotFoundError: No module named "
        r"'not_installed_anywhere' \(line 2 of .*half_net\.py\)\)",
        error,
    )
    assert error.count("\n") == 1


def test_two_of_one_name_are_told_with_both_places(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text = new("sky", "twin_sky", tmp_path / "one").read_text()
    (tmp_path / "two").mkdir()
    (tmp_path / "two" / "twin_sky.py").write_text(text)
    capfd.readouterr()
    assert main(["check-plugin", "sky=twin_sky", f"plugins=[{tmp_path / 'one'},{tmp_path / 'two'}]"]) == 2
    error = capfd.readouterr().err
    assert re.fullmatch(
        r"bgs-bench: Two sky plugins are called 'twin_sky': TwinSky in .*/one/twin_sky\.py and TwinSky in "
        r".*/two/twin_sky\.py\. Rename one of them\.\n",
        error,
    ), error


def test_the_next_commands_of_losses_and_evaluators_keep_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    new("loss", "next_term", tmp_path)
    assert "bgs-bench run 'loss=[rgb,ssim,geo,next_term]' " in capsys.readouterr().out
