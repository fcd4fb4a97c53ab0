"""Checkpoints of a run under way: what mapping has learned so far, so that a killed run is resumed from there.

Only the map and what was measured are kept. Tracking, stereo and sky are repeated up to the frame of the checkpoint,
which takes a small part of mapping's time, works for every plugin that gives the same answer twice, and needs no disk.
Where a tracker or keyframer looks at the map, their states are kept too.
"""

from __future__ import annotations

import json
import logging
import math
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import torch

from bench.errors import BenchError, first_line
from bench.io.atomic import TEMPORARY_PATTERN, atomic_path
from bench.io.torch_files import load_tensors

CHECKPOINT_FOLDER = "checkpoint"
_FILE = "state.pt"
_AS_THEY_ARE = ("mapper", "random", "seeing", "keyframe_poses")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Snapshot:
    """A run after ``len(rows)`` frames.

    ``rows`` are those of ``frames.csv``; ``mapper`` is what ``Mapper.state`` gave; ``seconds`` by stage, ``elapsed_s``
    of wall time; ``psnr_db`` of the newest keyframe; ``random`` is the state of torch's generator;
    ``events`` so far, as plain data. Of a run whose tracker or keyframer looks at the map also: ``seeing``, the states
    of the two by kind, and ``keyframe_poses``, by number the (4, 4) that each mapped keyframe came with.
    """

    rows: list[dict[str, Any]]
    mapper: dict[str, Any]
    seconds: dict[str, float]
    elapsed_s: float
    psnr_db: float
    peak_memory_gb: float
    random: torch.Tensor
    resumed_after: list[int] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)
    seeing: dict[str, Any] = field(default_factory=dict)
    keyframe_poses: dict[int, torch.Tensor] = field(default_factory=dict)


class Checkpoints:
    """The newest checkpoint of the run in ``folder``; written at most every ``every_s`` seconds (infinite = never).

    ``fingerprint`` stands for all that the run's result depends on; a checkpoint with another one is of no use.
    """

    def __init__(self, folder: Path, fingerprint: str, every_s: float) -> None:
        self._folder = folder / CHECKPOINT_FOLDER
        self._fingerprint = fingerprint
        self._every_s = every_s
        self._written = time.monotonic()
        self._gave_up = False

    def if_due(self, take: Callable[[], Snapshot | None]) -> None:
        """Write what ``take`` gives if it is time for a checkpoint; None = this run can have none.

        A checkpoint that can't be written costs safety, not the run: a warning says so, once.
        """
        if self._gave_up or not time.monotonic() - self._written >= self._every_s or math.isinf(self._every_s):
            return
        snapshot = take()
        if snapshot is None:
            self._gave_up = True
            return
        try:
            self._write(snapshot)
        except (OSError, BenchError) as error:
            log.warning("no checkpoint could be written, the run goes on without: %s", error)
            self._gave_up = True
        self._written = time.monotonic()

    def load(self) -> Snapshot | None:
        """The checkpoint, or None where there is none that fits; one that does not is removed, and the log says why."""
        path = self._folder / _FILE
        if not path.is_file():
            return None
        try:
            content = load_tensors(path)
            fits = content["fingerprint"] == self._fingerprint
            told = json.loads(content["told"])
            snapshot = Snapshot(**{name: content[name] for name in _AS_THEY_ARE}, **told)
        except Exception as error:  # the unpickler raises whatever the damage leads to
            log.warning("the checkpoint in %s is damaged (%s); the run begins anew", self._folder, first_line(error))
            self.remove()
            return None
        if not fits:
            log.info("code, packages or weights have changed since the checkpoint; the run begins anew")
            self.remove()
            return None
        return snapshot

    def remove(self) -> None:
        """Delete the checkpoint; none is no error."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _write(self, snapshot: Snapshot) -> None:
        self._folder.mkdir(exist_ok=True)
        for leftover in self._folder.glob(TEMPORARY_PATTERN):
            leftover.unlink()
        # As JSON, whose floats come back to the bit: numbers of numpy's own types would not pass weights_only.
        told = {f.name: getattr(snapshot, f.name) for f in fields(snapshot) if f.name not in _AS_THEY_ARE}
        content = {
            "fingerprint": self._fingerprint,
            "told": json.dumps(told, default=lambda number: number.item()),
            **{name: getattr(snapshot, name) for name in _AS_THEY_ARE},
        }
        with atomic_path(self._folder / _FILE) as temporary:
            torch.save(content, temporary)
