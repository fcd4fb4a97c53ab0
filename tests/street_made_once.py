"""Streets that are made once in a process: drawing their images takes longer than most of what is tested on them."""

from __future__ import annotations

import copy
import functools
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import pytest

from plugins.datasets import street
from plugins.datasets.street import Street

_KEPT = 300
_LARGEST_PX = 100_000
_made: OrderedDict[tuple[object, ...], Any] = OrderedDict()


def _once(method: Callable[[Street, int], Any]) -> Callable[[Street, int], Any]:
    """The method, which gives a copy of what it gave before for the same settings and position."""

    @functools.wraps(method)
    def once(self: Street, position: int) -> Any:
        if self.camera.width * self.camera.height > _LARGEST_PX:
            return method(self, position)
        key = (method.__name__, type(self), repr(self._config), position)
        found = _made.get(key)
        if found is None:
            found = _made[key] = method(self, position)
            if len(_made) > _KEPT:
                _made.popitem(last=False)
        return copy.deepcopy(found)

    return once


def remember_streets(patch: pytest.MonkeyPatch) -> None:
    """From now on, images, depth and LiDAR of a street that was there before are remembered; so is its layout."""
    for method in (Street.frame, Street.true_depth, Street.lidar_depth):
        patch.setattr(Street, method.__name__, _once(method))
    for build in (street.build_street, street.build_circuit):
        patch.setattr(street, build.__name__, functools.lru_cache(maxsize=8)(build))
