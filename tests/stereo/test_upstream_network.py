"""The plugins around published networks, with the authors' code replaced by stand-ins that run in real processes."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bench import registry
from bench.config import compose_run
from bench.contracts.stereo import DepthSource
from bench.errors import BenchError
from bench.stereo.upstream.network import UpstreamConfig, UpstreamNetwork
from bench.stereo.upstream.temporal import TemporalConfig, TemporalUpstreamNetwork
from bench.types import Image, StereoCamera, StereoFrame
from tests.stereo.fake_upstream import (
    igev_checkout,
    igev_checkpoint,
    tcsm_checkout,
    tcsm_checkpoint,
    write_files,
)

NAMES = ("igev", "igev_plusplus", "tcsm", "monster_k", "monster_m", "mocha", "foundation_stereo")
HEIGHT, WIDTH = 37, 70
CAMERA = StereoCamera(WIDTH, HEIGHT, 100.0, 110.0, 34.0, 18.0, (0.5, 0.0, 0.0))


def network(name: str, **settings: object) -> UpstreamNetwork:
    plugin = registry.lookup("stereo", name)
    built = plugin.cls(plugin.config(name=name, device="cpu", **settings))  # type: ignore[call-arg]
    assert isinstance(built, UpstreamNetwork)
    return built


def constant_pair(left_rgb: tuple[int, int, int], right_rgb: tuple[int, int, int]) -> tuple[Image, Image]:
    left, right = (np.full((HEIGHT, WIDTH, 3), rgb, np.uint8) for rgb in (left_rgb, right_rgb))
    return left, right


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("upstream")


@pytest.fixture(scope="module")
def igev(folder: Path) -> Iterator[UpstreamNetwork]:
    files = {"checkout": str(igev_checkout(folder / "IGEV")), "weights": str(igev_checkpoint(folder / "kitti15.pth"))}
    built = network("igev", **files)
    yield built
    built.close()


@pytest.fixture(scope="module")
def tcsm(folder: Path) -> Iterator[TemporalUpstreamNetwork]:
    files = {"checkout": str(tcsm_checkout(folder / "TCSM")), "weights": str(tcsm_checkpoint(folder / "raw.pth"))}
    built = network("tcsm", **files)
    assert isinstance(built, TemporalUpstreamNetwork)
    yield built
    built.close()


@pytest.mark.slow
def test_two_networks_of_one_package_name_side_by_side(igev: UpstreamNetwork, tcsm: UpstreamNetwork) -> None:
    """Both stand-ins assert that ``core.which`` is their own."""
    pair = constant_pair((40, 1, 2), (3, 25, 4))
    for _ in range(2):
        # gain (40 - 25) + 16 iterations, worked by hand; a swap of sides or channels gives another number.
        np.testing.assert_array_equal(igev.disparity(*pair), np.full((HEIGHT, WIDTH), 46.0, np.float32))
        np.testing.assert_array_equal(tcsm.disparity(*pair), np.full((HEIGHT, WIDTH), 20.0, np.float32))
    assert not [name for name in sys.modules if name.partition(".")[0] in ("core", "cupy")]


@pytest.mark.slow
def test_padding_is_taken_off_where_it_was_put_on(igev: UpstreamNetwork) -> None:
    rng = np.random.default_rng(1)
    left, right = (rng.integers(30, 200, (HEIGHT, WIDTH, 3), dtype=np.uint8) for _ in range(2))
    expected = 2.0 * (left[:, :, 0].astype(np.float32) - right[:, :, 1]) + 16
    np.testing.assert_array_equal(igev.match(left, right), expected)
    # What has no positive disparity is unknown.
    np.testing.assert_array_equal(igev.disparity(left, right), np.where(expected > 0, expected, np.nan))


def test_weights_for_provenance(igev: UpstreamNetwork, folder: Path) -> None:
    assert igev.weights() == {
        "network": folder / "kitti15.pth",
        "code": folder / "IGEV" / "IGEV-Stereo" / "core" / "igev_stereo.py",
    }


def test_the_process_dies(folder: Path, igev: UpstreamNetwork) -> None:
    """The last use of this fixture: the stand-in ends its process when it sees white in the corner."""
    with pytest.raises(BenchError) as error:
        igev.disparity(*constant_pair((255, 0, 0), (0, 0, 0)))
    assert str(error.value).startswith("stereo=igev: the process of IGEV-Stereo ended with exit code 7")
    with pytest.raises(BenchError, match="the process of IGEV-Stereo is not running"):
        igev.disparity(*constant_pair((40, 1, 2), (3, 25, 4)))


@pytest.mark.slow
def test_what_the_process_refuses_is_told(folder: Path) -> None:
    """Through another interpreter's start, which sees the bench's modules but not the folder that holds them."""
    wrong = tcsm_checkpoint(folder / "wrong.pth")
    with pytest.raises(BenchError) as error:
        network("igev", checkout=str(igev_checkout(folder / "again")), weights=str(wrong), python=sys.executable)
    assert str(error.value) == (
        f"stereo=igev: The checkpoint {wrong} does not fit IGEVStereo: of 6 keys 4 missing (norm.weight, norm.bias, "
        "norm.running_mean, ...). Is it of another network, or of other settings?"
    )


@pytest.mark.parametrize("name", NAMES)
def test_every_network_says_what_to_fetch(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BGS_CACHE", str(tmp_path))
    monkeypatch.delenv("BGS_WEIGHTS", raising=False)
    with pytest.raises(BenchError) as error:
        network(name)
    text = str(error.value)
    assert text.startswith(f"stereo={name} runs the authors' own ")
    assert "run `git clone https://github.com/" in text
    assert f"`bgs-bench weights get {name}`" in text or str(tmp_path / "weights") in text
    assert "licence: " in text
    assert f"`stereo={name} stereo.checkout=FOLDER`" in text
    assert f"`stereo={name} stereo.onnx=FILE`" in text
    assert "\n" not in text


@pytest.mark.parametrize("name", NAMES)
def test_every_network_can_be_chosen(name: str) -> None:
    config = compose_run([f"stereo={name}", "stereo.checkout=some/where", "stereo.iterations=9"]).plugin("stereo")
    assert isinstance(config, UpstreamConfig)
    assert Path(config.checkout).is_absolute()
    assert config.iterations == 9
    assert registry.lookup("stereo", name).unavailable_reason() is None


def test_only_tcsm_is_temporal() -> None:
    classes = {name: registry.lookup("stereo", name).cls for name in NAMES}
    assert all(issubclass(cls, DepthSource) and cls.worth_caching for cls in classes.values())
    assert {name for name, cls in classes.items() if cls.temporal} == {"tcsm"}


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (
            {"checkout": "nowhere"},
            r"stereo\.checkout=nowhere does not exist\. Give the folder that `git clone https://",
        ),
        ({"checkout": "{empty}"}, r"holds no IGEV-Stereo/core/igev_stereo\.py\. Give the folder"),
        ({"checkout": "{empty}", "weights": "no.pth"}, r"stereo\.weights=no\.pth is no file"),
        ({"checkout": "{empty}", "onnx": "x.onnx"}, r"stereo\.checkout and stereo\.onnx are both set"),
        ({"onnx": "x.onnx"}, r"stereo\.weights and stereo\.onnx are both set"),
        ({"onnx": "x.onnx", "weights": ""}, r"stereo\.onnx=x\.onnx is no file"),
        ({"checkout": "{empty}", "dtype": "bfloat16"}, r"stereo\.dtype='bfloat16' is not one of float32, float16"),
        (
            {"checkout": "{empty}", "iterations": -1},
            r"stereo\.iterations=-1 is too small; the least is 0",
        ),
        ({"checkout": "{empty}", "timeout_s": 0.0}, r"stereo\.timeout_s=0\.0 must be above 0"),
        ({"checkout": "{igev}", "python": "/no/python"}, r"/no/python could not be started .* Correct stereo\.python"),
        ({"checkout": "{igev}", "start_timeout_s": 0.01}, r"gave no answer within 0\.01 s and was killed"),
    ],
)
def test_wrong_settings(tmp_path: Path, settings: dict[str, object], told: str) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    places = {"{empty}": str(empty), "{igev}": str(igev_checkout(tmp_path / "igev"))}
    weights = {"weights": str(igev_checkpoint(tmp_path / "net.pth"))}
    with pytest.raises(BenchError, match=told):
        network("igev", **weights | {key: places.get(str(value), value) for key, value in settings.items()})


def test_the_root_may_be_given_itself(tmp_path: Path) -> None:
    root = igev_checkout(tmp_path) / "IGEV-Stereo"
    recipe = registry.lookup("stereo", "igev").cls.recipe
    assert recipe.root_in(tmp_path) == recipe.root_in(root) == root


def test_monster_needs_its_monocular_updates(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"iterations=7 is too few for MonSter; the least is 8, its authors use 32"):
        network("monster_m", checkout=str(tmp_path), iterations=7)


def test_foundation_stereo_reads_the_settings_beside_its_checkpoint(tmp_path: Path) -> None:
    """They go over the recipe's; the number format is the bench's setting; what is no plain value is left out."""
    checkout = write_files(tmp_path / "fs", {"core/foundation_stereo.py": ""})
    weights = igev_checkpoint(tmp_path / "model_best_bp2.pth")
    plugin = registry.lookup("stereo", "foundation_stereo").cls
    settings = UpstreamConfig(
        name="foundation_stereo", checkout=str(checkout), weights=str(weights), python="/no/python"
    )
    with pytest.raises(BenchError, match=r"settings .*cfg\.yaml can't be read .* beside the checkpoint: put it there"):
        plugin(settings)
    (tmp_path / "cfg.yaml").write_text("max_disp: 416\nvit_size: vits\nmixed_precision: true\nlr: {start: 1}\n")
    unstarted = plugin.__new__(plugin)
    unstarted.weights_path, unstarted._config = weights, settings
    assert unstarted._arguments() == {"max_disp": 416, "vit_size": "vits", "mixed_precision": False, "low_memory": 0}


class _Motions:
    """Stands for the estimated motion, so that the test knows it."""

    def __init__(self) -> None:
        self.step_m: float | None = 1.0

    def __call__(self, before: Image, depth: object, now: Image, camera: StereoCamera) -> np.ndarray | None:
        if self.step_m is None:
            return None
        T = np.eye(4)
        T[2, 3] = -self.step_m
        return T


@pytest.mark.slow
def test_tcsm_uses_the_frame_before_and_begins_anew_on_a_jump(
    tcsm: TemporalUpstreamNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stand-in gives 20 px alone, 30 px minus the forward motion in metres with the frame before."""
    motions = _Motions()
    monkeypatch.setattr("bench.stereo.upstream.temporal.motion_between", motions)
    left, right = constant_pair((40, 1, 2), (3, 25, 4))

    def disparity_of(number: int) -> float:
        depth = tcsm.depth(StereoFrame(number, 0.0, left, right), 0, CAMERA).depth
        disparity = CAMERA.fx * CAMERA.baseline / depth
        assert np.ptp(disparity) == 0
        return float(disparity[0, 0])

    class _Sequence:
        def require_right(self, part: str, instead: str) -> None:
            """It has right images."""

    tcsm.start(_Sequence())  # type: ignore[arg-type]
    assert [disparity_of(number) for number in (3, 4)] == pytest.approx([20, 29])
    motions.step_m = 2.5
    assert disparity_of(9) == pytest.approx(27.5)  # 5 frames later, the most that max_gap lets pass
    assert disparity_of(15) == pytest.approx(20)  # 6 frames later
    assert disparity_of(15) == pytest.approx(20)  # the same frame again
    assert disparity_of(16) == pytest.approx(27.5)
    motions.step_m = 9.0
    assert disparity_of(17) == pytest.approx(20)  # further than max_step_m
    motions.step_m = None
    assert disparity_of(18) == pytest.approx(20)  # no motion was found
    motions.step_m = 1.0
    assert disparity_of(19) == pytest.approx(29)
    tcsm.start(_Sequence())  # type: ignore[arg-type]
    assert disparity_of(20) == pytest.approx(20)


def test_tcsm_takes_no_strips(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"for whole images: leave stereo\.tile_rows at 0"):
        network("tcsm", checkout=str(tmp_path), tile_rows=100)
    with pytest.raises(BenchError, match=r"stereo\.max_gap=-1 must not be negative"):
        network("tcsm", checkout=str(tmp_path), max_gap=-1)
    assert TemporalConfig().max_gap == 5


@pytest.mark.slow
def test_onnx_file_takes_the_place_of_checkout_and_weights(weights_root: Path) -> None:
    """On a real network: the same bits as stereo=onnx gives, and no process."""
    file = weights_root / "nvtiny" / "nvtiny_161x513.onnx"
    rng = np.random.default_rng(2)
    left, right = (rng.integers(0, 256, (90, 260, 3), dtype=np.uint8) for _ in range(2))
    plugin = registry.lookup("stereo", "onnx")
    alone = plugin.cls(plugin.config(name="onnx", weights=str(file), preset="nvtiny", device="cpu"))  # type: ignore[call-arg]
    exported = network("tcsm", onnx=str(file), onnx_preset="nvtiny")
    np.testing.assert_array_equal(exported.disparity(left, right), alone.disparity(left, right))
    assert exported.weights() == {"network": file}
    assert not exported.temporal
    with pytest.raises(BenchError, match=r"stereo\.left=left: .* has 'left:0' \(1, 161, 513, 3\) float"):
        network("igev", onnx=str(file))
