"""``bgs-bench view``: what is sent of a map, where it listens, and what it says where it can't."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from plyfile import PlyData
from scipy.spatial.transform import Rotation
from scipy.special import expit

from bench.cli import main
from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.gaussians.map import GaussianMap
from bench.viewers.splats import read_splats
from tests.evaluation.tiny_run import write_tiny_run
from tests.report.conftest import HOSTILE, tiny_config

COUNT, SKY = 40, 7
_VISER = {"reason": "viser is not installed: pip install 'bgs-slam-bench[viewer]'"}


def write_map(folder: Path) -> Path:
    """A map of two keyframes and a sky, and which Gaussian belongs to which."""
    gaussians, random = GaussianMap(1, "cpu"), torch.Generator().manual_seed(0)
    for number in (10, 13):
        gaussians.add(number, np.eye(4), torch.randn(23, COUNT // 2, generator=random), torch.ones(COUNT // 2))
    gaussians.add_sky(np.zeros(3), torch.randn(23, SKY, generator=random), torch.ones(SKY), 1e-6)
    gaussians.save(folder / "map.ply")
    np.save(folder / "map_keyframes.npy", gaussians.keyframes_of_all())
    return folder / "map.ply"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = write_tiny_run(tmp_path / HOSTILE.replace("/", "_"), tiny_config())
    write_map(folder)
    return folder


@pytest.fixture
def page(run: Path) -> Iterator[Any]:
    pytest.importorskip("viser", **_VISER)
    from bench.viewers.page import Page

    page = Page(SavedRunFolder(run), "127.0.0.1", 18080, 30)
    yield page
    page.stop()


def test_splats_are_what_the_file_says(tmp_path: Path) -> None:
    """Worked out from the file by plyfile and scipy."""
    vertex = PlyData.read(str(write_map(tmp_path)))["vertex"]

    def columns(*names: str) -> np.ndarray:
        return np.stack([np.asarray(vertex[name], np.float64) for name in names], axis=1)

    w, x, y, z = columns("rot_0", "rot_1", "rot_2", "rot_3").T
    turns = Rotation.from_quat(np.stack([x, y, z, w], axis=1)).as_matrix()
    variances = np.exp(2 * columns("scale_0", "scale_1", "scale_2"))
    splats = read_splats(tmp_path / "map.ply", 1000)
    assert (len(splats), splats.whole, splats.sky, splats.sh_degree) == (COUNT + SKY, COUNT + SKY, SKY, 1)
    np.testing.assert_allclose(splats.centers, columns("x", "y", "z"), rtol=1e-6)
    np.testing.assert_allclose(splats.covariances, np.einsum("nij,nj,nkj->nik", turns, variances, turns), atol=1e-5)
    # The constant harmonic is 1 / sqrt(4 pi), and grey its zero.
    colors = 0.5 + columns("f_dc_0", "f_dc_1", "f_dc_2") / np.sqrt(4 * np.pi)
    np.testing.assert_allclose(splats.colors, colors.clip(0, 1), atol=1e-6)
    np.testing.assert_allclose(splats.opacities, expit(columns("opacity")), rtol=1e-5)
    assert splats.keyframes is not None
    assert splats.keyframes.tolist() == [-1] * SKY + [10] * (COUNT // 2) + [13] * (COUNT // 2)


def test_of_a_large_map_those_that_cover_most_are_sent(tmp_path: Path) -> None:
    planes = torch.zeros(14, 50)
    planes[6], planes[3:6] = 1.0, torch.linspace(-3, 0, 50)
    planes[:3] = torch.arange(50)
    planes[3:6, 10] = 20.0  # longer than a half float holds
    gaussians = GaussianMap(0, "cpu")
    gaussians.add(0, np.eye(4), planes, torch.ones(50))
    gaussians.save(tmp_path / "map.ply")
    splats = read_splats(tmp_path / "map.ply", 3)
    assert splats.centers[:, 0].tolist() == [10, 48, 49]
    assert (len(splats), splats.whole, splats.keyframes) == (3, 50, None)
    assert np.isfinite(splats.covariances.astype(np.float16)).all()


def test_keyframes_of_another_map_are_refused(tmp_path: Path) -> None:
    ply = write_map(tmp_path)
    np.save(tmp_path / "map_keyframes.npy", np.zeros(COUNT, np.int32))
    with pytest.raises(BenchError, match="belongs to another map"):
        read_splats(ply, 9)


def test_it_listens_on_this_machine_alone(page: Any) -> None:
    port = page.server.get_port()
    listening = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    # State 0A is LISTEN; addresses are hexadecimal, the last byte first.
    assert [row[1] for row in listening if row[1].endswith(f":{port:04X}") and row[3] == "0A"] == [
        f"0100007F:{port:04X}"
    ]
    assert page.url == f"http://127.0.0.1:{port}"
    assert page.server.request_share_url() is None


def test_a_frames_words_are_text(page: Any, run: Path) -> None:
    (run / "views/left/color/000011.png").write_bytes(b"spoilt")
    page._at.value = 1
    page._show_frame()
    shown = page._about.content
    assert "Frame 11, keyframe" in shown
    assert "is damaged" in shown
    assert "&lt;script&gt;" in shown
    assert "<script>" not in shown
    assert [each.visible for each in page._images.values()] == [True, False, True]


def test_the_map_up_to_a_frame_and_what_is_left_out(page: Any) -> None:
    page._show_until(12)
    assert [(first, piece.visible) for first, piece in page._pieces] == [(10, True), (13, False)]
    assert page.notes[0] == "30 of 47 Gaussians, those that cover most; --max-gaussians N shows more"
    assert page.notes[1].startswith("colours do not change with the direction")


def spoilt(run: Path, how: str) -> list[str]:
    """Arguments, and the run made so that they are wrong."""
    if how == "missing":
        return [str(run.with_name("nowhere"))]
    if how == "no map":
        (run / "map.ply").unlink()
    if how == "no mapper":
        config = (run / "config.yaml").read_text()
        (run / "config.yaml").write_text(config.replace("name: gaussian", "name: none"))
    return [
        str(run),
        *{"port": ["--port", "0"], "host": ["--host", "192.0.2.1"], "few": ["--max-gaussians", "0"]}.get(how, []),
    ]


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ("missing", "There is no run folder"),
        ("no map", "There is no map"),
        ("no mapper", "has no map: its mapper (none) saves none"),
        ("port", "--port 0 must lie between 1 and 64000"),
        ("host", "--host 192.0.2.1 is no address of this machine"),
        ("few", "--max-gaussians 0 is too small"),
    ],
)
def test_what_can_not_be_shown(run: Path, capsys: pytest.CaptureFixture[str], how: str, text: str) -> None:
    pytest.importorskip("viser", **_VISER)
    assert main(["view", *spoilt(run, how)]) == 2
    said = capsys.readouterr().err
    assert text in " ".join(said.split())


def test_without_viser_it_says_how_to_install_it(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert main(["view", str(run)]) == 2
    assert "pip install 'bgs-slam-bench[viewer]'" in capsys.readouterr().err
