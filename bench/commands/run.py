"""``bgs-bench run``: run a system, score it, show its row of the table."""

from __future__ import annotations

import argparse
import itertools
import os
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from bench.commands.hydra_flags import (
    add_config_flags,
    add_hydra_flags,
    config_text,
    given_overrides,
    is_shown,
    wants_config,
)
from bench.config import RunConfig, compose_run
from bench.errors import BenchError
from bench.evaluation.run_evaluators import evaluate_run
from bench.hydra_settings import as_value, typed_overrides
from bench.runs.config_file import CONFIG_FILE, RUNS_FOLDER
from bench.runs.folder import LOG_FILE, METRICS_FILE
from bench.runs.lock import only_one
from bench.runs.status import read_status, without_scores
from bench.runs.watchdog import Watchdog
from bench.saved_config import overrides_of
from bench.slam.needs import Needs
from bench.slam.observers import Observers
from bench.slam.run import run_system
from bench.slam.system import System
from bench.sweeps.combinations import plan_combinations, require_writable
from bench.sweeps.experiment import table_experiments
from bench.sweeps.launchers.choice import LauncherChoice, count_of_jobs, split_launcher
from bench.sweeps.launchers.make import make_runs
from bench.sweeps.listing import list_skipped
from bench.sweeps.lookup import look_up
from bench.sweeps.plan import Plan
from bench.sweeps.search.settings import split_search
from bench.sweeps.search.trials import BEST_FILE, Search
from bench.sweeps.sweep import Choice
from bench.sweeps.view import SweepView
from bench.tables.collect import collect_row
from bench.tables.render import print_table
from bench.terminal import say

_EXAMPLES = """examples:
  bgs-bench run
  bgs-bench run dataset=kitti dataset.root=DIR dataset.sequence=06 dataset.frames=0:10 stereo=sgbm output=runs/kitti06
  bgs-bench run -m seed=0,1,2 system=bgs_slam,bgs_slam_paper
  bgs-bench run -m experiment=ablation dataset.root=DIR seed=0,1,2 --jobs 2
  bgs-bench run -m seed=0,1,2 launcher=slurm hydra.launcher.partition=gpu
  bgs-bench run -m sweeper=optuna sweeper.metric=psnr_db 'mapper.color_rate=tag(log,interval(1e-3,0.1))'
  bgs-bench run --config-dir conf +experiment=mine               # conf/experiment/mine.yaml
  bgs-bench run --from results/runs/3f2a9c01d4e5 seed=1
"""

# How the overrides begin that say how a sweep is made.
_OF_SWEEPS = ("launcher=", "hydra.launcher.", "sweeper=", "sweeper.")


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
    parser.add_argument("--jobs", type=count_of_jobs, metavar="N", help="with -m: so many at once (default: 1)")
    parser.add_argument(
        "--from", dest="from_run", type=Path, metavar="RUN_FOLDER", help="make that run again, with these overrides"
    )
    parser.add_argument("--dry-run", action="store_true", help="say what would be run, and in which folder, and stop")
    add_config_flags(parser)
    add_hydra_flags(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compose, run, score and print; with ``-m`` every combination, each in its own folder."""
    console, only_shown = Console(), wants_config(args)
    overrides = given_overrides(args)
    if args.from_run is not None:
        overrides = overrides_of(args.from_run, overrides)
    if args.multirun:
        return _multirun(overrides, args, console)
    if table_experiments(overrides):
        raise BenchError("experiment= stands for many runs; add -m.")
    if args.jobs is not None or any(each.lstrip("+").startswith(_OF_SWEEPS) for each in overrides):
        raise BenchError("launcher=, sweeper= and --jobs are for many runs; add -m.")
    config = compose_run(overrides)
    if args.from_run is not None and config.values["output"] is None:
        config = replace(config, values=config.values | {"output": str(_new_folder(config))})
    if only_shown:
        print(config_text(config, args.package), end="")
        return 0
    if args.dry_run:
        found = look_up(config.output)
        say(f"{'keep' if found.progress == 'finished' else 'run '} {found.progress}: {config.output}", console)
        return 0
    path = _run_one(config, console)
    print_table([collect_row(path)], console)
    say(f"run folder: {path}", console)
    return 0


def run_overrides(
    overrides: Sequence[str] | Mapping[str, Any] = (), *, output: str | Path | None = None, progress: bool = False
) -> Path:
    """Make and score one run as ``bgs-bench run`` does, and give its folder; one that is finished is not made again.

    ``overrides``: as typed, ``["stereo=sgbm", "dataset.frames=20"]``, or ``{"stereo": "sgbm", "dataset": {"frames":
    20}}``, also with dotted keys. ``output``: the run folder (default: by the settings, in ``results/runs``).
    ``progress`` shows the bar. Raises ``BenchError`` for wrong input, and ``RunFailedError``, which is one, for a run
    that broke; what there is of it is in the folder.
    """
    given = typed_overrides(overrides)
    if output is not None:
        given.append(f"output={as_value(str(output))}")
    return _run_one(compose_run(given), Console(quiet=not progress))


def _new_folder(config: RunConfig) -> Path:
    """The folder of a run that is made again: its usual one, or where that run is finished one beside it."""
    usual = RUNS_FOLDER / config.hash
    candidates = (usual.with_name(f"{usual.name}-{number}") for number in itertools.count(2))
    return next(folder for folder in itertools.chain([usual], candidates) if look_up(folder).progress != "finished")


def _run_one(config: RunConfig, console: Console) -> Path:
    """Run and score, unless that is done; while another process makes the same run, wait for it."""

    def wait(who: str) -> None:
        text = f"{who} makes this run already ({config.output}); waiting for it"
        say(text, console)

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
    watchdog = Watchdog(config.limits)
    with (
        Progress(*columns, console=console) as bar,
        watchdog.watching(),
        _failing_in_a_line(config.output),
        Observers.of(config) as observers,
    ):
        frames = bar.add_task("frames", total=None, note="", visible=False)

        def show(done: int, total: int, psnr_db: float) -> None:
            note = f"{psnr_db:.2f} dB" if psnr_db == psnr_db else ""
            bar.update(frames, completed=done, total=total, note=note, visible=True)

        def foresee(system: System) -> None:
            known = read_status(config.output)
            if config.values["rerun"] or known is None or not known.is_complete:
                say(Needs.of(system, config).line(), bar.console)

        folder = run_system(config, show, watchdog, foresee, observers)
        if folder.already_done:
            note = "already done; rerun=true runs it again"
            bar.update(frames, total=1, completed=1, note=note, visible=True)
            if (folder.path / METRICS_FILE).is_file():
                return folder.path
        scoring = bar.add_task("scoring", total=None, note="")

        def show_scoring(what: str, done: int, total: int) -> None:
            watchdog.step()
            bar.update(scoring, completed=done, total=total, note=what)

        complete = read_status(folder.path)
        assert complete is not None
        watchdog.begin(lambda reason: (folder.path, without_scores(complete, "failed", reason)))
        observers.scored(evaluate_run(folder.path, show_scoring))
    return folder.path


@contextmanager
def _failing_in_a_line(folder: Path) -> Iterator[None]:
    """Raise ``RunFailedError`` for what breaks a run but is no wrong input, a plugin that ends the program included."""
    try:
        yield
    except BenchError:
        raise
    except (Exception, SystemExit) as error:
        raise RunFailedError(_failure(error, folder)) from error


class RunFailedError(BenchError):
    """A run broke for another reason than wrong input; the run folder's log has the traceback."""

    exit_code = 1


def _failure(error: BaseException, folder: Path) -> str:
    """One line: the error, where it was raised, and the log, if the run came so far as to have one."""
    raised = traceback.extract_tb(error.__traceback__)[-1]
    status = read_status(folder)
    ours = status is not None and status.pid == os.getpid() and not status.is_complete
    log_file = f"; the traceback is in {folder / LOG_FILE}" if ours else ""
    text = " ".join(str(error).split())
    return f"The run failed: {type(error).__name__}: {text} (line {raised.lineno} of {raised.filename}{log_file})"


def _search(search: Search, launcher: LauncherChoice, args: argparse.Namespace, console: Console) -> int:
    """Make the trials of a search; their table, and the best of them."""
    if is_shown(Plan((search.first,), (), search.root), Choice(), args, console):
        if args.dry_run:
            say(f"then up to {search.config.trials - 1} trials that follow from the scores; {search.folder}", console)
        return 0
    try:
        runs = search.run(launcher, console)
    except KeyboardInterrupt:
        say("stopped; the same command resumes from there.", console)
        return 130
    folders = [planned.folder for planned in runs if (planned.folder / CONFIG_FILE).is_file()]
    if folders:
        print_table([collect_row(folder) for folder in folders], console)
    best = search.best()
    if best is None:
        say(f"no run has {search.metric.path}; see the reasons above", console)
        return 1
    say(f"best of {len(runs)}: {search.metric.title} {best.value:g}, {best.run.label}: {best.run.folder}", console)
    say(f"wrote {search.folder / BEST_FILE}", console)
    return 0


def _multirun(given: list[str], args: argparse.Namespace, console: Console) -> int:
    """Every combination of the swept values, each in its own folder and process; one that fails stops no other."""
    overrides, launcher = split_launcher(given, args.jobs)
    overrides, searched = split_search(overrides)
    if searched is not None:
        return _search(Search(overrides, searched), launcher, args, console)
    plan = plan_combinations(overrides)
    rerun = any(planned.config.values["rerun"] for planned in plan.runs)
    choice = Choice(failed=True, finished=rerun)
    if is_shown(plan, choice, args, console):
        return 0
    require_writable(plan.root)
    list_skipped(plan, console)
    view = SweepView(console, "sweep", plan.runs, launcher.at_once)
    try:
        make_runs(plan, launcher, choice, view)
    except KeyboardInterrupt:
        console.print("stopped; the same command resumes from there.", soft_wrap=True)
        return 130
    folders = [planned.folder for planned in plan.runs if (planned.folder / CONFIG_FILE).is_file()]
    if folders:
        print_table([collect_row(folder) for folder in folders], console)
    return 0 if all(look_up(planned.folder).progress == "finished" for planned in plan.runs) else 1
