"""``bgs-bench list KIND NAME``: the settings of a plugin or a run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bench.cli import main


def test_settings_of_a_plugin_as_they_are_typed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    assert main(["list", "stereo", "sgbm"]) == 0
    out = capsys.readouterr().out
    lines = out.splitlines()
    assert lines[0].startswith("stereo=sgbm: OpenCV semi-global matching")
    assert lines[1].endswith("plugins/stereo/sgbm.py")
    assert lines[2] == "available"
    place = lines.index("stereo.num_disparities=96  (int)")
    assert lines[place + 1] == "    Disparities searched, from 0; a multiple of 16."
    assert "stereo.color=false  (bool)" in lines
    assert max(map(len, lines[3:])) <= 60
    # A long meaning is wrapped, and no word of it is lost.
    assert "their costs" not in out
    assert "Match the right image too, instead of reading its disparities off the left's costs." in " ".join(
        out.split()
    )


def test_terms_and_nested_settings_have_their_whole_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "loss", "smooth"]) == 0
    assert "loss.smooth.distances=[1]  (tuple[int, ...])" in capsys.readouterr().out
    assert main(["list", "tracker", "stereo_orb"]) == 0
    assert "tracker.loops.min_way_m=30.0  (float)" in capsys.readouterr().out
    assert main(["list", "sky", "none"]) == 0
    assert capsys.readouterr().out.endswith("no settings\n")


def test_settings_of_a_run(capsys: pytest.CaptureFixture[str]) -> None:
    """What a run without overrides has, as conf/config.yaml says."""
    assert main(["list", "run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for line in (
        "system=bgs_slam  (str)",
        "tracker=stereo_orb",
        "loss=[rgb,mse,ssim,geo]",
        "limits.memory_gb=null  (float | None)",
    ):
        assert line in lines
    assert "cache.limit_gb=20.0  (float)" in lines
    assert "protocol.holdout_every=0  (int)" in lines


def test_what_to_fetch_is_said_where_a_network_can_not_run_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("BGS_WEIGHTS", str(tmp_path))
    monkeypatch.setenv("BGS_CACHE", str(tmp_path / "cache"))

    def listed() -> dict[str, str]:
        assert main(["list", "stereo"]) == 0
        return {line.split()[1]: " ".join(line.split()[2:]) for line in capsys.readouterr().out.splitlines()}

    lines = listed()
    assert lines["sgbm"].startswith("available OpenCV")
    assert lines["onnx"].startswith("needs weights: give stereo.weights=FILE.onnx")
    assert re.match(
        r"needs weights: fetch checkpoint/.*, from https://drive.google.com.*kitti2015.pth", lines["anynet"]
    )
    clone = "give stereo.checkout=FOLDER, which `git clone https://github.com/Junda24/MonSter` makes"
    assert lines["monster_k"] == f"needs weights: {clone}, and run `bgs-bench weights get monster_k`"
    (tmp_path / "anynet").mkdir()
    (tmp_path / "anynet" / "kitti2015.pth").touch()
    assert listed()["anynet"].startswith("available AnyNet")
    assert main(["list", "sky", "u2net"]) == 0
    assert "\nneeds weights: fetch " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["list", "stereo", "sgmb"], "Unknown stereo 'sgmb'. Known: "),
        (["list", "run", "x"], "`bgs-bench list run` takes no name"),
    ],
)
def test_wrong_names(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
