"""The contract of a loss term: finite, differentiable, and its gradient is the value's slope."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from bench.authoring.verdict import Candidate, Check, ContractBrokenError, Note
from bench.contracts.loss import LossValue
from bench.contracts.rasterizer import Rendered
from bench.supervision.photometric import Photometric
from bench.supervision.ssim import gaussian_blur, ssim
from bench.supervision.target import Target
from bench.types import PinholeView

if TYPE_CHECKING:
    from torch import Tensor

_SIZE, _ODD_SIZE = (24, 40), (33, 47)
_IMAGES = ("color", "depth", "alpha")
_DIRECTIONS = 8
# By dtype: the step of central differences, and how far gradient and slope may differ.
_STEP = {torch.float64: 1e-6, torch.float32: 1e-2}
_TOLERANCE = {torch.float64: 1e-3, torch.float32: 0.05}

Case = tuple[Rendered, Target]


@dataclass
class Subject:
    """The loss term under test."""

    candidate: Candidate

    @cached_property
    def dtype(self) -> torch.dtype:
        """Float64 where the term can do it; kernels of an author's own may know float32 only, as mapping uses it."""
        try:
            self.term.evaluate(*make_case(*_SIZE, seed=0))
        except Exception:  # told in the finding; what is wrong in float32 too is reported there
            return torch.float32
        return torch.float64

    @cached_property
    def term(self) -> Any:
        return self.candidate.build()

    def evaluate(self, case: Case) -> LossValue:
        """The answer for one render, checked for its form."""
        answer = self.term.evaluate(*case)
        if not isinstance(answer, LossValue) or not isinstance(answer.value, float):
            got = type(answer.value).__name__ if isinstance(answer, LossValue) else type(answer).__name__
            raise ContractBrokenError(
                f"evaluate() gave {got}",
                "LossValue with a Python float as value",
                "write TorchLoss.loss, which returns one torch number; or LossValue(float(value), ...)",
                "evaluate",
            )
        for name in _IMAGES:
            grad, image = getattr(answer, f"grad_{name}"), getattr(case[0], name)
            if grad is not None and (grad.shape != image.shape or grad.dtype != image.dtype):
                raise ContractBrokenError(
                    f"grad_{name} is {grad.dtype} {tuple(grad.shape)}",
                    f"{image.dtype} {tuple(image.shape)}, like the image; None for zero",
                    "torch.zeros_like(rendered.depth) is a good start",
                    "evaluate",
                )
        return answer


def make_case(height: int, width: int, seed: int, dtype: torch.dtype = torch.float64, known: float = 0.8) -> Case:
    """A render and a target of noise: depths of 3 to 8 m, known at a share of the pixels, alpha 0.05 to 1."""
    rng = np.random.default_rng(seed)

    def noise(low: float, high: float, *shape: int) -> Tensor:
        return torch.from_numpy(rng.uniform(low, high, shape)).to(dtype)

    mask = torch.from_numpy(rng.random((height, width)) < known)
    view = PinholeView(np.eye(4), 30.0, 30.0, width / 2 - 0.5, height / 2 - 0.5, width, height)
    target = Target(noise(0, 1, 3, height, width), noise(3, 8, height, width) * mask, mask, view)
    if dtype == torch.float64:
        # The C++ core has them in float32 only.
        mean = gaussian_blur(target.image)
        vars(target)["local_statistics"] = mean, gaussian_blur(target.image**2) - mean**2
    alpha = noise(0.05, 1, height, width)
    return Rendered(noise(0, 1, 3, height, width), noise(3, 8, height, width) * alpha, alpha), target


def _finite(subject: Subject) -> str:
    cases = {
        "noise": make_case(*_SIZE, seed=1, dtype=torch.float32),
        "an odd size": make_case(*_ODD_SIZE, seed=2, dtype=torch.float32),
        "no depth known": make_case(*_SIZE, seed=3, dtype=torch.float32, known=0.0),
    }
    rendered, target = make_case(*_SIZE, seed=4, dtype=torch.float32)
    zero = [torch.zeros_like(getattr(rendered, name)) for name in _IMAGES]
    cases["an empty render"] = Rendered(*zero), target
    cases["a perfect render"] = (
        Rendered(target.image.clone(), target.depth.clone(), torch.ones_like(target.depth)),
        target,
    )
    for what, case in cases.items():
        answer = subject.evaluate(case)
        bad = [name for name in _IMAGES if not _is_finite(getattr(answer, f"grad_{name}"))]
        if not np.isfinite(answer.value) or bad:
            wrong = f"the gradient by {bad[0]}" if bad else f"the value {answer.value}"
            raise ContractBrokenError(
                f"for {what}, {wrong} is not finite",
                "finite values and gradients: one NaN spoils the whole map",
                "guard 0/0 and log(0): .clamp_min(1e-6); sqrt(x + 1e-12), whose slope at 0 is finite",
                "loss",
            )
    return ", ".join(cases)


def _is_finite(grad: Tensor | None) -> bool:
    return grad is None or bool(torch.isfinite(grad).all())


def _gradient(subject: Subject) -> str | Note:
    """Along random directions: the gradient against central differences of the value."""
    dtype = subject.dtype
    case, step = make_case(*_SIZE, seed=5, dtype=dtype), _STEP[dtype]
    answer, rng = subject.evaluate(case), np.random.default_rng(0)
    used = [name for name in _IMAGES if getattr(answer, f"grad_{name}") is not None]
    for name in _IMAGES:
        errors = []
        for _ in range(_DIRECTIONS):
            direction = torch.from_numpy(rng.standard_normal(tuple(getattr(case[0], name).shape))).to(dtype)
            ahead, behind = (subject.evaluate(_moved(case, name, sign * step * direction)).value for sign in (1, -1))
            slope, grad = (ahead - behind) / (2 * step), getattr(answer, f"grad_{name}")
            said = 0.0 if grad is None else float((grad * direction).sum())
            errors.append(abs(slope - said) / max(abs(slope), abs(said), 1e-4))
        # The median: a direction may lead over a kink (abs, max), where the slope is not one number.
        if np.median(errors) > _TOLERANCE[dtype]:
            raise ContractBrokenError(
                f"the gradient by {name} differs from the value's slope by {np.median(errors):.1%} ({str(dtype)[6:]})",
                "value and gradient of the same function",
                "TorchLoss derives it; is something detached, a weight applied twice, or float32 inside?",
                "loss" if hasattr(subject.term, "loss") else "evaluate",
            )
    if not used:
        return Note("depends on none of the images: it changes nothing")
    return f"by {', '.join(used)}: agrees with central differences in {str(dtype)[6:]}"


def _moved(case: Case, name: str, by: Tensor) -> Case:
    images = {n: getattr(case[0], n) + (by if n == name else 0) for n in _IMAGES}
    return Rendered(**images), case[1]


def _float32(subject: Subject) -> str | Note:
    if subject.dtype == torch.float32:
        return Note("the term works in float32 only, so its rounding could not be judged")
    double, single = (
        subject.evaluate(make_case(*_ODD_SIZE, seed=6, dtype=dtype)) for dtype in (torch.float64, torch.float32)
    )
    if abs(double.value - single.value) > 1e-3 * max(abs(double.value), 1e-3):
        raise ContractBrokenError(
            f"float32 gives {single.value:.6g}, float64 {double.value:.6g}",
            "the same to three digits: mapping works in float32",
            "take differences before powers and logarithms",
            "evaluate",
        )
    return f"{single.value:.6g}, as in float64"


def _repeats(subject: Subject) -> str:
    case = make_case(*_SIZE, seed=7, dtype=torch.float32)
    before = [getattr(case[0], name).clone() for name in _IMAGES] + [case[1].depth.clone()]
    first, second = subject.evaluate(case), subject.evaluate(case)
    after = [getattr(case[0], name) for name in _IMAGES] + [case[1].depth]
    if not all(torch.equal(a, b) for a, b in zip(before, after, strict=True)):
        raise ContractBrokenError(
            "the rendered images or the target were changed in place",
            "inputs stay as they are",
            "no in-place operations",
            "loss",
        )
    grads = [(getattr(first, f"grad_{name}"), getattr(second, f"grad_{name}")) for name in _IMAGES]
    equal = all((a is None and b is None) or (a is not None and b is not None and torch.equal(a, b)) for a, b in grads)
    if first.value != second.value or not equal:
        raise ContractBrokenError(
            "twice the same images gave different values or gradients",
            "the same bits",
            "no randomness; no state",
            "loss",
        )
    return "twice the same bits; inputs left as they were"


def _photometric(subject: Subject) -> str | Note:
    """Of a term that is fused with others: its own value is the mixture that it declares."""
    mixture = subject.term.photometric
    if mixture is None:
        return Note("no: it is evaluated by itself, after the fused pass of L1, L2 and SSIM")
    rendered, target = make_case(*_SIZE, seed=8, dtype=torch.float32)
    error = rendered.color - target.image
    dissimilarity = 1 - ssim(rendered.color, target.image, target.local_statistics)
    parts = Photometric(float(error.abs().mean()), float(error.square().mean()), float(dissimilarity))
    expected = parts.weighted(mixture)
    found = subject.evaluate((rendered, target)).value
    if abs(found - expected) > 1e-5:
        raise ContractBrokenError(
            f"photometric={mixture} makes {expected:.6f}, evaluate() gives {found:.6f}",
            "the same: with `photometric` set, evaluate() is not called",
            "leave photometric out unless the term is exactly a * mean L1 + b * mean L2 + c * (1 - mean SSIM)",
            "evaluate",
        )
    return f"{mixture.l1} L1 + {mixture.l2} L2 + {mixture.dssim} (1 - SSIM), as evaluate() says"


def checks_of(subject: Subject) -> tuple[Check[Subject], ...]:
    """All checks of a loss term."""
    return (
        Check("finite", _finite, essential=True),
        Check("gradient", _gradient),
        Check("float32", _float32),
        Check("determinism", _repeats),
        Check("fused", _photometric),
    )
