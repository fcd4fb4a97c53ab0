"""Numbers for Weights & Biases."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.contracts.observer import RunBegins, ScalarLogger, numbers_in
from bench.errors import require_choice
from bench.registry import PluginConfig, register


@dataclass(frozen=True)
class WandbConfig(PluginConfig):
    """Which project, and whether anything leaves this machine."""

    mode: str = "offline"
    """offline writes files alone, which `wandb sync` sends later; online sends at once (log in by `wandb login`)."""
    project: str = "bgs-slam-bench"
    """The project on the server."""
    entity: str | None = None
    """Whose project it is; null: yours."""
    folder: str | None = field(default=None, metadata={"path": True})
    """The folder that gets wandb/ with its files; null: the run folder."""

    def __post_init__(self) -> None:
        require_choice("logger.wandb.mode", self.mode, ("offline", "online"))


@register("logger", "wandb", config=WandbConfig)
class Wandb(ScalarLogger):
    """Weights & Biases, offline unless mode=online."""

    def __init__(self, config: WandbConfig) -> None:
        self.config = config

    @classmethod
    def unavailable_reason(cls) -> str | None:
        """None, or that the package is missing and how to get it."""
        missing = importlib.util.find_spec("wandb") is None
        return "wandb is not installed. Run: pip install 'bgs-slam-bench[wandb]'" if missing else None

    def begin(self, run: RunBegins) -> None:
        """A run of W&B, named by the config's hash: a resumed run goes on in the same one."""
        os.environ.setdefault("WANDB_ERROR_REPORTING", "false")
        import wandb  # takes seconds

        # Of the machine, the code and what is printed nothing is taken along.
        settings = wandb.Settings(
            silent=True,
            console="off",
            disable_git=True,
            disable_code=True,
            x_disable_meta=True,
            x_disable_stats=True,
            x_disable_machine_info=True,
        )
        c = self.config
        folder = run.folder if c.folder is None else Path(c.folder)
        folder.mkdir(parents=True, exist_ok=True)
        self._run = wandb.init(
            project=c.project,
            entity=c.entity,
            dir=str(folder),
            mode="online" if c.mode == "online" else "offline",
            id=f"{run.config_hash}-{run.folder.name}"[:64],
            resume="allow",
            name=run.name,
            config=dict(run.config),
            settings=settings,
        )

    def log(self, frame: int, values: Mapping[str, float]) -> None:
        """One point a curve; W&B leaves out frames that it has when they come again after a break."""
        self._run.log(dict(values), step=frame)

    def scored(self, metrics: Mapping[str, Any]) -> None:
        """The run's summary."""
        self._run.summary.update(numbers_in(metrics))

    def end(self) -> None:
        """Send or write what is waiting."""
        self._run.finish()
