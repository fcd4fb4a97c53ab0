"""Hydra's own settings among the overrides: the one that a run obeys, and what to type in place of the others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.types import Override

from bench.errors import BenchError
from bench.override_text import quoted

SEARCH_PATH = "hydra.searchpath"
"""The folders in which configs are looked for beside the bench's own; ``--config-dir FOLDER`` says the same."""
EXPERIMENT = "experiment"
"""The group of the user's own configs of whole runs: ``+experiment=NAME`` is FOLDER/experiment/NAME.yaml."""
# By how the setting begins; the first that fits.
_INSTEAD = {
    "hydra.run.dir": "output=FOLDER names the run folder",
    "hydra.sweep.dir": "output=FOLDER names the folder that gets the run folders of a sweep",
    "hydra.sweep.subdir": "a sweep's run folders are named by the hash of their config; leave it out, the folder of "
    "each run is printed",
    "hydra/launcher": "launcher=NAME chooses one of basic, joblib, slurm, slurm_local, ray",
    "hydra/sweeper": "sweeper=optuna searches; without it `run -m` makes every combination",
    "hydra.sweeper": "sweeper=optuna has sweeper.trials, sweeper.metric, sweeper.direction and sweeper.seed",
    "hydra.job.chdir": "a run never changes the current folder; leave it out",
    "hydra.job.env_set": "set environment variables before the command, NAME=VALUE bgs-bench ...",
    "hydra.job_logging": "each run folder has its log.txt; leave it out",
    "hydra/job_logging": "each run folder has its log.txt; leave it out",
    "hydra.verbose": "each run folder has its log.txt; leave it out",
    "hydra.mode": "-m makes a sweep",
    "hydra": "nothing here reads this setting of Hydra's own; leave it out (output=FOLDER names the run folder, "
    "launcher=NAME where runs are made)",
}


def require_known(override: Override) -> None:
    """Raise ``BenchError``, with what to type instead, for a setting of Hydra's own that no run obeys."""
    key = override.key_or_group
    if not override.is_hydra_override() or key == SEARCH_PATH or key.startswith("hydra.launcher."):
        return
    instead = next(text for begins, text in _INSTEAD.items() if key.startswith(begins))
    raise BenchError(f"{override.input_line}: {instead}.")


def search_path(folder: Path) -> str:
    """The override that makes Hydra look for configs in ``folder`` too; raises ``BenchError`` where it is not there."""
    _require_folder(folder)
    return f"{SEARCH_PATH}=[{as_value(f'file://{folder.absolute()}')}]"


def config_folders(parsed: Sequence[Override]) -> list[Path]:
    """The user's own folders of configs among parsed overrides; raises ``BenchError`` for one that is not there."""
    override = next((each for each in parsed if each.key_or_group == SEARCH_PATH), None)
    value = None if override is None else override.value()
    if value is None:
        return []
    if not isinstance(value, list):
        raise BenchError(f"{SEARCH_PATH}={value} must be a list of folders, {SEARCH_PATH}=[{value}].")
    folders = [Path(str(each).removeprefix("file://")) for each in value]
    for folder in folders:
        _require_folder(folder)
    return folders


def configs_in(folders: Sequence[Path], group: str) -> list[str]:
    """The names of the configs of a group in these folders."""
    return sorted({file.stem for folder in folders for file in (folder / group).glob("*.yaml")})


def as_value(value: object) -> str:
    """Plain data as the value of an override, whatever characters are in it."""
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, dict):
        return "{" + ",".join(f"{key}:{as_value(each)}" for key, each in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return f"[{','.join(map(as_value, value))}]"
    return "null" if value is None else str(value).lower() if isinstance(value, bool) else repr(value)


def _require_folder(folder: Path) -> None:
    if not folder.is_dir():
        raise BenchError(f"There is no folder {folder} with configs of yours (--config-dir). Create it, or correct it.")


def typed_overrides(overrides: Sequence[str] | Mapping[str, Any]) -> list[str]:
    """Overrides as typed, ``["stereo=sgbm"]``, also of one alone, and of a mapping, whose keys may be dotted and values
    mappings."""
    if isinstance(overrides, Mapping):
        return list(_typed(overrides))
    return [overrides] if isinstance(overrides, str) else list(overrides)


def _typed(settings: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Settings as overrides; the items of a mapping are settings below it."""
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from _typed(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}={as_value(str(value) if isinstance(value, Path) else value)}"
