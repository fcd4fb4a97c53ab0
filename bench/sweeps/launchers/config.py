"""The config of a Hydra launcher, from our preset ``conf/hydra/launcher/bgs_NAME.yaml`` and a user's overrides.

(Under the plugin's own name a preset would hide the plugin's typed config.)
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra import initialize_config_dir
from hydra._internal.callbacks import Callbacks
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.core.utils import setup_globals
from hydra.errors import HydraException
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

import bench
from bench.errors import BenchError, did_you_mean
from bench.override_text import quoted

_CONFIG = "sweep"


@dataclass(frozen=True)
class ComposedLauncher:
    """``config`` is what a launcher's ``setup`` gets; ``at_once`` how many runs it makes here, 0 on a cluster."""

    config: DictConfig
    context: HydraContext
    at_once: int

    @property
    def settings(self) -> DictConfig:
        """The launcher's own."""
        settings: DictConfig = self.config.hydra.launcher
        return settings

    def instantiate(self, task: Any) -> Any:
        """The launcher that will call ``task``."""
        return Plugins.instance().instantiate_launcher(self.context, task, self.config)


def compose_launcher(name: str, settings: Sequence[str], at_once: int, folder: Path = Path()) -> ComposedLauncher:
    """Compose the preset; ``folder`` is where the launcher may write its own files.

    ``at_once`` is what ``--jobs`` says; joblib's own ``n_jobs`` may change it. Raises ``BenchError`` for settings that
    the launcher does not have, with the nearest one.
    """
    fixed = [f"hydra/launcher=bgs_{name}", f"at_once={at_once}", f"hydra.sweep.dir={quoted(folder.absolute())}"]
    GlobalHydra.instance().clear()
    conf = Path(bench.__file__).parent
    conf = conf / "conf" if (conf / "conf").is_dir() else conf.parent / "conf"
    with initialize_config_dir(str(conf.resolve()), version_base="1.3"):
        hydra = GlobalHydra.instance().hydra
        assert hydra is not None
        setup_globals()
        try:
            config = hydra.compose_config(_CONFIG, [*fixed, *settings], RunMode.MULTIRUN, from_shell=False)
            launcher = OmegaConf.to_container(config.hydra.launcher, resolve=False)
        except (HydraException, OmegaConfBaseException) as error:
            base = hydra.compose_config(_CONFIG, fixed, RunMode.MULTIRUN, from_shell=False)
            raise BenchError(_explain(name, base.hydra.launcher, settings, error)) from error
        context = HydraContext(config_loader=hydra.config_loader, callbacks=Callbacks(config))
    GlobalHydra.instance().clear()
    assert isinstance(launcher, dict)
    return ComposedLauncher(config, context, _workers(config.hydra.launcher) if name == "joblib" else at_once)


def _workers(config: DictConfig) -> int:
    """How many runs joblib makes at once; like joblib, a negative number leaves cores free."""
    workers = int(config.n_jobs)
    return workers if workers > 0 else max(1, len(os.sched_getaffinity(0)) + 1 + workers)


def _explain(name: str, launcher: DictConfig, settings: Sequence[str], error: Exception) -> str:
    """Which setting is wrong, and what there is."""
    for setting in settings:
        node: Any = launcher
        for part in setting.lstrip("+").partition("=")[0].split(".")[2:]:
            accepted = [str(key) for key in node if key != "_target_"] if isinstance(node, DictConfig) else []
            if part not in accepted:
                has = f"; it has {', '.join(accepted)}" if accepted else ""
                return f"{setting}: launcher={name} has no setting '{part}'{has}.{did_you_mean(part, accepted)}"
            node = node._get_node(part)
    reason = str(error.__cause__ or error).strip().split("\n", 1)[0].rstrip(".")
    return f"{' '.join(settings)}: {reason}. Change that setting of launcher={name}."
