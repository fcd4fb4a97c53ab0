"""Numbers for TensorBoard."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.contracts.observer import RunBegins, ScalarLogger, numbers_in
from bench.registry import PluginConfig, register


@dataclass(frozen=True)
class TensorBoardConfig(PluginConfig):
    """Where its files go."""

    folder: str | None = field(default=None, metadata={"path": True})
    """The folder that gets a folder of the run; null: tensorboard/ in the run folder."""


@register("logger", "tensorboard", config=TensorBoardConfig)
class TensorBoard(ScalarLogger):
    """TensorBoard's event files: `tensorboard --logdir results/runs` compares the runs there."""

    def __init__(self, config: TensorBoardConfig) -> None:
        self.config = config

    @classmethod
    def unavailable_reason(cls) -> str | None:
        """None, or that the package is missing and how to get it."""
        missing = importlib.util.find_spec("tensorboard") is None
        return "tensorboard is not installed. Run: pip install 'bgs-slam-bench[tensorboard]'" if missing else None

    def begin(self, run: RunBegins) -> None:
        """Open the event file; of what a broken run wrote, TensorBoard drops the frames that come again."""
        from torch.utils.tensorboard import SummaryWriter  # takes seconds

        own = self.config.folder
        folder = run.folder / "tensorboard" if own is None else Path(own) / run.folder.name
        self._writer = SummaryWriter(str(folder), purge_step=run.first_number if run.first else None)
        config = json.dumps(run.config, indent=2, default=str)
        self._writer.add_text("config", "\n".join(f"    {line}" for line in config.splitlines()))

    def log(self, frame: int, values: Mapping[str, float]) -> None:
        """One point a curve."""
        for name, value in values.items():
            self._writer.add_scalar(name, value, frame)

    def scored(self, metrics: Mapping[str, Any]) -> None:
        """Each metric as a curve of one point."""
        self.log(0, numbers_in({"metrics": metrics}))

    def end(self) -> None:
        """Write what is waiting."""
        self._writer.close()
