"""The fused L1 + L2 + SSIM kernel against a float64 conv2d SSIM written here, and the terms against both."""

from __future__ import annotations

import pytest
import torch
from loss_cases import random_case
from skimage.metrics import structural_similarity
from torch import Tensor

from bench import registry
from bench.contracts.loss import TorchLoss
from bench.contracts.rasterizer import Rendered
from bench.gaussians.loss_stack import LossStack
from bench.supervision.photometric import Photometric, photometric
from bench.supervision.ssim import local_statistics, ssim
from bench.supervision.target import Target
from plugins.losses.mse import MseConfig, MseLoss
from plugins.losses.rgb import RgbConfig, RgbLoss
from plugins.losses.ssim import SsimConfig, SsimLoss


def ssim_with_conv2d(image: Tensor, target: Tensor) -> Tensor:
    """Mean SSIM with an 11x11 Gaussian window (sigma 1.5), zero padding, float64, dense 2-D convolutions."""
    offsets = torch.arange(11, dtype=torch.float64) - 5
    window = torch.exp(-(offsets[:, None] ** 2 + offsets[None, :] ** 2) / (2 * 1.5**2))
    window = (window / window.sum()).expand(3, 1, 11, 11)

    def local_mean(x: Tensor) -> Tensor:
        return torch.nn.functional.conv2d(x[None], window, padding=5, groups=3)[0]

    x, y = image, target
    mx, my = local_mean(x), local_mean(y)
    vx, vy, cxy = local_mean(x * x) - mx**2, local_mean(y * y) - my**2, local_mean(x * y) - mx * my
    c1, c2 = 0.01**2, 0.03**2
    return ((2 * mx * my + c1) * (2 * cxy + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))).mean()


SIZES = [(41, 70), (17, 33), (5, 9), (3, 130), (1, 1), (130, 12), (257, 40), (128, 16), (16, 8)]


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize(
    "weights", [Photometric(0.8, 0.5, 0.2), Photometric(dssim=1.0), Photometric(1.0), Photometric(0.0, 1.0)]
)
def test_fused_kernel(height: int, width: int, weights: Photometric) -> None:
    """Sizes below the window, not a multiple of eight lanes, and around the kernel's bands of 128 rows."""
    rendered, target = random_case(height, width, seed=height)
    values, grad = photometric(rendered.color, target, weights)
    leaf, y = rendered.color.double().requires_grad_(), target.image.double()
    true_l1, true_l2, true_ssim = (leaf - y).abs().mean(), (leaf - y).square().mean(), ssim_with_conv2d(leaf, y)
    (weights.l1 * true_l1 + weights.l2 * true_l2 + weights.dssim * (1 - true_ssim)).backward()
    assert leaf.grad is not None
    assert values[:2] == pytest.approx((true_l1.item(), true_l2.item()), rel=1e-6)
    if weights.dssim:
        assert values.dssim == pytest.approx(1 - true_ssim.item(), abs=2e-6)
    error = float((grad.double() - leaf.grad).norm() / leaf.grad.norm())
    assert error < 2e-5


def test_the_float64_oracle_is_the_ssim_of_scikit_image() -> None:
    """In a black frame as wide as the window, zero padding and scikit-image's reflection are the same."""
    rendered, target = random_case(30, 34, seed=1)
    x, y = (torch.nn.functional.pad(t.double(), (12, 12, 12, 12)) for t in (rendered.color, target.image))
    theirs = structural_similarity(
        *(t.numpy() for t in (x, y)),
        channel_axis=0,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=1.0,
        full=True,
    )[1]
    assert float(ssim_with_conv2d(x, y)) == pytest.approx(float(theirs.mean()), abs=1e-9)


def test_identical_images_and_a_single_pixel_by_hand() -> None:
    """SSIM of an image with itself is 1 and its gradient 0; that of one pixel follows from its weight in the window."""
    _, target = random_case(23, 31, seed=2)
    values, grad = photometric(target.image.clone(), target, Photometric(0.8, 0.5, 0.2))
    assert values == (0.0, 0.0, pytest.approx(0.0, abs=1e-6))
    assert float(grad.abs().max()) < 1e-7
    # One pixel: its window holds the pixel with weight w = 0.26601172^2 and zeros elsewhere.
    w = 0.26601172**2
    x, y = 0.3, 0.7
    mx, my = w * x, w * y
    vx, vy, cov = w * x * x - mx * mx, w * y * y - my * my, w * x * y - mx * my
    by_hand = (2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
    _, one = random_case(1, 1, seed=0)
    single = Target(torch.full((3, 1, 1), y), one.depth, one.depth_mask, one.view)
    assert photometric(torch.full((3, 1, 1), x), single, Photometric(dssim=1.0))[0].dssim == pytest.approx(
        1 - by_hand, rel=1e-5
    )


def test_local_statistics_against_conv2d() -> None:
    _, target = random_case(21, 43, seed=3)
    offsets = torch.arange(11, dtype=torch.float64) - 5
    window = torch.exp(-(offsets[:, None] ** 2 + offsets[None, :] ** 2) / 4.5)
    window = (window / window.sum()).expand(3, 1, 11, 11)
    y = target.image.double()
    blur = [torch.nn.functional.conv2d(t[None], window, padding=5, groups=3)[0] for t in (y, y * y)]
    mean, variance = local_statistics(target.image)
    torch.testing.assert_close(mean.double(), blur[0], atol=1e-6, rtol=0)
    torch.testing.assert_close(variance.double(), blur[1] - blur[0] ** 2, atol=1e-6, rtol=0)


def _value_and_gradient(term: TorchLoss, rendered: Rendered, target: Target) -> tuple[float, Tensor]:
    result = term.evaluate(rendered, target)
    assert result.grad_color is not None
    return result.value, result.grad_color


def test_the_terms_agree_with_the_fused_pass() -> None:
    rendered, target = random_case(37, 50, seed=4)
    terms: dict[str, TorchLoss] = {
        "rgb": RgbLoss(RgbConfig("rgb", 0.8)),
        "mse": MseLoss(MseConfig("mse", 0.5)),
        "ssim": SsimLoss(SsimConfig("ssim", 0.2)),
    }
    values, (color, depth, alpha) = LossStack(list(terms.values())).evaluate(rendered, target)
    alone = {name: _value_and_gradient(term, rendered, target) for name, term in terms.items()}
    assert values == {name: pytest.approx(value, rel=1e-5) for name, (value, _) in alone.items()}
    assert color is not None
    assert depth is None
    assert alpha is None
    expected = sum(terms[name].config.weight * grad for name, (_, grad) in alone.items())
    assert float((color - expected).norm() / expected.norm()) < 2e-5


def test_torch_form_of_ssim_against_the_oracle() -> None:
    rendered, target = random_case(19, 27, seed=5)
    got = ssim(rendered.color, target.image, target.local_statistics)
    assert float(got) == pytest.approx(
        float(ssim_with_conv2d(rendered.color.double(), target.image.double())), abs=2e-6
    )


def test_terms_of_weight_zero_are_left_out() -> None:
    rendered, target = random_case(9, 9, seed=6)
    stack = LossStack([RgbLoss(RgbConfig("rgb", 1.0)), SsimLoss(SsimConfig("ssim", 0.0))])
    values, (color, _, _) = stack.evaluate(rendered, target)
    assert set(values) == {"rgb"}
    assert color is not None
    torch.testing.assert_close(color, torch.sign(rendered.color - target.image) / rendered.color.numel())


def test_default_weights_are_those_of_the_paper() -> None:
    """Paper, "Implementation Details": rgb 0.8, ssim 0.2, geo 0.1, normal 0.1, smooth 0.5."""
    weights = {name: registry.lookup("loss", name).config().weight for name in registry.names("loss") if name in PAPER}  # type: ignore[attr-defined]
    assert weights == PAPER


PAPER = {"rgb": 0.8, "ssim": 0.2, "geo": 0.1, "normal": 0.1, "smooth": 0.5}
