"""``bgs-bench list KIND NAME``: the settings of a plugin or a run."""

from __future__ import annotations

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
    assert main(["list", "tracker", "groundtruth"]) == 0
    assert capsys.readouterr().out.endswith("no settings\n")


def test_settings_of_a_run(capsys: pytest.CaptureFixture[str]) -> None:
    """What a run without overrides has, as conf/config.yaml says."""
    assert main(["list", "run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for line in (
        "system=bgs_slam  (str)",
        "tracker=stereo_orb",
        "loss=[rgb,ssim,geo]",
        "limits.memory_gb=null  (float | None)",
    ):
        assert line in lines
    assert "cache.limit_gb=20.0  (float)" in lines
    assert "protocol.holdout_every=0  (int)" in lines


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
