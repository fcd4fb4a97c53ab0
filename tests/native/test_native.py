"""The bindings of the C++ core: what they check, and that threads behave."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from bench import _native
from bench.authoring.random_scenes import SceneSpec, image_gradients, random_scene
from bench.contracts.rasterizer import AdamStep
from bench.gaussians.schema import planes_of
from bench.plugin_config import PluginConfig
from plugins.rasterizers.cpu import CpuRasterizer


@pytest.fixture(autouse=True)
def _threads_as_before() -> Iterator[None]:
    before = _native.threads()
    yield
    _native.set_threads(before)


def test_says_which_kernels_run() -> None:
    assert _native.instruction_set() in ("avx512", "avx2", "baseline")


@pytest.mark.parametrize("threads", [0, -1, 1025])
def test_number_of_threads_has_limits(threads: int) -> None:
    with pytest.raises(ValueError, match="threads must be between 1 and 1024"):
        _native.set_threads(threads)


def _photometric_value(image: torch.Tensor) -> float:
    mean, variance = torch.empty_like(image), torch.empty_like(image)
    target = image.flip(1).contiguous()
    _native.target_statistics(target, mean, variance)
    l1, _, similarity = _native.photometric(image, target, mean, variance, 0.8, 0.0, 0.2, torch.empty_like(image))
    return float(l1 + similarity)


def test_calls_from_several_python_threads_wait_for_each_other() -> None:
    _native.set_threads(2)
    images = [torch.rand(3, 40, 60, generator=torch.Generator().manual_seed(k)) for k in range(4)]
    alone = [_photometric_value(image) for image in images]
    together: dict[int, list[float]] = {}

    def work(k: int) -> None:
        together[k] = [_photometric_value(images[k]) for _ in range(50)]

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
    assert together == {k: [value] * 50 for k, value in enumerate(alone)}


def _in_child(results: multiprocessing.Queue[float]) -> None:
    results.put(_photometric_value(torch.full((3, 24, 24), 0.25)))


def test_works_after_a_fork() -> None:
    """Launchers fork; the threads of the parent do not exist in the child."""
    _native.set_threads(2)
    expected = _photometric_value(torch.full((3, 24, 24), 0.25))
    context = multiprocessing.get_context("fork")
    results = context.Queue()
    child = context.Process(target=_in_child, args=(results,))
    child.start()
    assert results.get(timeout=30) == expected
    child.join(timeout=30)
    assert child.exitcode == 0


@pytest.mark.parametrize(
    ("shape", "text"),
    [((3, 5, 7), "target, mean and variance must have the image's shape"), ((5, 6), "incompatible function arguments")],
)
def test_images_of_different_shapes_are_refused(shape: tuple[int, ...], text: str) -> None:
    image, other = torch.zeros(3, 5, 6), torch.zeros(*shape)
    with pytest.raises((ValueError, TypeError), match=text):
        _native.photometric(image, other, image, image, 1.0, 0.0, 0.0, None)


def test_adam_refuses_wrong_shapes() -> None:
    planes, rates = torch.zeros(14, 6), [0.1] * 14
    common = (0.9, 0.999, 1e-15, 1, None)
    with pytest.raises(ValueError, match=r"grads must have shape \(P, M\)"):
        _native.adam_step(planes, planes, planes, torch.zeros(14, 5), None, rates, *common)
    with pytest.raises(ValueError, match=r"must have the same shape \(P, M\), M at most N"):
        _native.adam_step(planes, torch.zeros(14, 7), torch.zeros(14, 7), planes, None, rates, *common)
    with pytest.raises(ValueError, match="second: each row must be contiguous"):
        _native.adam_step(planes, planes, torch.zeros(6, 14).T, planes, None, rates, *common)
    with pytest.raises(ValueError, match="rates must have one entry per plane"):
        _native.adam_step(planes, planes, planes, planes, None, rates[:3], *common)
    with pytest.raises(ValueError, match=r"position_rate must have shape \(M,\)"):
        _native.adam_step(planes, planes, planes, planes, torch.zeros(5), rates, *common)


@pytest.mark.parametrize("degree", [0, 3])
def test_adam_is_that_of_torch_for_any_number_of_planes(degree: int) -> None:
    generator = torch.Generator().manual_seed(3)
    start = torch.randn(planes_of(degree), 11, generator=generator)
    rates = [0.001 * (1 + k % 7) for k in range(len(start))]
    planes, first, second = start.clone(), torch.zeros_like(start), torch.zeros_like(start)
    rows = [row.double().requires_grad_() for row in start]
    theirs = torch.optim.Adam([{"params": [row], "lr": rate} for row, rate in zip(rows, rates, strict=True)], eps=1e-15)
    for step in range(1, 4):
        grads = torch.randn(start.shape, generator=generator)
        _native.adam_step(planes, first, second, grads, None, rates, 0.9, 0.999, 1e-15, step, None)
        for row, grad in zip(rows, grads.double(), strict=True):
            row.grad = grad
        theirs.step()
    torch.testing.assert_close(planes.double(), torch.stack(rows).detach(), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("pose", [False, True])
@pytest.mark.parametrize(("degree", "count", "learning"), [(0, 5000, 5000), (0, 4100, 3003), (3, 2100, 2048)])
def test_learning_at_once_gives_the_bits_of_backward_and_a_step(
    degree: int, count: int, learning: int, pose: bool
) -> None:
    planes, view = random_scene(SceneSpec(2, count, 90, 50, 3.0, (0.1, 0.9), degree))
    generator = torch.Generator().manual_seed(4)
    moments = torch.randn(2, len(planes), learning, generator=generator).abs() * 1e-3
    settings = (torch.rand(learning, generator=generator), [1e-2] * len(planes), 0.9, 0.99, 1e-15, 3)
    results = []
    for at_once in (False, True):
        rasterizer, buffer, (first, second) = CpuRasterizer(PluginConfig("cpu")), planes.clone(), moments.clone()
        rendered = rasterizer.render(buffer, view)
        step = AdamStep(buffer[:, :learning], first, second, *settings)
        if at_once:
            twist = rasterizer.learn(rendered, *image_gradients(view, 1), step, pose)
        else:
            by = rasterizer.backward(rendered, *image_gradients(view, 1), pose=pose, learning=learning)
            _native.adam_step(step.planes, first, second, by.planes, *settings, by.touched)
            twist = by.twist
        results.append([buffer, first, second, *([] if twist is None else [twist])])
    for one, other in zip(*results, strict=True):
        assert torch.equal(one, other)
    assert len(results[0]) == 3 + pose
    assert not torch.equal(results[0][0][:, :learning], planes[:, :learning])
    assert torch.equal(results[0][0][:, learning:], planes[:, learning:])


def test_learning_refuses_other_parameters() -> None:
    planes, view = random_scene(SceneSpec(2, 50, 40, 30, 3.0, (0.1, 0.9)))
    workspace, images = _native.Workspace(), [torch.zeros(shape) for shape in ((3, 30, 40), (30, 40), (30, 40))]
    workspace.forward(planes, view.T_cam_world, view.fx, view.fy, view.cx, view.cy, *images)
    rest = (torch.zeros(14, 50), torch.zeros(14, 50), None, [0.1] * 14, 0.9, 0.99, 1e-15, 1, False)
    with pytest.raises(ValueError, match="params must be the first Gaussians of planes"):
        workspace.learn(planes, *images, planes.clone(), *rest)
    with pytest.raises(ValueError, match=r"grad_color must have shape \(3, H, W\)"):
        workspace.learn(planes, torch.zeros(3, 20, 40), None, None, planes, *rest)


def test_backward_without_its_forward_is_refused() -> None:
    planes, touched = torch.zeros(14, 3), torch.zeros(3, dtype=torch.bool)
    with pytest.raises(ValueError, match="planes are not those of the forward pass"):
        _native.Workspace().backward(planes, None, None, None, planes.clone(), touched, False)


@pytest.mark.slow
def test_the_build_for_every_machine_gives_the_same_images() -> None:
    """The rasterizer's own tests with the kernels that need no AVX2; they are chosen at load, hence the process."""
    tests = Path(__file__).parent.parent / "rasterizers" / "test_cpu_rasterizer.py"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", str(tests)],
        env=os.environ | {"BGS_KERNELS": "baseline"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert " passed" in done.stdout
