"""Build a published network without its downloads: what it would fetch is in its full checkpoint anyway."""

from __future__ import annotations

import importlib
import importlib.util
import sys
import types
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import nn

from bench.stereo.upstream.splatting import splat_sum


class Arguments(dict[str, Any]):
    """A constructor's arguments, as ``args.x``, ``args['x']`` and ``args.get('x')``: networks use all three."""

    def __getattr__(self, name: str) -> Any:
        try:
            return self[name]
        except KeyError:
            raise AttributeError(f"the recipe has no constructor argument '{name}'") from None


class StandIn(types.ModuleType):
    """A module that is imported but never used; what is taken from it can be called only by mistake."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return StandIn(f"{self.__name__}.{name}")


class _Unread(dict[str, Any]):
    """Stands for the weights in a file that is not read."""


@contextmanager
def patched(patches: Sequence[str], stand_ins: Sequence[str], root: Path) -> Iterator[None]:
    """The named changes for as long as a network is imported and built; ``root`` is its checkout's import root."""
    with ExitStack() as stack:
        for module in stand_ins:
            if module not in sys.modules and importlib.util.find_spec(module) is None:
                sys.modules[module] = StandIn(module)
        stack.enter_context(_replaced(torch.hub, "load_state_dict_from_url", _refuse_download))
        for patch in patches:
            stack.enter_context(_PATCHES[patch](root))
        yield


@contextmanager
def _replaced(owner: Any, name: str, value: Any) -> Iterator[None]:
    original = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, original)


def _refuse_download(url: str, *_: Any, **__: Any) -> Any:
    raise RuntimeError(f"its code tries to download {url} while it is built; the checkpoint should make that needless")


@contextmanager
def _timm_offline(root: Path) -> Iterator[None]:
    """``timm.create_model`` without pretrained weights, and with ``act1``, which timm 0.5 had and later ones lack."""
    # Not a dependency of the bench: the interpreter's owner installs it for the network.
    timm = importlib.import_module("timm")
    original: Callable[..., nn.Module] = timm.create_model

    def create_model(name: str, *args: Any, pretrained: bool = False, **settings: Any) -> nn.Module:
        model = original(name, *args, **settings)
        # From timm 0.6 on bn1 applies the activation itself, so that nothing is left for act1 to do.
        if not hasattr(model, "act1") and hasattr(getattr(model, "bn1", None), "act"):
            model.act1 = nn.Identity()
        return model

    with _replaced(timm, "create_model", create_model):
        yield


@contextmanager
def _dinov2_from_checkout(root: Path) -> Iterator[None]:
    """``torch.hub.load`` of DINOv2's code from the copy in the checkout."""
    original = torch.hub.load

    def load(repository: str, model: str, *args: Any, **settings: Any) -> Any:
        if "dinov2" not in str(repository):
            raise RuntimeError(f"its code tries to fetch {repository} from torch's hub while it is built")
        return original(str(root / "dinov2"), model, *args, **settings | {"source": "local"})

    with _replaced(torch.hub, "load", load):
        yield


@contextmanager
def _depth_anything_unread(root: Path) -> Iterator[None]:
    """Depth Anything's own file is neither needed nor read."""
    load_file, load_state = torch.load, nn.Module.load_state_dict

    def load(file: Any, *args: Any, **settings: Any) -> Any:
        if Path(str(file)).name.startswith("depth_anything"):
            return _Unread()
        return load_file(file, *args, **settings)

    def load_state_dict(self: nn.Module, state_dict: Any, *args: Any, **settings: Any) -> Any:
        return None if isinstance(state_dict, _Unread) else load_state(self, state_dict, *args, **settings)

    with _replaced(torch, "load", load), _replaced(nn.Module, "load_state_dict", load_state_dict):
        yield


@contextmanager
def _torchvision_without_operators(root: Path) -> Iterator[None]:
    """Import a torchvision whose compiled operators do not fit this torch; the networks use its transforms only."""
    try:
        importlib.import_module("torchvision")
    except RuntimeError:
        for name in [name for name in sys.modules if name.partition(".")[0] == "torchvision"]:
            del sys.modules[name]
        with _replaced(torch.library, "register_fake", _describe_nothing):
            importlib.import_module("torchvision")
    yield


def _describe_nothing(*_: Any, **__: Any) -> Callable[[Any], Any]:
    """A decorator that leaves the function as it is."""
    return lambda function: function


@contextmanager
def _own_splatting(root: Path) -> Iterator[None]:
    """TCSM's forward warping through torch: its own is a CUDA kernel that old versions of cupy compile."""
    cupy = StandIn("cupy")
    cupy.memoize = _describe_nothing  # type: ignore[attr-defined]
    sys.modules["cupy"] = cupy
    splatting = importlib.import_module("core.utils.splatting.softsplat")
    # For good: it is looked up when a frame is warped.
    splatting.softsplat_func = types.SimpleNamespace(apply=splat_sum)  # type: ignore[attr-defined]
    yield


_PATCHES: dict[str, Callable[[Path], Any]] = {
    "timm": _timm_offline,
    "dinov2": _dinov2_from_checkout,
    "depth_anything": _depth_anything_unread,
    "torchvision": _torchvision_without_operators,
    "splatting": _own_splatting,
}
