"""SegFormer's calling convention, on a hand-written ONNX file and on a stand-in for ``transformers``.

Its real weights are not free to share, so no number here says how good the published network is.
"""

from __future__ import annotations

import importlib.machinery
import json
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from small_onnx import write_classifier

from bench.errors import BenchError
from bench.types import DepthMap, Image, StereoCamera
from plugins.sky.segformer import Segformer, SegformerConfig

CAMERA = StereoCamera(96, 64, 50.0, 50.0, 47.5, 31.5, (0.5, 0.0, 0.0))
MEAN, STD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])


def without_depth(image: Image) -> DepthMap:
    return DepthMap(np.full(image.shape[:2], np.nan, dtype=np.float32), "none")


def smooth_picture() -> Image:
    """Colours that change slowly, so that each class has some area."""
    noise = np.random.default_rng(0).standard_normal((1, 3, 6, 9))
    wide = torch.nn.functional.interpolate(torch.from_numpy(noise), size=(64, 96), mode="bicubic")[0]
    return np.clip(128 + 70 * wide.numpy().transpose(1, 2, 0), 0, 255).astype(np.uint8)


def expected(image: Image, kernel: np.ndarray, sky: int) -> np.ndarray:
    """Upsampled logits, then argmax, in torch and float64."""
    planes = (image / 255.0 - MEAN) / STD
    logits = torch.from_numpy(np.einsum("kc,hwc->khw", kernel, planes[::4, ::4]))
    full = torch.nn.functional.interpolate(logits[None], size=image.shape[:2], mode="bilinear", align_corners=False)
    return full[0].argmax(dim=0).numpy() == sky


@pytest.fixture
def kernel() -> np.ndarray:
    return np.random.default_rng(1).standard_normal((19, 3))


@pytest.mark.parametrize("size", [("h", "w"), (64, 96)])
def test_the_class_sky_is_the_argmax_of_upsampled_logits(tmp_path: Path, kernel: np.ndarray, size: Any) -> None:
    image = smooth_picture()
    file = write_classifier(tmp_path / "net.onnx", kernel, 4, size=size)
    used = set()
    for sky in range(19):
        found = Segformer(SegformerConfig(weights=str(file), sky_class=sky)).segment(
            image, without_depth(image), CAMERA
        )
        true = expected(image, kernel, sky)
        assert (found != true).mean() < 1e-3, "float32 at the border of two classes"
        used.add(bool(true.any()))
    assert used == {True, False}
    default = Segformer(SegformerConfig(weights=str(file)))
    assert np.array_equal(
        default.segment(image, without_depth(image), CAMERA),
        Segformer(SegformerConfig(weights=str(file), sky_class=10)).segment(image, without_depth(image), CAMERA),
    )
    assert default.weights() == {"sky": file}


def test_a_file_of_another_size_gets_the_image_resized(tmp_path: Path) -> None:
    """Blue above grey: class 1 is blue less red, class 0 its opposite; the file takes 32x32 only."""
    file = write_classifier(tmp_path / "net.onnx", np.array([[1.0, 0, -1], [-1.0, 0, 1]]), 4, size=(32, 32))
    image = np.full((64, 96, 3), 90, dtype=np.uint8)
    image[:, :, 0] = 140
    image[:32] = (60, 90, 200)
    found = Segformer(SegformerConfig(weights=str(file), sky_class=1)).segment(image, without_depth(image), CAMERA)
    assert found[:28].all()
    assert not found[36:].any()


def test_stereo_removes_what_is_near(tmp_path: Path) -> None:
    file = write_classifier(tmp_path / "net.onnx", np.array([[1.0, 0, -1], [-1.0, 0, 1]]), 4)
    image = np.full((64, 96, 3), (60, 90, 200), dtype=np.uint8)
    near = DepthMap(np.full((64, 96), 8.0, dtype=np.float32), "test")
    segformer = Segformer(SegformerConfig(weights=str(file), sky_class=1))
    assert segformer.segment(image, without_depth(image), CAMERA).all()
    assert not segformer.segment(image, near, CAMERA).any()


def test_other_inputs_than_configured_are_listed(tmp_path: Path) -> None:
    file = str(write_classifier(tmp_path / "net.onnx", np.eye(3), 4, inputs=("pixel_values", "mask")))
    with pytest.raises(BenchError, match=r"has the inputs 'pixel_values' .*, 'mask' .*; say which .* sky.input_name="):
        Segformer(SegformerConfig(weights=file))
    with pytest.raises(BenchError, match=r"sky.input_name=pixels: .* it has 'pixel_values' .*Did you mean 'pixel_val"):
        Segformer(SegformerConfig(weights=file, input_name="pixels"))
    with pytest.raises(BenchError, match=r"sky.output_name=logit: .* it has 'logits' tensor\(float\)"):
        Segformer(SegformerConfig(weights=file, input_name="pixel_values", output_name="logit"))


def test_wrong_settings(tmp_path: Path) -> None:
    image = np.zeros((64, 96, 3), dtype=np.uint8)
    file = str(write_classifier(tmp_path / "net.onnx", np.eye(3), 4, size=(32, 48)))
    with pytest.raises(BenchError, match=r"sky.size=\[64, 96\]: .*net.onnx takes \[32, 48\] only"):
        Segformer(SegformerConfig(weights=file, size=(64, 96)))
    with pytest.raises(BenchError, match=r"sky.size=\[64, 0\] is no size; give \[height,width\]"):
        Segformer(SegformerConfig(weights=file, size=(64, 0)))
    with pytest.raises(BenchError, match=r"returns 3 maps, so sky.sky_class=10 does not exist"):
        Segformer(SegformerConfig(weights=file)).segment(image, without_depth(image), CAMERA)


class FakeModel(torch.nn.Module):
    """As the real one is called: ``model(pixel_values=[1, 3, h, w]).logits`` is [1, classes, h/4, w/4]."""

    def forward(self, pixel_values: torch.Tensor) -> types.SimpleNamespace:
        blue = pixel_values[:, 2:, ::4, ::4]
        return types.SimpleNamespace(logits=torch.cat([-blue, torch.zeros_like(blue), blue], dim=1))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "config.json").write_text(json.dumps({"label2id": {"road": 0, "tree": 1, "sky": 2}}))
    (tmp_path / "model.safetensors").write_bytes(b"weights")
    return tmp_path


def test_a_hugging_face_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, bool]] = []

    def from_pretrained(path: str, local_files_only: bool) -> FakeModel:
        asked.append((path, local_files_only))
        return FakeModel()

    fake = types.ModuleType("transformers")
    fake.__spec__ = importlib.machinery.ModuleSpec("transformers", None)
    fake.SegformerForSemanticSegmentation = types.SimpleNamespace(from_pretrained=from_pretrained)  # type: ignore
    monkeypatch.setitem(sys.modules, "transformers", fake)
    # The weights' manifest names the file, a user may name the folder.
    for given in (folder, folder / "model.safetensors"):
        segformer = Segformer(SegformerConfig(weights=str(given), device="cpu"))
        image = np.zeros((64, 96, 3), dtype=np.uint8)
        # Normalised blue is positive above 0.406 * 255 = 103.5.
        image[:32, :, 2], image[32:, :, 2] = 110, 97
        found = segformer.segment(image, without_depth(image), CAMERA)
        assert found[:28].all()
        assert not found[36:].any()
        assert segformer.weights() == {"sky": folder / "model.safetensors"}
    assert asked == [(str(folder), True)] * 2


def test_without_transformers_the_message_has_the_command(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.sky.transformers_network.find_spec", lambda name: None)
    with pytest.raises(BenchError, match=r"is not installed. Run: pip install transformers \(or give an ONNX file\)"):
        Segformer(SegformerConfig(weights=str(folder)))


def test_a_folder_without_weights_or_that_does_not_load(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = types.ModuleType("transformers")
    fake.__spec__ = importlib.machinery.ModuleSpec("transformers", None)
    monkeypatch.setitem(sys.modules, "transformers", fake)
    with pytest.raises(BenchError, match=r"transformers can't load SegFormer from .* \(module 'transformers' has no"):
        Segformer(SegformerConfig(weights=str(folder), device="cpu"))
    (folder / "model.safetensors").unlink()
    with pytest.raises(BenchError, match=r"has neither model.safetensors nor pytorch_model.bin. Fetch one of them"):
        Segformer(SegformerConfig(weights=str(folder)))
