"""Writing another system's output as a run folder, whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.evaluation.frame_states import stretches
from bench.external.output import ExternalOutput
from bench.external.pictures import read_depth
from bench.external.settings import RESOURCES, ScoreSettings
from bench.io.atomic import write_image, write_text
from bench.io.images import read_rgb
from bench.protocol import Protocol
from bench.runs.config_file import differing_keys, read_config, write_config
from bench.runs.folder import (
    GROUND_TRUTH_FILE,
    PROVENANCE_FILE,
    RESOURCES_FILE,
    RunFolder,
    depth_to_16bit,
    picture_path,
)
from bench.runs.provenance import collect_provenance
from bench.runs.status import read_status
from bench.runs.trajectory_csv import as_csv

NOT_TRACKED, UNKNOWN = "lost", "unknown"
"""States of frames: without a pose in the trajectory, and where there is no trajectory to tell."""


def is_there(path: Path, config: dict[str, Any], config_hash: str) -> bool:
    """Whether ``path`` holds this very run already; ``BenchError`` when it is a file or holds anything else."""
    if not path.exists():
        return False
    if not path.is_dir():
        raise BenchError(f"--output {path} is a file. Name a folder that is empty or not there yet.")
    known = read_config(path)
    if known is None:
        if any(path.iterdir()):
            raise BenchError(f"--output {path} is not empty and holds no run. Name another folder, or empty this one.")
        return False
    if known[1] != config_hash or read_status(path) is None:
        keys = ", ".join(differing_keys(known[0], config)[:5]) or "its status, which is missing"
        raise BenchError(
            f"--output {path} holds another run (it differs in {keys}). Name another folder, or delete this one."
        )
    return True


def write_run(
    path: Path,
    config: dict[str, Any],
    config_hash: str,
    output: ExternalOutput,
    dataset: Dataset,
    settings: ScoreSettings,
    on_progress: Callable[[str, int, int], None],
) -> None:
    """Write the run folder ``path``: complete, or, when anything fails, not at all.

    Raises ``BenchError`` for a picture that turns out to be damaged, and for a place that can't be written.
    """
    with _staged(path) as staging:
        folder = RunFolder(staging, already_done=False)
        folder.warnings = dataset.to_tell()
        count = _frames_done(output, dataset, settings.status)
        rows = _rows(output, dataset, settings, Protocol.from_mapping(config["protocol"]))[:count]
        _write_views(staging, output, dataset, on_progress)
        folder.write_frames(rows)
        truth = dataset.ground_truth()
        if truth is not None:
            truth = truth.of_frames(dataset.numbers[:count])
            write_text(staging / GROUND_TRUTH_FILE, as_csv(truth))
        if output.trajectory is not None:
            folder.write_trajectory(output.trajectory, truth)
        # Nothing measured it here: only what the user knows of the system's run.
        known = {name: settings.resources.get(name) for name in RESOURCES}
        folder.write_json(RESOURCES_FILE, known | {"frames": count})
        folder.write_json(PROVENANCE_FILE, collect_provenance(config, config["seed"]))
        lost = np.array([row["state"] == NOT_TRACKED for row in rows], dtype=bool)
        write_config(staging, config, config_hash)
        done = count if output.trajectory is not None else len({*output.left, *output.right, *output.depth})
        gaps = stretches([row["number"] for row in rows], lost)
        folder.set_status(settings.status, settings.reason, done, len(dataset), gaps)


@contextmanager
def _staged(path: Path) -> Iterator[Path]:
    """A folder beside ``path`` that takes its name when the block succeeds, and is removed, with its parents made
    here, when it fails."""
    made = [parent for parent in path.parents if not parent.exists()]
    staging = path.parent / f".scoring-{os.getpid()}-{path.name}"
    try:
        staging.mkdir(parents=True)
        yield staging
        os.replace(staging, path)
    except BaseException as error:
        shutil.rmtree(staging, ignore_errors=True)
        for parent in made:
            if parent.is_dir() and not any(parent.iterdir()):
                parent.rmdir()
        if isinstance(error, OSError):
            raise BenchError(
                f"Can't write the run folder {path}: {error.strerror or error}. Give --output another place."
            ) from error
        raise


def _frames_done(output: ExternalOutput, dataset: Dataset, status: str) -> int:
    """All frames of a run that got to its end; else up to the last frame of which there is anything."""
    if status == "done":
        return len(dataset)
    numbers = set() if output.trajectory is None else set(output.trajectory.numbers.tolist())
    posed = [at for at, number in enumerate(dataset.numbers) if number in numbers]
    return max((-1, *posed, *output.left, *output.right, *output.depth)) + 1


def _rows(
    output: ExternalOutput, dataset: Dataset, settings: ScoreSettings, protocol: Protocol
) -> list[dict[str, Any]]:
    """The rows of ``frames.csv``; ``left_color``, ``right_color`` and ``left_depth`` say which pictures there are."""
    posed = None if output.trajectory is None else set(output.trajectory.numbers.tolist())
    return [
        {
            "number": number,
            "timestamp": output.times[at],
            "state": UNKNOWN if posed is None else "ok" if number in posed else NOT_TRACKED,
            "mapped": at in output.mapped,
            "heldout": settings.held_out and protocol.is_held_out(number),
            "left_color": at in output.left,
            "right_color": at in output.right,
            "left_depth": at in output.depth,
        }
        for at, number in enumerate(dataset.numbers)
    ]


def _write_views(
    path: Path, output: ExternalOutput, dataset: Dataset, on_progress: Callable[[str, int, int], None]
) -> None:
    size = (dataset.camera.width, dataset.camera.height)

    def color(source: Path, target: Path) -> None:
        write_image(target, read_rgb(source, size))

    def depth(source: Path, target: Path) -> None:
        write_image(target, depth_to_16bit(read_depth(source, size, output.depth_format)))

    kinds: tuple[tuple[Mapping[int, Path], Any, Any, Any], ...] = (
        (output.left, "left", "color", color),
        (output.right, "right", "color", color),
        (output.depth, "left", "depth", depth),
    )
    jobs = [
        (write, source, picture_path(path, view, what, dataset.numbers[at]))
        for files, view, what, write in kinds
        for at, source in sorted(files.items())
    ]
    for folder in {target.parent for _, _, target in jobs}:
        folder.mkdir(parents=True)
    with ThreadPoolExecutor(max_workers=2) as pool:
        pending = [pool.submit(write, source, target) for write, source, target in jobs]
        try:
            for done, job in enumerate(pending):
                job.result()
                on_progress("reading", done + 1, len(jobs))
        finally:
            for job in pending:
                job.cancel()
