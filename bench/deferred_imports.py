"""Imports that wait until they are needed: ``import torch`` alone takes longer than most commands work."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterable
from importlib.util import find_spec, module_from_spec
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
        with _lock:
            load = vars(self).pop("_load", None)
            if load is not None:
                load(self)
                self.__class__ = ModuleType  # type: ignore[assignment]
        return ModuleType.__getattribute__(self, name)


def defer(modules: Iterable[str] = SLOW) -> None:
    """Let ``import NAME`` of these top-level modules cost nothing until something is read from them.

    What is imported already, or is not installed, stays as it is. Threads may be the first to read one: the others
    wait.
    """
    for name in modules:
        spec = None if name in sys.modules else find_spec(name)
        if spec is not None and spec.loader is not None:
            module = module_from_spec(spec)
            vars(module)["_load"] = spec.loader.exec_module
            module.__class__ = _Deferred
            sys.modules[name] = module
