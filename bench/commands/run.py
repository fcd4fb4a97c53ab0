"""``bgs-bench run``: run a system, score it, show its row of the table."""

from __future__ import annotations

import argparse
import os
import sys
import traceback
from pathlib import Path
from typing import Any

import hydra
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from bench.config import RunConfig, compose_run, compose_sweep, config_folder, resolved, with_home
from bench.discovery import load_plugins
from bench.errors import BenchError
from bench.evaluation.run_evaluators import evaluate_run
from bench.runs.folder import LOG_FILE
from bench.runs.lock import only_one
from bench.runs.status import read_status
from bench.sweeps.experiment import EXPERIMENT, expand_experiment
from bench.system import run_system
from bench.tables.collect import collect_row
from bench.tables.render import print_table

_EXAMPLES = """examples:
  bgs-bench run
  bgs-bench run dataset=kitti dataset.root=DIR dataset.sequence=06 dataset.frames=0:10 stereo=sgbm output=runs/kitti06
  bgs-bench run -m seed=0,1,2 system=bgs_slam,bgs_slam_paper
  bgs-bench run -m experiment=ablation dataset.root=DIR seed=0,1,2
"""

# Hydra keeps its own folders and logs out of the way: run folders are ours.
_QUIET_HYDRA = [
    "hydra.run.dir=.",
    "hydra.sweep.subdir=.",
    "hydra.output_subdir=null",
    "hydra/job_logging=none",
    "hydra/hydra_logging=none",
]


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "run",
        help="run a system on a sequence (Hydra overrides; -m for a sweep)",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="what differs from conf/config.yaml")
    parser.add_argument("-m", "--multirun", action="store_true", help="run every combination of the values given")
    parser.add_argument("--print-config", action="store_true", help="print the composed config and stop")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compose, run, score and print; with ``-m`` every combination, each in its own folder."""
    console = Console()
    if args.multirun:
        return _multirun(args.overrides, console)
    if any(override.startswith(EXPERIMENT) for override in args.overrides):
        raise BenchError("experiment= stands for many runs; add -m.")
    config = compose_run(args.overrides)
    if args.print_config:
        print(OmegaConf.to_yaml(OmegaConf.create(config.values)), end="")
        return 0
    path = _run_one(config, console)
    print_table([collect_row(path)], console)
    console.print(f"run folder: {path}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _run_one(config: RunConfig, console: Console) -> Path:
    """Run and score, unless that is done; while another process makes the same run, wait for it."""

    def wait(who: str) -> None:
        text = f"{who} makes this run already ({config.output}); waiting for it"
        console.print(text, markup=False, highlight=False, soft_wrap=True)

    with only_one(config.output, wait):
        return _run_alone(config, console)


def _run_alone(config: RunConfig, console: Console) -> Path:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}"),
        TimeRemainingColumn(),
    )
    try:
        with Progress(*columns, console=console) as bar:
            frames = bar.add_task("frames", total=None, note="", visible=False)

            def show(done: int, total: int, psnr_db: float) -> None:
                note = f"{psnr_db:.2f} dB" if psnr_db == psnr_db else ""
                bar.update(frames, completed=done, total=total, note=note, visible=True)

            folder = run_system(config, show)
            if folder.already_done:
                note = "already done; rerun=true runs it again"
                bar.update(frames, total=1, completed=1, note=note, visible=True)
                if (folder.path / "metrics.json").is_file():
                    return folder.path
            scoring = bar.add_task("scoring", total=None, note="")
            evaluate_run(folder.path, lambda what, d, n: bar.update(scoring, completed=d, total=n, note=what))
    except (BenchError, KeyboardInterrupt):
        raise
    except Exception as error:
        raise RunFailedError(_failure(error, config.output)) from error
    return folder.path


class RunFailedError(BenchError):
    """A run broke for another reason than wrong input; the run folder's log has the traceback."""

    exit_code = 1


def _failure(error: Exception, folder: Path) -> str:
    """One line: the error, where it was raised, and the log, if the run came so far as to have one."""
    raised = traceback.extract_tb(error.__traceback__)[-1]
    status = read_status(folder)
    ours = status is not None and status.pid == os.getpid() and status.state != "done"
    log_file = f"; the traceback is in {folder / LOG_FILE}" if ours else ""
    text = " ".join(str(error).split())
    return f"The run failed: {type(error).__name__}: {text} (line {raised.lineno} of {raised.filename}{log_file})"


def _multirun(overrides: list[str], console: Console) -> int:
    """Hydra's multirun: every combination of the swept values runs in its own folder; one that fails stops no other."""
    sweeps = expand_experiment(with_home(overrides))
    # All are composed before the first is run, so that a wrong value is known at once.
    composed = [compose_sweep(each) for each in sweeps]
    sweep_folder = _sweep_folder(composed[0][0])
    finished: list[Path] = []
    failed: list[str] = []

    def job(composed: DictConfig) -> None:
        load_plugins(list(composed.plugins))  # a launcher's worker process starts with empty registries
        try:
            config = resolved(composed)
            if config.values["output"]:
                config.values["output"] = str(Path(config.values["output"]) / config.hash)
            finished.append(_run_one(config, console))
        except BenchError as error:
            failed.append(str(error))
            console.print(f"failed: {error}", style="red", markup=False)

    before = sys.argv
    quoted = str(sweep_folder).replace("'", "\\'")
    try:
        for each in sweeps:
            sys.argv = ["bgs-bench run", "--multirun", *each, *_QUIET_HYDRA, f"hydra.sweep.dir='{quoted}'"]
            hydra.main(config_path=str(config_folder().resolve()), config_name="config", version_base="1.3")(job)()
    finally:
        sys.argv = before
    print_table([collect_row(path) for path in finished], console)
    return 1 if failed else 0


def _sweep_folder(first: RunConfig) -> Path:
    """Where the run folders of a sweep and Hydra's multirun.yaml go; made here, where the error is one line."""
    folder = Path(first.values["output"] or "results/runs")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchError(
            f"Can't make the folder {folder}: {error.strerror}. Give output= a place that you may write to."
        ) from error
    return folder
