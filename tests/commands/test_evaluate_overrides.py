"""``bgs-bench evaluate RUN KEY=VALUE``: a run under another protocol, without changing what it says of itself."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from conftest import TINY

from bench.cli import main
from bench.config import compose_run, hash_of
from bench.runs.config_file import read_config

Finished = tuple[Path, subprocess.CompletedProcess[str]]


def content_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_another_protocol_is_another_run_folder(finished_run: Finished, tmp_path: Path) -> None:
    """The scores are those that a run with that protocol gets, and the folder is the one it would lie in."""
    run = finished_run[0]
    before = content_of(run)
    out = tmp_path / "scored"
    overrides = ["protocol.ssim=3dgs", "evaluator=[ate,image]"]
    assert main(["evaluate", str(run), *overrides, "--out", str(out)]) == 0
    assert content_of(run) == before
    found = read_config(out)
    old = read_config(run)
    assert found is not None
    assert old is not None
    assert hash_of(old[0]) == old[1]
    assert found[1] == compose_run([*TINY, *overrides]).hash != old[1]
    was, now = (json.loads((folder / "metrics.json").read_text()) for folder in (run, out))
    assert now["protocol"]["ssim"] == "3dgs"
    assert now["views"]["left"]["psnr_db"] == was["views"]["left"]["psnr_db"]
    assert now["views"]["left"]["ssim"] != was["views"]["left"]["ssim"]
    assert "resources" not in now
    assert now["trajectory"]["ate_rmse_m"] == was["trajectory"]["ate_rmse_m"]
    picture = "views/left/color/000000.png"
    assert (out / picture).stat().st_ino == (run / picture).stat().st_ino
    # Again, and on the new folder itself.
    after = content_of(out)
    assert main(["evaluate", str(run), *overrides, "--out", str(out)]) == 0
    assert main(["evaluate", str(out)]) == 0
    assert {name for name, content in content_of(out).items() if content != after[name]} <= {"trajectory.png"}


@pytest.mark.slow
def test_the_default_place_is_beside_the_run(
    finished_run: Finished, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = shutil.copytree(finished_run[0], tmp_path / "run")
    assert main(["evaluate", str(run), "protocol.alignment=none"]) == 0
    place = run.parent / compose_run([*TINY, "protocol.alignment=none"]).hash
    assert f"run folder: {place}\n" in capsys.readouterr().out
    assert json.loads((place / "metrics.json").read_text())["protocol"]["alignment"] == "none"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["mapper.iterations=3"], "mapper.iterations=3: scoring a saved run again can change its protocol and its"),
        (["protocol.holdout_every=5"], "protocol.holdout_every=5: this run was mapped and rendered with 0"),
        (["protocol.rendered_depth=normalized"], "this run was mapped and rendered with raw"),
        (["protocol.aligment=none"], "protocol has no setting 'aligment'"),
        (["protocol=papers"], "Did you mean 'paper'?"),
        (["protocol.alignment=se3"], "was made under these settings already"),
        (["--out", "x"], "--out is for scores under other settings"),
        (["protocol.ssim=3dgs", "--out", "."], ". holds something else"),
    ],
)
def test_what_can_not_be_changed_afterwards(
    finished_run: Finished,
    arguments: list[str],
    message: str,
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["evaluate", str(finished_run[0]), *arguments]) == 2
    out, error = capfd.readouterr()
    assert message in error
    assert error.count("\n") == 1
    assert out == ""
    assert list(tmp_path.iterdir()) == []
