"""The process that a sweep hands its runs to a Hydra launcher in: ``python -m bench.sweeps.launchers.launch FOLDER``.

A process of its own, because a launcher blocks, may die with a worker of its own, and sends all that Hydra knows to its
workers: in the sweep's process that includes the plugins of a user's folders, which no worker could import.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn, JobStatus
from omegaconf import OmegaConf, open_dict

from bench.errors import BenchError
from bench.plain_text import plain_line
from bench.sweeps.launchers.config import ComposedLauncher, compose_launcher
from bench.sweeps.launchers.exchange import Exchange, Note
from bench.sweeps.launchers.worker import RunTask
from bench.sweeps.lookup import Found

ORDER_FILE = "order.pickle"


@dataclass(frozen=True)
class Order:
    """What is to be launched, how."""

    task: RunTask
    launcher: str
    settings: tuple[str, ...]
    at_once: int


def main(folder: Path) -> int:
    """Launch what is ordered, and wait for its end. Exit code 1 = the launcher failed; its last line says why."""
    order: Order = pickle.loads((folder / ORDER_FILE).read_bytes())
    exchange = order.task.exchange
    threading.Thread(target=_end_with_the_sweep, args=(exchange,), daemon=True).start()
    try:
        composed = compose_launcher(order.launcher, order.settings, order.at_once, folder)
        _PREPARE.get(order.launcher, lambda _: None)(composed)
        if order.launcher == "slurm_local":
            _launch_one_by_one(composed, order)
        else:
            _launch(composed, order.task, range(len(order.task.jobs)))
    except Exception as error:  # launchers raise what they like
        print(f"bgs-bench: {_in_a_line(error)}", file=sys.stderr)
        return 1
    return 0


def _launch(composed: ComposedLauncher, task: RunTask, numbers: Sequence[int]) -> None:
    """Launch these runs together, and wait for them; raises what the launcher raises."""
    returned = composed.instantiate(task).launch([[f"job={number}"] for number in numbers], numbers[0])
    for number, each in zip(numbers, returned, strict=True):
        _pass_on(task.exchange, number, each)


def _launch_one_by_one(composed: ComposedLauncher, order: Order) -> None:
    """For a launcher that would start all its workers at once: as many as shall run at once, then the next.

    Raises what went wrong with one of them when all have ended.
    """
    with ThreadPoolExecutor(order.at_once) as pool:
        launched = [pool.submit(_launch, composed, order.task, [number]) for number in range(len(order.task.jobs))]
    for each in launched:
        each.result()


def _end_with_the_sweep(exchange: Exchange) -> None:
    """The sweep holds the other end of our standard input; when it is gone, no more runs shall begin."""
    # Not through sys.stdin, whose lock this thread would hold when the process ends.
    while os.read(0, 1):
        pass
    if exchange.folder.is_dir():
        exchange.begin_no_more()
    os._exit(1)


def _pass_on(exchange: Exchange, number: int, returned: JobReturn) -> None:
    """Tell what a worker could not tell itself; raises ``BenchError`` where that can't be written."""
    told = exchange.read(number)
    if told is not None and told.state == "ended":
        return
    if returned.status == JobStatus.COMPLETED:
        outcome = returned.return_value
        exchange.write(number, Note("ended", outcome.place, "", outcome.found, outcome.seconds))
    else:
        exchange.write(
            number, Note("ended", found=Found("failed", f"its worker: {_in_a_line(returned._return_value)}"))
        )


def _in_a_line(error: BaseException) -> str:
    text = plain_line(str(error))
    return text if isinstance(error, BenchError) else f"{type(error).__name__}: {text[:500]}"


def _prepare_ray(composed: ComposedLauncher) -> None:
    """Connect, and ask for a GPU a run where the cluster has some."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray

    # The plugin would name the size of the object store, which an existing cluster does not take.
    init: Any = OmegaConf.to_container(composed.settings.ray.init, resolve=True)
    ray.init(**init)
    remote = composed.settings.ray.remote
    if remote.get("num_gpus") == "auto":
        with open_dict(remote):
            remote.num_gpus = int(ray.cluster_resources().get("GPU", 0) > 0)


def _prepare_slurm(composed: ComposedLauncher) -> None:
    """Ask for a GPU a run where the partition has some."""
    settings = composed.settings
    if any(settings.get(key) is not None for key in ("gpus_per_node", "gpus_per_task", "gres")):
        return
    partition = [] if settings.partition is None else ["-p", settings.partition]
    try:
        said = subprocess.run(["sinfo", "-h", "-o", "%G", *partition], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise BenchError(
            f"launcher=slurm: sinfo fails ({error}). Start the sweep where Slurm's commands work."
        ) from error
    if "gpu" in said.stdout:
        settings.gpus_per_node = 1


_PREPARE: dict[str, Any] = {"ray": _prepare_ray, "slurm": _prepare_slurm}


if __name__ == "__main__":
    # The classes of the order belong to the module of this name, not to "__main__".
    from bench.sweeps.launchers.launch import main as launch

    sys.exit(launch(Path(sys.argv[1])))
