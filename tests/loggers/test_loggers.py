"""Each logger against the reader of its own package, on a run of three frames that was resumed after the first."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.contracts.observer import FrameDone, Observer, RunBegins
from bench.errors import BenchError
from bench.plugin_config import plugin_config_from
from bench.registry import build
from bench.types import StereoCamera, StereoFrame

CAMERA = StereoCamera(8, 6, 4.0, 4.0, 3.5, 2.5, (0.5, 0.0, 0.0))
CONFIG = {"system": "bgs_slam", "seed": 3, "mapper": {"name": "gaussian", "iterations": 12}}
NUMBERS = (5, 6, 9)
FRAMES = {5: {"gaussians": 100, "psnr_while_mapping": 20.5}, 6: {"gaussians": 100}, 9: {"gaussians": 150}}
METRICS = {"trajectory": {"ate_rmse_m": 0.25}, "views": {"left": {"psnr_db": 23.5, "lpips": None}}, "notes": {"a": "b"}}


def logger(name: str, **settings: Any) -> Observer:
    observer = build(plugin_config_from("logger", {"name": name, **settings}), "logger")
    assert isinstance(observer, Observer)
    return observer


BROKEN = ((0, NUMBERS[:2]), (1, NUMBERS[1:]))
"""A run that breaks after its second frame, and is resumed after its first."""


def follow(make: Callable[[], Observer], folder: Path, parts: Sequence[tuple[int, Sequence[int]]] = BROKEN) -> None:
    """A run in parts: position of the first frame, and frame numbers."""
    folder.mkdir()
    for first, numbers in parts:
        observer = make()
        observer.begin(RunBegins(folder, CONFIG, "abc123", CAMERA, NUMBERS, first))
        for number in numbers:
            frame = StereoFrame(number, 0.0, np.zeros((6, 8, 3), np.uint8))
            losses = {"rgb": 0.5} if number == 5 else None
            observer.frame(
                FrameDone(frame, np.eye(4), {"number": number, "state": "ok"} | FRAMES[number], None, losses)
            )
        if numbers[-1] == NUMBERS[-1]:
            observer.scored(METRICS)
        observer.end()


def records_of(file: Path) -> Iterator[bytes]:
    """The records of a .wandb file, which is a log of LevelDB: blocks of 32 KiB, each record with checksum, length and
    type (1 whole, 2 first, 3 middle, 4 last part), after 7 bytes of W&B's own."""
    data, at, record = file.read_bytes(), 7, b""
    assert data[:4] == b":W&B"
    while at + 7 <= len(data):
        if 32768 - at % 32768 < 7:
            at += 32768 - at % 32768
            continue
        length, part = struct.unpack("<HB", data[at + 4 : at + 7])
        record += data[at + 7 : at + 7 + length]
        at += 7 + length
        if part in (1, 4):
            yield record
            record = b""


def test_tensorboard(tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    follow(lambda: logger("tensorboard"), tmp_path / "run")
    events = accumulator.EventAccumulator(str(tmp_path / "run" / "tensorboard")).Reload()
    assert [(event.step, event.value) for event in events.Scalars("gaussians")] == [(5, 100.0), (6, 100.0), (9, 150.0)]
    assert [(event.step, event.value) for event in events.Scalars("loss/rgb")] == [(5, 0.5)]
    assert events.Scalars("metrics/trajectory/ate_rmse_m")[0].value == 0.25
    assert set(events.Tags()["scalars"]) == {
        *("gaussians", "psnr_while_mapping", "loss/rgb", "metrics/trajectory/ate_rmse_m", "metrics/views/left/psnr_db")
    }
    assert b'"iterations": 12' in events.Tensors("config/text_summary")[0].tensor_proto.string_val[0]


@pytest.mark.slow
def test_wandb_offline(tmp_path: Path) -> None:
    """The records of its own file: nothing was sent, and the summary holds the metrics."""
    pytest.importorskip("wandb", reason="wandb is not installed: pip install 'bgs-slam-bench[wandb]'")
    from wandb.proto import wandb_internal_pb2

    follow(lambda: logger("wandb"), tmp_path / "run", [(0, NUMBERS)])
    history: list[tuple[str | None, str | None]] = []
    summary: dict[str, str] = {}
    config: dict[str, str] = {}
    for file in sorted((tmp_path / "run" / "wandb").glob("offline-run-*/run-*.wandb")):
        for data in records_of(file):
            record = wandb_internal_pb2.Record()
            record.ParseFromString(data)
            items = {(item.key or "/".join(item.nested_key)): item.value_json for item in record.history.item}
            history.append((items.get("_step"), items.get("gaussians")))
            summary |= {(item.key or "/".join(item.nested_key)): item.value_json for item in record.summary.update}
            config |= {item.key: item.value_json for item in record.run.config.update}
    assert [pair for pair in history if pair[0]] == [("5", "100"), ("6", "100"), ("9", "150")]
    assert float(summary["views/left/psnr_db"]) == 23.5
    assert '"iterations":12' in config["mapper"].replace(" ", "")


@pytest.mark.slow
def test_mlflow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tracking = pytest.importorskip("mlflow.tracking", reason="not installed: pip install 'bgs-slam-bench[mlflow]'")
    pytest.importorskip("sqlalchemy", reason="not installed: pip install 'bgs-slam-bench[mlflow]'")
    monkeypatch.chdir(tmp_path)
    follow(lambda: logger("mlflow"), tmp_path / "run")
    client = tracking.MlflowClient(tracking_uri="sqlite:///results/mlflow.db")
    experiment = client.get_experiment_by_name("bgs-slam-bench")
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.info.status == "FINISHED"
    assert run.data.params["mapper.iterations"] == "12"
    assert run.data.metrics["metrics/views/left/psnr_db"] == 23.5
    steps = {(each.step, each.value) for each in client.get_metric_history(run.info.run_id, "gaussians")}
    assert steps == {(5, 100.0), (6, 100.0), (9, 150.0)}
    assert os.environ["MLFLOW_DISABLE_TELEMETRY"] == "true"


def test_wandb_has_two_modes() -> None:
    with pytest.raises(BenchError, match=r"logger\.wandb\.mode='on' is not one of offline, online"):
        plugin_config_from("logger", {"name": "wandb", "mode": "on"})
