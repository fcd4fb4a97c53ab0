"""A device that is none: tensors that say they lie elsewhere, and whose values lie on the CPU.

What would fail on a GPU fails with them: an operation on tensors of both devices, ``numpy()`` without ``cpu()``, a call
into the C++ core.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

DEVICE = torch.device("meta")
"""Torch's device without values: autograd and ``to`` know it on every machine."""
_ATEN = torch.ops.aten
# These take values from, or indices on, the CPU.
_CROSS = (_ATEN.copy_.default, _ATEN._to_copy.default)
_INDEXED = (_ATEN.index.Tensor, _ATEN.index_put_.default, _ATEN.index_put.default, _ATEN._index_put_impl_.default)


class Pretended(torch.Tensor):
    """A tensor on ``DEVICE``; ``values`` is on the CPU."""

    values: Tensor

    @staticmethod
    def __new__(cls, values: Tensor) -> Pretended:
        where = {"strides": values.stride(), "storage_offset": values.storage_offset()}
        made = torch.Tensor._make_wrapper_subclass(cls, values.shape, dtype=values.dtype, device=DEVICE, **where)
        made.values = values
        return made

    def new_tensor(self, data: Any, **given: Any) -> Tensor:
        """As torch's, which makes a tensor without values."""
        return torch.tensor(data, **({"dtype": self.dtype} | given)).to(DEVICE)

    def tolist(self) -> Any:
        """As torch's, which knows no subclasses."""
        return self.values.tolist()

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None) -> Any:
        return _dispatch(func, args, kwargs or {})


class _Factories(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None) -> Any:
        return _dispatch(func, args, kwargs or {})


def _dispatch(func: Any, args: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    """Run an operation on the values; what comes out lies where ``device`` says, else where what went in does."""
    tensors = [each for each in tree_flatten((args, kwargs))[0] if isinstance(each, Tensor)]
    pretended = [each for each in tensors if isinstance(each, Pretended)]
    asked = kwargs.get("device")
    there = bool(pretended) if asked is None else torch.device(asked) == DEVICE
    if not pretended and not there:
        return func(*args, **kwargs)
    foreign = tensors[:1] if func in _INDEXED else tensors
    if func not in _CROSS and any(not isinstance(each, Pretended) and each.ndim for each in foreign) and pretended:
        shapes = [f"{'there' if isinstance(each, Pretended) else 'cpu'} {tuple(each.shape)}" for each in tensors]
        raise RuntimeError(f"{func}: Expected all tensors to be on the same device: {', '.join(shapes)}")
    plain_args, plain_kwargs = tree_map(lambda x: x.values if isinstance(x, Pretended) else x, (tuple(args), kwargs))
    if asked is not None:
        plain_kwargs["device"] = torch.device("cpu")
    if func is _ATEN._to_copy.default and asked is not None and there != bool(pretended):
        plain_args = (plain_args[0].clone(),)  # a copy even of what has the dtype already
    out = func(*plain_args, **plain_kwargs)
    if func._schema.name.endswith("_") and not func._schema.name.endswith("__"):
        return args[0]
    return tree_map(lambda x: Pretended(x) if isinstance(x, Tensor) else x, out) if there else out


@contextmanager
def pretended_device() -> Iterator[torch.device]:
    """Within it ``torch.zeros(..., device=DEVICE)`` and ``tensor.to(DEVICE)`` have values."""
    make, convert = torch.tensor, torch.as_tensor
    with pytest.MonkeyPatch.context() as patch, _Factories():
        for name, known in (("tensor", make), ("as_tensor", convert)):
            patch.setattr(torch, name, _then_moved(known))
        yield DEVICE


def _then_moved(make: Any) -> Any:
    def made(data: Any, *given: Any, device: Any = None, **more: Any) -> Tensor:
        tensor: Tensor = make(data, *given, **more)
        return tensor if device is None else tensor.to(device)

    return made
