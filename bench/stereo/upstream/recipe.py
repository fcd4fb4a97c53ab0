"""What has to be known of one published network to build it from a checkout and read what it returns."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.errors import BenchError


@dataclass(frozen=True)
class UpstreamRecipe:
    """One published stereo network whose model is called as ``model(left, right, iters=n, test_mode=True)``.

    ``arguments`` are the attributes of the one object that its constructor takes; ``arguments_file`` names a YAML file
    beside the checkpoint that goes over them. ``import_folders`` are put on Python's path, relative to the checkout's
    root; the root is the first of ``roots`` that holds ``module``. ``output`` is the key (or index) of the disparity in
    what the model returns, None where it returns the tensor; ``sign`` is -1 where it returns the flow to the right
    image. ``patches`` name the changes in ``bench.stereo.upstream.construction`` that its code needs to be built
    without downloads, ``stand_ins`` modules that it imports but does not use; ``environment`` is set before it is
    imported.
    """

    title: str
    repository: str
    tested_commit: str
    """Commit whose calling convention this is."""
    weights: str
    """Name of its checkpoint in ``bgs-bench weights list``."""
    module: str
    class_name: str
    arguments: Mapping[str, Any]
    iterations: int
    least_iterations: int = 1
    roots: tuple[str, ...] = ("",)
    import_folders: tuple[str, ...] = ("",)
    arguments_file: str = ""
    output: str | int | None = None
    sign: int = 1
    pad_multiple: int = 32
    patches: tuple[str, ...] = ()
    stand_ins: tuple[str, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict)

    def plain(self) -> dict[str, Any]:
        """The recipe as plain JSON values."""
        return {one.name: getattr(self, one.name) for one in dataclasses.fields(self)} | {
            "arguments": dict(self.arguments),
            "environment": dict(self.environment),
        }

    @classmethod
    def from_plain(cls, values: Mapping[str, Any]) -> UpstreamRecipe:
        """The recipe that ``plain`` gave."""
        fields: dict[str, Any] = {key: tuple(one) if isinstance(one, list) else one for key, one in values.items()}
        return cls(**fields)

    def module_file(self) -> Path:
        """The model's file, relative to the root."""
        return Path(*self.module.split(".")).with_suffix(".py")

    def root_in(self, checkout: Path) -> Path:
        """The folder of ``checkout`` from which its modules are imported; raises ``BenchError`` for another folder."""
        for root in (checkout / folder for folder in (*self.roots, "")):
            if (root / self.module_file()).is_file():
                return root
        what = "does not exist" if not checkout.is_dir() else f"holds no {Path(self.roots[0]) / self.module_file()}"
        raise BenchError(
            f"stereo.checkout={checkout} {what}. Give the folder that `git clone {self.repository}` makes "
            f"(commit {self.tested_commit[:10]} is known to work)."
        )
