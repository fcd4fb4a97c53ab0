"""The launchers of a sweep: their names, what they need, and their settings on the command line."""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass

from bench.config import check_overrides
from bench.errors import BenchError, require_choice
from bench.sweeps.launchers.config import compose_launcher

BASIC = "basic"
SETTINGS = "hydra.launcher."
# The extra of ours that brings it, and the modules of which it is made.
_NEEDS = {
    "joblib": ("joblib", ("hydra_plugins.hydra_joblib_launcher", "joblib")),
    "slurm": ("slurm", ("hydra_plugins.hydra_submitit_launcher", "submitit")),
    "slurm_local": ("slurm", ("hydra_plugins.hydra_submitit_launcher", "submitit")),
    "ray": ("ray", ("hydra_plugins.hydra_ray_launcher", "ray")),
}
NAMES = (BASIC, *_NEEDS)
# They share out one machine, by --jobs; the others leave that to their cluster.
_ON_THIS_MACHINE = (BASIC, "joblib", "slurm_local")


@dataclass(frozen=True)
class LauncherChoice:
    """``settings`` are overrides of the preset ``conf/hydra/launcher/bgs_NAME.yaml``; ``at_once`` is 0 on a cluster."""

    name: str = BASIC
    settings: tuple[str, ...] = ()
    at_once: int = 1


def count_of_jobs(text: str) -> int:
    """Read what ``--jobs`` says; raises ``argparse.ArgumentTypeError``."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number of at least 1")
    return int(text)


def split_launcher(overrides: Sequence[str], jobs: int | None) -> tuple[list[str], LauncherChoice]:
    """The overrides of the runs, and the launcher that ``launcher=`` and ``hydra.launcher.*=`` among them choose.

    ``jobs`` is what ``--jobs`` says, None without. Raises ``BenchError`` for an unknown launcher or setting, and for a
    launcher that is not installed, with the command that installs it.
    """
    names = [each.partition("=")[2] for each in overrides if each.startswith("launcher=")]
    settings = tuple(each for each in overrides if each.lstrip("+").startswith(SETTINGS))
    rest = [each for each in overrides if not each.startswith("launcher=") and each not in settings]
    if len(names) > 1 or any("," in name for name in names):
        raise BenchError(f"launcher={','.join(names)}: a sweep has one launcher of {', '.join(NAMES)}.")
    name = require_choice("launcher", names[0] if names else BASIC, NAMES)
    if name == BASIC:
        if settings:
            raise BenchError(f"{settings[0]}: launcher=basic has no settings; it has --jobs N. Add launcher=NAME.")
        return rest, LauncherChoice(at_once=jobs or 1)
    _require_installed(name)
    if name not in _ON_THIS_MACHINE:
        if jobs is not None:
            raise BenchError(
                f"--jobs {jobs} is for one machine; how many runs launcher={name} makes at once the cluster decides. "
                f"Leave --jobs out, or set what a run asks for with {SETTINGS}*."
            )
        jobs = 0
    _check_sweeps(settings)
    at_once = compose_launcher(name, settings, 1 if jobs is None else jobs).at_once
    return rest, LauncherChoice(name, settings, at_once)


def _check_sweeps(settings: Sequence[str]) -> None:
    for parsed in check_overrides(settings):
        if parsed.is_sweep_override():
            raise BenchError(f"{parsed.input_line} names several values; a launcher's setting has one.")


def _require_installed(name: str) -> None:
    extra, modules = _NEEDS[name]
    missing = next((module for module in modules if not _is_there(module)), None)
    if missing is not None:
        raise BenchError(f"launcher={name} is not installed: pip install 'bgs-slam-bench[{extra}]'")


def _is_there(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # nor is the package that it would be in
        return False
