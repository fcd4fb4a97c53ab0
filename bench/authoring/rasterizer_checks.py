"""The contract of a rasterizer: images and gradients like those of the float64 reference, and a case worked by hand."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from bench import registry
from bench.authoring.random_scenes import GROUPS, SceneSpec, image_gradients, random_scene, relative_l2, render_and_back
from bench.authoring.verdict import Candidate, Check, ContractBrokenError, Note
from bench.contracts.rasterizer import Gradients, Rasterizer, Rendered
from bench.errors import BenchError
from bench.gaussians.map import GaussianMap
from bench.gaussians.optimizer import LearningRates, MapOptimizer
from bench.gaussians.parameters import planes_from
from bench.gaussians.schema import THRESHOLDS, planes_of
from bench.types import PinholeView

if TYPE_CHECKING:
    from torch import Tensor

_SCENES = (SceneSpec(1, 150, 70, 41, 1.2, (0.05, 0.5)), SceneSpec(4, 150, 33, 17, 6.0, (0.6, 0.99)))
_HARMONICS = SceneSpec(5, 150, 70, 41, 2.0, (0.05, 0.9), degree=3)
# Isolated pixels may differ: an alpha just above 1/255 in one implementation is just below it in another.
_QUANTILE, _IMAGE_TOLERANCE = 0.99, 2e-3
_GRADIENT_TOLERANCE = 0.02
_IMAGES = ("color", "depth", "alpha")


@dataclass
class Subject:
    """The rasterizer under test and the reference it is compared with."""

    candidate: Candidate

    @cached_property
    def rasterizer(self) -> Any:
        return self.candidate.build()

    @cached_property
    def reference(self) -> Rasterizer:
        known = registry.lookup("rasterizer", "reference")
        return registry.build(known.config(name="reference"), "rasterizer")

    def render(self, planes: Tensor, view: PinholeView, differentiable: bool = True) -> Rendered:
        """One render, checked for its form, with images on the CPU and the context untouched."""
        answer = self.rasterizer.render(planes.to(self.rasterizer.device), view, differentiable)
        size = (view.height, view.width)
        for name, shape in (("color", (3, *size)), ("depth", size), ("alpha", size)):
            image = getattr(answer, name, None)
            if not isinstance(image, torch.Tensor) or tuple(image.shape) != shape or image.dtype != torch.float32:
                got = f"{image.dtype} {tuple(image.shape)}" if isinstance(image, torch.Tensor) else type(image).__name__
                raise ContractBrokenError(
                    f"render(): {name} is {got}",
                    f"float32 tensor {shape}",
                    "Rendered(color, depth, alpha, context)",
                    "render",
                )
        return answer

    def both_ways(self, planes: Tensor, view: PinholeView) -> tuple[Rendered, Gradients]:
        """Forward and backward with made-up gradients of a loss."""
        device = self.rasterizer.device
        grads = tuple(grad.to(device) for grad in image_gradients(view, 1))
        rendered = self.render(planes, view)
        return rendered, self.rasterizer.backward(rendered, *grads, pose=True)


def _by_hand(subject: Subject) -> str:
    """Two balls on the optical axis: variance (40 * 0.2 / 4)^2 + 0.3 = 4.3 px^2, opacity 0.6 before 0.5."""
    view = PinholeView(np.eye(4), 40.0, 40.0, 10.0, 8.0, 21, 17)
    means, sizes = torch.tensor([[0.0, 0, 6], [0, 0, 4]]), torch.tensor([[0.3] * 3, [0.2] * 3])
    colors = torch.tensor([[0.0, 1, 0], [1, 0, 0]])
    planes = planes_from(means, sizes, torch.tensor([[1.0, 0, 0, 0]] * 2), torch.tensor([0.5, 0.6]), colors)
    image = subject.render(planes, view)
    found = [*image.color[:, 8, 10].tolist(), float(image.depth[8, 10]), float(image.alpha[8, 10])]
    expected = [0.6, 0.2, 0.0, 4 * 0.6 + 6 * 0.2, 0.8]
    if not np.allclose(found, expected, atol=1e-3):
        raise ContractBrokenError(
            f"0.6 of red at 4 m before 0.5 of green at 6 m: colour, depth, alpha are {np.round(found, 3).tolist()}",
            f"{np.round(expected, 3).tolist()}: blended front to back, depth = sum d alpha T, no background",
            "sort by depth, nearest first; do not divide depth by alpha; pixel centres are integers",
            "render",
        )
    falloff = float(image.alpha[8, 12])
    near, far = 0.6 * np.exp(-0.5 * 4 / 4.3), 0.5 * np.exp(-0.5 * 4 / 4.3)
    if abs(falloff - (near + (1 - near) * far)) > 2e-3:
        raise ContractBrokenError(
            f"two pixels beside the middle alpha is {falloff:.4f}",
            f"{near + (1 - near) * far:.4f}: alpha = opacity exp(-d^2 / 2 variance), variance (f sigma/z)^2 + 0.3 px^2",
            "add the 0.3 px^2 low-pass; log scales are of standard deviations",
            "render",
        )
    return "two balls on the optical axis, blended as worked by hand"


def _images(subject: Subject) -> str:
    worst = max(_image_error(subject, spec) for spec in _SCENES)
    return f"{_QUANTILE:.0%} quantile of the relative error at most {worst:.1g} against rasterizer=reference"


def _image_error(subject: Subject, spec: SceneSpec) -> float:
    planes, view = random_scene(spec)
    found, true = subject.render(planes, view), subject.reference.render(planes.double(), view)
    worst = 0.0
    for name in _IMAGES:
        truth = getattr(true, name)
        error = (getattr(found, name).cpu().double() - truth).abs() / max(float(truth.abs().max()), 1.0)
        quantile = float(torch.quantile(error.flatten(), _QUANTILE))
        worst = max(worst, quantile)
        if quantile > _IMAGE_TOLERANCE:
            t = THRESHOLDS
            raise ContractBrokenError(
                f"{name} of {spec.count} random Gaussians at {spec.width}x{spec.height}, harmonics of degree "
                f"{spec.degree}: {_QUANTILE:.0%} quantile of the relative error {quantile:.2g}",
                f"at most {_IMAGE_TOLERANCE:g} against rasterizer=reference (float64)",
                f"thresholds: nearest depth {t.near_m} m, alpha 1/{1 / t.alpha_min:.0f} to {t.alpha_max}, "
                f"transmittance {t.transmittance_end:g}; colours are clamped at 0, not at 1; quaternions are w x y z, "
                "of any length",
                "render",
            )
    return worst


def _gradients(subject: Subject) -> str:
    worst = max(_gradient_error(subject, spec) for spec in _SCENES)
    return (
        f"by {', '.join(group for group in GROUPS if group != 'harmonics')} and twist: relative L2 at most {worst:.1g}"
    )


def _gradient_error(subject: Subject, spec: SceneSpec) -> float:
    planes, view = random_scene(spec)
    _, found = subject.both_ways(planes, view)
    shapes = {"planes": tuple(planes.shape), "touched": (spec.count,), "twist": (6,)}
    if not isinstance(found, Gradients) or any(
        tuple(getattr(getattr(found, name), "shape", ())) != shape for name, shape in shapes.items()
    ):
        raise ContractBrokenError(
            f"backward() gave {type(found).__name__} of other shapes",
            f"Gradients: planes {tuple(planes.shape)}, touched ({spec.count},) bool, twist (6,) when pose is True",
            "return Gradients(planes, touched, twist)",
            "backward",
        )
    double = tuple(grad.double() for grad in image_gradients(view, 1))
    _, true = render_and_back(subject.reference, planes.double(), view, double)  # type: ignore[arg-type]
    errors = {group: relative_l2(found.dense()[rows].cpu(), true.planes[rows]) for group, rows in GROUPS.items()}
    assert found.twist is not None
    assert true.twist is not None
    errors["twist"] = relative_l2(found.twist.cpu(), true.twist)
    name = max(errors, key=lambda group: errors[group])
    if errors[name] > _GRADIENT_TOLERANCE:
        raise ContractBrokenError(
            f"the gradient by {name} differs by {errors[name]:.2g} (relative L2) from the reference's",
            f"at most {_GRADIENT_TOLERANCE:g}",
            "the conic's off-diagonal counts twice; no gradient where alpha is clamped; the twist perturbs p_cam "
            "from the left, translation first",
            "backward",
        )
    return errors[name]


def _harmonics(subject: Subject) -> str | Note:
    try:
        subject.render(*random_scene(_HARMONICS))
    except BenchError as error:
        return Note(f"colours do not depend on the direction: {error}")
    worst = max(_image_error(subject, _HARMONICS), _gradient_error(subject, _HARMONICS))
    return f"degree {_HARMONICS.degree}: images and gradients within {worst:.1g} of rasterizer=reference"


def _observation(subject: Subject) -> str | Note:
    planes, view = random_scene(_SCENES[0])
    try:
        found = subject.rasterizer.observe(planes.to(subject.rasterizer.device), view)
    except BenchError as error:
        return Note(str(error))
    true = subject.reference.observe(planes, view)
    for name in ("pixels", "median_depth"):
        value, truth = getattr(found, name).cpu(), getattr(true, name)
        if value.dtype != truth.dtype or value.shape != truth.shape:
            raise ContractBrokenError(
                f"observe(): {name} is {value.dtype} {tuple(value.shape)}",
                f"{truth.dtype} {tuple(truth.shape)}",
                "Observation(pixels, median_depth)",
                "observe",
            )
        wrong = float((value.nan_to_num(-1.0) - truth.nan_to_num(-1.0)).abs().gt(1e-3).double().mean())
        if wrong > 1 - _QUANTILE:
            raise ContractBrokenError(
                f"observe(): {name} differs from that of rasterizer=reference in {wrong:.1%} of its entries",
                f"at most {1 - _QUANTILE:.0%}",
                "pixels count where alpha >= 1/255 and the transmittance before is above a half; the median is the "
                "depth of the Gaussian at which transmittance falls to a half or below, NaN where it never does",
                "observe",
            )
    return "pixels per Gaussian and median depth like those of rasterizer=reference"


def _learning(subject: Subject) -> str | Note:
    rasterizer, (planes, view) = subject.rasterizer, random_scene(_SCENES[0])
    if not rasterizer.learns:
        return Note("no learn(): a step of Adam is a pass of its own after backward()")
    by_color, by_depth, by_alpha = (grad.to(rasterizer.device) for grad in image_gradients(view, 1))
    by_images, learned = (by_color, by_depth, by_alpha), []
    for at_once in (True, False):
        gaussians, optimizer = GaussianMap(0, rasterizer.device), MapOptimizer(LearningRates(*[1e-2] * 5))
        gaussians.add(0, np.eye(4), planes, torch.ones(planes.shape[1]))
        rendered = subject.render(gaussians.planes, view)
        if at_once:
            optimizer.learn(gaussians, rasterizer, rendered, by_images)
        else:
            optimizer.step(gaussians, rasterizer.backward(rendered, *by_images))
        learned.append(torch.cat([gaussians.planes, gaussians.first_moment, gaussians.second_moment]))
    if not torch.equal(*learned):
        raise ContractBrokenError(
            f"learn() makes other parameters and moments: by up to {float((learned[0] - learned[1]).abs().max()):.2g}",
            "the bits of backward() and a step of Adam with its gradients",
            "see bench/gaussians/optimizer.py for the step; only Gaussians in view take it",
            "learn",
        )
    return "learn(): the bits of backward() and a step of Adam"


def _nothing_to_see(subject: Subject) -> str:
    _, view = random_scene(_SCENES[1])
    behind = torch.zeros(planes_of(0), 1)
    behind[:3, 0] = torch.from_numpy(view.T_world_cam @ [0.1, 0.1, -3.0, 1.0])[:3].float()
    behind[6] = 1.0
    for planes in (torch.zeros(planes_of(0), 0), behind):
        rendered, grads = subject.both_ways(planes, view)
        largest = max(float(getattr(rendered, name).abs().max()) for name in _IMAGES)
        if largest > 0 or float(grads.dense().abs().sum()) > 0:
            raise ContractBrokenError(
                f"with {planes.shape[1]} Gaussians, none in view, something is drawn or has a gradient",
                "black images, alpha 0, zero gradients",
                "nearest depth is 0.2 m in front of the camera",
                "render",
            )
    return "no Gaussian, or one behind the camera: black, zero gradients"


def _repeats(subject: Subject) -> str | Note:
    planes, view = random_scene(_SCENES[0])
    kept = planes.clone()
    (first, by_first), (second, by_second) = subject.both_ways(planes, view), subject.both_ways(planes, view)
    if not torch.equal(planes, kept):
        raise ContractBrokenError(
            "the planes were changed in place", "inputs stay as they are", "work on a copy", "render"
        )
    if not all(torch.equal(getattr(first, name), getattr(second, name)) for name in _IMAGES):
        raise ContractBrokenError(
            "two renders differ", "the same bits", "blend in a fixed order, without atomics", "render"
        )
    if not torch.equal(by_first.dense(), by_second.dense()):
        return Note("images are the same bits twice, gradients are not (atomics?): maps can't be repeated to the bit")
    quick = subject.render(planes, view, differentiable=False)
    if not torch.equal(quick.color, first.color):
        raise ContractBrokenError(
            "differentiable=False gives another image", "the same image", "leave out only what backward needs", "render"
        )
    buffer = torch.full((len(planes), planes.shape[1] + 5), torch.nan, device=subject.rasterizer.device)
    buffer[:, :-5] = planes
    if not torch.equal(subject.render(buffer[:, :-5], view).color, first.color):
        raise ContractBrokenError(
            "the front of a larger buffer, buffer[:, :N], gives another image than its copy",
            "the same image",
            "planes.contiguous(), or rows that are planes.stride(0) floats apart",
            "render",
        )
    return "twice the same bits, forward and backward, with differentiable=False, and from the front of a larger buffer"


def _speed(subject: Subject) -> Note:
    planes, view = random_scene(SceneSpec(7, 5000, 320, 96, 3.0, (0.1, 0.9)))
    subject.both_ways(planes, view)
    start = time.perf_counter()
    subject.both_ways(planes, view)
    return Note(f"{(time.perf_counter() - start) * 1e3:.1f} ms forward and backward, 5000 Gaussians at 320x96")


def checks_of(subject: Subject) -> tuple[Check[Subject], ...]:
    """All checks of a rasterizer; the speed of one that is compared with itself would take long and tell nothing."""
    checks: tuple[Check[Subject], ...] = (
        Check("worked by hand", _by_hand, essential=True),
        Check("images", _images),
        Check("gradients", _gradients),
        Check("harmonics", _harmonics),
        Check("observation", _observation),
        Check("learning", _learning),
        Check("nothing to see", _nothing_to_see),
        Check("determinism", _repeats),
    )
    return checks if subject.candidate.plugin.name == "reference" else (*checks, Check("speed", _speed))
