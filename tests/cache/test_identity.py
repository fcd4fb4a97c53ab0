"""What makes two answers the same, and what does not; and which code counts."""

from __future__ import annotations

import dataclasses
import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from network_plugins import CountingConfig, CountingStereo

from bench import code_version as module
from bench.cache.identity import Identity
from bench.code_version import code_version
from bench.types import DepthMap, StereoCamera, StereoFrame
from plugins.stereo.sgbm import Sgbm

CAMERA = StereoCamera(8, 6, 7.0, 7.0, 4.0, 3.0, (0.5, 0.0, 0.0))
PIXELS = np.random.default_rng(0).integers(0, 256, (2, 6, 8, 3), dtype=np.uint8)
FRAME = StereoFrame(3, 0.3, PIXELS[0], PIXELS[1])


def identity(config: CountingConfig | None = None, sequence: str = "kitti/06", kind: str = "stereo") -> Identity:
    config = config or CountingConfig(name="counting_for_tests")
    weights = {"network": Path(config.weights)} if config.weights else {}
    return Identity(kind, CountingStereo, config, weights, sequence)


def test_equal_input_has_one_key_and_any_change_another() -> None:
    key = identity().of_frame(FRAME, CAMERA)
    copied = StereoFrame(3, 99.0, np.asfortranarray(PIXELS[0]), PIXELS[1].copy())  # the time stamp is no input
    assert identity().of_frame(copied, CAMERA) == key
    one_grey_level = PIXELS[1].copy()
    one_grey_level[5, 7, 2] ^= 1
    others = [
        identity().of_frame(dataclasses.replace(FRAME, right=one_grey_level), CAMERA),
        identity().of_frame(dataclasses.replace(FRAME, left=PIXELS[1], right=PIXELS[0]), CAMERA),
        identity().of_frame(dataclasses.replace(FRAME, number=4), CAMERA),
        identity().of_frame(FRAME, dataclasses.replace(CAMERA, fx=7.5)),
        identity().of_frame(FRAME, dataclasses.replace(CAMERA, right_position=(0.54, 0.0, 0.0))),
        identity(CountingConfig(name="counting_for_tests", far=81.0)).of_frame(FRAME, CAMERA),
        identity(CountingConfig(name="another")).of_frame(FRAME, CAMERA),
        identity(sequence="kitti/07").of_frame(FRAME, CAMERA),
        identity(kind="sky").of_frame(FRAME, CAMERA),
    ]
    assert len({key, *others}) == len(others) + 1


def test_a_sky_mask_depends_on_image_and_depth() -> None:
    depth = np.full((6, 8), 5.0, np.float32)
    key = identity().of_image(PIXELS[0], DepthMap(depth, "a"), CAMERA)
    assert identity().of_image(PIXELS[0], DepthMap(depth.copy(), "b"), CAMERA) == key
    farther = depth.copy()
    farther[0, 0] = np.nextafter(np.float32(5), np.float32(6))
    assert identity().of_image(PIXELS[0], DepthMap(farther, "a"), CAMERA) != key
    assert identity().of_image(PIXELS[1], DepthMap(depth, "a"), CAMERA) != key


def test_the_contents_of_the_weights_count_and_not_their_place(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("one.pth", "copy.pth", "other.pth")]
    for path, content in zip(paths, (b"weights", b"weights", b"better"), strict=True):
        path.write_bytes(content)
    one, copy, other = (identity(CountingConfig(name="n", weights=str(path))).of_frame(FRAME, CAMERA) for path in paths)
    assert one == copy
    assert one != other
    # A file that is written anew at the same place counts as what it is now.
    paths[0].write_bytes(b"retrained weights")
    assert identity(CountingConfig(name="n", weights=str(paths[0]))).of_frame(FRAME, CAMERA) != one


PLUGIN = """
import numpy
from {package}.layers import convolution

class Net:
    def run(self):
        from . import lazy
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A plugin package: ``net`` imports ``layers`` (which imports ``deep``) and, late, ``lazy``; not ``unrelated``."""
    folder = tmp_path / "my_networks"
    folder.mkdir()
    for name, text in {
        "__init__": "",
        "net": PLUGIN.format(package="my_networks"),
        "layers": "import my_networks.deep\nfrom bench.errors import BenchError\ndef convolution(): ...\n",
        "deep": "depth = 1\n",
        "lazy": "raise ImportError('needs a GPU')\n",
        "unrelated": "",
    }.items():
        (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield folder
    for name in [name for name in sys.modules if name.startswith("my_networks")]:
        del sys.modules[name]


@pytest.mark.parametrize(
    ("file", "counts"), [("net", True), ("layers", True), ("deep", True), ("lazy", True), ("unrelated", False)]
)
def test_the_code_that_a_plugin_imports_counts(package: Path, file: str, counts: bool) -> None:
    net = importlib.import_module("my_networks.net").Net
    before = code_version(net)
    assert code_version(net) == before
    with open(package / f"{file}.py", "a") as source:
        source.write("# changed\n")
    assert (code_version(net) != before) == counts


def test_the_contract_counts_and_the_rest_of_the_framework_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """The contract holds ``StereoBackbone.depth``: a change there changes depth."""
    asked: list[str] = []
    file_of = module._file_of

    def noted(name: str) -> Path | None:
        asked.append(name)
        return file_of(name)

    monkeypatch.setattr(module, "_file_of", noted)
    module.code_version(Sgbm)
    assert "bench.contracts.stereo" in asked
    assert not [name for name in asked if name.startswith(("bench.registry", "bench.errors", "numpy", "cv2"))]
