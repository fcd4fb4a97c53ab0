"""A published network as a stereo plugin: settings, padding, and the worker process that runs the authors' code."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from omegaconf import OmegaConf

import bench
from bench import registry
from bench.contracts.stereo import Matched
from bench.errors import BenchError, require_choice, require_least
from bench.peers.messages import Array, Message
from bench.peers.process import PeerFailure, PeerProcess
from bench.stereo.network import NetworkConfig, StereoNetwork
from bench.stereo.padding import Window, next_multiple, pad_to
from bench.stereo.upstream.recipe import UpstreamRecipe
from bench.types import Image, Map
from bench.weights import missing
from bench.weights.manifest import entry

# Another interpreter has packages of its own, so it is given the bench's modules but not the folder that holds them.
_START = """
import runpy, sys, types
package = types.ModuleType("bench")
package.__path__ = [sys.argv[1]]
sys.modules["bench"] = package
sys.path[:] = [folder for folder in sys.path if folder != sys.argv[2]]
runpy.run_module("bench.stereo.upstream.worker", run_name="__main__")
"""


@dataclass(frozen=True)
class UpstreamConfig(NetworkConfig):
    """Where the authors' network comes from: ``checkout`` and ``weights``, or ``onnx``."""

    checkout: str = field(default="", metadata={"path": True, "code": True})
    """Folder of the authors' repository, as `git clone` makes it."""
    onnx: str = field(default="", metadata={"path": True})
    """An ONNX file made from the network; it takes the place of checkout and weights."""
    onnx_preset: str = "left_right_disp"
    """Preset of stereo=onnx that describes the file. This one: inputs left and right, RGB from 0 to 255; output disp,
    positive, in pixels."""
    iterations: int = 0
    """Updates of the recurrent network; 0: as many as its authors use on KITTI."""
    python: str = field(default="", metadata={"path": True, "code": True})
    """Interpreter (3.9 or newer, with torch and numpy) of an environment made for the network; empty: the bench's."""
    trust_pickle: bool = field(default=False, metadata={"code": True})
    """Read a checkpoint that can run any code while it is read. Only for files from someone you trust."""
    start_timeout_s: float = 600.0
    """Without a loaded network after this time ..."""
    timeout_s: float = 3600.0
    """... or a disparity after this one, the network's process is killed and the run ends."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_choice("stereo.dtype", self.dtype, ("float32", "float16"))
        for key in ("checkout", "weights", "iterations"):
            if self.onnx and getattr(self, key):
                raise BenchError(
                    f"stereo.{key} and stereo.onnx are both set, but an ONNX file has it all inside. Give one of them."
                )
        require_least("stereo", self, iterations=0)
        for key in ("start_timeout_s", "timeout_s"):
            if not getattr(self, key) > 0:
                raise BenchError(f"stereo.{key}={getattr(self, key)} must be above 0.")


class UpstreamNetwork(StereoNetwork):
    """Runs the network that ``recipe`` describes; a plugin is this class with a recipe.

    The authors' code runs in a process of its own, so that networks whose packages have the same name (most call
    theirs ``core``) can be used side by side, and none of it is ever imported here.
    """

    recipe: ClassVar[UpstreamRecipe]

    def __init__(self, config: UpstreamConfig) -> None:
        """Start and load the network; raises ``BenchError`` that says what is missing and where to get it."""
        if not config.onnx and not config.checkout:
            raise BenchError(self._how_to_begin(config))
        _check(config, self.recipe)
        super().__init__(config, "" if config.onnx else self.recipe.weights)
        self._config = config
        self._process: PeerProcess | None = None
        self._exported = _onnx_network(config) if config.onnx else None
        if self._exported is None:
            self._root = self.recipe.root_in(Path(config.checkout).expanduser())
            self._start()

    def weights(self) -> dict[str, Path]:
        """The checkpoint, the settings beside it, and the model's own code; or the ONNX file."""
        if self._exported is not None:
            return self._exported.weights()
        assert self.weights_path is not None
        files = {"network": self.weights_path, "code": self._root / self.recipe.module_file()}
        if self.recipe.arguments_file:
            files["arguments"] = self.weights_path.with_name(self.recipe.arguments_file)
        return files

    def match(self, left: Image, right: Image) -> Map | Matched:
        """Disparity (H, W) float32 in pixels of these images, as the authors' code gives it."""
        if self._exported is not None:
            return self._exported.match(left, right)
        shape = next_multiple((left.shape[0], left.shape[1]), self.recipe.pad_multiple)
        (padded_left, window), (padded_right, _) = (pad_to(image, shape, "centred") for image in (left, right))
        fields, arrays = self.told_beside(left.shape, window)
        answer = self._ask(
            Message(
                "match",
                {"iterations": self._config.iterations or self.recipe.iterations} | fields,
                {"left": padded_left, "right": padded_right} | arrays,
            ),
            self._config.timeout_s,
        )
        return np.ascontiguousarray(answer.arrays["disparity"][window], dtype=np.float32)

    def told_beside(self, shape: tuple[int, ...], window: Window) -> tuple[dict[str, Any], dict[str, Array]]:
        """What the worker is told beside the images: fields and arrays; nothing, but by temporal networks."""
        return {}, {}

    def close(self) -> None:
        """End the network's process; can be called again. It also ends with this object."""
        if self._process is not None:
            self._process.close()

    def _start(self) -> None:
        config, checkpoint = self._config, self.weights_path
        assert checkpoint is not None
        package = Path(bench.__file__).parent
        command = [config.python or sys.executable, "-c", _START, str(package)]
        # The bench's own interpreter finds everything as it is; only for another one the folder is taken away.
        command.append(str(package.parent) if config.python else "")
        recipe = self.recipe.plain() | {"arguments": self._arguments()}
        try:
            self._process = PeerProcess(command)
        except PeerFailure as failure:
            raise BenchError(f"stereo={config.name}: {command[0]} {failure}. Correct stereo.python.") from failure
        self._ask(
            Message(
                "load",
                {
                    "recipe": recipe,
                    "root": str(self._root.absolute()),
                    "checkpoint": str(checkpoint.absolute()),
                    "device": config.device,
                    "trust_pickle": config.trust_pickle,
                },
            ),
            config.start_timeout_s,
        )

    def _arguments(self) -> dict[str, Any]:
        """The constructor's arguments: the recipe's, those in the file beside the checkpoint, the number format's."""
        arguments = dict(self.recipe.arguments)
        if self.recipe.arguments_file:
            assert self.weights_path is not None
            arguments |= _read_arguments(self.weights_path.with_name(self.recipe.arguments_file))
        if "precision_dtype" in arguments:
            arguments["precision_dtype"] = self._config.dtype
        return arguments | {"mixed_precision": self._config.dtype == "float16"}

    def _ask(self, message: Message, timeout_s: float) -> Message:
        assert self._process is not None
        try:
            answer = self._process.request(message, timeout_s)
        except PeerFailure as failure:
            raise BenchError(
                f"stereo={self._config.name}: the process of {self.recipe.title} {failure}. If memory ran out, lower "
                "stereo.scale."
            ) from failure
        if answer.kind == "refused":
            self.close()
            raise BenchError(f"stereo={self._config.name}: {answer.fields.get('reason')}")
        return answer

    @classmethod
    def missing_weights(cls) -> str:
        """The authors' repository, and their checkpoint where it is not here."""
        weights = missing(cls.recipe.weights)
        code = f"give stereo.checkout=FOLDER, which `git clone {cls.recipe.repository}` makes"
        return f"{code}, and {weights}" if weights else code

    @classmethod
    def _how_to_begin(cls, config: UpstreamConfig) -> str:
        recipe, name = cls.recipe, config.name
        steps = [f"run `git clone {recipe.repository}`"]
        if not config.weights and (how := missing(recipe.weights)):
            steps.append(f"{how} (licence: {entry(recipe.weights).licence})")
        steps.append(f"run again with `stereo={name} stereo.checkout=FOLDER`")
        return (
            f"stereo={name} runs the authors' own {recipe.title}, which is no part of this project: {'; '.join(steps)}."
            f" An ONNX export serves too: `stereo={name} stereo.onnx=FILE`."
        )


def _check(config: UpstreamConfig, recipe: UpstreamRecipe) -> None:
    if config.onnx and not Path(config.onnx).expanduser().is_file():
        raise BenchError(f"stereo.onnx={config.onnx} is no file. Correct the path.")
    if config.iterations and config.iterations < recipe.least_iterations:
        raise BenchError(
            f"stereo.iterations={config.iterations} is too few for {recipe.title}; the least is "
            f"{recipe.least_iterations}, its authors use {recipe.iterations}."
        )


def _read_arguments(path: Path) -> dict[str, Any]:
    advice = "It is published beside the checkpoint: put it there."
    try:
        content = OmegaConf.to_container(OmegaConf.load(path))
    # OmegaConf hands on whatever the file system, the decoder or the YAML reader raises.
    except Exception as error:
        reason = str(error).split("\n", 1)[0]
        raise BenchError(f"The network's settings {path} can't be read ({reason}). {advice}") from error
    if not isinstance(content, dict):
        raise BenchError(f"The network's settings {path} hold no keys and values. {advice}")
    # What is no plain value belongs to its training.
    return {str(key): value for key, value in content.items() if isinstance(value, bool | int | float | str | list)}


def _onnx_network(config: UpstreamConfig) -> StereoNetwork:
    """The plugin for any ONNX file, told how to talk to this one; scale, tiles and checks stay here."""
    onnx = registry.lookup("stereo", "onnx").config
    settings = {"weights": config.onnx, "preset": config.onnx_preset, "device": config.device, "dtype": config.dtype}
    network = registry.build(onnx(name="onnx", **settings), "stereo")
    assert isinstance(network, StereoNetwork)
    return network
