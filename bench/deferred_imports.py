"""Imports that wait until they are needed: ``import torch`` alone takes longer than most commands work."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterable
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, module_from_spec, spec_from_loader
from types import ModuleType
from typing import Any

SLOW = ("torch", "cv2", "pandas", "onnxruntime", "skimage", "scipy", "matplotlib")
_lock = threading.RLock()


class _Deferred(ModuleType):
    """A module that is executed when something is read from it for the first time.

    The standard library's LazyLoader does so even for ``__file__``, for which ``inspect`` (and so ``import torch``)
    asks every module there is.
    """

    def __getattr__(self, name: str) -> Any:
        _execute(self)
        return ModuleType.__getattribute__(self, name)


class _WholeFirst(MetaPathFinder):
    """Executes a deferred module before a part of it is imported: ``import torch.nn.functional`` alone would crash."""

    def find_spec(self, fullname: str, path: object, target: ModuleType | None = None) -> ModuleSpec | None:
        """None, unless executing the whole has imported the part already."""
        whole = sys.modules.get(fullname.partition(".")[0])
        if not isinstance(whole, _Deferred) or whole.__name__ == fullname:
            return None
        _execute(whole)
        part = sys.modules.get(fullname)
        if part is None:
            return None
        # The import system goes on with what a module that has appeared meanwhile says of itself.
        part.__spec__ = spec_from_loader(fullname, _Imported(part))
        return part.__spec__


class _Imported(Loader):
    """Gives a module that is imported already."""

    def __init__(self, module: ModuleType) -> None:
        self._module, self._spec = module, module.__spec__

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The module, of which the import system takes its ``spec`` for a moment."""
        return self._module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing is executed again."""
        module.__spec__ = self._spec


def _execute(module: _Deferred) -> None:
    with _lock:
        load = vars(module).pop("_load", None)
        if load is not None:
            load(module)
            module.__class__ = ModuleType  # type: ignore[assignment]


def defer(modules: Iterable[str] = SLOW) -> None:
    """Let ``import NAME`` of these top-level modules cost nothing until something is read from them.

    What is imported already, or is not installed, stays as it is. Threads may be the first to read one: the others
    wait.
    """
    if not any(isinstance(finder, _WholeFirst) for finder in sys.meta_path):
        sys.meta_path.insert(0, _WholeFirst())
    for name in modules:
        spec = None if name in sys.modules else find_spec(name)
        if spec is not None and spec.loader is not None:
            module = module_from_spec(spec)
            vars(module)["_load"] = spec.loader.exec_module
            module.__class__ = _Deferred
            sys.modules[name] = module
