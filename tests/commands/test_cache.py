"""``bgs-bench cache``: what the user reads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.cache.entry import Stored
from bench.cache.store import CacheStore
from bench.cli import main


def test_info_and_clear(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("BGS_CACHE", str(tmp_path))
    assert main(["cache", "info"]) == 0
    assert capsys.readouterr().out.splitlines()[0] == f"folder: {tmp_path / 'frames'}"
    store = CacheStore(tmp_path / "frames", limit=1e9)
    depth, mask = np.zeros((500, 1000), np.float32), np.zeros((5, 5), bool)
    for number in range(3):
        store.write("stereo", "psmnet", f"{number:064x}", Stored(depth, 0.1, "psmnet"))
    store.write("sky", "u2net", f"{9:064x}", Stored(mask, 0.1, ""))
    assert main(["cache", "info"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split()[:5] == ["sky", "u2net", "1", "entries", "0.000"]
    assert lines[2].split()[:5] == ["stereo", "psmnet", "3", "entries", "0.006"]
    assert lines[3].startswith("in all 0.006 GB; a run keeps it below its cache.limit_gb (default 20)")
    assert main(["cache", "clear", "--kind", "sky"]) == 0
    assert capsys.readouterr().out == f"removed 1 entries, 0.000 GB, from {tmp_path / 'frames'}\n"
    assert main(["cache", "clear", "--folder", str(tmp_path / "frames")]) == 0
    assert capsys.readouterr().out == f"removed 3 entries, 0.006 GB, from {tmp_path / 'frames'}\n"
