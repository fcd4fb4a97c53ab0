"""Hydra's own flags: those that work here, and for the others one sentence that says what to type instead."""

from __future__ import annotations

import argparse
import importlib.metadata
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from rich.console import Console

from bench.config import RunConfig
from bench.errors import BenchError, did_you_mean
from bench.hydra_settings import search_path
from bench.sweeps.listing import list_plan
from bench.sweeps.plan import Plan
from bench.sweeps.sweep import Choice

_OWN_CONFIG = (
    "the root config is the bench's own; put what differs into FOLDER/experiment/NAME.yaml and give "
    "--config-dir FOLDER +experiment=NAME"
)
_INSTEAD = {
    ("--info", "-i"): "`bgs-bench list run` shows a run's settings, `bgs-bench run --cfg job` the composed config, "
    "`bgs-bench doctor` what is installed",
    ("--config-name", "-cn"): _OWN_CONFIG,
    ("--config-path", "-cp"): _OWN_CONFIG,
    ("--shell-completion", "-sc"): "`bgs-bench completion` prints a script for bash and zsh",
    ("--hydra-help",): "`bgs-bench run --help` shows the flags, `bgs-bench list run` the settings",
    ("--experimental-rerun",): "`bgs-bench run --from RUN_FOLDER` makes a run again from its config",
}


class _Instead(argparse.Action):
    """A flag that says what to use instead of it."""

    def __call__(self, parser: argparse.ArgumentParser, _: Any, __: Any, option: str | None = None) -> None:
        """Say it, and exit as for wrong input."""
        parser.exit(BenchError.exit_code, f"bgs-bench: {option}: {self.const}.\n")


class _Version(argparse.Action):
    """``--version``, of the bench and of Hydra."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        """Print it and exit."""
        bench, hydra = (importlib.metadata.version(name) for name in ("bgs-slam-bench", "hydra-core"))
        print(f"bgs-bench {bench} (Hydra {hydra})")
        parser.exit()


def add_hydra_flags(parser: argparse.ArgumentParser) -> None:
    """Those that every command has which composes runs; ``overrides_of`` reads them."""
    parser.add_argument(
        "--config-dir",
        "-cd",
        type=Path,
        metavar="FOLDER",
        help="a folder with configs of yours: FOLDER/experiment/NAME.yaml is +experiment=NAME",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the versions of the bench and of Hydra")
    for flags, instead in _INSTEAD.items():
        parser.add_argument(*flags, action=_Instead, nargs="?", const=instead, help=argparse.SUPPRESS)


def add_config_flags(parser: argparse.ArgumentParser) -> None:
    """Those that show the config; ``show_config`` reads them."""
    parser.add_argument("--print-config", action="store_true", help="print the composed config and stop; so does --cfg")
    parser.add_argument("--cfg", "-c", choices=("job", "hydra", "all"), help=argparse.SUPPRESS)
    parser.add_argument("--resolve", action="store_true", help="with --print-config: as it always is, resolved")
    parser.add_argument("--package", "-p", metavar="KEY", help="with --print-config: only this part, as mapper.seeding")


def given_overrides(args: argparse.Namespace) -> list[str]:
    """The overrides of the command line, ``--config-dir`` among them; raises ``BenchError``."""
    return [*args.overrides, *([search_path(args.config_dir)] if args.config_dir else [])]


def wants_config(args: argparse.Namespace) -> bool:
    """Whether the config is to be printed, and nothing run; raises ``BenchError`` for Hydra's own config."""
    if args.cfg in ("hydra", "all"):
        raise BenchError(f"--cfg {args.cfg}: a run has no config of Hydra's own; --cfg job prints the run's.")
    wanted = bool(args.print_config or args.cfg)
    if not wanted and (args.resolve or args.package):
        raise BenchError(f"{'--resolve' if args.resolve else '--package'} goes with --print-config or --cfg job.")
    return wanted


def is_shown(plan: Plan, choice: Choice, args: argparse.Namespace, console: Console) -> bool:
    """Print the configs of a plan's runs, or what would be made, where that is all that is wanted."""
    if wants_config(args):
        texts = (f"# {each.label}: {each.folder}\n{config_text(each.config, args.package)}" for each in plan.runs)
        print("---\n".join(texts), end="")
    elif args.dry_run:
        list_plan(plan, choice, console)
    else:
        return False
    return True


def config_text(config: RunConfig, package: str | None) -> str:
    """The config, or the part of it at a dotted key, as YAML; raises ``BenchError`` for a key that is not there."""
    values = OmegaConf.create(config.values)
    if not package or package == "_global_":
        return OmegaConf.to_yaml(values)
    part = OmegaConf.select(values, package)
    if part is None:
        raise BenchError(f"--package {package}: the config has no such part.{did_you_mean(package, config.values)}")
    return f"# @package {package}\n" + (OmegaConf.to_yaml(part) if OmegaConf.is_config(part) else f"{part}\n")
