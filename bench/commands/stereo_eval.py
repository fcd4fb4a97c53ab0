"""``bgs-bench stereo-eval``: score stereo backbones as stereo, and show beside it what SLAM made of their depth."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from bench import registry
from bench.config import RunConfig
from bench.contracts.dataset import Dataset
from bench.errors import BenchError
from bench.evaluation.stereo_backbone import require_truth
from bench.evaluation.stereo_process import Broken, score_in_process
from bench.plugin_config import plugin_config_from
from bench.runs.config_file import read_config
from bench.swept_values import compose_sweep
from bench.tables.collect import find_runs
from bench.tables.document.csv_text import data_as_csv
from bench.tables.document.forms import form_of, save, text_of
from bench.tables.document.model import Data
from bench.tables.render import print_table, runs_document
from bench.tables.stereo import IMAGE_COLUMNS, STEREO_COLUMNS, Scored, image_table, stereo_rows
from bench.terminal import say

_EXAMPLES = """examples:
  bgs-bench stereo-eval stereo=psmnet,sgbm dataset=kitti2015 dataset.root=DIR
  bgs-bench stereo-eval stereo=psmnet,sgbm stereo.psmnet.scale=0.5 dataset=street --out stereo.md
  bgs-bench stereo-eval stereo=sgbm,lidar dataset=kitti dataset.root=DIR dataset.frames=0:10 --runs results/runs

stereo.NAME.KEY=VALUE is a setting of one of several backbones, stereo.KEY=VALUE of all of them.
"""


def add_parser(subparsers: Any) -> None:
    """Register the command with the parser that ``bgs-bench`` builds."""
    parser = subparsers.add_parser(
        "stereo-eval",
        help="score stereo backbones as stereo: EPE, D1, bad-n, density, time, memory",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="stereo=NAME,NAME dataset=NAME and settings")
    parser.add_argument(
        *("--runs", "-r"),
        nargs="+",
        action="extend",
        default=[],
        type=Path,
        metavar="FOLDER",
        help="run folders, or folders of them, whose PSNR, LPIPS, Depth-L1 and time stand beside their backbone",
    )
    parser.add_argument(
        "--out", nargs="+", action="extend", default=[], type=Path, metavar="FILE", help="FILE.md, .csv, .tex or .html"
    )
    parser.add_argument("--per-image", type=Path, metavar="FILE.csv", help="also write one row per image and backbone")
    parser.add_argument(
        "--warm-up", type=int, default=1, metavar="N", help="untimed passes over the first frame (default 1)"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Score each backbone in a process of its own, print the table and write the files.

    Exit code 1 when a backbone broke: its row says why, and the others have theirs. ``BenchError`` for wrong input
    before anything is scored.
    """
    forms = {path: form_of(path) for path in args.out}
    if args.warm_up < 0:
        raise BenchError(f"--warm-up {args.warm_up} is negative; choose 0 or more.")
    if args.per_image is not None and args.per_image.suffix != ".csv":
        raise BenchError(f"--per-image {args.per_image}: it is written as CSV; choose a name that ends with .csv.")
    runs = find_runs(args.runs) if args.runs else []
    for folder in runs:
        # A damaged one is better known before a network computed for an hour.
        read_config(folder)
    configs = _configs(args.overrides)
    datasets = _datasets(configs)
    console = Console()
    for text in dict.fromkeys(text for dataset in datasets for text in dataset.to_tell()):
        say(f"warning: {text}", console)
    scored = _score_all(configs, datasets, args.warm_up, console)
    rows = stereo_rows(scored, runs)
    print_table(rows, console, STEREO_COLUMNS)
    document = runs_document(rows, STEREO_COLUMNS, "Stereo backbones")
    texts = {path: text_of(document, form, path.parent) for path, form in forms.items()}
    if args.per_image is not None:
        texts[args.per_image] = data_as_csv(Data(IMAGE_COLUMNS, image_table(scored)), Path())
    for path, text in texts.items():
        save(path, text)
        say(f"wrote {path}", console)
    return 1 if any(isinstance(one.outcome, Broken) for one in scored) else 0


def _configs(overrides: Sequence[str]) -> list[RunConfig]:
    """One composed config a backbone and combination of values, in the order given."""
    chosen = [override for override in overrides if override.startswith("stereo=")]
    if len(chosen) > 1:
        raise BenchError(f"{chosen[1]}: stereo= is given twice. Write the names with commas, stereo=psmnet,sgbm.")
    names = [name.strip() for name in chosen[0].partition("=")[2].split(",")] if chosen else ["sgbm"]
    common: list[str] = []
    own: dict[str, list[str]] = {name: [] for name in names}
    for override in overrides:
        key, _, value = override.partition("=")
        group, *path = key.lstrip("+").split(".")
        if group not in ("dataset", "stereo", "plugins"):
            raise BenchError(f"{override}: stereo is scored without the rest of a system; give dataset and stereo.")
        if group == "stereo" and len(path) > 1 and path[0] in own:
            own[path[0]].append(f"stereo.{'.'.join(path[1:])}={value}")
        elif override not in chosen:
            common.append(override)
    return [config for name in names for config in compose_sweep([*common, f"stereo={name}", *own[name]])]


def _datasets(configs: Sequence[RunConfig]) -> list[Dataset]:
    """The data set of each config; ``BenchError`` where one can't be read, or has nothing to score against."""
    built: dict[str, Dataset] = {}
    datasets = []
    for config in configs:
        key = json.dumps(config.values["dataset"], sort_keys=True, default=str)
        if key not in built:
            built[key] = registry.build(config.plugin("dataset"), "dataset")
            require_truth(built[key])
        datasets.append(built[key])
    return datasets


def _score_all(
    configs: Sequence[RunConfig], datasets: Sequence[Dataset], warm_up: int, console: Console
) -> list[Scored]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        pairs = zip(configs, datasets, _labels(configs), strict=True)
        return [_score_one(config, dataset, label, warm_up, bar) for config, dataset, label in pairs]


def _score_one(config: RunConfig, dataset: Dataset, label: str, warm_up: int, bar: Progress) -> Scored:
    task = bar.add_task(label, total=len(dataset))
    outcome = score_in_process(config, warm_up, lambda done, total: bar.update(task, completed=done, total=total))
    return Scored(label, dataset.label, config.values["stereo"], outcome)


def _labels(configs: Sequence[RunConfig]) -> list[str]:
    """The plugin's name, with the settings that differ from its defaults where it is there with several settings."""
    settings: dict[str, set[str]] = {}
    for config in configs:
        stereo = config.values["stereo"]
        settings.setdefault(stereo["name"], set()).add(json.dumps(stereo, sort_keys=True, default=str))
    labels = []
    for config in configs:
        stereo = config.values["stereo"]
        label = str(stereo["name"])
        if len(settings[label]) > 1:
            default = vars(plugin_config_from("stereo", {"name": label}))
            changed = [f"{key}={value}" for key, value in stereo.items() if value != default[key] and key != "name"]
            label += f" ({', '.join(changed)})" if changed else ""
        labels.append(label)
    return labels
