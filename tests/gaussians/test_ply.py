"""map.ply: the layout of the original 3DGS code, read here by plyfile and by hand, and the way back."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from bench.errors import BenchError
from bench.gaussians import ply
from bench.gaussians.parameters import NamedParameters, planes_from
from bench.gaussians.ply import read_ply, write_ply, write_ply_in_parts
from bench.gaussians.schema import HARMONICS, QUATERNION, column_names, planes_of

# The header of a point_cloud.ply that the original 3DGS code writes, for harmonics of degree 0.
STANDARD = [
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
]


def one_gaussian() -> torch.Tensor:
    """At (1, 2, 3), sigmas 0.1, 0.2, 0.4 m, quaternion (0, 3, 0, 4) (length 5), opacity 0.8, colour (1, 0.5, 0)."""
    return planes_from(
        torch.tensor([[1.0, 2.0, 3.0]]),
        torch.tensor([[0.1, 0.2, 0.4]]),
        torch.tensor([[0.0, 3.0, 0.0, 4.0]]),
        torch.tensor([0.8]),
        torch.tensor([[1.0, 0.5, 0.0]]),
    )


def test_columns_and_values_of_the_standard_layout(tmp_path: Path) -> None:
    write_ply(tmp_path / "map.ply", one_gaussian())
    header, _, body = (tmp_path / "map.ply").read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert [line for line in lines if line.startswith("property")] == [f"property float {name}" for name in STANDARD]
    assert "element vertex 1" in lines
    row = dict(zip(STANDARD, np.frombuffer(body, "<f4"), strict=True))
    assert [row[k] for k in ("x", "y", "z", "nx", "ny", "nz")] == [1, 2, 3, 0, 0, 0]
    # What a viewer does: sigmoid, exp, 0.5 + 0.2820948 f_dc, quaternion w x y z.
    assert 1 / (1 + np.exp(-row["opacity"])) == pytest.approx(0.8, rel=1e-6)
    np.testing.assert_allclose(np.exp([row[f"scale_{k}"] for k in range(3)]), [0.1, 0.2, 0.4], rtol=1e-6)
    np.testing.assert_allclose([0.5 + 0.28209479 * row[f"f_dc_{k}"] for k in range(3)], [1, 0.5, 0], atol=1e-6)
    np.testing.assert_allclose([row[f"rot_{k}"] for k in range(4)], [0, 0.6, 0, 0.8], atol=1e-7)


def test_round_trip(tmp_path: Path) -> None:
    planes = torch.randn(14, 100, generator=torch.Generator().manual_seed(0))
    write_ply(tmp_path / "map.ply", planes)
    back, _ = read_ply(tmp_path / "map.ply")
    same = [row for row in range(14) if row not in range(6, 10)]
    assert torch.equal(back[same], planes[same])
    torch.testing.assert_close(NamedParameters(back).quaternions, NamedParameters(planes).quaternions)
    assert PlyData.read(str(tmp_path / "map.ply"))["vertex"].count == 100


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_harmonics_are_written_channel_by_channel(tmp_path: Path, degree: int) -> None:
    """3DGS keeps all coefficients of red, then green, then blue; we keep them coefficient by coefficient."""
    each = (degree + 1) ** 2 - 1
    planes = torch.randn(14 + 3 * each, 5, generator=torch.Generator().manual_seed(0))
    write_ply(tmp_path / "map.ply", planes)
    vertex = PlyData.read(str(tmp_path / "map.ply"))["vertex"].data
    rest = [f"f_rest_{k}" for k in range(3 * each)]
    assert list(vertex.dtype.names) == [*STANDARD[:9], *rest, *STANDARD[9:]]
    for coefficient in range(1, each + 1):
        for channel in range(3):
            column = vertex[f"f_rest_{channel * each + coefficient - 1}"]
            np.testing.assert_array_equal(column, planes[14 + 3 * (coefficient - 1) + channel])
    back, _ = read_ply(tmp_path / "map.ply")
    assert torch.equal(back[14:], planes[14:])
    assert torch.equal(back[:6], planes[:6])


@pytest.mark.parametrize("degree", [0, 2])
@pytest.mark.parametrize("counts", [(), (0,), (64,), (3, 0, 100, 1), (65, 63)])
def test_parts_give_the_file_of_plyfile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, degree: int, counts: tuple[int, ...]
) -> None:
    monkeypatch.setattr(ply, "_ROWS", 32)
    random = torch.Generator().manual_seed(0)
    wide = torch.randn(planes_of(degree), 200, generator=random)
    ends = np.cumsum((0, *counts))
    parts = [wide[:, begin:end] for begin, end in pairwise(ends)]
    write_ply_in_parts(tmp_path / "parts.ply", iter(parts), int(ends[-1]), degree)
    whole = wide[:, : ends[-1]].contiguous()
    write_ply(tmp_path / "whole.ply", whole)
    columns = dict(zip(column_names(degree), whole.numpy(), strict=True))
    unit = torch.nn.functional.normalize(whole[QUATERNION], dim=0)
    columns |= {f"rot_{k}": unit[k].numpy() for k in range(4)}
    rest = [f"f_rest_{k}" for k in range(whole[HARMONICS].shape[0])]
    table = np.zeros(whole.shape[1], [(name, "<f4") for name in (*STANDARD[:9], *rest, *STANDARD[9:])])
    for name, values in columns.items():
        table[name] = values
    PlyData([PlyElement.describe(table, "vertex")], byte_order="<").write(str(tmp_path / "plyfile.ply"))
    files = [(tmp_path / f"{name}.ply").read_bytes() for name in ("parts", "whole", "plyfile")]
    assert files[0] == files[2]
    assert files[1] == files[2]


def test_parts_that_are_not_what_was_announced(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"has 5 Gaussians, and 6 were announced"):
        write_ply_in_parts(tmp_path / "map.ply", [torch.zeros(14, 5)], 6, 0)
    with pytest.raises(BenchError, match=r"a part of the map has 23 planes, not 14"):
        write_ply_in_parts(tmp_path / "map.ply", [torch.zeros(23, 5)], 5, 0)


def test_an_empty_map(tmp_path: Path) -> None:
    write_ply(tmp_path / "map.ply", torch.zeros(14, 0))
    assert read_ply(tmp_path / "map.ply")[0].shape == (14, 0)


def test_another_layout_is_refused(tmp_path: Path) -> None:
    points = np.zeros(2, dtype=[(name, "<f4") for name in ("x", "y", "z")])
    PlyData([PlyElement.describe(points, "vertex")]).write(str(tmp_path / "cloud.ply"))
    with pytest.raises(BenchError, match=r"cloud.ply is no 3DGS map: the columns scale_0, .* are missing"):
        read_ply(tmp_path / "cloud.ply")


@pytest.mark.parametrize("column", ["f_rest_0", "f_rest_8"])
def test_an_impossible_number_of_harmonics_is_refused(tmp_path: Path, column: str) -> None:
    table = np.zeros(2, dtype=[(name, "<f4") for name in (*STANDARD, column)])
    PlyData([PlyElement.describe(table, "vertex")]).write(str(tmp_path / "map.ply"))
    with pytest.raises(BenchError, match=r"has 1 columns f_rest_\*; a 3DGS map has one of 0, 9, 24, 45"):
        read_ply(tmp_path / "map.ply")


@pytest.mark.parametrize(
    ("damage", "text"),
    [
        (lambda content: content[:-30], "no PLY file, or damaged: .*early end-of-file"),
        (lambda content: content.replace(b"property float y", b"propertx float y"), "no PLY file, or damaged: line"),
        (lambda content: content.replace(b"property float y", b"prop\n\xd6rty float y"), "no PLY file, or damaged"),
        (lambda content: content.replace(b"vertex", b"vortex"), "no element 'vertex'"),
        (lambda content: content.replace(b"vertex 1\n", b"vertex 999999999999999\n"), "no PLY file, or damaged"),
        (lambda content: b"\x89PNG\r\n\x1a\n", "no PLY file, or damaged"),
        (lambda content: b"", "no PLY file, or damaged"),
        (lambda content: content[:-4] + np.float32("nan").tobytes(), "1 of 1 Gaussians .* rot_3 of Gaussian 0"),
        (lambda content: content.replace(b"property float y", b"property list uchar float y"), "map.ply"),
    ],
)
def test_damaged_files_are_named_in_one_sentence(tmp_path: Path, damage: Callable[[bytes], bytes], text: str) -> None:
    path = tmp_path / "map.ply"
    write_ply(path, one_gaussian())
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(BenchError, match=text):
        read_ply(path)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(BenchError, match=r"There is no map .*none.ply"):
        read_ply(tmp_path / "none.ply")
