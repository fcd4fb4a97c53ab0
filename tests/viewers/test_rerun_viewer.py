"""What viewer=rerun writes, read by rerun's own reader; and what it refuses."""

from __future__ import annotations

import socket
from collections import Counter
from pathlib import Path

import pytest

from bench.authoring.candidate import candidate_of
from bench.authoring.observer_checks import Subject
from bench.errors import BenchError
from bench.plugin_config import plugin_config_from
from bench.registry import build

SMALL = ("dataset.width=64", "dataset.height=32", "dataset.frames=4")
ENTITIES = {
    *("/world", "/world/camera", "/world/camera/image", "/world/camera/depth", "/world/map", "/world/estimate"),
    *("/world/ground_truth", "/world/keyframes", "/numbers/psnr_while_mapping", "/numbers/loss/rgb", "/metrics"),
}


def rows_by_entity(file: Path) -> Counter[str]:
    chunk = pytest.importorskip("rerun.chunk", reason="rerun-sdk is not installed: pip install 'bgs-slam-bench[rerun]'")
    rows: Counter[str] = Counter()
    for each in chunk.RrdReader(str(file)).stream().to_chunks():
        rows[each.entity_path] += each.num_rows
    return rows


def test_a_file_holds_all_that_was_told(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install 'bgs-slam-bench[rerun]'")
    file = tmp_path / "new" / "run.rrd"
    subject = Subject(candidate_of(["viewer=rerun", f"viewer.save={file}", "viewer.max_gaussians=5", *SMALL]))
    for first in (0, 1):
        with subject.begun(first) as (viewer, _):
            for done in subject.frames[first:]:
                viewer.frame(done)
            viewer.optimised(subject.frames[0].trajectory, subject.frames[0].map)
            viewer.scored({"psnr_db": 20.0})
    rows = rows_by_entity(file)
    assert rows.keys() >= ENTITIES
    assert rows["/world/camera/image"] == 4
    assert rows["/world/camera/depth"] == 2
    assert rows_by_entity(file.with_name("run-2.rrd"))["/world/camera/image"] == 3


def test_without_a_viewer_that_listens_it_says_how_to_start_one() -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install 'bgs-slam-bench[rerun]'")
    with socket.create_server(("127.0.0.1", 0)) as free:
        url = f"rerun+http://127.0.0.1:{free.getsockname()[1]}/proxy"
    with pytest.raises(BenchError, match=r"no viewer listens there .* `rerun --bind 127\.0\.0\.1`, or .*FILE\.rrd"):
        build(plugin_config_from("viewer", {"name": "rerun", "url": url}), "viewer")


def test_a_recording_is_an_rrd() -> None:
    with pytest.raises(BenchError, match=r"viewer\.save=run\.txt must end in \.rrd"):
        plugin_config_from("viewer", {"name": "rerun", "save": "run.txt"})
